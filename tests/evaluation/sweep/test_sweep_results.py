"""The Markdown tables for a paper."""

from __future__ import annotations

import json

import pytest
from message_helpers import missing, naming

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.evaluation.sweep.results import format_summary, read_sweep

MM = {("pin", "none"): 4.0, ("pin", "icp"): 0.5, ("head", "none"): 2.0, ("head", "icp"): 2.0001}


def measure(one):
    base = MM[one.object, one.config.refiner.name]
    return {"chosen_median_mm": base * (1 if one.config.touch.noise == "none" else 2)}


def test_each_noise_has_a_table_with_the_best_values_in_bold(made_up):
    text = format_summary(
        made_up({"object": ["pin", "head"], "refiner": ["none", "icp"], "noise": ["none", "mild"]}, measure), "chosen"
    )
    first, second = text.split("## Noise: ")[1:]
    rows = ["| components | pin | head |", "| --- | --- | --- |", "| none | 4.00 | **2.00** |"]
    assert first.strip().splitlines() == ["none", "", *rows, "| icp | **0.500** | **2.00** |"]
    assert "| icp | **1.00** | **4.00** |" in second
    assert not missing(text, "gelslim", "heightmap", "face", "pixel", "dense", "product")


def test_failed_rows_show_their_errors(made_up):
    sweep = made_up(
        {"object": ["pin", "head"], "refiner": ["none", "icp"]},
        lambda one: (
            "TypeError: no" if one.object == "head" and one.config.refiner.name == "icp" else {"reg-1_median_mm": 1.0}
        ),
    )
    text = format_summary(sweep, "reg-1")
    assert "| icp | **1.00** | failed |" in text
    assert "1 of 4" in text
    assert text.endswith(
        "- head, gelslim, heightmap, face, pixel, dense, icp, product, noise strong, seed 0: TypeError: no\n"
    )


def test_a_sweep_without_variation_names_its_components(made_up):
    assert "| pixel + joint | **1.00** |" in format_summary(
        made_up({"object": "pin"}, lambda one: {"chosen_median_mm": 1.0}), "chosen"
    )


@pytest.mark.parametrize("rows", [[], [{}], [{"configuration": {}}], 3, [[]], ["\ud800"]])
def test_an_invalid_sweep_file_is_refused(tmp_path, rows):
    (tmp_path / "sweep.json").write_text(json.dumps({"rows": rows, "versions": {}}))
    with pytest.raises(ConfigError, match=naming(tmp_path / "sweep.json")):
        read_sweep(tmp_path)
