"""Messages as arrays and back: pixels of every encoding, transforms, and poses with ROS's covariance."""

from io import BytesIO
from types import SimpleNamespace as Fields

import numpy as np
import pytest
from message_helpers import naming
from PIL import Image
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.frame_tree import FrameTree
from tactile_loc.core.geometry.lie import move, rotate_covariance
from tactile_loc.core.geometry.rigid import draw_rotations, make_transform
from tactile_loc.core.runtime.errors import FrameError, RecordingError, TouchError
from tactile_loc.io.streams.ros_messages import RosPose, add_transforms, decode_image, read_transform

RGB = np.random.default_rng(0).integers(0, 256, (5, 4, 3), np.uint8)


def raw(data: bytes, encoding: str, step: int, big: bool = False, shape: tuple[int, int] = (5, 4)) -> Fields:
    return Fields(height=shape[0], width=shape[1], encoding=encoding, is_bigendian=big, step=step, data=data)


def padded(rows: np.ndarray) -> bytes:
    """The bytes of rows, each with two more at its end."""
    return b"".join(row.tobytes() + b"\xee\xee" for row in rows)


def compressed(values: np.ndarray, kind: str, format: str = "") -> Fields:
    file = BytesIO()
    Image.fromarray(values).save(file, kind)
    return Fields(format=format or kind, data=np.frombuffer(file.getvalue(), np.uint8))


@pytest.mark.parametrize(("encoding", "order"), [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0])])
def test_every_colour_encoding_is_read_as_rgb(encoding, order):
    np.testing.assert_array_equal(decode_image(raw(padded(RGB[..., order]), encoding, 14)), RGB)
    alpha = np.dstack([RGB[..., order], np.full((5, 4, 1), 7, np.uint8)])
    np.testing.assert_array_equal(decode_image(raw(alpha.tobytes(), f"{encoding[:3]}a8", 16)), RGB)
    alpha[2, 3, 3] = 0
    with pytest.raises(TouchError, match="transparent"):
        decode_image(raw(alpha.tobytes(), f"{encoding[:3]}a8", 16))


def test_grey_images_and_depth_images_are_read():
    np.testing.assert_array_equal(decode_image(raw(padded(RGB[..., 0]), "mono8", 6)), RGB[..., 0])
    depth = np.random.default_rng(1).random((5, 4))
    for big, dtype in ((False, "<f4"), (True, ">f4")):
        found = decode_image(raw(depth.astype(dtype).tobytes(), "32FC1", 16, big))
        assert found.dtype == np.float32
        assert found.dtype.isnative
        np.testing.assert_array_equal(found, depth.astype(np.float32))


def test_compressed_images_are_read():
    np.testing.assert_array_equal(decode_image(compressed(RGB, "png", "rgb8; png compressed bgr8")), RGB)
    opaque = np.dstack([RGB, np.full((5, 4), 255, np.uint8)])
    np.testing.assert_array_equal(decode_image(compressed(opaque, "png")), RGB)
    np.testing.assert_array_equal(decode_image(compressed(RGB[..., 0], "png")), RGB[..., 0])
    smooth = np.broadcast_to(np.array([200, 90, 10], np.uint8), (16, 16, 3))
    assert np.abs(decode_image(compressed(smooth, "jpeg")).astype(int) - smooth).max() <= 3


def test_unreadable_images_give_a_one_sentence_error():
    with pytest.raises(RecordingError, match=naming("'bayer_rggb8'", "bgr8")):
        decode_image(raw(b"", "bayer_rggb8", 4))
    for data, step in ((RGB.tobytes()[:-1], 12), (RGB.tobytes(), 11), (b"", 12)):
        with pytest.raises(TouchError, match=naming("4 x 5", "rgb8", 60, step)):
            decode_image(raw(data, "rgb8", step))
    with pytest.raises(TouchError, match="png"):
        decode_image(Fields(format="png", data=compressed(RGB, "png").data[:40]))
    for format in ("mono16; png compressed ", "16UC1; compressedDepth"):
        with pytest.raises(RecordingError, match=naming(format, "32FC1")):
            decode_image(compressed(RGB[..., 0].astype(np.uint16), "png", format))
    with pytest.raises(TouchError, match=naming("png", "transparent")):
        decode_image(compressed(np.dstack([RGB, RGB[..., 0]]), "png"))


def test_poses_survive_the_conversion_to_ros_and_back():
    rng = np.random.default_rng(2)
    for R in draw_rotations(5, rng):
        T = make_transform(R, rng.normal(size=3))
        np.testing.assert_allclose(RosPose.of(T, None).T, T, atol=1e-12)
    assert RosPose.of(np.eye(4), None).covariance[0] == -1
    assert RosPose.of(np.eye(4), np.diag(np.arange(1.0, 7.0))).covariance[::7] == (1, 2, 3, 4, 5, 6)
    assert RosPose.of(np.eye(4), None).quaternion_xyzw == (0, 0, 0, 1)


def test_the_covariance_in_the_base_equals_that_of_samples_about_fixed_axes():
    """Errors drawn in the sensor's frame, as in RefinedPose, have ROS's covariance in the base frame."""
    rng = np.random.default_rng(3)
    R_sensor, R_object = draw_rotations(2, rng)
    T_base_sensor = make_transform(R_sensor, rng.normal(size=3))
    T_sensor_object = make_transform(R_object, rng.normal(size=3))
    half = rng.normal(size=(6, 6)) * np.repeat([2e-3, 1e-2], 3)[:, None]
    C = half @ half.T
    samples = T_base_sensor @ move(T_sensor_object, rng.multivariate_normal(np.zeros(6), C, 100_000))
    T_base_object = T_base_sensor @ T_sensor_object
    turned = Rotation.from_matrix(samples[:, :3, :3] @ T_base_object[:3, :3].T).as_euler("xyz")  # fixed axes
    errors = np.hstack([samples[:, :3, 3] - T_base_object[:3, 3], turned])
    found = np.reshape(RosPose.of(T_base_object, rotate_covariance(C, R_sensor)).covariance, (6, 6))
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(errors.T @ errors / len(errors) / scale, found / scale, atol=0.02)
    assert np.abs((C - found) / scale).max() > 0.1  # the conversion changes the covariance


def test_invalid_transforms_are_refused():
    half_turn = read_transform(np.zeros(3), np.array([0, 0, 1.004, 0]))
    np.testing.assert_allclose(half_turn, np.diag([-1, -1, 1, 1]), atol=1e-12)
    for x_m, q in ((0, [0, 0, 0, 0]), (0, [0, 0, 3.0, 0]), (np.nan, [0, 0, 0, 1]), (0, [np.nan, 0, 0, 1])):
        with pytest.raises(FrameError, match="'gel'"):
            read_transform(np.array([x_m, 0, 0], float), np.array(q, float), "gel")


def test_the_slash_of_old_frame_names_is_dropped():
    tree, zero = FrameTree(), Fields(x=0.0, y=0.0, z=0.0)
    header = Fields(frame_id="/base", stamp=Fields(sec=1, nanosec=5))
    still = Fields(translation=zero, rotation=Fields(x=0.0, y=0.0, z=0.0, w=1.0))
    one = Fields(header=header, child_frame_id="gel", transform=still)
    add_transforms(tree, Fields(transforms=[one]), fixed=False)
    np.testing.assert_allclose(tree.look_up("base", "gel", 1_000_000_005), np.eye(4))
