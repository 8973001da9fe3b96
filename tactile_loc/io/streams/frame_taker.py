"""Takes single frames from a camera, a video or a folder, on request."""

from __future__ import annotations

import time

from tactile_loc.core.runtime.errors import SourceError
from tactile_loc.io.streams.frame_sources import POLL_S, Camera, Frames, FrameSource, ImageFolder, SourceFrame

SETTLES_S = 0.5  # a camera's first images are too dark or too bright
WAITS_S = 3.0  # longest wait for a new file in a folder


class FrameTaker:
    """Takes the newest frame of a source at each request, and each frame at most once.

    A camera or a video stays open from the first request until `close`. A video plays at its own rate.
    """

    def __init__(self, source: FrameSource, waits_s: float = WAITS_S) -> None:
        self.source, self._waits_s = source, waits_s
        self._frames: Frames | None = None

    def take(self) -> SourceFrame:
        """Return the newest frame. Raises SourceError if the source is missing, has ended, or has no new frame."""
        if isinstance(self.source, ImageFolder):
            return self._await_file(self.source)
        if self._frames is None:
            self._frames = self._open()
        frame = next(self._frames, None)
        if frame is None:
            raise SourceError(f"{self.source.about} has ended; take a frame again to begin anew")
        return frame

    def close(self) -> None:
        """Close the camera or the video."""
        if self._frames is not None:
            self._frames.close()
            self._frames = None

    def _open(self) -> Frames:
        frames, start_s = self.source.read_frames(), time.monotonic()
        if isinstance(self.source, Camera):
            for _ in frames:
                if time.monotonic() - start_s > SETTLES_S:
                    break
        return frames

    def _await_file(self, folder: ImageFolder) -> SourceFrame:
        end_s = time.monotonic() + self._waits_s
        while (frame := folder.take_newest()) is None:
            if time.monotonic() > end_s:
                raise SourceError(f"{folder.about} has no new image; write an image to it, then take a frame again")
            time.sleep(POLL_S)
        return frame
