"""ROS's messages as arrays, and back: images, transforms, poses with covariance. Of ROS itself nothing is needed.

A message is any object with the fields that its ROS definition names: one of rclpy's, rospy's or rosbags'.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import FrameError, RecordingError, TouchError
from tactile_loc.core.geometry.frame_tree import FrameTree
from tactile_loc.core.geometry.rigid import make_transform, quaternion_to_rotation, rotation_to_quaternion
from tactile_loc.io.images import UNREADABLE, load_image

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
IMAGE_TYPES = (IMAGE, COMPRESSED_IMAGE)
STATIC = "/tf_static"  # the topic of transforms that hold for all times
NS = 1_000_000_000
UNKNOWN = -1.0  # the covariance's first number where it is not known, as in sensor_msgs/Imu


@dataclass(frozen=True)
class Encoding:
    """How an image's pixels are stored: the type of a number, how many a pixel, and which of them, in our order."""

    dtype: str
    channels: int = 1
    kept: tuple[int, ...] = (0,)


ENCODINGS = {
    "rgb8": Encoding("u1", 3, (0, 1, 2)),
    "bgr8": Encoding("u1", 3, (2, 1, 0)),
    "rgba8": Encoding("u1", 4, (0, 1, 2)),
    "bgra8": Encoding("u1", 4, (2, 1, 0)),
    "mono8": Encoding("u1"),
    "32FC1": Encoding("f4"),
}


def image_array(message: Any) -> NDArray[Any]:
    """Return a sensor_msgs Image or CompressedImage as colours (H, W, 3) uint8, grey (H, W) uint8 or depths (H, W).

    Depths (encoding 32FC1) are float32 in metres. Raises RecordingError for an encoding that is none of these, and
    TouchError for an image that is damaged.
    """
    return _raw(message) if hasattr(message, "encoding") else _compressed(message)


def _raw(message: Any) -> NDArray[Any]:
    encoding = ENCODINGS.get(message.encoding)
    if encoding is None:
        raise RecordingError(
            f"images of the encoding {message.encoding!r} cannot be read; convert them to one of {', '.join(ENCODINGS)}"
        )
    dtype = np.dtype(encoding.dtype).newbyteorder(">" if message.is_bigendian else "<")
    used = message.width * encoding.channels * dtype.itemsize  # bytes of a row; the others fill it up
    data = np.frombuffer(message.data, np.uint8)
    if message.step < used or len(data) < message.height * message.step or not used:
        raise TouchError(
            f"the image has {len(data)} bytes in rows of {message.step}; {message.width} x {message.height} pixels of "
            f"{message.encoding} take {message.height * used}"
        )
    rows = data[: message.height * message.step].reshape(message.height, message.step)[:, :used]
    pixels = np.ascontiguousarray(rows).view(dtype).reshape(message.height, message.width, encoding.channels)
    kept = pixels if encoding.kept == tuple(range(encoding.channels)) else pixels[..., list(encoding.kept)]
    own = kept.astype(dtype.newbyteorder("="), copy=False)
    return own[..., 0] if len(encoding.kept) == 1 else own


def _compressed(message: Any) -> NDArray[Any]:
    try:
        mode, values = load_image(BytesIO(bytes(message.data)))
    except UNREADABLE as error:
        raise TouchError(f"the compressed image ({message.format}) is damaged, or is no PNG or JPEG") from error
    if mode not in ("RGB", "L"):
        raise RecordingError(
            f"compressed images of the kind {mode} ({message.format}) cannot be read; they must be colour or grey, "
            "of 8 bits"
        )
    return values


def stamp_ns(header: Any) -> int:
    """Return the time of a std_msgs Header, ns."""
    return int(header.stamp.sec) * NS + int(header.stamp.nanosec)


def add_transforms(tree: FrameTree, message: Any, fixed: bool) -> None:
    """Add the transforms of a tf2_msgs TFMessage to a tree. Raises FrameError for what is no rotation."""
    for one in message.transforms:
        q, t = one.transform.rotation, one.transform.translation
        T = transform(np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w]), one.child_frame_id)
        tree.add(_plain(one.header.frame_id), _plain(one.child_frame_id), stamp_ns(one.header), T, fixed)


def transform(t_m: NDArray[np.float64], q_xyzw: NDArray[np.float64], name: str = "it") -> NDArray[np.float64]:
    """Return the transform (4, 4) of a translation (3,), metres, and a quaternion (4,), scalar last, as ROS has them.

    Raises FrameError, which calls it `name`, unless they are finite and the quaternion has a direction.
    """
    length = float(np.linalg.norm(q_xyzw))
    if not (np.isfinite(t_m).all() and np.isfinite(length) and length > 1e-6):
        raise FrameError(f"the transform of {name!r} has the rotation {q_xyzw.tolist()}, which is none")
    return make_transform(quaternion_to_rotation(np.roll(q_xyzw / length, 1)), t_m)


def _plain(name: str) -> str:
    """A frame's name as ROS 2 has it: without a leading slash."""
    return name.removeprefix("/")


@dataclass(frozen=True, eq=False)
class RosPose:
    """What a geometry_msgs PoseWithCovariance says.

    `position_m` (3,); `quaternion_xyzw` (4,), scalar last; `covariance` (36,), rows of 6: x, y, z (m), then rotations
    about the fixed axes x, y, z (rad), of the frame that the header names. Its first number is -1 where it is unknown.
    """

    position_m: tuple[float, ...]
    quaternion_xyzw: tuple[float, ...]
    covariance: tuple[float, ...]

    @classmethod
    def of(cls, T: NDArray[np.float64], covariance: NDArray[np.float64] | None) -> RosPose:
        """Take a pose (4, 4), metres, and its covariance (6, 6) as `RefinedPose` has it, or None.

        A rotation vector's error and rotations about the three fixed axes are the same to first order, which is all
        that a covariance says.
        """
        numbers = [UNKNOWN, *[0.0] * 35] if covariance is None else covariance.ravel().tolist()
        wxyz = rotation_to_quaternion(T[:3, :3])
        return cls(tuple(T[:3, 3].tolist()), tuple(np.roll(wxyz, -1).tolist()), tuple(numbers))

    @property
    def T(self) -> NDArray[np.float64]:  # noqa: N802 - the field's name
        """The pose (4, 4), metres."""
        return transform(np.array(self.position_m), np.array(self.quaternion_xyzw))


def pose_of(message: Any) -> RosPose:
    """Return what a geometry_msgs PoseWithCovarianceStamped says."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    covariance = tuple(float(v) for v in message.pose.covariance)
    return RosPose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), covariance)
