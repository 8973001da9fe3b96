"""Videos as images, by OpenCV or imageio, whichever is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import CalibrationError

VIDEO_SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".mpg", ".mpeg", ".m4v", ".wmv", ".gif")
TO_INSTALL = "pip install 'tactile-loc[video]'"


def video_frames(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames (H, W, 3) of a video, red first.

    Raises CalibrationError when it holds none, is damaged, or nothing is installed that reads its kind.
    """
    read = _by_opencv if importlib.util.find_spec("cv2") else _by_imageio
    number = 0
    for frame in read(path):
        number += 1
        yield np.ascontiguousarray(frame[..., :3], np.uint8)
    if not number:
        raise CalibrationError(f"{path} holds no frame that can be read; is it a whole video? {TO_INSTALL}")


def _by_opencv(path: Path) -> Iterator[NDArray[np.uint8]]:
    import cv2

    film = cv2.VideoCapture(str(path))
    try:
        while (answer := film.read())[0]:
            yield answer[1][..., ::-1]
    finally:
        film.release()


def _by_imageio(path: Path) -> Iterator[NDArray[np.uint8]]:
    try:
        import imageio.v3
    except ImportError as error:
        raise CalibrationError(f"{path} is a video, and nothing is installed that reads them; {TO_INSTALL}") from error
    try:
        yield from imageio.v3.imiter(path, **({"mode": "RGB"} if path.suffix.lower() == ".gif" else {}))
    except (OSError, ValueError, RuntimeError, ImportError, SyntaxError, EOFError) as error:
        reason = " ".join(str(error).split())[:120]
        raise CalibrationError(
            f"{path} cannot be read as a video ({reason}); is it whole? for films such as mp4: {TO_INSTALL}"
        ) from error
