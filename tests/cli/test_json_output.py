"""--json: stdout contains exactly one document, also when the command fails."""

import json
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
import rich
import typer
from cli_helpers import TINY, succeed
from message_helpers import naming
from press_sets import ball_set
from tactile_loc_cli import console
from tactile_loc_cli.command import make_command
from tactile_loc_cli.main import app
from tactile_loc_cli.options import RunOptions, Takes
from typer.testing import CliRunner

from tactile_loc.plugins.refiners.none import NoRefiner
from tactile_loc.store.store import StageStore

PIN = ["--object", "pin", *TINY]


@pytest.fixture
def document(cli):
    """Run a command with --json, require success, and return its document."""

    def run(*words: object) -> dict:
        done = succeed(cli(*words, "--json"))
        return parsed(done.stdout)

    return run


def parsed(stdout: str) -> dict:
    """The single JSON object in stdout; NaN and infinity are refused."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not valid JSON")

    value = json.loads(stdout, parse_constant=refuse)
    assert isinstance(value, dict)
    return value


def commands() -> dict[str, typer.core.TyperCommand]:
    """Every command by its words, including commands of groups."""
    found = {}
    for name, command in typer.main.get_command(app).commands.items():
        parts = getattr(command, "commands", None)
        found |= {f"{name} {part}": c for part, c in parts.items()} if parts else {name: command}
    return found


@pytest.mark.parametrize("words", commands())
def test_every_command_has_the_shared_options(cli, words):
    text = cli(*words.split(), "-h").stdout
    assert all(option in text for option in ("--json", "-v, --verbose", "-q, --quiet"))


def test_build_and_store_report_object_grid_stages_entries_and_bytes(document, tmp_path):
    store = tmp_path / "store"
    found = document("build", *PIN, "--store", store)
    assert (found["object"]["name"], found["object"]["symmetry"]) == ("pin", "z2")
    assert max(found["object"]["size_m"]) == pytest.approx(0.031, abs=1e-3)
    assert found["grid"]["mean_spacing_m"] == pytest.approx(0.008, rel=0.15)
    assert set(found["stages"].values()) == {"built"}
    assert set(document("build", *PIN, "--store", store)["stages"].values()) == {"reused"}
    assert found["store"] == str(store)
    entries = document("store", "list", "--store", store)["entries"]
    assert {entry["digest"] for entry in entries} == {entry.digest for entry in StageStore(store).entries()}
    assert document("store", "size", "--store", store)["bytes"] == sum(entry["bytes"] for entry in entries)
    pruned = document("store", "prune", "--all", "--yes", "--store", store)
    assert pruned["bytes"] == sum(entry["bytes"] for entry in entries)


def test_simulate_reports_touches_images_and_poses(document):
    found = document("simulate", *PIN, "--count", 2, "--images", "--out", "out")
    assert found["press_depth_m"] == pytest.approx(2e-3)
    for touch, image in zip(found["touches"], found["images"], strict=True):
        assert Path(image).is_file()
        with np.load(touch) as stored:
            assert stored["T_sensor_object"].tolist() == found["T_sensor_object"][Path(touch).stem]


def test_run_reports_its_result_file(document):
    found = document("run", *PIN, "--out", "out")
    stored = json.loads(Path("out/result.json").read_text())
    assert {key: found[key] for key in stored} == stored
    assert all(Path(path).is_file() for path in found["written"])


def test_calibrate_reports_angles_in_radians(document):
    presses = ball_set(6).write(Path("presses"))
    found = document("calibrate", presses, "-o", "steps=5", "--out", "mine")
    errors = json.loads(Path("mine/calibration.json").read_text())["held_out"]["mean"]
    assert found["held_out"]["mean_errors"]["slope_rad"] == pytest.approx(np.radians(errors["slope_deg"]))
    assert "slope_deg" not in found["held_out"]["mean_errors"]
    assert Path(found["picture"]).is_file()


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (["run", *PIN, "--touch", "none.npz"], "TouchError"),
        (["build", "--object", "pinn"], "ObjectError"),
        (["run", "--refiner", "ipc"], "UnknownPluginError"),
        (["run", "--objct", "pin"], "UsageError"),
        (["rnu"], "UsageError"),
        (["store"], "UsageError"),
        (["objects", "store"], "UsageError"),
    ],
)
def test_an_error_is_a_document_and_stderr_is_unchanged(cli, words, kind):
    plain, done = cli(*words), cli(*words, "--json")
    assert (done.exit_code, plain.exit_code) == (2, 2)
    error = parsed(done.stdout)["error"]
    assert error["kind"] == kind
    if words[0] not in ("rnu", "store"):  # without a valid command, --json belongs to no command
        assert done.stderr == plain.stderr
    assert f"error: {error['message']}\n" in done.stderr
    assert plain.stdout == ""


@pytest.mark.parametrize(
    ("raised", "kind", "code"),
    [(ZeroDivisionError("so"), "ZeroDivisionError", 1), (KeyboardInterrupt(), "Interrupted", 130)],
)
def test_an_unexpected_error_or_interruption_is_a_document(cli, monkeypatch, raised, kind, code):
    def fail(*_):
        raise raised

    monkeypatch.setattr(NoRefiner, "refine", fail)
    done = cli("run", *PIN, "--refiner", "none", "--json")
    assert done.exit_code == code, done.stderr
    assert parsed(done.stdout)["error"]["kind"] == kind


def test_stdout_contains_only_the_document():
    """A command from make_command prints and returns a document, another returns nothing."""
    made = typer.Typer()

    def talk() -> dict:
        console.say("a line")
        console.say_table([["a", "b"]])
        rich.print("rich")
        sys.stdout.write("a stranger\n")
        sys.stderr.write("on stderr\n")
        return {"path": Path("a"), "nan": float("nan"), "array": np.arange(2), "one": np.float32(1), "nested": ((), {})}

    made.command("talk")(make_command(talk))
    made.command("quiet")(make_command(lambda: None))
    done = CliRunner().invoke(made, ["talk", "--json"])
    expected = {"path": "a", "nan": None, "array": [0, 1], "one": 1.0, "nested": [[], {}]}
    assert parsed(done.stdout) == expected
    assert done.stderr == "on stderr\n"
    assert CliRunner().invoke(made, ["talk"]).stdout == "a line\na b\nrich\na stranger\n"
    assert parsed(CliRunner().invoke(made, ["quiet", "--json"]).stdout) == {}


def test_only_declared_options_can_be_taken():
    def paint(given: Annotated[RunOptions, Takes("object", "colour")]) -> None:
        console.say(str(given))

    with pytest.raises(ValueError, match=naming("RunOptions", "colour")):
        make_command(paint)
