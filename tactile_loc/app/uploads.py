"""Files that visitors upload: their names and sizes, and the files in a zip archive."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePath, PurePosixPath

from tactile_loc.core.errors import UploadError
from tactile_loc.store.files import write_atomically

MB = 1_000_000
LARGEST_MB = 200  # an uploaded file
UNPACKED_MB, MOST_FILES = 1000, 2000  # all files of an archive together, and their number
ARCHIVE_SUFFIX = ".zip"
HIDDEN = "__MACOSX"  # a folder that macOS adds to archives


def write_upload(folder: Path, name: str, content: bytes) -> Path:
    """Write an uploaded file into a folder, and return its path. Only the last part of its name is used.

    Raises UploadError if the file is too large or has no name, and OutputError if it cannot be written.
    """
    require_size(name, content)
    plain = _find_plain_name(name)
    if not plain or plain == "..":
        raise UploadError(f"a file cannot be called {name!r}; give it another name")
    return _write(folder / plain, content)


def _find_plain_name(name: str) -> str:
    """Return the last part of a name, with the separators of any system."""
    return PurePath(name.replace("\\", "/")).name


def _write(path: Path, content: bytes) -> Path:
    return write_atomically(path, lambda temporary: temporary.write_bytes(content))


def require_size(name: str, content: bytes) -> None:
    """Raise UploadError if an uploaded file is larger than LARGEST_MB."""
    if len(content) > LARGEST_MB * MB:
        raise UploadError(
            f"{name} has {len(content) / MB:.0f} MB; the limit is {LARGEST_MB} MB, so upload less at once"
        )


def is_archive(name: str) -> bool:
    """Return whether a file is a zip archive, by its name."""
    return PurePath(name).suffix.lower() == ARCHIVE_SUFFIX


def list_files(name: str, content: bytes) -> Iterator[tuple[PurePosixPath, bytes]]:
    """Yield the path and the content of each file in an upload: those of a zip archive, or the one file itself.

    Paths in an archive are relative and stay inside it. Hidden files are left out. Raises UploadError if the upload or
    what it unpacks to is too large, if the archive is damaged, or if a path leads out of it.
    """
    require_size(name, content)
    if not is_archive(name):
        yield PurePosixPath(_find_plain_name(name)), content
        return
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for member, path in _check_members(name, archive.infolist()):
                yield path, archive.read(member)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError) as error:
        raise UploadError(
            f"{name} cannot be read as a zip archive ({error}); pack it again, without a password"
        ) from error


def _check_members(name: str, members: list[zipfile.ZipInfo]) -> list[tuple[zipfile.ZipInfo, PurePosixPath]]:
    """Return the files of an archive with their paths. Raises UploadError before anything is unpacked."""
    paths = [(member, PurePosixPath(member.filename.replace("\\", "/"))) for member in members if not member.is_dir()]
    shown = [(member, path) for member, path in paths if not _is_hidden(path)]
    outside = next(
        (path for _, path in shown if path.is_absolute() or ".." in path.parts or ":" in path.parts[0]), None
    )
    if outside is not None:
        raise UploadError(f"{name} holds the path {str(outside)!r}, which leads out of the archive; pack it again")
    total_mb = sum(member.file_size for member, _ in shown) / MB
    if total_mb > UNPACKED_MB or len(shown) > MOST_FILES:
        raise UploadError(
            f"{name} unpacks to {len(shown)} files of {total_mb:.0f} MB; the limits are {MOST_FILES} files and "
            f"{UNPACKED_MB} MB, so upload less at once"
        )
    if not shown:
        raise UploadError(f"{name} holds no file; pack the files again")
    return shown


def _is_hidden(path: PurePosixPath) -> bool:
    return HIDDEN in path.parts or (path.name.startswith(".") and path.name != "..")


def unpack_upload(folder: Path, name: str, content: bytes) -> list[Path]:
    """Write the files of an upload into a folder, with their folders, and return their paths.

    Raises UploadError as `list_files`, and OutputError if a file cannot be written.
    """
    return [_write(folder / path, data) for path, data in list_files(name, content)]
