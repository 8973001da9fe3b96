"""ROS's message types without ROS: messages to bytes and back, by rosbags."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import MissingLibraryError, RecordingError
from tactile_loc.core.geometry.rigid import rotation_to_quaternion
from tactile_loc.io.ros_messages import ENCODINGS, IMAGE, NS, POSE, TF, RosPose

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
CDR, ROS1 = "cdr", "ros1"  # how ROS 2 and ROS 1 write a message's bytes


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
def topic_of(name: str, type_name: str) -> Topic:
    """Return a topic of ROS 2 messages of a type that ROS comes with. Raises MissingLibraryError."""
    return Topic(name, type_name, definition_of(type_name))


def definition_of(type_name: str) -> bytes:
    """Return the definition of a type that ROS 2 comes with; of another, none."""
    store = type_store(CDR)
    return store.generate_msgdef(type_name, ros_version=2)[0].encode() if type_name in store.types else b""


@cache
def type_store(encoding: str) -> Any:
    """Return the types that ROS 2 or ROS 1 comes with, as rosbags has them; None for another encoding.

    Raises MissingLibraryError without rosbags.
    """
    require_libraries()
    from rosbags.typesys import Stores, get_typestore

    stores = {CDR: Stores.ROS2_HUMBLE, ROS1: Stores.ROS1_NOETIC}
    return get_typestore(stores[encoding]) if encoding in stores else None


def decoded(topic: Topic, data: bytes) -> Any:
    """Return the message of a topic that bytes hold. Raises RecordingError for bytes that hold none."""
    store = type_store(topic.message_encoding)
    if store is None:
        raise RecordingError(
            f"the messages of {topic.name} are written as {topic.message_encoding or 'nothing that is named'}; only "
            "those of ROS 2 (cdr) and ROS 1 (ros1) can be read"
        )
    read = store.deserialize_cdr if topic.message_encoding == CDR else store.deserialize_ros1
    try:
        return read(data, topic.type)
    except Exception as error:  # whatever stray bytes make of generated code
        raise RecordingError(f"a message of {topic.name} is no {topic.type}: it is damaged") from error


def encoded(message: Any, type_name: str) -> bytes:
    """Return a message as ROS 2 writes it (CDR). Raises MissingLibraryError."""
    return bytes(type_store(CDR).serialize_cdr(message, type_name))


def image_message(values: NDArray[Any], encoding: str, stamp_ns: int, frame: str) -> Any:
    """Return the sensor_msgs Image of an array (H, W) or (H, W, C), of an encoding such as rgb8 or 32FC1."""
    dtype = np.dtype(ENCODINGS[encoding].dtype).newbyteorder("<")
    rows = np.ascontiguousarray(values, dtype).reshape(len(values), -1)
    return _made(
        IMAGE, header=header(stamp_ns, frame), height=values.shape[0], width=values.shape[1], encoding=encoding,
        is_bigendian=0, step=rows.shape[1] * dtype.itemsize, data=rows.view(np.uint8).ravel(),
    )  # fmt: skip


def pose_message(pose: RosPose, stamp_ns: int, frame: str) -> Any:
    """Return the geometry_msgs PoseWithCovarianceStamped of a pose in `frame`."""
    with_covariance = _made(
        "geometry_msgs/msg/PoseWithCovariance", pose=_pose(pose), covariance=np.array(pose.covariance)
    )
    return _made(POSE, header=header(stamp_ns, frame), pose=with_covariance)


def plain_pose_message(T: NDArray[np.float64], stamp_ns: int, frame: str) -> Any:
    """Return the geometry_msgs PoseStamped of a pose (4, 4), metres, in `frame`."""
    return _made(POSE_STAMPED, header=header(stamp_ns, frame), pose=_pose(RosPose.of(T, None)))


def transform_message(transforms: dict[tuple[str, str], NDArray[np.float64]], stamp_ns: int) -> Any:
    """Return the tf2_msgs TFMessage of transforms T_parent_child (4, 4), metres, by (parent, child)."""
    listed = [
        _made(
            "geometry_msgs/msg/TransformStamped", header=header(stamp_ns, parent), child_frame_id=child,
            transform=_made(
                "geometry_msgs/msg/Transform", translation=_vector("Vector3", T[:3, 3].tolist()),
                rotation=_quaternion(np.roll(rotation_to_quaternion(T[:3, :3]), -1).tolist()),
            ),
        )
        for (parent, child), T in transforms.items()
    ]  # fmt: skip
    return _made(TF, transforms=listed)


def header(stamp_ns: int, frame: str) -> Any:
    """Return the std_msgs Header of a time and a frame."""
    stamp = _made("builtin_interfaces/msg/Time", sec=stamp_ns // NS, nanosec=stamp_ns % NS)
    return _made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _pose(pose: RosPose) -> Any:
    return _made(
        "geometry_msgs/msg/Pose", position=_vector("Point", pose.position_m),
        orientation=_quaternion(pose.quaternion_xyzw),
    )  # fmt: skip


def _vector(kind: str, xyz: Any) -> Any:
    return _made(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", xyz, strict=True)))


def _quaternion(xyzw: Any) -> Any:
    return _made("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", xyzw, strict=True)))


def _made(type_name: str, **fields: Any) -> Any:
    return type_store(CDR).types[type_name](**fields)
