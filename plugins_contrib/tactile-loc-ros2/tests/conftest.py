"""Fixtures: real ROS 2 message types from rosbags, a localizer that is built fast, and images of it."""

from array import array
from collections.abc import Callable
from dataclasses import fields
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tactile_loc import Localizer

# Definitions of vision_msgs 4, which rosbags lacks
VISION = {
    "ObjectHypothesis": "string class_id\nfloat64 score\n",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id\n",
    "Detection3DArray": "std_msgs/Header header\nDetection3D[] detections\n",
}
CONTACT_FREE_M = 0.002
NS = 1_000_000_000


class MessageTypes:
    """The message types of a ROS 2 distribution. As in rclpy, fields that are not stated have default values."""

    def __init__(self, store: str) -> None:
        typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed: pip install rosbags")
        self.store = typesys.get_typestore(typesys.Stores[store])
        for name, text in VISION.items():
            self.store.register(typesys.get_types_from_msg(text, f"vision_msgs/msg/{name}"))

    def find(self, name: str) -> Callable[..., Any]:
        """Return what makes a message of a type."""
        if name == "std_srvs/srv/Trigger":  # rosbags has no services
            return SimpleNamespace
        return partial(self._make, name)

    def _make(self, name: str, /, **given: Any) -> Any:
        kind = self.store.types[name]
        given = {key: np.array(value) if isinstance(value, array) else value for key, value in given.items()}
        unknown = given.keys() - {one.name for one in fields(kind)}
        assert not unknown, f"{name} has no fields {unknown}"
        return kind(**{field: given.get(field, self._default(kind_of)) for field, kind_of in self._fields(name)})

    def _fields(self, name: str) -> list[tuple[str, Any]]:
        return list(self.store.fielddefs[name][1])

    def _default(self, kind_of: Any) -> Any:
        """Return the default of a field: its definition is (node type, details)."""
        node, details = kind_of[0].name, kind_of[1]
        if node == "BASE":
            return {"string": "", "bool": False}.get(details[0], 0.0 if details[0].startswith("float") else 0)
        if node == "NAME":
            return self._make(details)
        (inner, length) = details
        if inner[0].name == "BASE" and inner[1][0] != "string":
            return np.zeros(length or 0, {"byte": "u1", "char": "u1"}.get(inner[1][0], inner[1][0]))
        return [self._default(inner) for _ in range(length or 0)]

    def pass_on(self, message: Any) -> Any:
        """Return a message after serialising it to CDR, the encoding of ROS 2, and reading it again."""
        name = message.__msgtype__
        return self.store.deserialize_cdr(self.store.serialize_cdr(message, name), name)


@cache
def load_types(store: str) -> MessageTypes:
    return MessageTypes(store)


@pytest.fixture(params=["ROS2_HUMBLE", "ROS2_JAZZY"])
def each_types(request: pytest.FixtureRequest) -> MessageTypes:
    return load_types(request.param)


@pytest.fixture(scope="session")
def types() -> MessageTypes:
    return load_types("ROS2_JAZZY")


@pytest.fixture(scope="session")
def localizer() -> Localizer:
    return Localizer.create("pin", sensor="gelslim", grid={"name": "face", "spacing_mm": 10}, temperature=1e-3)


@pytest.fixture(scope="session")
def make_image(types: MessageTypes) -> Callable[..., Any]:
    """Return a function that makes a sensor_msgs Image of depths, as it arrives over the network."""

    def make(depth_m: np.ndarray, stamp_ns: int = 5 * NS + 7, frame: str = "gel", **fields: Any) -> Any:
        stamp = types.find("builtin_interfaces/msg/Time")(sec=stamp_ns // NS, nanosec=stamp_ns % NS)
        header = types.find("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)
        data = np.ascontiguousarray(depth_m, "<f4").view(np.uint8).ravel()
        h, w = depth_m.shape
        given = {"height": h, "width": w, "encoding": "32FC1", "is_bigendian": 0, "step": 4 * w, "data": data}
        return types.pass_on(types.find("sensor_msgs/msg/Image")(header=header, **{**given, **fields}))

    return make


@pytest.fixture(scope="session")
def depth_m() -> np.ndarray:
    depth = np.full((200, 200), CONTACT_FREE_M, np.float32)
    depth[50:90, 60:150] = 0.0
    return depth


@pytest.fixture(scope="session")
def untouched_m() -> np.ndarray:
    return np.full((200, 200), CONTACT_FREE_M, np.float32)
