"""Reads videos as images, with OpenCV or imageio, whichever is installed."""

import importlib.util
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.runtime.limits import TooLargeError, require_pixels
from tactile_loc.io.images import summarize
from tactile_loc.store.files import link_plainly

VIDEO_SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".mpg", ".mpeg", ".m4v", ".wmv", ".gif")
TO_INSTALL = "pip install 'tactile-loc[video]'"
TO_READ = f"check the file, or install another reader: {TO_INSTALL}"
USUAL_HZ = 30.0  # assumed rate of a video whose header has no rate


@dataclass(frozen=True)
class VideoFacts:
    """The rate and the number of frames that a video's header gives. `count` is None if unknown."""

    rate_hz: float = USUAL_HZ
    count: int | None = None


def read_video(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames (H, W, 3) of a video, in RGB.

    Raises CalibrationError when the video has no frames, is damaged, or has a format that no installed library reads.
    """
    read = _read_opencv if importlib.util.find_spec("cv2") else _read_imageio
    number = 0
    try:
        for frame in read(path):
            require_pixels(frame.shape[1], frame.shape[0])
            number += 1
            yield np.ascontiguousarray(frame[..., :3], np.uint8)
    except TooLargeError as error:
        raise CalibrationError(f"a frame of {path} cannot be read: {error}") from error
    if not number:
        raise CalibrationError(f"{path} holds no frame that can be read; {TO_READ}")


def read_video_facts(path: Path) -> VideoFacts:
    """Return the rate and the number of frames that a video's header gives. The number is approximate."""
    read = _read_opencv_facts if importlib.util.find_spec("cv2") else _read_imageio_facts
    rate_hz, count = read(path)
    known = math.isfinite(count) and count >= 1
    return VideoFacts(rate_hz if math.isfinite(rate_hz) and rate_hz > 0 else USUAL_HZ, round(count) if known else None)


def _open_opencv(path: Path) -> Any:
    import cv2

    with link_plainly(path) as plain:
        return cv2.VideoCapture(str(plain))


def _read_opencv_facts(path: Path) -> tuple[float, float]:
    import cv2

    film = _open_opencv(path)
    try:
        return float(film.get(cv2.CAP_PROP_FPS)), float(film.get(cv2.CAP_PROP_FRAME_COUNT))
    finally:
        film.release()


def _read_imageio_facts(path: Path) -> tuple[float, float]:
    try:
        import imageio.v3

        about = imageio.v3.immeta(path)
    except Exception:  # noqa: BLE001 - reading the frames reports it
        return math.nan, math.nan
    duration = float(about.get("duration", math.nan))
    if path.suffix.lower() == ".gif":  # then the duration is that of the first frame, milliseconds
        return 1e3 / duration if duration > 0 else math.nan, math.nan
    rate_hz = float(about.get("fps", math.nan))
    return rate_hz, rate_hz * duration


def _read_opencv(path: Path) -> Iterator[NDArray[np.uint8]]:
    import cv2

    film = _open_opencv(path)
    try:
        require_pixels(int(film.get(cv2.CAP_PROP_FRAME_WIDTH)), int(film.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        while (answer := film.read())[0]:
            yield np.asarray(answer[1][..., ::-1], np.uint8)
    finally:
        film.release()


def _read_imageio(path: Path) -> Iterator[NDArray[np.uint8]]:
    try:
        import imageio.v3
    except ImportError as error:
        raise CalibrationError(f"{path} is a video, but no reader of videos is installed: {TO_INSTALL}") from error
    try:
        yield from imageio.v3.imiter(path, **({"mode": "RGB"} if path.suffix.lower() == ".gif" else {}))
    except Exception as error:  # readers raise errors of any type for damaged bytes
        raise CalibrationError(f"{path} cannot be read as a video ({summarize(error)[:120]}); {TO_READ}") from error
