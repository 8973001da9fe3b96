"""Reads .npy, .npz and zip files from untrusted sources.

Pickles are never loaded. Files that are damaged, or that state more data than they hold, are refused.
"""

import math
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.limits import MOST_BYTES, read_unpacked, require_size

PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # they unpack within a limit for memory
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
LONGEST_HEADER = 2**16  # bytes of a header of .npy; one of version 2 may state 4 GiB


def load_npy(path: Path) -> NDArray[Any]:
    """Return the array of an .npy file.

    Raises ValueError when the file is damaged or not .npy, and OSError when it cannot be opened.
    """
    measure_npy(path)
    with path.open("rb") as file, convert_damage():
        array: NDArray[Any] = np.load(file, allow_pickle=False)
    return array


def measure_npy(path: Path) -> NDArray[Any]:
    """Return an array without memory, with the shape and the type of that in an .npy file. Raises like `load_npy`."""
    with path.open("rb") as file, convert_damage():
        return _read_header(file, path.stat().st_size)


def load_npz(path: Path, names: Collection[str] | None = None, most: int = MOST_BYTES) -> dict[str, NDArray[Any]]:
    """Return the arrays of an .npz file by name; only those of `names` if given. They take up to `most` bytes.

    Raises ValueError when the file is damaged, not .npz, or too large, and OSError when it cannot be opened.
    """
    chosen = {name: one for name, one in measure_npz(path).items() if names is None or name in names}
    require_size(sum(one.nbytes for one in chosen.values()), most)
    with path.open("rb") as file, convert_damage(), np.load(file, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in chosen}


def measure_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Return arrays without memory, with the shapes and types of those in an .npz file. Raises like `load_npz`."""
    with path.open("rb") as file, convert_damage():
        _require_magic(file, b"PK")
        file.seek(0)
        found = {}
        with zipfile.ZipFile(file) as archive:
            for member in archive.infolist():
                _require_packing(member)
                with archive.open(member) as stream:
                    found[member.filename.removesuffix(".npy")] = _read_header(stream, member.file_size)
        return found


@contextmanager
def convert_damage() -> Iterator[None]:
    """Convert the errors of the block, which reads a damaged file, to ValueError. OSError stays as it is."""
    try:
        yield
    except (OSError, ValueError):
        raise
    except Exception as error:  # damaged bytes raise errors of any type
        raise ValueError(str(error) or type(error).__name__) from error


def _read_header(file: IO[bytes], size: int) -> NDArray[Any]:
    """Return an array without memory, with the shape and the type that the header of an .npy file states.

    Raises ValueError unless the file of `size` bytes is .npy and holds all the numbers of the array.
    """
    _require_magic(file, np.lib.format.MAGIC_PREFIX)
    version = tuple(file.read(2))
    if version not in HEADERS:
        raise ValueError(f"its .npy version {version} is unknown")
    head = BytesIO(file.read(LONGEST_HEADER))
    shape, _, dtype = HEADERS[version](head)
    left, said = size - 8 - head.tell(), math.prod(shape) * dtype.itemsize
    if dtype.hasobject:
        raise ValueError("allow_pickle")
    if min(shape, default=0) < 0 or dtype.itemsize == 0 or said > left:
        raise ValueError(f"its header states {dtype} of shape {shape}, {said} bytes, but it holds {left}")
    return np.broadcast_to(np.zeros((), dtype), shape)


def _require_magic(file: IO[bytes], magic: bytes) -> None:
    if file.read(len(magic)) != magic:
        raise ValueError("it begins like another kind of file")


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return the content of a zip archive's member. Raises ValueError if it is damaged, too large or rarely packed."""
    _require_packing(member)
    try:
        with archive.open(member) as stream:
            return read_unpacked(stream, member.file_size, MOST_BYTES)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:  # RuntimeError: it needs a password
        raise ValueError(f"{member.filename!r} in it is damaged ({error})") from error


def _require_packing(member: zipfile.ZipInfo) -> None:
    if member.compress_type not in PACKINGS:
        raise ValueError(f"{member.filename!r} in it is neither stored nor deflated; pack it again")
