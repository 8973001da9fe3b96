import json
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from store_helpers import KEY, Five, folder_of, forbidden, run_python

from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore, find_root
from tactile_loc.store.workspace import Workspace


def test_a_stage_is_built_once_and_then_read(store):
    five = Five()
    built = store.build(KEY, five)
    again = store.build(StageKey("bank", 1, {"step_m": 0.002, "grid": "abc"}), forbidden)
    assert five.computed == [0, 1, 2, 3, 4]
    assert store.built == [KEY]
    assert again == built
    assert StageStore(store.root).get(KEY) == built


def test_an_artifact_returns_the_saved_values(store):
    arrays = {
        "f32": np.arange(6, dtype=np.float32).reshape(2, 3),
        "empty": np.zeros((0, 4)),
        "scalar": np.array(3),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "flags": np.array([True, False]),
    }

    def make(workspace: Workspace) -> None:
        for name, array in arrays.items():
            workspace.save_array(name, array)
        workspace.save_file("both.npz", lambda path: np.savez(path, a=arrays["f32"]))

    artifact = store.build(KEY, make)
    for name, array in arrays.items():
        for mmap in (True, False):
            found = artifact.load_array(name, mmap=mmap)
            assert found.dtype == array.dtype
            np.testing.assert_array_equal(found, array)
    assert isinstance(artifact.load_array("f32"), np.memmap)
    assert not isinstance(artifact.load_array("f32", mmap=False), np.memmap)
    with pytest.raises(ValueError, match="read-only"):
        artifact.load_array("f32")[0, 0] = 1
    np.testing.assert_array_equal(np.load(artifact.find_file("both.npz"))["a"], arrays["f32"])
    assert artifact.names == ("both.npz", *sorted(f"{name}.npy" for name in arrays))
    assert artifact.nbytes == sum(artifact.find_file(name).stat().st_size for name in artifact.names)


def test_the_folder_holds_only_the_kept_pieces_and_the_manifest(store):
    def make(workspace: Workspace) -> None:
        Five()(workspace)
        (workspace.path / "scratch").mkdir()
        (workspace.path / "scratch" / "notes.txt").write_text("x")

    artifact = store.build(KEY, make)
    assert artifact.names == ("meta.json", "piece0.npy", "piece1.npy", "piece2.npy", "sum.npy")
    assert artifact.path == folder_of(store)
    assert {path.name for path in artifact.path.iterdir()} == {*artifact.names, "manifest.json"}
    assert (artifact.path / "meta.json").read_text() == '{\n "a": [\n  1.5,\n  null\n ],\n "n": 5\n}\n'
    assert artifact.load_json("meta") == {"n": 5, "a": [1.5, None]}
    manifest = json.loads((artifact.path / "manifest.json").read_text())
    assert manifest["inputs"] == KEY.inputs
    assert (manifest["stage"], manifest["version"]) == ("bank", 1)
    assert set(manifest["files"]["sum.npy"]) == {"size", "sha256"}


def test_a_label_is_stored_and_is_not_part_of_the_key(store):
    named = StageKey(KEY.stage, KEY.version, KEY.inputs, label="pin")
    assert named == KEY
    assert store.build(named, Five()).key.label == "pin"
    assert store.build(KEY, forbidden).key.label == "pin"


def test_a_missing_file_of_an_artifact_is_refused_with_the_existing_files(store):
    artifact = store.build(KEY, Five())
    with pytest.raises(StoreError, match=naming("bank", "'nothing.npy'", "piece0.npy", "sum.npy")):
        artifact.load_array("nothing")
    with pytest.raises(StoreError, match=naming("bank", "'manifest.json'", "piece0.npy")):
        artifact.load_json("manifest")


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        *((name, 1, [f"'{name}.json'"]) for name in ("../up", "a/b", ".hidden", "", "manifest")),
        *(("x", value, ["'x'", "JSON"]) for value in (float("nan"), {"a": Path("x")})),
    ],
)
def test_names_outside_the_folder_and_values_that_json_cannot_hold_are_refused(store, name, value, words):
    with pytest.raises(StoreError, match=naming("bank", *words)):
        store.build(KEY, lambda workspace: workspace.save_json(name, value))


# Two processes


BUILDER = """
import logging, os, sys, time
from pathlib import Path
import numpy as np
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore

root, calls = Path(sys.argv[1]), Path(sys.argv[2])
logging.basicConfig(level=logging.INFO, stream=sys.stdout)

def compute():
    with calls.open("a") as file:
        file.write("made\\n")
    deadline_s = time.monotonic() + 600
    while not (calls.parent / "go").exists() and time.monotonic() < deadline_s:
        time.sleep(0.01)
    return np.random.default_rng(os.getpid()).normal(size=100)

store = StageStore(root)
artifact = store.build(StageKey("bank", 1, {}), lambda workspace: workspace.save_array("x", compute()))
print("RESULT", len(store.built), artifact.load_array("x").tobytes().hex())
"""


def test_two_processes_build_once(store, tmp_path):
    processes = [run_python(BUILDER, store.root, tmp_path / "calls") for _ in range(2)]
    first_lines = [process.stdout.readline() for process in processes if process.stdout]
    assert sorted("waiting" in line for line in first_lines) == [False, True]
    (tmp_path / "go").touch()
    results = [process.communicate(timeout=600)[0].split("RESULT ")[1].split() for process in processes]
    assert (tmp_path / "calls").read_text() == "made\n"
    assert sorted(built for built, _ in results) == ["0", "1"]
    assert results[0][1] == results[1][1]


def test_get_and_remove_do_not_touch_a_stage_during_its_build(store):
    def make(workspace: Workspace) -> None:
        other = StageStore(store.root)
        assert other.get(KEY) is None
        with pytest.raises(StoreError, match=naming(f"{KEY.short}.partial", "process")):
            other.remove(KEY.digest)
        (entry,) = other.entries()
        assert other.is_being_built(entry)
        workspace.save_json("x", 1)

    assert store.build(KEY, make).load_json("x") == 1
    (entry,) = store.entries()
    assert not store.is_being_built(entry)


def test_one_stage_may_build_another(store):
    grid = StageKey("grid", 1, {})

    def make(workspace: Workspace) -> None:
        inner = store.build(grid, lambda inside: inside.save_array("poses", np.arange(3)))
        workspace.save_array("bank", inner.load_array("poses") * 2)

    np.testing.assert_array_equal(store.build(KEY, make).load_array("bank"), [0, 2, 4])
    assert store.built == [grid, KEY]


# The whole store


def test_entries_are_listed_and_removed(store):
    assert store.entries() == []
    assert store.get(KEY) is None
    assert not store.root.exists(), "reading creates the store"
    grid = StageKey("grid", 1, {})
    bank, poses = store.build(KEY, Five()), store.build(grid, Five())
    with pytest.raises(KeyboardInterrupt):
        store.build(StageKey("shapes", 1, {}), Five(stop_at=1))
    (store.root / "grid" / "mine").mkdir()
    entries = store.entries()
    assert [(entry.stage, entry.complete) for entry in entries] == [("bank", True), ("grid", True), ("shapes", False)]
    assert [entry.digest for entry in entries[:2]] == [KEY.short, grid.short]
    assert entries[0].nbytes == bank.nbytes + (bank.path / "manifest.json").stat().st_size
    assert abs((entries[0].created - bank.created).total_seconds()) < 60
    assert store.remove(KEY.digest) == entries[0].nbytes
    assert store.remove(entries[2].digest) == entries[2].nbytes > 0
    assert store.remove("") == store.remove(KEY.digest) == 0
    assert [entry.stage for entry in store.entries()] == ["grid"]
    assert store.get(KEY) is None
    assert store.get(grid) == poses
    assert (store.root / "grid" / "mine").is_dir()


def test_artifacts_without_a_manifest_or_at_a_temporary_path_are_incomplete(store):
    without = store.build(KEY, Five()).path
    (without / "manifest.json").unlink()
    (entry,) = store.entries()
    assert not entry.complete
    assert entry.nbytes > 0
    partial = store.build(StageKey("grid", 1, {}), Five()).path
    partial.rename(partial.with_suffix(".partial"))
    assert [entry.complete for entry in store.entries()] == [False, False]


def test_a_folder_that_cannot_be_removed_is_named(store, monkeypatch):
    folder = store.build(KEY, Five()).path

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("shutil.rmtree", refuse)
    with pytest.raises(StoreError, match=naming(folder, "Permission denied")):
        store.remove(KEY.digest)


def test_the_default_root_follows_the_environment(monkeypatch, tmp_path):
    for name in ("TACTILE_LOC_STORE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find_root() == tmp_path / ".cache" / "tactile-loc"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert find_root() == tmp_path / ".cache" / "tactile-loc"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert find_root() == tmp_path / "xdg" / "tactile-loc"
    monkeypatch.setenv("TACTILE_LOC_STORE", "~/mine")
    assert StageStore().root == tmp_path / "mine"
    assert StageStore(Path("~/other")).root == tmp_path / "other"
    assert list(tmp_path.iterdir()) == []
