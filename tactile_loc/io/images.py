"""Images as files: photos of the gel, masks, 16-bit depths. Nothing is ever unpickled, and a damaged file is told."""

from __future__ import annotations

import os
import struct
import warnings
import zlib
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import TouchError
from tactile_loc.io.arrays import load_npy

FORMATS = ".npz, .npy or 16-bit grey .png"  # of contact shapes
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")

MOST_PIXELS = 2**26  # 8192 x 8192: more than any camera behind a gel has

UNREADABLE = (
    OSError, ValueError, TypeError, EOFError, KeyError, IndexError, SyntaxError, RuntimeError, MemoryError,
    struct.error, zlib.error,
)  # fmt: skip


def read_colour_image(path: Path) -> NDArray[np.uint8] | None:
    """Return a colour image (H, W, 3), or None when the file is something else; TouchError when it is damaged.

    A picture in colour, or an .npy file of (H, W, 3) uint8.
    """
    suffix = path.suffix.lower()
    if suffix not in (*IMAGE_SUFFIXES, ".npy"):
        return None
    require_file(path)
    try:
        mode, values = ("RGB", load_npy(path)) if suffix == ".npy" else load_image(path)
    except UNREADABLE as error:
        raise TouchError(why_unreadable(path, error)) from error
    colour = mode == "RGB" and values.ndim == 3 and values.shape[2] == 3 and values.dtype == np.uint8
    return values if colour else None


def load_image(path: Path | IO[bytes], mode: str | None = None) -> tuple[str, NDArray[Any]]:
    """Return the mode and the values of an image's file, in Pillow's `mode` if one is named, else in its own.

    Raises one of UNREADABLE when it is damaged or enormous.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the bound is ours
            file = BytesIO(path.read_bytes()) if isinstance(path, Path) else path  # beyond whose end no length leads
            with Image.open(file) as image:
                _require_bounded(image.size)
                wanted = image if mode is None else image.convert(mode)
                return wanted.mode, np.asarray(wanted)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error


def _require_bounded(size_px: tuple[int, int]) -> None:
    width, height = size_px
    if width * height > MOST_PIXELS:
        raise ValueError(f"{width} x {height} pixels are more than the {MOST_PIXELS / 1e6:.0f} million of any sensor")


def write_image(path: Path, values: NDArray[Any]) -> Path:
    """Write uint8 values (H, W) or (H, W, 3), or uint16 (H, W), as the picture that the suffix says. Raises OSError."""
    from PIL import Image

    Image.fromarray(values).save(path)
    return path


def require_file(path: Path) -> None:
    """Raise TouchError unless there is a file, and no folder, at `path`."""
    if os.path.isdir(path):
        raise TouchError(f"{path} is a folder; give one file, {FORMATS}")
    if not os.path.isfile(path):
        raise TouchError(f"there is no file {path}; check the path")


def why_unreadable(path: Path, error: BaseException) -> str:
    """Return the sentence that says why a file could not be read."""
    if "allow_pickle" in str(error):
        return f"{path} holds Python objects, which are never loaded; save plain numbers (H, W)"
    reason = " ".join(str(error).split()) or type(error).__name__
    return f"{path} cannot be read as {path.suffix.lower()[1:]} ({reason}); it is damaged or of another kind"
