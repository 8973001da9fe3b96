"""Videos: frames above the limit of images."""

import importlib.util

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.io.streams.videos import read_video


@pytest.mark.parametrize("library", ["cv2", "imageio"])
def test_frames_above_the_limit_of_images_are_refused(tmp_path, monkeypatch, library):
    writer = pytest.importorskip("imageio.v3")
    pytest.importorskip(library)
    path = tmp_path / "press.gif"
    writer.imwrite(path, np.zeros((2, 48, 64, 3), np.uint8))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name == library or None)
    assert [frame.shape for frame in read_video(path)][:1] == [(48, 64, 3)]
    monkeypatch.setattr("tactile_loc.core.runtime.limits.MOST_PIXELS", 1000)
    with pytest.raises(CalibrationError, match="64 x 48"):
        next(read_video(path))
