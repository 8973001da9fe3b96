"""ROS's messages as arrays, and back: images, transforms, poses with covariance. Of ROS itself nothing is needed.

A message is any object with the fields that its ROS definition names: one of rclpy's, rospy's or rosbags'. Messages are
made, and turned into bytes, by rosbags.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.deprecation import make_getattr
from tactile_loc.core.errors import FrameError, MissingLibraryError, RecordingError, TouchError
from tactile_loc.core.geometry.frame_tree import FrameTree
from tactile_loc.core.geometry.rigid import make_transform, quaternion_to_rotation, rotation_to_quaternion
from tactile_loc.io.images import UNREADABLE, load_image

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
IMAGE_TYPES = (IMAGE, COMPRESSED_IMAGE)
STATIC = "/tf_static"  # the topic of transforms that hold for all times
NS = 1_000_000_000
CDR, ROS1 = "cdr", "ros1"  # how ROS 2 and ROS 1 write a message's bytes
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


def decode_image(message: Any) -> NDArray[Any]:
    """Return a sensor_msgs Image or CompressedImage as colours (H, W, 3) uint8, grey (H, W) uint8 or depths (H, W).

    Depths (encoding 32FC1) are float32 in metres. Raises RecordingError for an encoding that is none of these, and
    TouchError for an image that is damaged.
    """
    return _decode_raw(message) if hasattr(message, "encoding") else _decode_compressed(message)


def _decode_raw(message: Any) -> NDArray[Any]:
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


def _decode_compressed(message: Any) -> NDArray[Any]:
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


def read_stamp_ns(header: Any) -> int:
    """Return the time of a std_msgs Header, ns."""
    return int(header.stamp.sec) * NS + int(header.stamp.nanosec)


def add_transforms(tree: FrameTree, message: Any, fixed: bool) -> None:
    """Add the transforms of a tf2_msgs TFMessage to a tree. Raises FrameError for what is no rotation."""
    for one in message.transforms:
        q, t = one.transform.rotation, one.transform.translation
        T = read_transform(np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w]), one.child_frame_id)
        tree.add(_name_frame(one.header.frame_id), _name_frame(one.child_frame_id), read_stamp_ns(one.header), T, fixed)


def read_transform(t_m: NDArray[np.float64], q_xyzw: NDArray[np.float64], name: str = "it") -> NDArray[np.float64]:
    """Return the transform (4, 4) of a translation (3,), metres, and a quaternion (4,), scalar last, as ROS has them.

    Raises FrameError, which calls it `name`, unless they are finite and the quaternion has a direction.
    """
    length = float(np.linalg.norm(q_xyzw))
    if not (np.isfinite(t_m).all() and np.isfinite(length) and length > 1e-6):
        raise FrameError(f"the transform of {name!r} has the rotation {q_xyzw.tolist()}, which is none")
    return make_transform(quaternion_to_rotation(np.roll(q_xyzw / length, 1)), t_m)


def _name_frame(name: str) -> str:
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
        return read_transform(np.array(self.position_m), np.array(self.quaternion_xyzw))


def read_pose(message: Any) -> RosPose:
    """Return what a geometry_msgs PoseWithCovarianceStamped says."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    covariance = tuple(float(v) for v in message.pose.covariance)
    return RosPose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), covariance)


@dataclass(frozen=True)
class Topic:
    """A topic of a recording: its `type` as ROS 2 names it, its definition, and how its messages are written."""

    name: str
    type: str
    definition: bytes = field(repr=False)
    definition_encoding: str = "ros2msg"
    message_encoding: str = CDR
    metadata: tuple[tuple[str, str], ...] = field(default=(), compare=False, repr=False)


def require_libraries() -> None:
    """Raise MissingLibraryError, which says how to install them, unless mcap and rosbags are there."""
    for name in ("mcap", "rosbags"):
        try:
            import_module(name)
        except ImportError as error:
            raise MissingLibraryError(
                f"recordings are read and written with {name}, which is not installed: "
                "pip install 'tactile-loc[recordings]'"
            ) from error


@cache
def make_topic(name: str, type_name: str) -> Topic:
    """Return a topic of ROS 2 messages of a type that ROS comes with. Raises MissingLibraryError."""
    return Topic(name, type_name, find_definition(type_name))


def find_definition(type_name: str) -> bytes:
    """Return the definition of a type that ROS 2 comes with; of another, none."""
    store = load_types(CDR)
    return store.generate_msgdef(type_name, ros_version=2)[0].encode() if type_name in store.types else b""


@cache
def load_types(encoding: str) -> Any:
    """Return the types that ROS 2 or ROS 1 comes with, as rosbags has them; None for another encoding.

    Raises MissingLibraryError without rosbags.
    """
    require_libraries()
    from rosbags.typesys import Stores, get_typestore

    stores = {CDR: Stores.ROS2_HUMBLE, ROS1: Stores.ROS1_NOETIC}
    return get_typestore(stores[encoding]) if encoding in stores else None


def encode(message: Any, type_name: str) -> bytes:
    """Return a message as ROS 2 writes it (CDR). Raises MissingLibraryError."""
    return bytes(load_types(CDR).serialize_cdr(message, type_name))


def make_image(values: NDArray[Any], encoding: str, stamp_ns: int, frame: str) -> Any:
    """Return the sensor_msgs Image of an array (H, W) or (H, W, C), of an encoding such as rgb8 or 32FC1."""
    dtype = np.dtype(ENCODINGS[encoding].dtype).newbyteorder("<")
    rows = np.ascontiguousarray(values, dtype).reshape(len(values), -1)
    return _make(
        IMAGE, header=make_header(stamp_ns, frame), height=values.shape[0], width=values.shape[1], encoding=encoding,
        is_bigendian=0, step=rows.shape[1] * dtype.itemsize, data=rows.view(np.uint8).ravel(),
    )  # fmt: skip


def make_pose(pose: RosPose, stamp_ns: int, frame: str) -> Any:
    """Return the geometry_msgs PoseWithCovarianceStamped of a pose in `frame`."""
    with_covariance = _make(
        "geometry_msgs/msg/PoseWithCovariance", pose=_make_pose(pose), covariance=np.array(pose.covariance)
    )
    return _make(POSE, header=make_header(stamp_ns, frame), pose=with_covariance)


def make_plain_pose(T: NDArray[np.float64], stamp_ns: int, frame: str) -> Any:
    """Return the geometry_msgs PoseStamped of a pose (4, 4), metres, in `frame`."""
    return _make(POSE_STAMPED, header=make_header(stamp_ns, frame), pose=_make_pose(RosPose.of(T, None)))


def make_transforms(transforms: dict[tuple[str, str], NDArray[np.float64]], stamp_ns: int) -> Any:
    """Return the tf2_msgs TFMessage of transforms T_parent_child (4, 4), metres, by (parent, child)."""
    listed = []
    for (parent, child), T in transforms.items():
        pose = RosPose.of(T, None)
        shift, turn = _make_vector("Vector3", pose.position_m), _make_vector("Quaternion", pose.quaternion_xyzw)
        moved = _make("geometry_msgs/msg/Transform", translation=shift, rotation=turn)
        head = make_header(stamp_ns, parent)
        listed.append(_make("geometry_msgs/msg/TransformStamped", header=head, child_frame_id=child, transform=moved))
    return _make(TF, transforms=listed)


def make_header(stamp_ns: int, frame: str) -> Any:
    """Return the std_msgs Header of a time and a frame."""
    stamp = _make("builtin_interfaces/msg/Time", sec=stamp_ns // NS, nanosec=stamp_ns % NS)
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _make_pose(pose: RosPose) -> Any:
    position, turn = _make_vector("Point", pose.position_m), _make_vector("Quaternion", pose.quaternion_xyzw)
    return _make("geometry_msgs/msg/Pose", position=position, orientation=turn)


def _make_vector(kind: str, values: tuple[float, ...]) -> Any:
    """A geometry_msgs Point, Vector3 or Quaternion."""
    return _make(f"geometry_msgs/msg/{kind}", **dict(zip("xyzw", values, strict=False)))


def _make(type_name: str, **fields: Any) -> Any:
    return load_types(CDR).types[type_name](**fields)


__getattr__ = make_getattr(__name__)
