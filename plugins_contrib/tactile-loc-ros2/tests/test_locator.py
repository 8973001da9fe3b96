"""Locating images: encodings of real Image and CompressedImage messages, errors, press depths, and tracks."""

import time
from collections.abc import Callable
from io import BytesIO
from itertools import count
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tactile_loc import LocatedFrame, Verdict, decode_image

from tactile_loc_ros2.locator import ImageLocator

T = np.array([[0, -1, 0, 0.001], [1, 0, 0, 0.002], [0, 0, 1, 0.003], [0, 0, 0, 1.0]])
C = np.diag(np.arange(1.0, 7.0))
NS = 1_000_000_000
COLOURS = np.arange(5 * 4 * 3, dtype=np.uint8).reshape(5, 4, 3)


def estimated(touch) -> LocatedFrame:
    return LocatedFrame(Verdict.CERTAIN, T[None], np.ones(1), C, 0.9)


@pytest.fixture
def locator(localizer) -> ImageLocator:
    return ImageLocator(localizer, estimator=estimated)


def test_serialised_images_are_read_and_photos_need_a_calibrated_sensor(locator, make_image, types):
    padded = np.pad(COLOURS.reshape(5, -1), ((0, 0), (0, 3)), constant_values=255)  # rows end with unused bytes
    image = make_image(np.zeros((5, 4), np.float32), encoding="rgb8", step=padded.shape[1], data=padded.ravel())
    np.testing.assert_array_equal(decode_image(image), COLOURS)
    file = BytesIO()
    Image.fromarray(COLOURS).save(file, "png")
    data = np.frombuffer(file.getvalue(), np.uint8)
    message = types.pass_on(types.find("sensor_msgs/msg/CompressedImage")(format="png", data=data))
    np.testing.assert_array_equal(decode_image(message), COLOURS)
    assert "not calibrated for images" in locator.locate(message).located.says


def test_a_touch_has_the_press_depth_and_the_sensor_pose(localizer, make_image, depth_m):
    touch = ImageLocator(localizer, press_depth_m=1e-3).read_touch(make_image(depth_m), T)
    assert touch.press_depth_m == 1e-3
    np.testing.assert_array_equal(touch.T_base_sensor, T)


def test_an_image_without_contact_is_no_error(locator, make_image, untouched_m):
    located = locator.locate(make_image(untouched_m)).located
    assert located.T_sensor_object is None
    assert located.verdict is Verdict.NO_CONTACT


@pytest.mark.parametrize(
    ("change", "mentioned"),
    [
        ({"encoding": "yuv422"}, "yuv422"),
        ({"height": 20, "width": 20, "step": 80}, "20, 20"),
        ({"data": np.zeros(3, np.uint8)}, "has 3 bytes"),
        ({"step": 3}, "rows of 3"),
    ],
)
def test_an_unreadable_image_gives_an_error(locator, make_image, depth_m, change, mentioned):
    located = locator.locate(make_image(depth_m, **change)).located
    assert located.T_sensor_object is None
    assert located.verdict is None
    assert mentioned in located.says


@pytest.fixture
def tracked(localizer) -> tuple[ImageLocator, np.ndarray]:
    touch = localizer.simulate(1, seed=2)[0]
    return ImageLocator(localizer, touch.press_depth_m, track=True), touch.contact_shape.depth_m


def follow(locator: ImageLocator, frame: Callable[[int], Any], T: np.ndarray | None, begin_ns: int = 0) -> Any:
    """Locate frames until a search in another thread has found the pose. Return the result, and the last stamp."""
    end_s = time.monotonic() + 120
    for stamp_ns in count(begin_ns, NS // 10):
        found = locator.locate(frame(stamp_ns)) if T is None else locator.locate(frame(stamp_ns), T)
        assert not found.slipped
        if found.located.T_sensor_object is not None:
            return found.located, stamp_ns
        assert time.monotonic() < end_s
        time.sleep(0.02)
    raise AssertionError


def test_a_track_predicts_the_pose_without_contact(tracked, make_image, untouched_m):
    locator, depth_m = tracked
    found, last_ns = follow(locator, lambda stamp_ns: make_image(depth_m, stamp_ns=stamp_ns), np.eye(4))
    predicted = locator.locate(make_image(untouched_m, stamp_ns=last_ns + 8 * NS // 10), np.eye(4)).located
    assert predicted.verdict is Verdict.NO_CONTACT
    assert predicted.says
    np.testing.assert_allclose(predicted.T_sensor_object, found.T_sensor_object, atol=1e-4)


def test_a_track_without_sensor_poses_assumes_a_sensor_at_rest(tracked, make_image):
    locator, depth_m = tracked
    rested, last_ns = follow(locator, lambda stamp_ns: make_image(depth_m, stamp_ns=stamp_ns), None)
    moved = np.eye(4)
    moved[0, 3] = 0.5
    again = locator.locate(make_image(depth_m, stamp_ns=last_ns + 7 * NS // 10), moved).located
    assert again.T_sensor_object is None or abs(again.T_sensor_object[0, 3] - rested.T_sensor_object[0, 3]) > 0.1


def test_a_reset_clock_begins_another_track(tracked, make_image):
    locator, depth_m = tracked

    def locate(stamp_ns: int) -> LocatedFrame:
        return locator.locate(make_image(depth_m, stamp_ns=stamp_ns), np.eye(4)).located

    assert locate(100 * NS).T_sensor_object is None  # the search goes on
    _, last_ns = follow(locator, lambda stamp_ns: make_image(depth_m, stamp_ns=stamp_ns), np.eye(4), 101 * NS)
    late = locate(last_ns - 3 * NS // 10)
    assert late.T_sensor_object is not None
    assert locate(5 * NS).T_sensor_object is None
    assert locate(5 * NS).verdict is not None
