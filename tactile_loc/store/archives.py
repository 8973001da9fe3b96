"""Members of zip archives, which may state a wrong size, or unpack to far more than the archive's size."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterable

from tactile_loc.core.runtime.limits import MOST_BYTES, read_unpacked

PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def require_packing(members: Iterable[zipfile.ZipInfo]) -> None:
    """Raise ValueError if members of a zip archive are packed in a way that unpacks without a limit for memory."""
    for one in members:
        if one.compress_type not in PACKINGS:
            raise ValueError(f"{one.filename!r} in it is neither stored nor deflated; pack it again")


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return the content of a zip archive's member. Raises ValueError if it is damaged, too large or rarely packed."""
    require_packing([member])
    try:
        with archive.open(member) as stream:
            return read_unpacked(stream, member.file_size, MOST_BYTES)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:  # RuntimeError: it needs a password
        raise ValueError(f"{member.filename!r} in it is damaged ({error})") from error
