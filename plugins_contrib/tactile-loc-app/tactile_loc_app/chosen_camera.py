"""The camera, video or folder of images from which a visitor takes frames."""

import os
import time
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from threading import Lock

from tactile_loc import Camera, FrameSource, ImageFolder, SourceFrame, TactileLocError, open_source

from tactile_loc_app.errors import AppError

DEVICES = "/dev/"
SETTLES_S = 0.5  # a camera's first images are too dark or too bright
WAITS_S, POLL_S = 3.0, 0.05  # longest wait for a new file in a folder, and time between two looks


class ChosenCamera:
    """The source that was chosen last. It stays open for the next frame, until another one is chosen or it fails.

    Each frame is taken at most once. A video plays at its own rate.
    """

    def __init__(self) -> None:
        self._chosen = ""
        self._source: FrameSource | None = None
        self._frames: Generator[SourceFrame, None, None] | None = None
        self._lock = Lock()

    def take(self, source: str) -> SourceFrame:
        """Return the newest frame of a source: a camera's number or device, or the path of a video or a folder.

        Raises TactileLocError if there is no such source, or if it has no new frame.
        """
        name = source.strip()
        with self._lock:
            if name != self._chosen or self._source is None:
                self._drop()
                self._chosen, self._source = name, _find_source(name)
            try:
                if isinstance(self._source, ImageFolder):
                    return await_file(self._source)
                self._frames = self._frames or _open(self._source)
                frame = next(self._frames, None)
                if frame is None:
                    raise AppError(f"{self._source.about} has ended; take a frame again to begin anew")
                return frame
            except TactileLocError:
                if not os.path.isdir(name):  # a folder remembers its files
                    self._drop()
                raise

    def close(self) -> None:
        """Close the source."""
        with self._lock:
            self._drop()

    def _drop(self) -> None:
        if self._frames is not None:
            self._frames.close()
        self._source = self._frames = None


def _find_source(name: str) -> FrameSource:
    if not name:
        raise AppError("no camera is chosen; give its number, such as 0, or the path of a video or a folder of images")
    is_camera = name.isdigit() or name.startswith(DEVICES)
    path = Path(name)
    with suppress(RuntimeError, ValueError):  # no such user, or a name that no user can have
        path = path.expanduser()
    return open_source(None, name, False) if is_camera else open_source(path, None, False)


def _open(source: FrameSource) -> Generator[SourceFrame, None, None]:
    """Return the frames of a camera, once it has settled, or of a video."""
    frames, start_s = source.read_frames(), time.monotonic()
    if isinstance(source, Camera):
        for _ in frames:
            if time.monotonic() - start_s > SETTLES_S:
                break
    return frames


def await_file(folder: ImageFolder, waits_s: float = WAITS_S) -> SourceFrame:
    """Wait for a new file in a folder, and return the newest one. Raises TactileLocError if there is none."""
    end_s = time.monotonic() + waits_s
    while (frame := folder.take_newest()) is None:
        if time.monotonic() > end_s:
            raise AppError(f"{folder.about} has no new image; write an image to it, then take a frame again")
        time.sleep(POLL_S)
    return frame
