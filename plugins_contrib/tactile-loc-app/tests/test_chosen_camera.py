"""The camera of a visitor: which source a text means, which frame is taken, and what happens after an error."""

import itertools
import os
import time

import numpy as np
import pytest
from PIL import Image
from tactile_loc import Camera, ImageFolder, SourceFrame, TactileLocError
from tactile_loc.io.streams.frame_sources import Video

from tactile_loc_app import chosen_camera
from tactile_loc_app.chosen_camera import ChosenCamera


@pytest.fixture
def sources(monkeypatch) -> list:
    """The sources that were opened; none of them has a frame."""
    opened: list = []

    def refuse(source):
        opened.append(source)
        raise TactileLocError("nothing")

    monkeypatch.setattr(chosen_camera, "_open", refuse)
    monkeypatch.setattr(chosen_camera, "await_file", refuse)
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


def put(folder, name: str, written_s: float | None = None) -> None:
    Image.fromarray(np.full((12, 16, 3), 7, np.uint8)).save(folder / name)
    os.utime(folder / name, None if written_s is None else (written_s, written_s))


def test_a_folder_remembers_the_files_that_were_taken(tmp_path, monkeypatch):
    monkeypatch.setattr(chosen_camera, "POLL_S", 0.001)
    monkeypatch.setattr(chosen_camera.await_file, "__defaults__", (0.01,))
    for n in range(3):
        put(tmp_path, f"{n}.png", 10 + n)
    chosen = ChosenCamera()
    assert chosen.take(str(tmp_path)).name == "2.png"
    for _ in range(2):
        with pytest.raises(TactileLocError):
            chosen.take(str(tmp_path))
    put(tmp_path, "new.png")
    assert chosen.take(str(tmp_path)).name == "new.png"
    chosen.close()


def test_a_camera_settles_first_stays_open_and_begins_anew_at_its_end(monkeypatch):
    """The frames of a camera take 1 ms each, and it stops after a while."""
    started = []

    def read_frames(camera):
        started.append(camera)
        for number in itertools.count():
            time.sleep(0.001)
            if len(started) == 1 and number > 300:
                return
            yield SourceFrame(number, 0.0, f"frame-{number}")

    monkeypatch.setattr(Camera, "read_frames", read_frames)
    monkeypatch.setattr(chosen_camera, "SETTLES_S", 0.02)
    chosen = ChosenCamera()
    first, second = chosen.take("0"), chosen.take("0")
    assert second.number == first.number + 1 > 1
    assert len(started) == 1
    with pytest.raises(TactileLocError):
        list(iter(lambda: chosen.take("0"), None))
    assert chosen.take("0").number < second.number + 100
    assert len(started) == 2
