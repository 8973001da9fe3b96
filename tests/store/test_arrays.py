"""Arrays in .npy and .npz files are read unchanged, and files with wrong headers or other contents are refused."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.store.arrays import load_npy, load_npz
from tactile_loc.store.artifact import read_packed, write_packed
from tactile_loc.store.keys import StageKey

NUMBERS = np.arange(12.0).reshape(3, 4)


def lying(descr: str, shape: tuple[int, ...], content: bytes = bytes(96)) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue() + content


def zipped(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_written_by_numpy_are_read_unchanged(tmp_path, order):
    np.save(tmp_path / "a.npy", np.asarray(NUMBERS, order=order))
    np.savez_compressed(tmp_path / "a.npz", depth=NUMBERS, unit=np.array("mm"), none=np.zeros((0, 3)))
    np.testing.assert_array_equal(load_npy(tmp_path / "a.npy"), NUMBERS)
    read = load_npz(tmp_path / "a.npz")
    assert (list(read), str(read["unit"]), read["none"].shape) == (["depth", "unit", "none"], "mm", (0, 3))
    np.testing.assert_array_equal(read["depth"], NUMBERS)


LIES = [("<f8", (10**5, 10**6)), ("<f8", (2**62, 8)), ("<f8", (-1, 3)), ("<U0", (10**9,)), ("<f8", (13,)), ("|O", (3,))]


@pytest.mark.parametrize(("descr", "shape"), LIES)
def test_a_header_that_promises_too_much_data_is_refused(tmp_path, descr, shape):
    (tmp_path / "a.npy").write_bytes(lying(descr, shape))
    archive = zipped(tmp_path / "a.npz", depth=lying(descr, shape))
    for load, path in ((load_npy, tmp_path / "a.npy"), (load_npz, archive)):
        with pytest.raises(ValueError, match=r"96|allow_pickle"):
            load(path)


@pytest.mark.parametrize("content", [b"", b"PK", b"PK\x03\x04" + bytes(100), b"\x93NUMPY\x09\x00", b"text"])
def test_a_file_without_arrays_is_refused(tmp_path, content):
    for suffix, load in ((".npy", load_npy), (".npz", load_npz)):
        (tmp_path / f"a{suffix}").write_bytes(content)
        with pytest.raises(ValueError):  # noqa: PT011 - the reason is whatever the file lacks
            load(tmp_path / f"a{suffix}")


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
    assert (tmp_path / "a.npz").stat().st_size < 400 + MOSTLY_EMPTY.nbytes / 10


def test_files_without_a_packed_array_are_refused(tmp_path, store):
    path = tmp_path / "codes.npz"
    write_packed(path, MOSTLY_EMPTY)
    np.savez(tmp_path / "other.npz", something=MOSTLY_EMPTY)
    for content in (b"", b"PK nothing", path.read_bytes()[:-40], (tmp_path / "other.npz").read_bytes()):
        with pytest.raises(StoreError, match=r"codes\.npz"):
            store.build(
                KEY, lambda work, c=content: work.save_file("codes.npz", lambda to: to.write_bytes(c))
            ).load_array("codes")
        store.remove(KEY.digest)


def test_an_array_that_would_fill_the_memory_is_refused(tmp_path):
    path = tmp_path / "codes.npz"
    write_packed(path, np.zeros(2 * 10**6, np.uint8))
    assert path.stat().st_size < 10**4
    with zipfile.ZipFile(path) as file, zipfile.ZipFile(tmp_path / "other.npz", "w", zipfile.ZIP_BZIP2) as other:
        other.writestr("array.npy", file.read("array.npy"))
    with pytest.raises(ValueError, match="limit"):
        load_npz(path, most=10**6)
    with pytest.raises(ValueError, match="deflated"):  # it may unpack to more than it states
        load_npz(tmp_path / "other.npz")
