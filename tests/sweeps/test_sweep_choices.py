"""What tells choices of a slot apart, and how they are called."""

from __future__ import annotations

from tactile_loc.io.config import SlotConfig
from tactile_loc.sweeps.choices import label, varied_options


def choice(name: str, **options: object) -> SlotConfig:
    return SlotConfig(name=name, options=options)


def test_an_option_varies_only_within_a_component():
    choices = [choice("icp", rounds=3, points=9), choice("icp", rounds=5, points=9), choice("render", rounds=7)]
    assert varied_options(choices) == ["rounds"]
    assert varied_options(choices[::2]) == []


def test_a_label_says_what_varies():
    assert label(choice("icp", rounds=3, points=9), ["rounds"]) == "icp rounds=3"
    assert label(choice("face", spacing_mm=4.0, face="auto"), ["spacing_mm", "face"]) == "face spacing_mm=4 face=auto"
    assert label(choice("none"), ["rounds"]) == "none"
    assert (
        label(choice("file", path="/far/away/mine.toml", flat=True), ["path", "flat"])
        == "file path=mine.toml flat=true"
    )
