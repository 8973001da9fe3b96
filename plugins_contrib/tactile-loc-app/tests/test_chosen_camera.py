"""The camera of a visitor: which source a text means, and what happens after an error."""

import os

import numpy as np
import pytest
from PIL import Image
from tactile_loc import TactileLocError
from tactile_loc.io.streams import frame_sources
from tactile_loc.io.streams.frame_sources import Camera, ImageFolder, Video

from tactile_loc_app import chosen_camera
from tactile_loc_app.chosen_camera import ChosenCamera


@pytest.fixture
def sources(monkeypatch) -> list:
    """The sources that were opened; none of them has a frame."""
    opened: list = []

    class Taker:
        def __init__(self, source) -> None:
            opened.append(source)

        def take(self):
            raise TactileLocError("nothing")

        def close(self) -> None:
            pass

    monkeypatch.setattr(chosen_camera, "FrameTaker", Taker)
    return opened


def test_a_text_names_a_camera_a_video_or_a_folder(sources, tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"film")
    for text in ("0", " /dev/video2 ", str(tmp_path / "film.mp4"), str(tmp_path)):
        with pytest.raises(TactileLocError):
            ChosenCamera().take(text)
    assert [type(source) for source in sources] == [Camera, Camera, Video, ImageFolder]
    assert [sources[0].device, sources[1].device] == ["0", "/dev/video2"]


def test_a_failed_camera_is_opened_again(sources):
    chosen = ChosenCamera()
    for _ in range(2):
        with pytest.raises(TactileLocError):
            chosen.take("0")
    assert len(sources) == 2


@pytest.mark.parametrize("text", ["", "  ", "nowhere.mp4", "a\0b", "~no\0body/a", "~nobody-here/a", 5000 * "a", "97"])
def test_a_missing_source_is_an_error(text):
    with pytest.raises(TactileLocError):  # OpenCV may be missing, too
        ChosenCamera().take(text)


def test_a_folder_remembers_the_files_that_were_taken(tmp_path, monkeypatch):
    monkeypatch.setattr(frame_sources, "POLL_S", 0.001)
    picture = Image.fromarray(np.full((12, 16, 3), 7, np.uint8))
    chosen = ChosenCamera()
    picture.save(tmp_path / "0.png")
    assert chosen.take(str(tmp_path)).name == "0.png"
    chosen._taker._waits_s = 0.01
    for _ in range(2):
        with pytest.raises(TactileLocError):
            chosen.take(str(tmp_path))
    picture.save(tmp_path / "1.png")
    os.utime(tmp_path / "1.png")
    assert chosen.take(str(tmp_path)).name == "1.png"
    chosen.close()
