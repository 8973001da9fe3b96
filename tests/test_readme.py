"""The README's commands and links exist, and its Python example runs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.main import get_command

from tactile_loc import StageStore
from tactile_loc.locate.localizer import Localizer

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def commands(program: str) -> list[list[str]]:
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [w[1:] for w in words if w and w[0] == program]


def test_the_python_example_runs(monkeypatch, tmp_path, capsys):
    original = Localizer.create.__func__
    coarse = {"store": StageStore(tmp_path), "grid": {"name": "face", "spacing_mm": 8.0}, "temperature": 0.05}
    monkeypatch.setattr(Localizer, "create", classmethod(lambda cls, *a, **k: original(cls, *a, **{**k, **coarse})))
    (example,) = blocks("python")
    exec(compile(example, "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert lines
    assert all(
        re.fullmatch(r" *[\d.]+%  at -?[\d.]+, -?[\d.]+, -?[\d.]+ mm  \(imprint IoU \d+%\)", line) for line in lines
    )


@pytest.mark.parametrize("words", commands("tactile-loc"), ids=" ".join)
def test_every_command_in_the_readme_is_valid(words):
    from tactile_loc_cli.main import app

    group = get_command(app)
    command = group.commands[words[0]]
    command.make_context(words[0], list(words[1:]))  # raises on an option that does not exist


def test_every_make_target_in_the_readme_exists():
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    shown = {w[0] for w in commands("make")} | set(re.findall(r"`make ([a-z]+)`", README))
    assert shown <= set(targets)


def test_links_and_pictures_exist():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_table_of_components_matches_the_registry():
    from tactile_loc.slots.registry import BUILT_IN, SLOTS, registry

    for slot in SLOTS:
        (row,) = re.findall(rf"^\| {slot} \| (.*) \|$", README, re.MULTILINE)
        own = {c.spec.name for c in registry().components if c.spec.slot == slot and c.distribution == BUILT_IN}
        assert set(re.findall(r"`([\w-]+)`", row)) == own
