"""The commands `store list`, `store size` and `store prune`."""

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import assert_refused, succeed
from filelock import FileLock
from message_helpers import missing, naming
from tactile_loc_cli.commands.store import parse_age, write_age
from tactile_loc_cli.main import app
from typer.testing import CliRunner

from tactile_loc import StageKey, StageStore
from tactile_loc.plugin import ConfigError

DAY_S = 86400
OBJECT = {"mesh": "ab12cd34" + "0" * 56, "symmetry": "z2", "centre_m": [0, 0, 0]}
GRID = StageKey("grid", 1, {"object": OBJECT, "sampler": {"class": "tactile_loc.plugins.grids.face:FaceGrid"}})
RAYCAST = {"class": "tactile_loc.plugins.renderers.raycast:RaycastRenderer"}
SHAPES = StageKey("shapes", 1, {"grid": GRID.digest, "renderer": RAYCAST})
PIXEL = {"class": "tactile_loc.plugins.encoders.pixel:PixelEncoder"}
ENCODED = {"shapes": SHAPES.digest, "encoder": PIXEL, "trained": ""}
BANKS = [StageKey("bank", 1, {**ENCODED, "press_depth_m": press_m}) for press_m in (0.001, 0.002)]


@pytest.fixture
def place(tmp_path) -> Path:
    """A store of five entries: grid (40 days old), shapes (20), banks (10 and 0) and an interrupted build (30)."""
    root = tmp_path / "place"
    store = StageStore(root)
    for key, days in zip([GRID, SHAPES, *BANKS], [40, 20, 10, 0], strict=True):
        artifact = store.build(key, lambda work: work.save_array("numbers", np.arange(100)))
        age(artifact.path / "manifest.json", days)
    left = root / "encoder" / "0123456789abcdef.partial"
    left.mkdir(parents=True)
    (left / "checkpoint.safetensors").write_bytes(b"x" * 500)
    age(left, 30)
    return root


def age(path: Path, days: float) -> None:
    os.utime(path, (time.time() - days * DAY_S,) * 2)


def held(root: Path) -> set[str]:
    return {f"{entry.stage} {entry.digest}" for entry in StageStore(root).entries()}


def called(key: StageKey) -> str:
    return f"{key.stage} {key.short}"


LEFT = "encoder 0123456789abcdef"
ALL = {LEFT, *(called(key) for key in (GRID, SHAPES, *BANKS))}


@pytest.fixture
def ask(cli, place) -> Callable:
    """Return a function that runs a `store` command."""
    return lambda *words: cli("store", *words, "--store", place)


def test_a_missing_default_store_counts_as_empty(cli, tmp_path, monkeypatch):
    monkeypatch.setenv("TACTILE_LOC_STORE", str(tmp_path / "nowhere"))
    for words in (["list"], ["size"], ["prune", "--all", "--yes"]):
        done = succeed(cli("store", *words))
        assert "0 entries, 0 B" in done.stdout
    assert not (tmp_path / "nowhere").exists()


def test_a_chosen_store_must_be_a_folder(cli, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    for name in ("nowhere", "file"):
        for words in (["list"], ["size"], ["prune", "--all", "--yes"]):
            done = cli("store", *words, "--store", tmp_path / name, "--json")
            assert done.exit_code == 2
            assert json.loads(done.stdout)["error"]["kind"] == "StoreError"
            assert not missing(done.stderr, tmp_path / name, "--store")
    monkeypatch.setenv("TACTILE_LOC_STORE", str(tmp_path / "file"))
    assert cli("store", "list").exit_code == 2
    assert not (tmp_path / "nowhere").exists()


def test_the_list_names_the_inputs_of_each_stage(ask):
    entries = json.loads(ask("list", "--json").stdout)["entries"]
    made_from = {f"{e['stage']} {e['digest']}": e["made_from"] for e in entries}
    grid = {"object": "mesh ab12cd34 (z2)", "grid": "face"}
    assert made_from[called(GRID)] == grid
    assert made_from[called(SHAPES)] == {**grid, "renderer": "raycast"}
    assert made_from[called(BANKS[0])] == {**grid, "renderer": "raycast", "encoder": "pixel"}
    assert made_from[LEFT] == {}
    assert [e["stage"] for e in entries] == ["grid", "encoder", "shapes", "bank", "bank"]  # newest last
    assert entries[0]["age_s"] == pytest.approx(40 * DAY_S, abs=600)


def test_the_list_names_the_object(cli):
    cli("build", "--object", "pin", "--grid", "face", "-o", "grid.spacing_mm=8", "--store", "named")
    entries = json.loads(cli("store", "list", "--json", "--store", "named").stdout)["entries"]
    assert {entry["made_from"]["object"] for entry in entries} == {"pin"}


def test_the_printed_list_is_grouped_by_object(ask, place):
    """The object of the newest entry comes last, and so does the newest entry of each object."""
    build = StageStore(place).build
    other = build(StageKey("grid", 1, {"object": OBJECT}, "pin"), lambda work: work.save_json("made", 1))
    age(other.path / "manifest.json", 35)
    lines = [line.split() for line in ask("list").stdout.splitlines()]
    assert [line[0] for line in lines[1:7]] == ["pin", "unknown", "mesh", "shapes", "bank", "bank"]
    assert [line[:4] for line in lines[3:4]] == [["mesh", "ab12cd34", "(z2)", "grid"]]


def test_a_damaged_manifest_is_listed_as_damaged(ask, place):
    manifest = place / "grid" / GRID.short / "manifest.json"
    manifest.write_text(manifest.read_text().replace("z2", "z3"))
    entries = {e["stage"]: e for e in json.loads(ask("list", "--json").stdout)["entries"]}
    assert (entries["grid"]["state"], entries["grid"]["made_from"]) == ("damaged", {})
    assert entries["shapes"]["made_from"] == {"renderer": "raycast"}


def test_circular_inputs_do_not_hang_the_list(ask, place, monkeypatch):
    from tactile_loc_cli.commands import store

    monkeypatch.setattr(store, "_read_inputs", lambda entry: {"itself": GRID.digest, "other": SHAPES.digest})
    assert ask("list").exit_code == 0


def test_size_is_reported_by_stage(ask, place):
    found = json.loads(ask("size", "--json").stdout)
    files = [path for path in place.glob("*/*/**/*") if path.is_file()]
    assert found["bytes"] == sum(path.stat().st_size for path in files)
    assert found["stages"]["bank"]["entries"] == 2
    assert found["stages"]["encoder"] == {"entries": 1, "incomplete": 1, "bytes": 500}
    assert found["bytes"] == sum(stage["bytes"] for stage in found["stages"].values())


@pytest.mark.parametrize(
    ("words", "removed"),
    [
        (["--all"], ALL),
        (["--older-than", "25d"], {called(GRID), LEFT}),
        (["--older-than", "0s"], ALL),
        (["--older-than", "6w"], set()),
        (["--stage", "bank"], {called(key) for key in BANKS}),
        (["--stage", "bank", "--stage", "grid"], {called(key) for key in (GRID, *BANKS)}),
        (["--stage", "bank", "--older-than", "240h"], {called(BANKS[0])}),
        (["--incomplete"], {LEFT}),
        (["--incomplete", "--older-than", "35d"], set()),
        (["--keep-newest", 1], {called(BANKS[0]), LEFT}),
        (["--keep-newest", 1, "--stage", "bank"], {called(BANKS[0])}),
        (["--keep-newest", 2, "--stage", "bank"], set()),
    ],
)
def test_pruning_removes_entries_that_meet_all_conditions(ask, place, words, removed):
    dry = ask("prune", *words, "--dry-run")
    assert held(place) == ALL
    done = ask("prune", *words, "--yes", "--json")
    assert done.exit_code == dry.exit_code == 0, done.stderr
    assert held(place) == ALL - removed
    found = json.loads(done.stdout)
    assert {f"{e['stage']} {e['digest']}" for e in found["removed"]} == removed
    assert found["left_alone"] == []
    for name in removed:
        assert name in dry.stdout
    assert f"{len(removed)} entr" in dry.stdout


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        ([], ["--older-than", "--all"]),
        (["--yes"], ["--stage"]),
        (["--dry-run"], ["--incomplete"]),
        (["--all", "--incomplete"], ["--all"]),
        (["--stage", "banks"], ["'banks'", "bank", "encoder", "grid", "shapes"]),
        (["--older-than", "soon"], ["'soon'", "30d"]),
        (["--older-than", "-3d"], ["-3d"]),
        (["--older-than", "9" * 30 + "d"], ["--older-than", "9" * 30 + "d"]),
        (["--keep-newest", 0], ["--keep-newest"]),
        (["--all"], ["--yes", "--dry-run"]),
    ],
)
def test_invalid_conditions_and_a_missing_confirmation_are_refused(ask, place, words, mentioned):
    assert_refused(ask("prune", *words), *mentioned)
    assert held(place) == ALL


@pytest.mark.parametrize(("answer", "left"), [("y\n", set()), ("n\n", ALL), ("\n", ALL)])
@pytest.mark.parametrize("as_json", [True, False])
def test_pruning_on_a_terminal_asks_for_confirmation(place, monkeypatch, answer, left, as_json):
    monkeypatch.setattr("tactile_loc_cli.commands.store._is_terminal", lambda: True)
    line = ["store", "prune", "--all", "--store", str(place), *(["--json"] if as_json else [])]
    done = CliRunner().invoke(app, line, input=answer, prog_name="tactile-loc")
    assert done.exit_code == 0, done.stderr
    assert not missing(done.stderr, "5 entries")
    assert held(place) == left
    if as_json:
        assert len(json.loads(done.stdout)["removed"]) == 5 - len(left)


def test_pruning_keeps_and_reports_entries_being_built(ask, place):
    with FileLock(place / "encoder" / "0123456789abcdef.lock"):
        entries = {e["stage"]: e for e in json.loads(ask("list", "--json").stdout)["entries"]}
        assert entries["encoder"]["state"] == "being built"
        done = ask("prune", "--all", "--yes")
        assert done.exit_code == 0, done.stderr
        assert LEFT in done.stdout
        assert held(place) == {LEFT}
        found = json.loads(ask("prune", "--all", "--yes", "--json").stdout)
        assert (found["removed"], [e["stage"] for e in found["left_alone"]]) == ([], ["encoder"])
    assert ask("prune", "--all", "--yes").exit_code == 0
    assert held(place) == set()


def test_pruning_keeps_entries_that_another_process_locks(ask, place, monkeypatch):
    with FileLock(place / "grid" / f"{GRID.short}.lock"):
        monkeypatch.setattr(StageStore, "is_being_built", _free_at_first())
        done = ask("prune", "--stage", "grid", "--yes")
    assert done.exit_code == 0, done.stderr
    assert called(GRID) in held(place)
    assert not missing(done.stdout, "0 entries", "0 B")


def _free_at_first() -> Callable:
    """Return a stand-in for is_being_built whose first answer is False."""
    asked = StageStore.is_being_built
    calls: list[int] = []

    def answer(self, entry):
        calls.append(1)
        return len(calls) > 1 and asked(self, entry)

    return answer


def test_ages_are_parsed_and_written():
    for text, seconds in {"90s": 90, "1.5h": 5400, "2d": 172800, "1w": 604800, " 3M ": 180}.items():
        assert parse_age(text).total_seconds() == seconds
    for text in ("", "d", "3", "3y", "-1d", "nan d"):
        with pytest.raises(ConfigError, match=naming(repr(text), "--older-than", "30d")):
            parse_age(text)
    written = {-1: "0 s", 0: "0 s", 119: "119 s", 120: "2 min", 3 * 3600: "3 h", 47 * 3600: "47 h", 49 * 3600: "2 d"}
    assert {seconds: write_age(seconds) for seconds in written} == written
