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
PHOTO = "an 8-bit colour photo"
PICTURES = {
    "RGB": PHOTO, "RGBA": "an 8-bit colour photo with an alpha channel", "L": "an 8-bit grey picture",
    "LA": "an 8-bit grey picture with an alpha channel", "1": "a black and white picture",
    "CMYK": "a CMYK picture, in the colours of ink", "F": "a picture of floating-point numbers",
}  # fmt: skip
OPAQUE = 255  # value of an alpha channel
PICTURE_FORMATS = ("PNG", "JPEG", "BMP", "DIB", "TIFF", "WEBP", "GIF", "PPM")  # in Pillow; JPEG includes MPO
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")

MOST_PIXELS, MOST_SIDE_PX = 2**26, 2**14  # largest image and image side; no camera behind a gel takes larger images
MOST_BYTES = 2**30  # largest size of all arrays in one .npz file
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
DAMAGES = (
    EOFError, LookupError, SyntaxError, TypeError, RuntimeError, ArithmeticError, AttributeError, MemoryError,
    lzma.LZMAError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
UNREADABLE = (OSError, ValueError, TypeError)  # errors of reading a damaged file, or of converting its arrays


def read_photo(path: Path) -> NDArray[np.uint8]:
    """Return the colours (H, W, 3) of a photo of a gel, a picture or an .npy file of uint8.

    Raises TouchError for any other file, for a picture with transparent pixels, and when the file is damaged.
    """
    mode, image = _read_picture(path)
    if image is None:
        kind = "no picture" if mode is None else name_kind(mode)
        raise TouchError(f"{path} is {kind}, not {PHOTO}; give the camera's own image, PNG or JPEG")
    return image


def read_colour_image(path: Path) -> NDArray[np.uint8] | None:
    """Read a photo (H, W, 3) like `read_photo`. Return None for a file that may be a contact shape, or is no picture.

    Raises TouchError when the file is missing or damaged, and for a picture that is neither photo nor contact shape.
    """
    mode, image = _read_picture(path)
    if image is None and mode is not None and not (path.suffix.lower() == ".png" and mode.startswith("I")):
        raise TouchError(explain_picture(path, mode))
    return image


def _read_picture(path: Path) -> tuple[str | None, NDArray[np.uint8] | None]:
    """Return the mode of a picture, or None for another file, and its colours (H, W, 3), or None if it is no photo."""
    suffix = path.suffix.lower()
    if suffix not in (*IMAGE_SUFFIXES, ".npy"):
        return None, None
    require_file(path)
    try:
        mode, values = load_image(path) if suffix in IMAGE_SUFFIXES else ("RGB", load_npy(path))
    except UNREADABLE as error:
        raise TouchError(explain_unreadable(path, error)) from error
    if suffix == ".npy":
        channels = values.shape[2] if values.ndim == 3 and values.dtype == np.uint8 else 0
        if channels not in (3, 4):
            return None, None
        mode = "RGBA"[:channels]
    image = find_colours(mode, values, str(path))
    return mode, image if image is not None and image.ndim == 3 else None


def find_colours(mode: str, values: NDArray[Any], name: str) -> NDArray[np.uint8] | None:
    """Return the colours (H, W, 3) of a photo, or its brightness (H, W) if it is grey. Return None for another mode.

    `mode` and `values` are as `load_image` returns them. Raises TouchError if pixels are transparent.
    """
    if mode in ("RGBA", "LA"):
        require_opaque(values[..., -1], name)
        values = values[..., 0] if mode == "LA" else values[..., :3]
    return np.ascontiguousarray(values) if mode in ("RGB", "RGBA", "L", "LA") else None


def require_opaque(alpha: NDArray[np.uint8], name: str) -> None:
    """Raise TouchError if pixels are transparent in an alpha channel (H, W)."""
    clear = float((alpha < OPAQUE).mean())
    if clear > 0:
        raise TouchError(
            f"{name} has an alpha channel, and {max(clear, 0.01):.0%} of its pixels are transparent, so it is no photo "
            "of a gel; give the camera's own image"
        )


def name_kind(mode: str) -> str:
    """Return the kind of a picture in words, from its mode in Pillow."""
    return "a 16-bit grey picture" if mode.startswith("I") else PICTURES.get(mode, f"a picture of the mode {mode}")


def explain_picture(name: object, mode: str) -> str:
    """Return the error message for a picture, in a mode of Pillow, that cannot be used as a touch."""
    return (
        f"{name} is {name_kind(mode)}; give a contact shape ({FORMATS}, with its unit), or {PHOTO} (RGB) with a "
        "calibrated sensor"
    )


def read_brightness(path: Path) -> NDArray[Any]:
    """Return the brightness (H, W) of a grey picture, which may be stored as equal colours, or the colours (H, W, C).

    Raises TouchError when the file is missing or damaged, or has transparent pixels.
    """
    require_file(path)
    try:
        mode, values = load_image(path)
    except UNREADABLE as error:
        raise TouchError(explain_unreadable(path, error)) from error
    colours = find_colours(mode, values, str(path))
    values = values if colours is None else colours
    if values.ndim == 3 and (values == values[..., :1]).all():
        return values[..., 0]
    return values


def load_image(path: Path | IO[bytes], mode: str | None = None) -> tuple[str, NDArray[Any]]:
    """Return the mode and the values of an image file, converted to Pillow's `mode` if `mode` is given.

    The image is turned as its EXIF data state, like in any viewer. A palette is replaced by its colours. Raises OSError
    when the file cannot be read, and ValueError when it is damaged, too large, or has several pages.
    """
    from PIL import Image, ImageOps

    with _convert_damage(Image.DecompressionBombError), warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # MOST_PIXELS is the limit
        file = BytesIO(path.read_bytes()) if isinstance(path, Path) else path  # its end limits a damaged length
        with Image.open(file, formats=PICTURE_FORMATS) as image:
            width, height = image.size
            if width * height > MOST_PIXELS or max(width, height) > MOST_SIDE_PX:
                most = f"{MOST_PIXELS / 1e6:.0f} million pixels, {MOST_SIDE_PX} along a side"
                raise ValueError(f"it has {width} x {height} pixels; the limit is {most}")
            if image.format != "MPO" and getattr(image, "is_animated", False):  # phones add previews to MPO
                raise ValueError("it has several pages; save each page as a file")
            ImageOps.exif_transpose(image, in_place=True)
            wanted = mode or _find_plain_mode(image)
            return wanted, np.asarray(image if wanted == image.mode else image.convert(wanted))


def _find_plain_mode(image: Any) -> str:
    """Return the mode that holds all of an image's colours without a palette or a colour that means transparency."""
    if image.mode.startswith("I"):
        return str(image.mode)
    if image.mode in ("PA", "La", "RGBa") or image.info.get("transparency") is not None:
        return "LA" if image.mode in ("1", "L", "La") else "RGBA"
    return "RGB" if image.mode in ("P", "YCbCr", "RGBX") else str(image.mode)


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
