"""Files that visitors upload: their names and sizes, and the files in a zip archive."""

from __future__ import annotations

import io
import re
import stat
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path, PurePath, PurePosixPath
from typing import TYPE_CHECKING, Any

from tactile_loc.commands import read_member, write_atomically

from tactile_loc_app.errors import AppError

if TYPE_CHECKING:
    from viser import ClientHandle

MB = 1_000_000
LARGEST_MB = 200  # an uploaded file
UNPACKED_MB, MOST_FILES = 1000, 2000  # all files of an archive together, and their number
LONGEST_PLAIN = 255  # bytes of a name without folders, in most file systems
ARCHIVE_SUFFIX = ".zip"
DRIVE = re.compile("[A-Za-z]:")
HIDDEN = "__MACOSX"  # a folder that macOS adds to archives
MOST_RUNNING, LEAST_PART = 16, 2**16  # uploads of a visitor at once; bytes of the parts of an upload, on average
MOST_ENTRIES, ENTRY = 10 * MOST_FILES, b"PK\x01\x02"  # all of an archive, with folders and hidden files; how one begins
DAMAGED = (zipfile.BadZipFile, EOFError, OSError, RuntimeError, NotImplementedError, ValueError)


def limit_uploads(client: ClientHandle, show_error: Callable[[AppError], None]) -> None:
    """Drop a visitor's uploads that are too large, by their stated sizes and before they are kept.

    All uploads that are running together may have LARGEST_MB. One that has more than it stated is dropped, too.
    """
    from viser import _messages

    gui, connection = client.gui, client.gui._websock_interface
    running: dict[str, Any] = gui._current_file_upload_states

    def begin(client_id: Any, start: _messages.FileTransferStartUpload) -> None:
        try:
            names = " with ".join([start.filename, *(one["filename"] for one in running.values())])
            require_size(names, start.size_bytes + sum(one["total_bytes"] for one in running.values()))
            if len(running) >= MOST_RUNNING or not 0 <= LEAST_PART * (max(start.part_count, 1) - 1) <= start.size_bytes:
                raise AppError(f"{start.filename} cannot be uploaded in this way; upload fewer files at once")
        except AppError as error:
            whole = (start.source_component_uuid, start.transfer_uuid, start.size_bytes, start.size_bytes)
            connection.queue_message(_messages.FileTransferPartAck(*whole))  # the browser stops waiting
            show_error(error)
        else:
            gui._handle_file_transfer_start(client_id, start)

    def receive(client_id: Any, part: _messages.FileTransferPart) -> None:
        state = running.get(part.transfer_uuid)
        if state is not None and state["transferred_bytes"] + len(part.content) > state["total_bytes"]:
            del running[part.transfer_uuid]
            show_error(AppError(f"{state['filename']} has more bytes than the browser stated; upload it again"))
        else:
            gui._handle_file_transfer_part(client_id, part)

    for message, handle in ((_messages.FileTransferStartUpload, begin), (_messages.FileTransferPart, receive)):
        connection.unregister_handler(message)
        connection.register_handler(message, handle)


def take_upload(button: Any) -> tuple[str, bytes]:
    """Return the name and the content of a button's file, which the button then forgets."""
    file = button.value
    button._impl.value = type(file)("", b"")
    return file.name, file.content


def write_upload(folder: Path, name: str, content: bytes) -> Path:
    """Write an uploaded file into a folder, and return its path. Only the last part of its name is used.

    Raises AppError if the file is too large or has no name, and AppError if it cannot be written.
    """
    require_size(name, len(content))
    plain = _find_plain_name(name)
    if not plain or plain.startswith(".") or "\0" in plain or len(plain.encode()) > LONGEST_PLAIN:
        raise AppError(f"a file cannot be called {name[:LONGEST_PLAIN]!r}; give it another name")
    return _write(folder / plain, content)


def _find_plain_name(name: str) -> str:
    """Return the last part of a name, with the separators of any system."""
    return PurePath(name.replace("\\", "/")).name


def _write(path: Path, content: bytes) -> Path:
    return write_atomically(path, lambda temporary: temporary.write_bytes(content))


def require_size(name: str, size: int) -> None:
    """Raise AppError if files of a size, bytes, are larger than LARGEST_MB."""
    if size > LARGEST_MB * MB:
        raise AppError(f"{name} has {size / MB:.0f} MB; the limit is {LARGEST_MB} MB, so upload less at once")


def is_archive(name: str) -> bool:
    """Return whether a file is a zip archive, by its name."""
    return PurePath(name).suffix.lower() == ARCHIVE_SUFFIX


def read_files(name: str, content: bytes) -> Iterator[tuple[PurePosixPath, bytes]]:
    """Yield the path and the content of each file in an upload: those of a zip archive, or the one file itself.

    Paths in an archive are relative and stay inside it. Hidden files are left out. Raises AppError if the upload or
    what it unpacks to is too large, if the archive is damaged, or if a path leads out of it.
    """
    require_size(name, len(content))
    if not is_archive(name):
        yield PurePosixPath(_find_plain_name(name)), content
        return
    if content.count(ENTRY) > MOST_ENTRIES:  # reading their names takes much memory
        raise AppError(f"{name} has more than {MOST_ENTRIES} entries; the limit is {MOST_FILES} files")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for member, path in _check_members(name, archive.infolist()):
                yield path, read_member(archive, member)
    except DAMAGED as error:
        raise AppError(
            f"{name} cannot be read as a zip archive ({error}); pack it again, without a password"
        ) from error


def _check_members(name: str, members: list[zipfile.ZipInfo]) -> list[tuple[zipfile.ZipInfo, PurePosixPath]]:
    """Return the files of an archive with their paths. Raises AppError before anything is unpacked."""
    paths = [(member, PurePosixPath(member.filename.replace("\\", "/"))) for member in members if not member.is_dir()]
    shown = [(member, path) for member, path in paths if not _is_hidden(path)]
    for member, path in shown:
        if path.is_absolute() or not path.parts or ".." in path.parts or DRIVE.match(path.parts[0]):
            raise AppError(f"{name} holds the path {str(path)!r}, which leads out of the archive; pack it again")
        if "\0" in member.orig_filename or stat.S_ISLNK(member.external_attr >> 16):
            raise AppError(f"{name} holds {member.orig_filename!r}, which is no plain file; leave it out")
        require_size(f"{path} in {name}", member.file_size)
    if len({path for _, path in shown}) < len(shown):
        raise AppError(f"{name} holds two files of the same name; pack it again")
    total_mb = sum(member.file_size for member, _ in shown) / MB
    if total_mb > UNPACKED_MB or len(shown) > MOST_FILES:
        raise AppError(
            f"{name} unpacks to {len(shown)} files of {total_mb:.0f} MB; the limits are {MOST_FILES} files and "
            f"{UNPACKED_MB} MB, so upload less at once"
        )
    if not shown:
        raise AppError(f"{name} holds no file; pack the files again")
    return shown


def _is_hidden(path: PurePosixPath) -> bool:
    return HIDDEN in path.parts or (path.name.startswith(".") and path.name != "..")


def unpack_upload(folder: Path, name: str, content: bytes) -> list[Path]:
    """Write the files of an upload into a folder, with their folders, and return their paths.

    Raises AppError as `read_files`, and OutputError if a file cannot be written.
    """
    return [_write(folder / path, data) for path, data in read_files(name, content)]
