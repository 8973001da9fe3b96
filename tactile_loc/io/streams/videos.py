"""Reads videos as images, with OpenCV."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.runtime.limits import TooLargeError, require_pixels
from tactile_loc.store.files import link_plainly

VIDEO_SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".mpg", ".mpeg", ".m4v", ".wmv", ".gif")
TO_READ = "check the file, or convert it to MP4"
USUAL_HZ = 30.0  # assumed rate of a video whose header has no rate


@dataclass(frozen=True)
class VideoFacts:
    """The rate and the number of frames that a video's header gives. `count` is None if unknown."""

    rate_hz: float = USUAL_HZ
    count: int | None = None


def read_video(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames (H, W, 3) of a video, in RGB.

    Raises CalibrationError when the video has no frames, is damaged, or when OpenCV is not installed.
    """
    number = 0
    with _open(path) as film:
        while (answer := film.read())[0]:
            number += 1
            yield np.ascontiguousarray(answer[1][..., ::-1], np.uint8)
    if not number:
        raise CalibrationError(f"{path} holds no frame that can be read; {TO_READ}")


def read_video_facts(path: Path) -> VideoFacts:
    """Return the rate and the number of frames that a video's header gives. The number is approximate."""
    with _open(path) as film:
        import cv2

        rate_hz, count = (float(film.get(name)) for name in (cv2.CAP_PROP_FPS, cv2.CAP_PROP_FRAME_COUNT))
    known = math.isfinite(count) and count >= 1
    return VideoFacts(rate_hz if math.isfinite(rate_hz) and rate_hz > 0 else USUAL_HZ, round(count) if known else None)


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """Yield a VideoCapture of OpenCV. Raises CalibrationError if its frames are too large, and without OpenCV."""
    try:
        import cv2
    except ImportError as error:
        raise CalibrationError(
            f"{path} is a video, but OpenCV is not installed: pip install 'tactile-loc[camera]'"
        ) from error
    with link_plainly(path) as plain:
        film = cv2.VideoCapture(str(plain))
    try:
        require_pixels(int(film.get(cv2.CAP_PROP_FRAME_WIDTH)), int(film.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        yield film
    except TooLargeError as error:
        raise CalibrationError(f"a frame of {path} cannot be read: {error}") from error
    finally:
        film.release()
