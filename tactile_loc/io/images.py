"""Reads images and arrays from untrusted files: photos, masks, depths, .npy and .npz.

Pickles are never loaded. Files that are damaged, or that state more data than they hold, are refused.
"""

from __future__ import annotations

import lzma
import math
import os
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import TouchError

FORMATS = ".npz, .npy or 16-bit grey .png"  # formats of contact shapes
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")

MOST_PIXELS, MOST_SIDE_PX = 2**26, 2**14  # largest image and image side; no camera behind a gel takes larger images
MOST_BYTES = 2**30  # largest size of all arrays in one .npz file
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
DAMAGES = (
    EOFError, LookupError, SyntaxError, TypeError, RuntimeError, ArithmeticError, AttributeError, MemoryError,
    lzma.LZMAError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
UNREADABLE = (OSError, ValueError, TypeError)  # errors of reading a damaged file, or of converting its arrays


def read_colour_image(path: Path) -> NDArray[np.uint8] | None:
    """Read an image (H, W, 3) from a colour picture or an .npy file of uint8. Return None for any other file.

    Raises TouchError when the file is missing or damaged.
    """
    suffix = path.suffix.lower()
    if suffix not in (*IMAGE_SUFFIXES, ".npy"):
        return None
    require_file(path)
    try:
        mode, values = ("RGB", load_npy(path)) if suffix == ".npy" else load_image(path)
    except UNREADABLE as error:
        raise TouchError(explain_unreadable(path, error)) from error
    colour = mode == "RGB" and values.ndim == 3 and values.shape[2] == 3 and values.dtype == np.uint8
    return values if colour else None


def load_image(path: Path | IO[bytes], mode: str | None = None) -> tuple[str, NDArray[Any]]:
    """Return the mode and the values of an image file, converted to Pillow's `mode` if `mode` is given.

    Raises OSError when the file cannot be read, and ValueError when it is damaged or too large.
    """
    from PIL import Image

    with _convert_damage(Image.DecompressionBombError), warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # MOST_PIXELS is the limit
        file = BytesIO(path.read_bytes()) if isinstance(path, Path) else path  # its end limits a damaged length
        with Image.open(file) as image:
            width, height = image.size
            if width * height > MOST_PIXELS or max(width, height) > MOST_SIDE_PX:
                most = f"{MOST_PIXELS / 1e6:.0f} million pixels, {MOST_SIDE_PX} along a side"
                raise ValueError(f"it has {width} x {height} pixels; the limit is {most}")
            wanted = image if mode is None else image.convert(mode)
            return wanted.mode, np.asarray(wanted)


def write_image(path: Path, values: NDArray[Any]) -> Path:
    """Write an image in the format of the suffix, and return the path.

    The values are uint8 (H, W) or (H, W, 3), or uint16 (H, W). Raises OSError when the file cannot be written.
    """
    from PIL import Image

    Image.fromarray(values).save(path)
    return path


def encode_png(values: NDArray[np.uint8]) -> bytes:
    """Return the bytes of a PNG file of an image (H, W) or (H, W, 3)."""
    from PIL import Image

    file = BytesIO()
    Image.fromarray(values).save(file, "PNG")
    return file.getvalue()


def require_file(path: Path) -> None:
    """Raise TouchError unless `path` is a file."""
    if os.path.isdir(path):
        raise TouchError(f"{path} is a folder; give one file, {FORMATS}")
    if not os.path.isfile(path):
        raise TouchError(f"there is no file {path}; check the path")


def explain_unreadable(path: Path, error: BaseException) -> str:
    """Return the error message for a file that could not be read."""
    if "allow_pickle" in str(error):
        return f"{path} holds Python objects, which are never loaded; save plain numbers (H, W)"
    kind = path.suffix.lower()[1:]
    return f"{path} cannot be read as {kind} ({summarize(error)}); it is damaged or of another kind, so save it again"


def summarize(error: BaseException) -> str:
    """Return an error's message in one line, or its type if it has none."""
    return " ".join(str(error).split()) or type(error).__name__


def load_npy(path: Path) -> NDArray[Any]:
    """Return the array of an .npy file.

    Raises ValueError when the file is damaged or not .npy, and OSError when it cannot be opened.
    """
    with path.open("rb") as file, _convert_damage():
        _require_filled(file, path.stat().st_size)
        file.seek(0)
        array: NDArray[Any] = np.load(file, allow_pickle=False)
    return array


def load_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an .npz file by name.

    Raises ValueError when the file is damaged or not .npz, and OSError when it cannot be opened.
    """
    with path.open("rb") as file, _convert_damage():
        _require_magic(file, b"PK")
        file.seek(0)
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            held = sum(member.file_size for member in members)
            if held > MOST_BYTES:
                raise ValueError(f"it inflates to {held / 2**30:.3g} GiB; the limit is {MOST_BYTES / 2**30:g} GiB")
            for member in members:
                with archive.open(member) as stream:
                    _require_filled(stream, member.file_size)
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}


@contextmanager
def _convert_damage(*others: type[Exception]) -> Iterator[None]:
    """Convert the errors that damaged files cause in the block, DAMAGES and `others`, to ValueError."""
    try:
        yield
    except DAMAGES + others as error:
        raise ValueError(str(error) or type(error).__name__) from error


def _require_filled(file: IO[bytes], size: int) -> None:
    """Raise ValueError unless a file of `size` bytes is .npy and holds all the numbers that its header states."""
    _require_magic(file, np.lib.format.MAGIC_PREFIX)
    version = tuple(file.read(2))
    if version not in HEADERS:
        raise ValueError(f"its .npy version {version} is unknown")
    shape, _, dtype = HEADERS[version](file)
    left, said = size - file.tell(), math.prod(shape) * dtype.itemsize
    if dtype.hasobject:
        raise ValueError("allow_pickle")
    if min(shape, default=0) < 0 or dtype.itemsize == 0 or said > left:
        raise ValueError(f"its header states {dtype} of shape {shape}, {said} bytes, but it holds {left}")


def _require_magic(file: IO[bytes], magic: bytes) -> None:
    if file.read(len(magic)) != magic:
        raise ValueError("it begins like another kind of file")
