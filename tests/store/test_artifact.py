import json
import logging
import os
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from store_helpers import KEY, Five, contents, flip, folder_of

from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.store import artifact as artifact_module
from tactile_loc.store.artifact import MANIFEST, Artifact, DamagedError, read_artifact
from tactile_loc.store.keys import StageKey, hash_json
from tactile_loc.store.store import StageStore


def edit_manifest(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "created": "2001-01-01T00:00:00+00:00"}))


def replace_by_file(folder: Path) -> None:
    folder.rename(folder.with_name("elsewhere"))
    folder.write_text("in the way")


DAMAGES = {
    "truncated file": lambda folder: os.truncate(folder / "sum.npy", 200),
    "empty file": lambda folder: os.truncate(folder / "meta.json", 0),
    "missing file": lambda folder: (folder / "sum.npy").unlink(),
    "changed end": flip("sum.npy", -1),
    "changed head": flip("piece0.npy", 3),
    "changed manifest": flip("manifest.json", 100),
    "missing manifest": lambda folder: (folder / "manifest.json").unlink(),
    "truncated manifest": lambda folder: os.truncate(folder / "manifest.json", 50),
    "edited manifest": edit_manifest,
    "file for a folder": replace_by_file,
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
@pytest.mark.parametrize("same_instance", [True, False])
def test_a_damaged_artifact_is_removed_and_built_again(store, damage, same_instance, caplog):
    truth = contents(store.build(KEY, Five()).path)
    damage(folder_of(store))
    reader = store if same_instance else StageStore(store.root)
    with caplog.at_level(logging.WARNING):
        assert reader.get(KEY) is None
    assert len(caplog.records) == 1
    assert "bank" in caplog.text
    assert not folder_of(store).exists()
    five = Five()
    assert contents(reader.build(KEY, five).path) == truth
    assert five.computed == [0, 1, 2, 3, 4]


def test_an_unreadable_file_counts_as_damaged(store, monkeypatch):
    artifact = store.build(KEY, Five())

    def refuse(path: Path) -> str:
        raise StoreError(f"Cannot read {path}: Input/output error")

    monkeypatch.setattr(artifact_module, "hash_file", refuse)
    with pytest.raises(DamagedError, match=r"\.(npy|json)\b"):
        artifact.verify()


def test_an_artifact_moved_to_another_key_is_not_read(store):
    other = StageKey("bank", 2, {})
    store.build(KEY, Five()).path.rename(folder_of(store, other))
    assert store.get(other) is None
    assert not folder_of(store, other).exists()


def build_old(store: StageStore, monkeypatch: pytest.MonkeyPatch) -> tuple[Artifact, list[str]]:
    """Build an artifact with files of long ago; return it, and the list of all files that will be hashed."""
    built = store.build(KEY, Five())
    for path in built.path.iterdir():
        os.utime(path, (1e9, 1e9))
    hashed: list[str] = []
    real = artifact_module.hash_file
    monkeypatch.setattr(artifact_module, "hash_file", lambda path: hashed.append(path.name) or real(path))
    return built, hashed


def test_checksums_are_read_once_while_the_files_are_unchanged(store, monkeypatch):
    built, hashed = build_old(store, monkeypatch)
    for _ in range(3):
        assert store.get(KEY) == built
    assert sorted(hashed) == list(built.names)
    os.utime(built.find_file("sum.npy"), (1e9, 1e9 + 1))
    assert store.get(KEY) == built
    assert len(hashed) == 2 * len(built.names)


def test_pickled_arrays_are_refused(store):
    objects = np.array([{"a": 1}], dtype=object)
    with pytest.raises(StoreError, match=naming("'x'", "bank", "objects")):
        store.build(KEY, lambda workspace: workspace.save_array("x", objects))
    artifact = store.build(
        KEY, lambda workspace: workspace.save_file("x.npy", lambda path: np.save(path, objects, allow_pickle=True))
    )
    for mmap in (True, False):
        with pytest.raises(StoreError, match=r"x\.npy"):
            artifact.load_array("x", mmap=mmap)


def test_a_change_within_one_tick_of_the_clock_is_seen(store):
    path = store.build(KEY, Five()).find_file("sum.npy")
    assert store.get(KEY) is not None
    stat = path.stat()
    flip("sum.npy", -1)(path.parent)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert store.get(KEY) is None


@pytest.mark.parametrize("text", ["[" * 10**5, '{"sha256": "", "format": NaN}', "{}"], ids=["nested", "nan", "empty"])
def test_an_invalid_manifest_is_refused(tmp_path, text):
    (tmp_path / MANIFEST).write_text(text)
    with pytest.raises(DamagedError):
        read_artifact(tmp_path)


@pytest.mark.parametrize("format", [0, 2])
def test_a_manifest_of_another_format_is_not_read(store, format):
    path = store.build(KEY, Five()).path
    manifest = {**json.loads((path / MANIFEST).read_text()), "format": format}
    del manifest["sha256"]
    (path / MANIFEST).write_text(json.dumps({**manifest, "sha256": hash_json(manifest)}))
    with pytest.raises(DamagedError, match="format"):
        read_artifact(path)
