"""Reads images from untrusted files: photos, masks and depths. Damaged files are refused, and so are large ones."""

import base64
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.runtime.limits import MOST_FILE_BYTES, TooLargeError, require_pixels, require_size
from tactile_loc.store.arrays import convert_damage, load_npy, measure_npy

FORMATS = ".npz, .npy or 16-bit grey .png"  # formats of contact shapes
PHOTO = "an 8-bit colour photo"
PICTURES = {
    "RGB": PHOTO,
    "RGBA": "an 8-bit colour photo with an alpha channel",
    "L": "an 8-bit grey picture",
    "LA": "an 8-bit grey picture with an alpha channel",
    "1": "a black and white picture",
    "CMYK": "a CMYK picture, in the colours of ink",
    "F": "a picture of floating-point numbers",
}
OPAQUE = 255  # value of an alpha channel
PICTURE_FORMATS = ("PNG", "JPEG", "BMP", "DIB", "TIFF", "WEBP", "GIF", "PPM")  # in Pillow; JPEG includes MPO
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")

COLOUR_ARRAYS = {3: "RGB", 4: "RGBA"}  # modes of photos, by the number of channels
TILE_WIDTH, TILE_HEIGHT = 322, 323  # tags of TIFF
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
    """Return the mode of a picture, or None for another file, and its colours (H, W, 3), or None if it is no photo.

    Only the header is read if it shows that the file is no photo.
    """
    if path.suffix.lower() not in (*IMAGE_SUFFIXES, ".npy"):
        return None, None
    with guard_reading(path):
        if path.suffix.lower() == ".npy":
            held = measure_npy(path)
            mode = COLOUR_ARRAYS.get(held.shape[2]) if held.ndim == 3 and held.dtype == np.uint8 else None
            values = None if mode is None else load_npy(path)
        else:
            with _open_picture(path) as picture:
                mode = _find_plain_mode(picture)
                values = _decode(picture, mode) if mode in COLOUR_ARRAYS.values() else None
    return mode, None if mode is None or values is None else find_colours(mode, values, str(path))


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
            f"{name} has an alpha channel, and {format_percent(clear)} of its pixels are transparent, so it is no "
            "photo of a gel; give the camera's own image"
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
    with guard_reading(path):
        mode, values = load_image(path)
    colours = find_colours(mode, values, str(path))
    values = values if colours is None else colours
    if values.ndim == 3 and (values == values[..., :1]).all():
        return values[..., 0]
    return values


def load_image(path: Path | IO[bytes], mode: str | None = None) -> tuple[str, NDArray[Any]]:
    """Return the mode and the values (H, W) or (H, W, C) of an image file, converted to Pillow's `mode` if given.

    The image is turned as its EXIF data state, like in any viewer. A palette is replaced by its colours. Raises OSError
    when the file cannot be read, and ValueError when it is damaged, too large, or has several pages.
    """
    with _open_picture(path) as image:
        wanted = mode or _find_plain_mode(image)
        return wanted, _decode(image, wanted)


def _decode(image: Any, mode: str) -> NDArray[Any]:
    from PIL import ImageOps

    ImageOps.exif_transpose(image, in_place=True)
    return np.asarray(image if mode == image.mode else image.convert(mode))


@contextmanager
def _open_picture(path: Path | IO[bytes]) -> Iterator[Any]:
    """Yield an image of Pillow, of which only the header is read. Raises OSError or ValueError as `load_image`."""
    from PIL import Image

    with convert_damage(), warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # MOST_PIXELS is the limit
        if isinstance(path, Path):
            require_size(path.stat().st_size, MOST_FILE_BYTES)
        file = BytesIO(path.read_bytes()) if isinstance(path, Path) else path  # its end limits a damaged length
        with Image.open(file, formats=PICTURE_FORMATS) as image:
            require_pixels(*image.size)
            tags = getattr(image, "tag_v2", {})  # of TIFF, where a tile may be larger than the image
            require_pixels(tags.get(TILE_WIDTH, 1), tags.get(TILE_HEIGHT, 1))
            if image.format != "MPO" and getattr(image, "is_animated", False):  # phones add previews to MPO
                raise TooLargeError("it has several pages; save each page as a file")
            yield image


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


def make_png_url(png: bytes) -> str:
    """Return the bytes of a PNG file as a data URL, which a page shows without the file."""
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"


@contextmanager
def guard_reading(path: Path) -> Iterator[None]:
    """Raise TouchError if there is no file, and convert errors of the block, which reads a damaged file, to it."""
    if os.path.isdir(path):
        raise TouchError(f"{path} is a folder; give one file, {FORMATS}")
    if not os.path.isfile(path):
        raise TouchError(f"there is no file {path}; check the path")
    try:
        yield
    except TooLargeError as error:
        raise TouchError(f"{path} cannot be read: {error}") from error
    except UNREADABLE as error:
        says = f"{path} cannot be read as {path.suffix.lower()[1:]} ({summarize(error)}); it is damaged or of another "
        says += "kind, so save it again"
        if "allow_pickle" in str(error):
            says = f"{path} holds Python objects, which are never loaded; save plain numbers (H, W)"
        raise TouchError(says) from error


def summarize(error: BaseException) -> str:
    """Return an error's message in one line, or its type if it has none."""
    words = re.sub(r" ?<[^>]* object at 0x[0-9a-f]+>", "", str(error))  # Pillow names the object that it reads
    return " ".join(words.split()) or type(error).__name__
