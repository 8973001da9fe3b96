"""Converts ROS messages to arrays and back: images, transforms, and poses with covariance. ROS is not needed.

A message is any object with the fields of its ROS definition, from rclpy, rospy or rosbags. The library rosbags creates
and serializes messages.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.frame_tree import FrameTree
from tactile_loc.core.geometry.rigid import (
    Floats,
    make_transform,
    quaternion_to_rotation,
    require_unit,
    rotation_to_quaternion_xyzw,
)
from tactile_loc.core.runtime.errors import FrameError, MissingLibraryError, RecordingError, TouchError
from tactile_loc.io.images import UNREADABLE, find_colours, load_image, name_kind, require_opaque

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TEXT = "std_msgs/msg/String"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
IMAGE_TYPES = (IMAGE, COMPRESSED_IMAGE)
STATIC = "/tf_static"  # the topic of constant transforms
NS = 1_000_000_000
CDR, ROS1 = "cdr", "ros1"  # the encodings of messages in ROS 2 and ROS 1
UNKNOWN = -1.0  # first number of an unknown covariance, as in sensor_msgs/Imu


ENCODINGS = {  # the type of an image's numbers, and its channels in order
    "rgb8": ("u1", "rgb"),
    "bgr8": ("u1", "bgr"),
    "rgba8": ("u1", "rgba"),
    "bgra8": ("u1", "bgra"),
    "mono8": ("u1", "v"),
    "32FC1": ("f4", "v"),
}


def decode_image(message: Any) -> NDArray[Any]:
    """Return a sensor_msgs Image or CompressedImage as colours (H, W, 3) uint8, grey (H, W) uint8 or depths (H, W).

    Depths (encoding 32FC1) are float32 in metres. Raises RecordingError for another encoding, and TouchError for a
    damaged image.
    """
    return _decode_raw(message) if hasattr(message, "encoding") else _decode_compressed(message)


def _decode_raw(message: Any) -> NDArray[Any]:
    if message.encoding not in ENCODINGS:
        raise RecordingError(
            f"images of the encoding {message.encoding!r} cannot be read; convert them to one of {', '.join(ENCODINGS)}"
        )
    kind, order = ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    used = message.width * len(order) * dtype.itemsize  # bytes of a row, without padding
    data = np.frombuffer(message.data, np.uint8)
    if message.step < used or len(data) < message.height * message.step or not used:
        raise TouchError(
            f"the image is damaged: it has {len(data)} bytes in rows of {message.step}, but {message.width} x "
            f"{message.height} pixels of {message.encoding} need {message.height * used}"
        )
    rows = data[: message.height * message.step].reshape(message.height, message.step)[:, :used]
    pixels = np.ascontiguousarray(rows).view(dtype).reshape(message.height, message.width, len(order))
    if order[3:] and np.ptp(pixels[..., 3]) > 0:  # a constant alpha channel only fills the fourth byte
        require_opaque(pixels[..., 3], f"the {message.encoding} image")
    own = pixels.astype(dtype.newbyteorder("="), copy=False)
    if order == "v":
        return own[..., 0]
    return own if order == "rgb" else own[..., [order.index(colour) for colour in "rgb"]]


def _decode_compressed(message: Any) -> NDArray[Any]:
    """Return the image of a CompressedImage. Its format names the order of colours before the compression only."""
    if "compressedDepth" in message.format:
        raise RecordingError(
            f"compressed depth images ({message.format}) cannot be read; record the uncompressed images, as 32FC1"
        )
    try:
        mode, values = load_image(BytesIO(bytes(message.data)))
    except UNREADABLE as error:
        raise TouchError(f"the compressed image ({message.format}) is damaged, or not a PNG or JPEG") from error
    image = find_colours(mode, values, f"the compressed image ({message.format})")
    if image is None:
        raise RecordingError(
            f"the compressed image ({message.format}) is {name_kind(mode)}; publish 8-bit colour or grey, or the "
            "depths as uncompressed 32FC1"
        )
    return image


def read_stamp_ns(header: Any) -> int:
    """Return the time of a std_msgs Header, ns."""
    return int(header.stamp.sec) * NS + int(header.stamp.nanosec)


def add_transforms(tree: FrameTree, message: Any, fixed: bool) -> None:
    """Add the transforms of a tf2_msgs TFMessage to a tree. Raises FrameError for a transform that is not rigid."""
    for one in message.transforms:
        q, t = one.transform.rotation, one.transform.translation
        T = read_transform(np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w]), one.child_frame_id)
        tree.add(_name_frame(one.header.frame_id), _name_frame(one.child_frame_id), read_stamp_ns(one.header), T, fixed)


def read_transform(t_m: Floats, q_xyzw: Floats, name: str = "it") -> Floats:
    """Return the transform (4, 4) of a translation (3,), metres, and a quaternion (4,), scalar last, as in ROS.

    Raises FrameError, which names the frame `name`, for infinite numbers or a quaternion that is not a unit quaternion.
    """
    if not np.isfinite(t_m).all():
        raise FrameError(f"the translation of {name!r} is {t_m.tolist()}; check the node that publishes it")
    q = require_unit(q_xyzw, f"the quaternion of {name!r}", FrameError)
    return make_transform(quaternion_to_rotation(np.roll(q, 1)), t_m)


def _name_frame(name: str) -> str:
    """Return the name of a frame in the form of ROS 2: without a leading slash."""
    return name.removeprefix("/")


@dataclass(frozen=True, eq=False)
class RosPose:
    """The contents of a geometry_msgs PoseWithCovariance.

    `position_m` is (3,). `quaternion_xyzw` is (4,), scalar last. `covariance` is (36,), row by row: x, y, z (m), then
    rotations (rad) about the fixed axes x, y, z of the header's frame. The first number is -1 if the covariance is
    unknown.
    """

    position_m: tuple[float, ...]
    quaternion_xyzw: tuple[float, ...]
    covariance: tuple[float, ...]

    @classmethod
    def of(cls, T: Floats, covariance: Floats | None) -> RosPose:
        """Convert a pose (4, 4), metres, and its covariance (6, 6), as in `RefinedPose`, or None.

        To first order, the errors of a rotation vector equal rotations about the three fixed axes. The covariance
        therefore needs no conversion.
        """
        numbers = [UNKNOWN, *[0.0] * 35] if covariance is None else covariance.ravel().tolist()
        return cls(tuple(T[:3, 3].tolist()), tuple(rotation_to_quaternion_xyzw(T[:3, :3]).tolist()), tuple(numbers))

    @property
    def T(self) -> Floats:  # noqa: N802 - the field's name
        """The pose (4, 4), metres."""
        return read_transform(np.array(self.position_m), np.array(self.quaternion_xyzw))


def read_pose(message: Any) -> RosPose:
    """Return the pose in a geometry_msgs PoseWithCovarianceStamped."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    covariance = tuple(float(v) for v in message.pose.covariance)
    return RosPose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), covariance)


@dataclass(frozen=True)
class Topic:
    """A topic of a recording: its ROS 2 `type`, the type's definition, and the encoding of the topic's messages."""

    name: str
    type: str
    definition: bytes = field(repr=False)
    definition_encoding: str = "ros2msg"
    message_encoding: str = CDR
    metadata: tuple[tuple[str, str], ...] = field(default=(), compare=False, repr=False)


def require_libraries() -> None:
    """Raise MissingLibraryError unless mcap and rosbags are installed."""
    for name in ("mcap", "rosbags"):
        try:
            import_module(name)
        except ImportError as error:
            raise MissingLibraryError(
                f"recordings are read with {name}, which is not installed: pip install 'tactile-loc[recordings]'"
            ) from error


@cache
def make_topic(name: str, type_name: str) -> Topic:
    """Return a topic of ROS 2 messages of a standard type.

    Raises MissingLibraryError when mcap or rosbags is not installed.
    """
    return Topic(name, type_name, find_definition(type_name))


def find_definition(type_name: str) -> bytes:
    """Return the definition of a standard ROS 2 type, or empty bytes for another type."""
    store = load_types(CDR)
    return store.generate_msgdef(type_name, ros_version=2)[0].encode() if type_name in store.types else b""


@cache
def load_types(encoding: str) -> Any:
    """Return rosbags' standard types for an encoding: CDR for ROS 2, ROS1 for ROS 1, or None for another encoding.

    Raises MissingLibraryError when mcap or rosbags is not installed.
    """
    require_libraries()
    from rosbags.typesys import Stores, get_typestore

    stores = {CDR: Stores.ROS2_HUMBLE, ROS1: Stores.ROS1_NOETIC}
    return get_typestore(stores[encoding]) if encoding in stores else None


def encode(message: Any, type_name: str) -> bytes:
    """Return the bytes of a message in CDR, the encoding of ROS 2.

    Raises MissingLibraryError when mcap or rosbags is not installed.
    """
    return bytes(load_types(CDR).serialize_cdr(message, type_name))


def make_image(values: NDArray[Any], encoding: str, stamp_ns: int, frame: str) -> Any:
    """Return the sensor_msgs Image of an array (H, W) or (H, W, C), in an encoding such as rgb8 or 32FC1."""
    dtype = np.dtype(ENCODINGS[encoding][0]).newbyteorder("<")
    rows = np.ascontiguousarray(values, dtype).reshape(len(values), -1)
    return _make(
        IMAGE,
        header=make_header(stamp_ns, frame),
        height=values.shape[0],
        width=values.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1] * dtype.itemsize,
        data=rows.view(np.uint8).ravel(),
    )


def make_pose(pose: RosPose, stamp_ns: int, frame: str) -> Any:
    """Return the geometry_msgs PoseWithCovarianceStamped of a pose in `frame`."""
    with_covariance = _make(
        "geometry_msgs/msg/PoseWithCovariance", pose=_make_pose(pose), covariance=np.array(pose.covariance)
    )
    return _make(POSE, header=make_header(stamp_ns, frame), pose=with_covariance)


def make_text(text: str) -> Any:
    """Return the std_msgs String of a text."""
    return _make(TEXT, data=str(text))


def make_plain_pose(T: Floats, stamp_ns: int, frame: str) -> Any:
    """Return the geometry_msgs PoseStamped of a pose (4, 4), metres, in `frame`."""
    return _make(POSE_STAMPED, header=make_header(stamp_ns, frame), pose=_make_pose(RosPose.of(T, None)))


def make_transforms(transforms: dict[tuple[str, str], Floats], stamp_ns: int) -> Any:
    """Return the tf2_msgs TFMessage of transforms T_parent_child (4, 4), metres, with keys (parent, child)."""
    listed = []
    for (parent, child), T in transforms.items():
        pose = RosPose.of(T, None)
        shift, rotation = _make_vector("Vector3", pose.position_m), _make_vector("Quaternion", pose.quaternion_xyzw)
        moved = _make("geometry_msgs/msg/Transform", translation=shift, rotation=rotation)
        head = make_header(stamp_ns, parent)
        listed.append(_make("geometry_msgs/msg/TransformStamped", header=head, child_frame_id=child, transform=moved))
    return _make(TF, transforms=listed)


def make_header(stamp_ns: int, frame: str) -> Any:
    """Return the std_msgs Header of a time and a frame."""
    stamp = _make("builtin_interfaces/msg/Time", sec=stamp_ns // NS, nanosec=stamp_ns % NS)
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _make_pose(pose: RosPose) -> Any:
    position, rotation = _make_vector("Point", pose.position_m), _make_vector("Quaternion", pose.quaternion_xyzw)
    return _make("geometry_msgs/msg/Pose", position=position, orientation=rotation)


def _make_vector(kind: str, values: tuple[float, ...]) -> Any:
    return _make(f"geometry_msgs/msg/{kind}", **dict(zip("xyzw", values, strict=False)))


def _make(type_name: str, **fields: Any) -> Any:
    return load_types(CDR).types[type_name](**fields)
