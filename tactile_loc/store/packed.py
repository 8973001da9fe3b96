"""One array deflated: an npz file that numpy reads as any other."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MEMBER = "array"
LEVEL = 1  # of deflation: higher ones take several times as long and save a twentieth


def write_packed(path: Path, array: NDArray[Any]) -> None:
    """Write an array of any shape, without Python objects; the same array makes the same bytes."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=LEVEL) as file,
        file.open(f"{MEMBER}.npy", "w", force_zip64=True) as member,
    ):
        np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)


def read_packed(path: Path) -> NDArray[Any]:
    """Return the array that `write_packed` wrote. Raises ValueError when the file holds none, OSError as any read."""
    try:
        with np.load(path, allow_pickle=False) as file:
            array: NDArray[Any] = file[MEMBER]
    except (zipfile.BadZipFile, zlib.error, KeyError, EOFError) as error:
        raise ValueError(f"it holds no packed array ({error})") from error
    return array
