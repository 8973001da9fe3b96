"""The contract checks of commands: the built-in commands pass, and each check can fail."""

import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest
from message_helpers import missing

from tactile_loc.plugin import CommandSpec, registry
from tactile_loc.testing import list_properties, parametrize_with_checks
from tactile_loc.testing.running import run_checks

SOUND = '''
from typing import Annotated
from tactile_loc.commands import RunOptions, Takes, declare

def bow(given: Annotated[RunOptions, Takes("object")], deep: Annotated[bool, declare("--deep", "Very.")] = False):
    """Bow."""
'''


@parametrize_with_checks([offered.spec for offered in registry().commands])
def test_the_installed_commands_pass(component, check):
    check(component)


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., CommandSpec]:
    """Write a module with the source of a command, and return the command's spec."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    def spec(source: str, summary: str = "Bow.", target: str = "bow") -> CommandSpec:
        module = f"{tmp_path.name.replace('-', '_')}_polite"
        (tmp_path / f"{module}.py").write_text(textwrap.dedent(source))
        return CommandSpec("bow", summary, f"{module}:{target}")

    return spec


def test_a_sound_command_passes_and_has_no_properties(write):
    spec = write(SOUND)
    assert [result.problem for result in run_checks(spec, properties=True) if not result.passed] == []
    assert list_properties(spec) == []


@pytest.mark.parametrize(
    ("failing", "change", "named"),
    [
        ("check_target", {"target": "bows"}, ["AttributeError"]),
        ("check_target", {"source": "import typer\nbow = typer.Typer()"}, ["@application.command()"]),
        ("check_target", {"source": "import nobody_has_this\n"}, ["pip install nobody_has_this"]),
        ("check_summary", {"summary": "bow"}, ["'bow'"]),
        ("check_help", {"summary": "Bow low."}, ["'Bow low.'", "'Bow.'"]),
        ("check_help", {"source": SOUND.replace('"""Bow."""', "return {}")}, ["docstring"]),
        ("check_options_are_described", {"source": SOUND.replace("deep:", "low=1, deep:")}, ["low"]),
        ("check_options_are_described", {"source": SOUND.replace('"Very."', "None")}, ["deep"]),
        ("check_shared_options", {"source": SOUND.replace("--deep", "--json")}, ["--json"]),
        ("check_import_is_light", {"source": SOUND + "import trimesh"}, ["trimesh"]),
    ],
)
def test_each_check_can_fail(write, failing, change, named):
    problems = {result.name: result.problem for result in run_checks(write(**{"source": SOUND, **change}))}
    assert not missing(problems[failing], *named)
