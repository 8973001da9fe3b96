"""Videos: frames above the limit of images, and a machine without OpenCV."""

import sys

import numpy as np
import pytest
from PIL import Image

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.io.streams.videos import read_video, read_video_facts


def test_frames_above_the_limit_of_images_are_refused(tmp_path, monkeypatch):
    pytest.importorskip("cv2", reason="OpenCV reads the video")
    black, grey = (Image.fromarray(np.full((48, 64, 3), value, np.uint8)) for value in (0, 99))
    black.save(tmp_path / "press.gif", save_all=True, append_images=[grey])
    assert [frame.shape for frame in read_video(tmp_path / "press.gif")][:1] == [(48, 64, 3)]
    monkeypatch.setattr("tactile_loc.core.runtime.limits.MOST_PIXELS", 1000)
    with pytest.raises(CalibrationError, match="64 x 48"):
        next(read_video(tmp_path / "press.gif"))


def test_without_opencv_the_message_names_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    (tmp_path / "press.mp4").write_bytes(b"")
    with pytest.raises(CalibrationError, match=r"tactile-loc\[camera\]"):
        read_video_facts(tmp_path / "press.mp4")
    with pytest.raises(CalibrationError, match=r"tactile-loc\[camera\]"):
        next(read_video(tmp_path / "press.mp4"))
