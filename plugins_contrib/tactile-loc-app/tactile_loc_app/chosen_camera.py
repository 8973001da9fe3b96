"""The camera, video or folder of images from which a visitor takes frames."""

import os
from contextlib import suppress
from pathlib import Path
from threading import Lock

from tactile_loc import FrameTaker, SourceFrame, TactileLocError, open_source

from tactile_loc_app.errors import AppError

DEVICES = "/dev/"


class ChosenCamera:
    """The source that was chosen last. It stays open for the next frame, until another one is chosen or it fails."""

    def __init__(self) -> None:
        self._chosen = ""
        self._taker: FrameTaker | None = None
        self._lock = Lock()

    def take(self, source: str) -> SourceFrame:
        """Return the newest frame of a source: a camera's number or device, or the path of a video or a folder.

        Raises AppError if there is no such source, or if it has no new frame.
        """
        name = source.strip()
        with self._lock:
            if name != self._chosen or self._taker is None:
                self._drop()
                self._chosen, self._taker = name, _open(name)
            try:
                return self._taker.take()
            except TactileLocError:
                if not os.path.isdir(name):  # a folder remembers its files
                    self._drop()
                raise

    def close(self) -> None:
        """Close the source."""
        with self._lock:
            self._drop()

    def _drop(self) -> None:
        if self._taker is not None:
            self._taker.close()
        self._taker = None


def _open(name: str) -> FrameTaker:
    if not name:
        raise AppError("no camera is chosen; give its number, such as 0, or the path of a video or a folder of images")
    is_camera = name.isdigit() or name.startswith(DEVICES)
    path = Path(name)
    with suppress(RuntimeError, ValueError):  # no such user, or a name that no user can have
        path = path.expanduser()
    return FrameTaker(open_source(None, name, False) if is_camera else open_source(path, None, False))
