from pathlib import Path

import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import SourceError
from tactile_loc.io.streams import cameras
from tactile_loc.io.streams.cameras import find_device, list_cameras

DIGITS = ["usb-Facebook_DIGIT_D20123", "usb-Facebook_DIGIT_D20124"]
MINI = "usb-Arducam_Technology_Co.__Ltd._GelSight_Mini_R0B_28GH-8AJB_28GH8AJB"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The links of two DIGITs and a GelSight Mini, as udev makes them: one for images, and one for metadata."""
    for number, name in enumerate([*DIGITS, MINI]):
        for index in range(2):
            (tmp_path / f"{name}-video-index{index}").symlink_to(f"../../video{2 * number + index}")
    monkeypatch.setattr(cameras, "BY_NAME", tmp_path)
    return tmp_path


def test_each_camera_is_listed_once():
    assert list_cameras() == sorted([*DIGITS, MINI])


@pytest.mark.parametrize("camera", ["0", "/dev/video2", "rtsp://robot.local/finger", "v4l2src ! appsink"])
def test_numbers_devices_and_addresses_stay(camera):
    assert find_device(camera) == camera


@pytest.mark.parametrize(("serial", "device"), [("D20124", "video2"), ("d20123", "video0"), ("28GH8AJB", "video4")])
def test_a_serial_number_finds_its_device(folder, serial, device):
    found = Path(find_device(serial))
    assert found.parent == folder
    assert found.readlink().name == device


def test_an_unknown_or_ambiguous_name_lists_the_connected_cameras(folder, monkeypatch):
    for camera in ("D9", "DIGIT"):
        with pytest.raises(SourceError, match=naming(repr(camera), *DIGITS, MINI, "serial number")):
            find_device(camera)
    monkeypatch.setattr(cameras, "BY_NAME", folder / "none")
    assert list_cameras() == []
    with pytest.raises(SourceError, match=naming("'D20123'", "no cameras by name")):
        find_device("D20123")
