"""Packed arrays are read unchanged, and other files are refused."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.store.artifact import read_packed, write_packed
from tactile_loc.store.keys import StageKey

KEY = StageKey("shapes", 1, {"of": "a test"})
MOSTLY_EMPTY = np.pad(np.arange(64, dtype=np.uint16).reshape(8, 8), 60, constant_values=65535)


@pytest.mark.parametrize("array", [MOSTLY_EMPTY, np.float32(3.5), np.empty((0, 4)), np.asfortranarray(MOSTLY_EMPTY)])
def test_a_packed_array_is_read_back(tmp_path, array):
    for name in ("a.npz", "b.npz"):
        write_packed(tmp_path / name, np.asarray(array))
    found = read_packed(tmp_path / "a.npz")
    assert (found.dtype, found.shape) == (np.asarray(array).dtype, np.shape(array))
    np.testing.assert_array_equal(found, array)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_mostly_empty_array_needs_a_tenth_of_the_space(tmp_path):
    write_packed(tmp_path / "a.npz", np.stack([MOSTLY_EMPTY] * 50))
    assert (tmp_path / "a.npz").stat().st_size < 50 * MOSTLY_EMPTY.nbytes / 10


def test_the_store_packs_arrays_on_request_and_an_interrupted_build_finds_them_again(store):
    made = []

    def build(work, interrupted):
        found = work.load("codes")
        if found is None:
            made.append(1)
            work.save_array("codes", MOSTLY_EMPTY, packed=True)
        if interrupted:
            raise KeyboardInterrupt
        np.testing.assert_array_equal(work.load("codes"), MOSTLY_EMPTY)

    with pytest.raises(KeyboardInterrupt):
        store.build(KEY, lambda work: build(work, True))
    artifact = store.build(KEY, lambda work: build(work, False))
    assert len(made) == 1
    assert artifact.names == ("codes.npz",)
    np.testing.assert_array_equal(artifact.load_array("codes"), MOSTLY_EMPTY)


@pytest.mark.parametrize("content", [b"", b"PK nothing", "cut", "other"])
def test_files_without_a_packed_array_are_refused(tmp_path, store, content):
    path = tmp_path / "codes.npz"
    write_packed(path, MOSTLY_EMPTY)
    if content == "cut":
        content = path.read_bytes()[:-40]
    if content == "other":
        np.savez(path, something=MOSTLY_EMPTY)
    else:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=r"packed|file"):
        read_packed(path)
    content = path.read_bytes()
    artifact = store.build(KEY, lambda work: work.save_file("codes.npz", lambda to: to.write_bytes(content)))
    with pytest.raises(StoreError, match=r"codes\.npz"):
        artifact.load_array("codes")


def test_a_packed_array_that_would_fill_the_memory_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "codes.npz"
    write_packed(path, MOSTLY_EMPTY)
    with zipfile.ZipFile(path) as file, zipfile.ZipFile(tmp_path / "other.npz", "w", zipfile.ZIP_BZIP2) as other:
        other.writestr("array.npy", file.read("array.npy"))
    monkeypatch.setattr("tactile_loc.store.artifact._MEMORY_BYTES", MOSTLY_EMPTY.nbytes)
    for name in ("codes.npz", "other.npz"):
        with pytest.raises(ValueError, match=r"memory|deflated"):
            read_packed(tmp_path / name)
