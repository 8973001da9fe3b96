"""Locks of folders and files between processes. The system releases the locks of a process that ends.

Windows opens no folder, and deletes no file that is open. There, a file in a folder stands for the folder.
"""

import os
from pathlib import Path

OPENS_FOLDERS = os.name != "nt"
IN_FOLDER = ".tmp-lock"  # the file that stands for its folder
POLL_S = 0.005  # pause between two attempts to get a lock


def open_folder(folder: Path) -> int:
    """Open a folder, to lock it or to sync it, and return the descriptor. Raises OSError if that fails."""
    if OPENS_FOLDERS:
        return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    return os.open(folder / IN_FOLDER, os.O_RDWR | os.O_CREAT)


def is_at(folder: Path, descriptor: int) -> bool:
    """Return whether a folder is still the one that was opened."""
    try:
        return os.path.samestat((folder if OPENS_FOLDERS else folder / IN_FOLDER).stat(), os.fstat(descriptor))
    except OSError:
        return False


def lock(descriptor: int, wait: bool) -> bool:
    """Lock an open folder or file, and return whether that succeeded. It always does with `wait`.

    Closing the descriptor releases the lock. Raises OSError if the file system has no locks.
    """
    from filelock import lock_descriptor

    return lock_descriptor(descriptor, blocking=wait, poll_interval=POLL_S)
