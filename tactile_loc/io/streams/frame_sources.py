"""Sources of live frames: a camera, a folder that receives images, or a video.

A source yields either every frame, or the newest frame each time. In the second case, older frames are dropped and
counted.
"""

import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import MissingLibraryError, SourceError, TactileLocError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.images import read_colour_image
from tactile_loc.io.streams.cameras import NOT_FIXED, CameraSettings, find_device
from tactile_loc.io.streams.videos import TO_READ, read_video, read_video_facts
from tactile_loc.io.touches import list_touches, read_contents, read_touch, touch_from_image
from tactile_loc.slots.sensor import SensorModel

POLL_S = 0.05
SETTLED_S = 1.0  # an unreadable file that has not grown for this time is damaged, not incomplete
LACKING, FEW = 0.02, 3  # allowed error of the number of frames in a video's header: share, and least number
LEAVES_S = 2.0  # longest wait for the end of a reading thread


@dataclass(frozen=True, eq=False)
class SourceFrame:
    """One frame: an `image` (H, W, 3) uint8, or a file at `path`, or the `problem` that makes the frame unusable.

    `number` counts all frames of the source from 0, including dropped frames. `time_s` is the time since 1970, or since
    the beginning of a video. `settings` are those of the camera, if it is one.
    """

    number: int
    time_s: float
    name: str
    image: NDArray[np.uint8] | None = field(default=None, repr=False)
    path: Path | None = None
    problem: TactileLocError | None = None
    settings: CameraSettings = NOT_FIXED

    def read_touch(
        self, sensor: SensorModel, unit: str | None = None, press_depth_m: float | None = None, kind: str | None = None
    ) -> Touch:
        """Return the touch that a sensor reads from the frame. Raises TouchError when the frame is not a touch.

        The arguments are those of the function `read_touch`, which reads a file.
        """
        if self.problem is not None:
            raise self.problem
        if self.image is not None:
            return touch_from_image(self.image, sensor, press_depth_m, self.name)
        return read_touch(Path(self.name) if self.path is None else self.path, sensor, unit, press_depth_m, kind)


Frames = Generator[SourceFrame, None, None]


class FrameSource(ABC):
    """A source of frames. `about` is the source in words, and `dropped` counts frames that newer frames replaced."""

    about: str
    dropped = 0

    @abstractmethod
    def read_frames(self) -> Frames:
        """Yield frames as they arrive, until the source ends. Raises SourceError when the source is lost."""


class _Followed(FrameSource):
    """A source whose frames another thread reads, so that only the newest frame waits."""

    def __init__(self, about: str) -> None:
        self.about = about
        self._changed = threading.Condition()
        self._frame: SourceFrame | None = None
        self._ended = False
        self._error: BaseException | None = None

    def _follow(self, frames: Iterator[SourceFrame]) -> Frames:
        """Read the frames in another thread, and yield the newest frame each time, until the frames end.

        Raises the error that ended the other thread.
        """
        left = threading.Event()
        thread = threading.Thread(target=self._fill, args=(frames, left), name="frames", daemon=True)
        thread.start()
        try:
            while (frame := self._take()) is not None:
                yield frame
        finally:
            left.set()
            thread.join(LEAVES_S)

    def _fill(self, frames: Iterator[SourceFrame], left: threading.Event) -> None:
        try:
            for frame in frames:
                if left.is_set():
                    break
                with self._changed:
                    self.dropped += self._frame is not None
                    self._frame = frame
                    self._changed.notify()
        except BaseException as error:  # noqa: BLE001 - the other thread raises it
            self._error = error
        with self._changed:
            self._ended = True
            self._changed.notify()

    def _take(self) -> SourceFrame | None:
        """Wait for a frame and return it, or None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._ended)
            frame, self._frame = self._frame, None
        if frame is None and self._error is not None:
            raise self._error
        return frame


class Camera(_Followed):
    """A camera that OpenCV opens, given as in `find_device`, with `settings` to be fixed.

    It yields the newest frame each time.
    """

    def __init__(self, device: str, settings: CameraSettings = NOT_FIXED) -> None:
        super().__init__(f"camera {device}")
        self.device, self.settings = device, settings

    def read_frames(self) -> Frames:
        """Yield the newest frame each time.

        Raises SourceError when the camera is missing or lost, or does not take a setting.
        """
        opened = self._open()
        try:
            settings = self.settings.fix(opened, self.about)
        except SourceError:
            opened.release()
            raise
        return self._follow(self._grab(opened, settings))

    def _open(self) -> Any:
        try:
            import cv2
        except ImportError as error:
            raise MissingLibraryError(
                "cameras are read with OpenCV, which is not installed: pip install 'tactile-loc[camera]'"
            ) from error
        device = find_device(self.device)
        found = cv2.VideoCapture(int(device) if device.isdigit() else device)
        if not found.isOpened():
            found.release()
            raise SourceError(
                f"{self.about} cannot be opened; check its connection and permissions, and close other programs that "
                "use it"
            )
        return found

    def _grab(self, opened: Any, settings: CameraSettings) -> Iterator[SourceFrame]:
        number = 0
        try:
            while (answer := opened.read())[0]:
                image = np.ascontiguousarray(answer[1][..., ::-1], np.uint8)
                yield SourceFrame(number, time.time(), f"frame-{number:06d}", image, settings=settings)
                number += 1
        finally:
            opened.release()
        raise SourceError(f"{self.about} stopped after {number} images; check its connection")


class Video(_Followed):
    """A video. It yields every frame, or, like a camera, the newest frame each time at the video's own rate."""

    def __init__(self, path: Path, every: bool) -> None:
        super().__init__(f"video {path}")
        self.path, self.every = path, every

    def read_frames(self) -> Frames:
        """Yield the frames. Raises SourceError when the video cannot be read or is truncated."""
        return self._read() if self.every else self._follow(self._play())

    def _read(self) -> Frames:
        facts, number = read_video_facts(self.path), 0
        try:
            for number, image in enumerate(read_video(self.path), 1):
                yield SourceFrame(number - 1, (number - 1) / facts.rate_hz, f"frame-{number - 1:06d}", image)
        except TactileLocError as error:
            raise SourceError(str(error)) from error
        if facts.count is not None and number < facts.count - max(FEW, LACKING * facts.count):
            raise SourceError(f"{self.path} ends after {number} of {facts.count} frames; {TO_READ}")

    def _play(self) -> Iterator[SourceFrame]:
        start = time.monotonic()
        for frame in self._read():
            time.sleep(max(0.0, start + frame.time_s - time.monotonic()))
            yield frame


class ImageFolder(FrameSource):
    """A folder that receives images or contact shapes, ordered by the time of writing, then by name.

    With `every`, the source yields each file that is in the folder, and then ends. Otherwise it yields the newest file
    each time, and waits for more files. A file that is written again is another frame.
    """

    def __init__(self, path: Path, every: bool) -> None:
        self.path, self.every, self.about = path, every, f"folder {path}"
        self._number = 0
        self._seen: dict[str, int] = {}  # time of writing of each file, ns
        self._growing: dict[str, tuple[int, float]] = {}  # size, and the time of its last change

    def read_frames(self) -> Frames:
        """Yield the files as frames. Raises SourceError when the folder is missing or vanishes."""
        while True:
            waiting = self._list_waiting()
            yield from self._take(waiting, self.every)
            if self.every and not self._growing:
                return
            time.sleep(POLL_S)

    def take_newest(self) -> SourceFrame | None:
        """Return the newest file that was not yielded yet, or None. Raises SourceError when the folder is missing."""
        return next(self._take(self._list_waiting(), every=False), None)

    def _list_waiting(self) -> list[tuple[int, Path]]:
        """Return the files that were not yielded yet, oldest first, each with its time of writing, ns."""
        try:
            found = [(_read_time_ns(path), path) for path in list_touches(self.path)]
            found.sort(key=lambda one: one[0])
        except OSError as error:
            raise SourceError(f"{self.path} cannot be read ({error.strerror}); check that the folder exists") from error
        waiting = [(when, path) for when, path in found if self._seen.get(path.name) != when]
        self._growing = {path.name: self._growing[path.name] for _, path in waiting if path.name in self._growing}
        return waiting

    def _take(self, waiting: list[tuple[int, Path]], every: bool) -> Iterator[SourceFrame]:
        """Yield each readable file, or only the newest, and drop the older files."""
        places = range(len(waiting)) if every else reversed(range(len(waiting)))
        for place in places:
            when, path = waiting[place]
            if (frame := self._read_frame(path)) is None:
                continue
            if not every:
                self._seen |= {older.name: ns for ns, older in waiting[:place]}
                self.dropped += place
                self._number += place
            self._seen[path.name] = when
            self._number += 1
            yield replace(frame, number=self._number - 1)
            if not every:
                return

    def _read_frame(self, path: Path) -> SourceFrame | None:
        """Return a file as a frame, or None while the file may be incomplete."""
        problem = None
        try:
            image = read_colour_image(path)
            if image is None:
                read_contents(path)
        except TactileLocError as error:
            if self._may_grow(path):
                return None
            image, problem = None, error
        self._growing.pop(path.name, None)
        return SourceFrame(0, time.time(), path.name, image, path, problem)

    def _may_grow(self, path: Path) -> bool:
        """Return whether an unreadable file has grown within the last SETTLED_S seconds."""
        size, now = path.stat().st_size if path.exists() else -1, time.monotonic()
        before, since = self._growing.get(path.name, (size, now))
        self._growing[path.name] = (size, since if size == before else now)
        return now - self._growing[path.name][1] < SETTLED_S


def _read_time_ns(path: Path) -> int:
    """Return a file's time of writing, ns, or 0 if the file has just been removed."""
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def open_source(
    path: Path | None, camera: str | None, every: bool, settings: CameraSettings = NOT_FIXED
) -> FrameSource:
    """Return the source for a camera with `settings`, or for a folder of images or a video at `path`.

    The source yields `every` frame, or the newest frame each time. Raises SourceError when `path` and `camera` are both
    given or both missing, when `path` does not exist, when `every` is set for a camera, or `settings` without one.
    """
    if path is not None and camera is None:
        if settings != NOT_FIXED:
            raise SourceError("exposure and white balance need `camera`; leave them out for a folder or a video")
        if not os.path.exists(path):  # unlike `Path.exists`, for names that no file can have, too
            raise SourceError(f"there is no file or folder {path}; give a folder of images, or a video")
        return ImageFolder(path, every) if path.is_dir() else Video(path, every)
    if camera is None or path is not None:
        raise SourceError("give one source of images: `camera` with its number, a folder, or a video")
    if every:
        raise SourceError("`once` needs a folder or a video; leave it out with `camera`")
    return Camera(camera, settings)
