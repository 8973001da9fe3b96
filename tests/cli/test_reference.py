"""docs/cli.md matches the program."""

from pathlib import Path

import pytest
from tactile_loc_cli import ANNEXES
from tactile_loc_cli.main import app
from tactile_loc_cli.reference import INTRODUCTION, main, make_reference
from typer.main import get_command

from tactile_loc.io.config import RunConfig
from tactile_loc.io.toml import read_toml


def test_the_page_is_up_to_date():
    for annex in ANNEXES.values():
        pytest.importorskip(annex.replace("-", "_"))
    page = Path(__file__).parents[2] / "docs" / "cli.md"
    assert page.read_text() == make_reference(), "run python -m tactile_loc_cli.reference"


def test_the_page_is_not_written_without_a_package_with_commands(monkeypatch):
    page = Path(__file__).parents[2] / "docs" / "cli.md"
    before = page.read_text()
    monkeypatch.setitem(ANNEXES, "sing", "tactile-loc-choir")
    with pytest.raises(SystemExit):
        main()
    assert page.read_text() == before


def test_the_configuration_on_the_page_is_valid(tmp_path):
    toml = INTRODUCTION.split("```toml\n")[1].split("```")[0]
    (tmp_path / "as-it-is.toml").write_text(toml)
    assert RunConfig.from_toml(tmp_path / "as-it-is.toml").grid.options == {"spacing_mm": 3.0}
    (tmp_path / "all.toml").write_text(toml.replace("\n# ", "\n"))
    settings = read_toml(tmp_path / "all.toml")
    assert RunConfig.from_dict(settings).touch.press_depth_mm == 1.5


def list_commands(command, words=()):
    """Yield the words of every command below a command, and the command."""
    yield words, command
    for name, one in getattr(command, "commands", {}).items():
        yield from list_commands(one, (*words, name))


def test_each_command_that_reads_photos_takes_a_newer_image_of_the_untouched_gel():
    flags = {
        words: {flag for parameter in command.params for flag in parameter.opts}
        for words, command in list_commands(get_command(app))
    }
    readers = {words for words, known in flags.items() if {"--sensor", "--touch-kind"} <= known}
    assert {("run",), ("replay",), ("identify",), ("mount",)} <= readers
    assert [words for words in readers if "--zero" not in flags[words]] == []
