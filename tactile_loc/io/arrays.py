"""Arrays as files, .npy and .npz, from anybody: nothing is unpickled, no more memory is taken than the file fills."""

from __future__ import annotations

import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 2**30  # of all arrays of one .npz
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
DAMAGES = (
    EOFError, KeyError, SyntaxError, TypeError, RuntimeError, OverflowError, AttributeError, MemoryError,
    lzma.LZMAError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def load_npy(path: Path) -> NDArray[Any]:
    """Return the array of an .npy file. Raises ValueError when it is damaged or none, OSError as any read."""
    with path.open("rb") as file, _damage_told():
        _require_filled(file, path.stat().st_size)
        file.seek(0)
        array: NDArray[Any] = np.load(file, allow_pickle=False)
    return array


def load_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an .npz file by their names. Raises ValueError when it is damaged or none, OSError."""
    with path.open("rb") as file, _damage_told():
        _require_magic(file, b"PK")
        file.seek(0)
        with zipfile.ZipFile(file) as archive:
            _require_bounded(archive.infolist())
            for member in archive.infolist():
                with archive.open(member) as stream:
                    _require_filled(stream, member.file_size)
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}


@contextmanager
def _damage_told() -> Iterator[None]:
    """Whatever a damaged file makes of the readers' code is a ValueError."""
    try:
        yield
    except DAMAGES as error:
        raise ValueError(str(error) or type(error).__name__) from error


def _require_bounded(members: list[zipfile.ZipInfo]) -> None:
    held = sum(member.file_size for member in members)
    if held > MOST_BYTES:
        raise ValueError(f"it inflates to {held / 2**30:.3g} GiB, more than {MOST_BYTES / 2**30:g}")


def _require_filled(file: IO[bytes], size: int) -> None:
    """Raise ValueError unless a file of `size` bytes begins as .npy, and holds as many numbers as it says."""
    _require_magic(file, np.lib.format.MAGIC_PREFIX)
    version = tuple(file.read(2))
    if version not in HEADERS:
        raise ValueError(f"it is of version {version}, which cannot be read")
    shape, _, dtype = HEADERS[version](file)
    left, said = size - file.tell(), math.prod(shape) * dtype.itemsize
    if dtype.hasobject:
        raise ValueError("allow_pickle")
    if min(shape, default=0) < 0 or dtype.itemsize == 0 or said > left:
        raise ValueError(f"it says to hold {dtype} of shape {shape}, {said} bytes, but {left} follow")


def _require_magic(file: IO[bytes], magic: bytes) -> None:
    if file.read(len(magic)) != magic:
        raise ValueError("its first bytes are those of another kind of file")
