"""The largest inputs that are read. Readers check a file's header against them before they take memory."""

from typing import IO

MOST_PIXELS, MOST_SIDE_PX = 2**25, 2**14  # largest image and image side; no camera behind a gel takes larger images
MOST_FILE_BYTES = 2**28  # file of a picture
MOST_BYTES = 2**30  # all arrays of an .npz file together
MOST_PART_BYTES = 2**28  # an unpacked chunk of a recording, a record of a library, a table, an array of a mesh file


class TooLargeError(ValueError):
    """An input is larger than the limits here allow, or has several pages. The message states what to change."""


def require_size(size: int, most: int = MOST_PART_BYTES) -> None:
    """Raise TooLargeError if something takes more than `most` bytes in memory."""
    if not 0 <= size <= most:
        raise TooLargeError(f"it takes {size / 2**30:.3g} GiB of memory; the limit is {most / 2**30:.3g} GiB")


def read_unpacked(stream: IO[bytes], size: int, most: int = MOST_PART_BYTES) -> bytes:
    """Return all `size` bytes of a stream that unpacks. Raises ValueError if it holds fewer or more, or above `most`.

    The stream must not unpack more than is asked for. Then memory is limited, whatever the file states.
    """
    require_size(size, most)
    content = stream.read(size + 1)
    if len(content) != size:
        raise ValueError(f"it states {size} bytes, but holds {'more' if len(content) > size else len(content)}")
    return content


def require_pixels(width: int, height: int) -> None:
    """Raise TooLargeError if an image has too many pixels."""
    if width * height > MOST_PIXELS or max(width, height) > MOST_SIDE_PX:
        most = f"{MOST_PIXELS / 1e6:.0f} million pixels, {MOST_SIDE_PX} along a side"
        raise TooLargeError(f"it has {width} x {height} pixels; the limit is {most}")
