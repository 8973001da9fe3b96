"""Single frames on request: each frame at most once, the newest first, and an error when there is none."""

from __future__ import annotations

import os
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from tactile_loc.core.runtime.errors import SourceError
from tactile_loc.io.streams import frame_sources
from tactile_loc.io.streams.frame_sources import Camera, FrameTaker, ImageFolder, Video
from tactile_loc.io.streams.videos import VideoFacts


def picture(grey: int) -> np.ndarray:
    return np.full((12, 16, 3), grey, np.uint8)


def test_a_folder_gives_its_newest_file_once(tmp_path):
    for folder in (tmp_path, tmp_path / "missing"):  # empty, or missing
        with pytest.raises(SourceError):
            FrameTaker(ImageFolder(folder, every=False), waits_s=0.05).take()
    for n in range(3):
        Image.fromarray(picture(n)).save(tmp_path / f"{n}.png")
        os.utime(tmp_path / f"{n}.png", (10 + n, 10 + n))
    taker = FrameTaker(ImageFolder(tmp_path, every=False), waits_s=0.1)
    assert taker.take().name == "2.png"
    with pytest.raises(SourceError):
        taker.take()
    Image.fromarray(picture(9)).save(tmp_path / "new.png")
    assert taker.take().name == "new.png"


def test_a_video_plays_until_it_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(frame_sources, "read_video", lambda _: iter([picture(n) for n in range(50)]))
    monkeypatch.setattr(frame_sources, "read_video_facts", lambda _: VideoFacts(1000.0, 50))
    taker = FrameTaker(Video(tmp_path / "film.mp4", every=False))
    numbers = [taker.take().number]
    time.sleep(0.2)
    numbers.append(taker.take().number)
    assert numbers[1] == 49 > numbers[0]
    with pytest.raises(SourceError):
        taker.take()


class Capture:
    """A camera of OpenCV with 1000 images a second, whose first image is black."""

    released = 0

    def __init__(self, device: object) -> None:
        self.taken = 0

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return True

    def read(self) -> tuple[bool, np.ndarray]:
        time.sleep(0.001)
        self.taken += 1
        return True, picture(0 if self.taken == 1 else 100)

    def release(self) -> None:
        Capture.released += 1


def test_a_camera_settles_first_and_stays_open_until_it_is_closed(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", SimpleNamespace(VideoCapture=Capture))
    monkeypatch.setattr(frame_sources, "SETTLES_S", 0.02)
    taker = FrameTaker(Camera("0"))
    first, second = taker.take(), taker.take()
    assert second.number > first.number > 1
    assert first.image.max() == 100
    assert Capture.released == 0
    taker.close()
    assert Capture.released == 1
