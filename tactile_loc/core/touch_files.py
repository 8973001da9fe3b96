"""What the files of touches hold, before anybody knows the sensor. Nothing is ever unpickled."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import TouchError
from tactile_loc.core.geometry import is_rigid

FORMATS = ".npz, .npy or 16-bit grey .png"
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")

_UNREADABLE = (
    OSError, ValueError, EOFError, KeyError, SyntaxError, RuntimeError, MemoryError,
    tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class FileContents:
    """What a file says: depths (H, W) and the press depth in `unit` (None when it names none), poses in metres."""

    depth: NDArray[Any]
    unit: str | None = None
    press_depth: float | None = None
    T_sensor_object: NDArray[np.float64] | None = None
    T_base_sensor: NDArray[np.float64] | None = None


def read_contents(path: Path) -> FileContents:
    """Read what an .npz, .npy or 16-bit grey .png file says; raises TouchError when it is none or damaged."""
    readers = {".npz": _read_npz, ".npy": _read_npy, ".png": _read_png}
    suffix = path.suffix.lower()
    _check_file(path)
    if suffix not in readers:
        raise TouchError(_is_image(path) if suffix in IMAGE_SUFFIXES else f"{path} is no touch; give {FORMATS}")
    try:
        return readers[suffix](path)
    except _UNREADABLE as error:
        raise TouchError(_unreadable(path, error)) from error


def read_colour_image(path: Path) -> NDArray[np.uint8] | None:
    """Return a colour image (H, W, 3), or None when the file is something else; TouchError when it is damaged.

    A picture in colour, or an .npy file of (H, W, 3) uint8.
    """
    suffix = path.suffix.lower()
    if suffix not in (*IMAGE_SUFFIXES, ".npy"):
        return None
    _check_file(path)
    try:
        mode, values = ("RGB", _read_npy(path).depth) if suffix == ".npy" else _load_image(path)
    except _UNREADABLE as error:
        raise TouchError(_unreadable(path, error)) from error
    colour = mode == "RGB" and values.ndim == 3 and values.shape[2] == 3 and values.dtype == np.uint8
    return values if colour else None


def _check_file(path: Path) -> None:
    try:
        folder, file = path.is_dir(), path.is_file()
    except OSError as error:
        raise TouchError(f"{path} cannot be read ({error.strerror})") from error
    if folder:
        raise TouchError(f"{path} is a folder; give one file, {FORMATS}")
    if not file:
        raise TouchError(f"there is no file {path}; check the path")


def _unreadable(path: Path, error: BaseException) -> str:
    if "allow_pickle" in str(error):
        return f"{path} holds Python objects, which are never loaded; save plain numbers (H, W)"
    reason = " ".join(str(error).split()) or type(error).__name__
    return f"{path} cannot be read as {path.suffix.lower()[1:]} ({reason}); it is damaged or of another kind"


def _is_image(path: Path) -> str:
    return (
        f"{path} is an image, but not one in colour of 8 bits, which a sensor calibrated for images reads; convert it, "
        f"or give a contact shape as {FORMATS}, with its unit"
    )


def _expect_magic(file: IO[bytes], magic: bytes) -> None:
    if file.read(len(magic)) != magic:
        raise ValueError("its first bytes are those of another kind of file")
    file.seek(0)


def _read_npy(path: Path) -> FileContents:
    with path.open("rb") as file:
        _expect_magic(file, b"\x93NUMPY")
        return FileContents(np.load(file, allow_pickle=False))


def _read_npz(path: Path) -> FileContents:
    with path.open("rb") as file:
        _expect_magic(file, b"PK")
        archive = np.load(file, allow_pickle=False)
        arrays = {name: np.asarray(archive[name]) for name in archive.files}
    unit = str(arrays["unit"]) if "unit" in arrays else None
    return FileContents(
        _find_depth(arrays, path), unit, _number(arrays, "press_depth", path),
        _pose(arrays, "T_sensor_object", path), _pose(arrays, "T_base_sensor", path),
    )  # fmt: skip


def _find_depth(arrays: Mapping[str, NDArray[Any]], path: Path) -> NDArray[Any]:
    """Return the array `depth`, else the only 2-D array of a stranger's file."""
    if "depth" in arrays:
        return arrays["depth"]
    maps = [a for name, a in arrays.items() if a.ndim >= 2 and not name.startswith("T_")]
    if len(maps) != 1:
        held = ", ".join(f"{name} {a.shape}" for name, a in arrays.items()) or "nothing"
        raise TouchError(f"{path} holds {held}; a touch holds one array (H, W), or names it 'depth'")
    return maps[0]


def _number(arrays: Mapping[str, NDArray[Any]], name: str, path: Path) -> float | None:
    if name not in arrays:
        return None
    value = arrays[name]
    if value.size != 1 or value.dtype.kind not in "fiu":
        raise TouchError(f"{name} in {path} has the shape {value.shape} and type {value.dtype}; it must be one number")
    return float(value.reshape(()))


def _pose(arrays: Mapping[str, NDArray[Any]], name: str, path: Path) -> NDArray[np.float64] | None:
    if name not in arrays:
        return None
    T = arrays[name]
    if T.shape != (4, 4) or T.dtype.kind not in "fiu" or not is_rigid(T.astype(np.float64)):
        raise TouchError(
            f"{name} in {path} is no rigid transform; it must be (4, 4), rotation and metres, last row 0 0 0 1"
        )
    return T.astype(np.float64)


def _read_png(path: Path) -> FileContents:
    mode, values = _load_image(path)
    if mode != "I" and not mode.startswith("I;16"):  # Pillow before 11 opens 16-bit grey as "I"
        raise TouchError(_is_image(path))
    return FileContents(values.astype(np.uint16))


def _load_image(path: Path) -> tuple[str, NDArray[Any]]:
    """Return an image's mode and its values. Raises OSError or ValueError when it is damaged or enormous."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            return image.mode, np.asarray(image)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error
