"""Frames of a folder, a video and a camera: every frame, the newest, or single frames on request, and lost sources."""

import importlib.util
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from message_helpers import missing, naming
from PIL import Image

from tactile_loc.core.runtime.errors import MissingLibraryError, SourceError, TouchError
from tactile_loc.io.streams import frame_sources
from tactile_loc.io.streams.cameras import CameraSettings
from tactile_loc.io.streams.frame_sources import Camera, ImageFolder, SourceFrame, Video, open_source
from tactile_loc.io.streams.videos import VideoFacts


def until_it_fails(frames: Iterable[SourceFrame]) -> tuple[list[SourceFrame], str]:
    """Return the frames before a source was lost, and its error."""
    found = []
    try:
        for frame in frames:
            found.append(frame)
    except SourceError as error:
        return found, str(error)
    raise AssertionError("the source gave no error")


COLOURS = [(200, 30, 30), (30, 200, 30), (30, 30, 200), (200, 200, 30)]


def picture(colour: tuple[int, int, int]) -> np.ndarray:
    return np.full((12, 16, 3), colour, np.uint8)


def put(folder: Path, name: str, colour: tuple[int, int, int], written_s: float | None = None) -> Path:
    folder.mkdir(exist_ok=True)
    Image.fromarray(picture(colour)).save(folder / name)
    if written_s is not None:
        os.utime(folder / name, (written_s, written_s))
    return folder / name


@pytest.fixture
def meanwhile(monkeypatch) -> Callable[..., None]:
    """Call one function at each wait of a source; more waits than functions are an error."""

    def arrange(*happenings: Callable[[], object]) -> None:
        waiting = iter(happenings)
        monkeypatch.setattr(frame_sources.time, "sleep", lambda _: next(waiting)())

    return arrange


def test_a_folder_gives_every_frame_in_the_order_of_time_and_name(tmp_path):
    for name, colour, written_s in zip(("c.png", "b.png", "a.png", "z.png"), COLOURS, (5, 7, 7, 2), strict=True):
        put(tmp_path / "in", name, colour, written_s)
    (tmp_path / "in" / "notes.txt").write_text("no image")
    source = ImageFolder(tmp_path / "in", every=True)
    frames = list(source.read_frames())
    assert [frame.name for frame in frames] == ["z.png", "c.png", "a.png", "b.png"]
    assert [frame.number for frame in frames] == [0, 1, 2, 3]
    assert source.dropped == 0
    for frame, colour in zip(frames, (COLOURS[3], COLOURS[0], COLOURS[2], COLOURS[1]), strict=True):
        np.testing.assert_array_equal(frame.image, picture(colour))


def test_a_folder_gives_its_newest_frame_and_then_waits(tmp_path, meanwhile):
    folder = tmp_path / "in"
    for k in range(3):
        put(folder, f"{k}.png", COLOURS[k], 10 + k)
    meanwhile(
        lambda: None,
        lambda: put(folder, "a.png", COLOURS[3], 20),
        lambda: put(folder, "2.png", COLOURS[1], 30),  # written again
    )
    source = ImageFolder(folder, every=False)
    frames = source.read_frames()
    found = [next(frames) for _ in range(3)]
    assert [(frame.number, frame.name) for frame in found] == [(2, "2.png"), (3, "a.png"), (4, "2.png")]
    assert source.dropped == 2
    np.testing.assert_array_equal(found[2].image, picture(COLOURS[1]))


def test_a_folder_waits_for_a_file_that_is_being_written_unless_it_stays_damaged(tmp_path, meanwhile, monkeypatch):
    folder = tmp_path / "in"
    whole = put(folder, "whole.png", COLOURS[0], 1).read_bytes()
    (folder / "half.png").write_bytes(whole[: len(whole) // 2])
    meanwhile(lambda: (folder / "half.png").write_bytes(whole))
    names = [frame.name for frame in ImageFolder(folder, every=True).read_frames()]
    assert names == ["whole.png", "half.png"]
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "cut.png").write_bytes(whole[: len(whole) // 2])
    monkeypatch.setattr(frame_sources, "SETTLED_S", 0.0)
    (frame,) = ImageFolder(tmp_path / "damaged", every=True).read_frames()
    with pytest.raises(TouchError, match=naming("cut.png", "png")):
        frame.read_touch(None)  # type: ignore[arg-type]


def test_a_folder_that_vanishes_gives_an_error(tmp_path, meanwhile):
    put(tmp_path / "in", "0.png", COLOURS[0])
    meanwhile(lambda: shutil.rmtree(tmp_path / "in"))
    frames = ImageFolder(tmp_path / "in", every=False).read_frames()
    assert next(frames).name == "0.png"
    with pytest.raises(SourceError, match=naming(tmp_path / "in")):
        next(frames)


def write_gif(path: Path) -> Path:
    first, *rest = [Image.fromarray(picture(colour)) for colour in COLOURS]
    first.save(path, save_all=True, append_images=rest, duration=40, loop=0)
    return path


@pytest.mark.skipif(importlib.util.find_spec("cv2") is None, reason="OpenCV reads the video")
def test_a_video_gives_every_frame(tmp_path):
    frames = list(Video(write_gif(tmp_path / "film.gif"), every=True).read_frames())
    assert [frame.time_s for frame in frames] == pytest.approx([0, 0.04, 0.08, 0.12])
    for frame, colour in zip(frames, COLOURS, strict=True):
        assert np.abs(frame.image.astype(int) - picture(colour)).max() < 12


@pytest.fixture
def film(monkeypatch) -> list[int]:
    """A video of 50 frames at 1000 Hz, whose facts a test may change."""
    monkeypatch.setattr(frame_sources, "read_video", lambda _: iter([picture((k, k, k)) for k in range(50)]))
    monkeypatch.setattr(frame_sources, "read_video_facts", lambda _: VideoFacts(1000.0, 50))
    return list(range(50))


def test_a_video_without_every_gives_its_newest_frame(film, tmp_path):
    source = Video(tmp_path / "film.mp4", every=False)
    found = []
    for frame in source.read_frames():
        found.append(frame.number)
        while not source._ended:
            time.sleep(0.001)
    assert found[-1] == 49
    assert len(found) <= 3
    assert len(found) + source.dropped == 50


def test_a_truncated_video_gives_its_frames_and_then_an_error(film, tmp_path, monkeypatch):
    monkeypatch.setattr(frame_sources, "read_video_facts", lambda _: VideoFacts(1000.0, 80))
    for every in (True, False):
        found, says = until_it_fails(Video(tmp_path / "film.mp4", every).read_frames())
        assert found[-1].number == 49
        assert not missing(says, "film.mp4", "50", "80")
    monkeypatch.setattr(frame_sources, "read_video_facts", lambda _: VideoFacts(1000.0, 51))  # containers miscount
    assert len(list(Video(tmp_path / "film.mp4", every=True).read_frames())) == 50


def test_a_truncated_video_file_gives_an_error(tmp_path):
    cv2 = pytest.importorskip("cv2", reason="OpenCV, which writes and reads the video, is not installed")
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    noise = np.random.default_rng(0).integers(0, 256, (60, 48, 64, 3), np.uint8)
    for image in noise:
        writer.write(image)
    writer.release()
    assert len(list(Video(path, every=True).read_frames())) == 60
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found, says = until_it_fails(Video(path, every=True).read_frames())
    assert 0 < len(found) < 60
    assert not missing(says, "film.avi", len(found))


def test_a_file_that_is_not_a_video_gives_an_error(tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"no film at all")
    with pytest.raises(SourceError, match=r"film\.mp4"):
        list(Video(tmp_path / "film.mp4", every=True).read_frames())


# OpenCV's numbers of a camera's properties
PROPERTIES = {
    "CAP_PROP_EXPOSURE": 15,
    "CAP_PROP_AUTO_EXPOSURE": 21,
    "CAP_PROP_AUTO_WB": 44,
    "CAP_PROP_WB_TEMPERATURE": 45,
}


class FakeCapture:
    """A camera of OpenCV that gives some images, in BGR, up to 1000 a second, and is then unplugged."""

    asked: object = None
    opens, images, released = True, 3, 0
    properties: ClassVar[dict[int, float]] = {}
    least_exposure = 1.0

    def __init__(self, device: object) -> None:
        type(self).asked, self.left = device, self.images

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return self.opens

    def read(self) -> tuple[bool, np.ndarray | None]:
        self.left -= 1
        time.sleep(0.001)
        return (True, picture((10, 20, 30))) if self.left >= 0 else (False, None)

    def get(self, name: int) -> float:
        return self.properties.get(name, 0.0)

    def set(self, name: int, value: float) -> bool:
        least = self.least_exposure if name == PROPERTIES["CAP_PROP_EXPOSURE"] else -np.inf
        self.properties[name] = max(value, least)
        return True

    def release(self) -> None:
        type(self).released += 1


@pytest.fixture
def capture(monkeypatch) -> type[FakeCapture]:
    kind = type("Capture", (FakeCapture,), {"properties": {}})
    monkeypatch.setitem(sys.modules, "cv2", SimpleNamespace(VideoCapture=kind, **PROPERTIES))
    return kind


def test_a_camera_gives_rgb_frames_and_an_error_when_it_is_unplugged(capture):
    camera = Camera("/dev/video2")
    found, says = until_it_fails(camera.read_frames())
    assert capture.asked == "/dev/video2"
    assert not missing(says, "/dev/video2", 3)
    assert found[-1].number == 2
    assert len(found) + camera.dropped == 3
    np.testing.assert_array_equal(found[-1].image, picture((30, 20, 10)))
    until_it_fails(Camera("0").read_frames())
    assert capture.asked == 0


AUTOMATIC = {PROPERTIES["CAP_PROP_AUTO_EXPOSURE"]: 3.0, PROPERTIES["CAP_PROP_AUTO_WB"]: 1.0}


def test_the_numbers_of_properties_are_those_of_opencv():
    cv2 = pytest.importorskip("cv2")
    assert {name: getattr(cv2, name) for name in PROPERTIES} == PROPERTIES


def test_exposure_and_white_balance_are_fixed_and_recorded(capture, caplog):
    capture.properties |= AUTOMATIC
    found, _ = until_it_fails(Camera("0", CameraSettings(150, 4600)).read_frames())
    assert {frame.settings for frame in found} == {CameraSettings(150, 4600)}
    assert capture.properties == dict(zip(PROPERTIES.values(), (150, 1, 0, 4600), strict=True))
    assert not caplog.records


def test_automatic_settings_are_warned_of(capture, caplog):
    capture.properties |= AUTOMATIC | {PROPERTIES["CAP_PROP_EXPOSURE"]: 156.0}
    found, _ = until_it_fails(Camera("0", CameraSettings(white_balance_k=4600)).read_frames())
    assert found[0].settings == CameraSettings(None, 4600)
    (record,) = caplog.records
    assert not missing(record.getMessage(), "camera 0", "exposure")


def test_an_exposure_that_the_camera_does_not_take_is_refused(capture):
    with pytest.raises(SourceError, match=naming("camera 0", "0.5", "1")):
        Camera("0", CameraSettings(0.5)).read_frames()
    assert capture.released == 1
    with pytest.raises(SourceError, match="`camera`"):
        open_source(Path(), None, False, CameraSettings(150))


def test_a_missing_camera_or_library_gives_an_error_at_once(capture, monkeypatch):
    monkeypatch.setattr(capture, "opens", False)
    with pytest.raises(SourceError, match="camera 3"):
        Camera("3").read_frames()
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingLibraryError, match=naming("pip install 'tactile-loc[camera]'")):
        Camera("0").read_frames()


def test_exactly_one_source_must_be_given(tmp_path):
    for given in ((None, None, False), (tmp_path, "0", False)):
        with pytest.raises(SourceError, match="`camera`"):
            open_source(*given)
    for given, word in (((None, "0", True), "`once`"), ((tmp_path / "nowhere", None, True), tmp_path / "nowhere")):
        with pytest.raises(SourceError, match=naming(word)):
            open_source(*given)
    assert isinstance(open_source(tmp_path, None, True), ImageFolder)
