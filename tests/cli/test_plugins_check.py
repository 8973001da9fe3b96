"""`tactile-loc plugins SLOT NAME --check`: contracts checked from the command line."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from cli_helpers import Cli, assert_refused, succeed
from message_helpers import missing
from strange_matchers import installed
from tactile_loc_cli.commands.plugins import plugins

from tactile_loc.slots import registry
from tactile_loc.slots.registry import ComponentSpec, hookimpl
from tactile_loc.testing import list_checks, list_properties

PARTS = """
import numpy as np
from pydantic import Field
from tactile_loc.plugin import ComponentOptions
from tactile_loc.plugins.matchers.dense import DenseMatcher

class Doubled(DenseMatcher):
    class Options(ComponentOptions):
        factor: float = Field(default=2.0, description="what scores are multiplied by")
    def scores(self, queries, weights=None):
        return (self.options.factor * super().scores(queries, weights)).astype("float32")

class Raising(DenseMatcher):
    def scores(self, queries, weights=None):
        return {}["key"]

class Uneven(DenseMatcher):
    def scores(self, queries, weights=None):
        along = np.arange(len(self._bank), dtype="float32")
        return super().scores(queries, weights) - 1e-3 * (queries[:, :1] > 0) * along

class Unmade(DenseMatcher):
    def __init__(self, options=None):
        raise OSError("no licence")
"""


class Stranger:
    """The entry point of a plugin that offers the matchers above."""

    name = value = "strange"
    group = registry.PROJECT
    dist = SimpleNamespace(name="strange-matchers")

    def load(self) -> Any:
        specs = [
            ComponentSpec("matcher", name.lower(), f"strange_parts:{name}", "made up", interface=2)
            for name in ("Doubled", "Raising", "Uneven", "Unmade")
        ]
        return SimpleNamespace(tactile_loc_components=hookimpl(lambda: specs))


@pytest.fixture
def strange(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install only the matchers above."""
    (tmp_path / "strange_parts.py").write_text(PARTS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(registry, "registry", lambda: registry.Registry([Stranger()]))


def test_a_built_in_component_passes_and_the_properties_option_adds_properties(cli: Cli):
    done = succeed(cli("plugins", "matcher", "dense", "--check"))
    heading, *lines, summary = done.stdout.splitlines()
    assert heading.startswith("matcher dense of tactile-loc: ")
    checks = list_checks(registry.registry().create("matcher", "dense"))
    assert lines == [f"ok      {check.name}" for check in checks]
    assert summary.startswith(f"{len(checks)} of {len(checks)} ")
    done = succeed(cli("plugins", "fuser", "product", "--check", "--properties"))
    component = registry.registry().create("fuser", "product")
    chosen = [*list_checks(component), *list_properties(component)]
    assert done.stdout.splitlines()[1:-1] == [f"ok      {check.name}" for check in chosen]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["uneven", "--check", "--properties"], r"FAILED  property_any_space: .*seed=.*"),
        (["raising", "--check"], r"FAILED  check_definition: KeyError: 'key' \(strange_parts\.py, line 15\)"),
    ],
)
def test_a_failure_names_its_case_or_exception_in_one_line(cli, strange, words, told):
    done = cli("plugins", "matcher", *words)
    assert done.exit_code == 1
    assert len([line for line in done.stdout.splitlines() if re.fullmatch(told, line)]) == 1


def test_a_broken_plugin_fails_with_exit_code_1(cli, strange):
    done = cli("plugins", "matcher", "doubled", "--check")
    assert done.exit_code == 1
    lines = {line.split()[1].rstrip(":"): line for line in done.stdout.splitlines()[1:-1]}
    assert lines["check_definition"].startswith("FAILED  check_definition: ")
    assert "||query - row||^2" in lines["check_definition"]
    assert lines["check_output"] == "ok      check_output"
    failed = sum(line.startswith("FAILED") for line in lines.values())
    assert not missing(done.stdout.splitlines()[-1], f"{len(lines) - failed} of {len(lines)}", f"{failed} failed")
    assert "Traceback" not in done.output


def test_options_reach_the_checked_component(cli, strange):
    assert cli("plugins", "matcher", "doubled", "--check", "-o", "matcher.factor=1").exit_code == 0
    assert_refused(cli("plugins", "matcher", "doubled", "--check", "-o", "matcher.factr=1"), "'factor'")


def test_a_component_that_fails_to_initialize_is_one_sentence(cli, strange):
    assert_refused(cli("plugins", "matcher", "unmade", "--check"), "'unmade'", "OSError: no licence")


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        (["--check"], ["--check"]),
        (["matcher", "--check"], ["--check"]),
        (["grid", "face", "-o", "grid.spacing_mm=3"], ["--check"]),
        (["matcher", "dense", "--check", "-o", "grid.spacing_mm=3"], ["'dense'", "grid"]),
        (["matcher", "dens", "--check"], ["'dense'"]),
        (["fuser", "product", "--properties"], ["--properties", "--check"]),
    ],
)
def test_a_check_needs_one_component_and_its_own_options(cli, words, mentioned):
    assert_refused(cli("plugins", *words), *mentioned)


def test_the_list_names_plugins_of_other_interfaces(cli):
    with installed():
        done = cli("plugins", "matcher")
    told = [line for line in done.stdout.splitlines() if line.startswith("interface: ")]
    assert [line.split("'")[1] for line in told] == ["behind", "ahead"]
    assert not missing(told[0], "was written for plugin interface 1", "this tactile-loc has 2")
    assert "pip install --upgrade tactile-loc" in told[1]
    assert [line for line in cli("plugins").stdout.splitlines() if line.startswith("interface: ")] == []


def test_the_command_returns_components_options_and_checks(strange):
    listed = plugins("matcher")
    about = {"name": "doubled", "distribution": "strange-matchers", "summary": "made up", "interface": 2}
    assert listed["components"][0] == {"slot": "matcher", **about}
    assert listed["conflicts"] == listed["not_loaded"] == []
    (option,) = plugins("matcher", "doubled")["options"]
    meaning = "what scores are multiplied by"
    assert option == {"option": "matcher.factor", "type": "float", "default": "2.0", "meaning": meaning}
    sound = plugins("matcher", "doubled", True, ["matcher.factor=1"])
    assert (sound["options"], sound["failed"]) == ({"factor": 1.0}, 0)
    with pytest.raises(typer.Exit) as ended:
        plugins("matcher", "doubled", True)
    outcome = ended.value.result
    assert outcome["failed"] > 0
    assert outcome["passed"] + outcome["failed"] == len(outcome["checks"])
    assert {c["name"] for c in outcome["checks"] if not c["passed"]} >= {"check_definition"}
