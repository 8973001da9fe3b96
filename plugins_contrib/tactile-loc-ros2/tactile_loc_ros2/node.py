"""The node `tactile_loc`: connects topics, parameters and services of ROS 2 with the modules that do not import ROS."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import Localizer, LocatedFrame, TactileLocError, Verdict
from tactile_loc.plugin import ConfigError, MissingLibraryError, TouchError

from tactile_loc_ros2.frames import LiveFrames, read_stamp_ns
from tactile_loc_ros2.images import ImageQueue
from tactile_loc_ros2.locator import ImageLocator
from tactile_loc_ros2.messages import (
    CAMERA,
    COMPRESSED_IMAGE,
    DETECTIONS,
    FLAG,
    IMAGE,
    MARKERS,
    NUMBER,
    POINTS,
    POSE,
    POSE_WITH_COVARIANCE,
    TEXT,
    TRANSFORMS,
    FindType,
    MarkerMaker,
    MessageMaker,
)
from tactile_loc_ros2.options import LISTS, NEVER, OPTIONS, NodeOptions, make_parser, split_arguments
from tactile_loc_ros2.touches import Reply, TouchSet, describe_located, round_known, view_in_base

Floats = NDArray[np.float64]

NODE = "tactile_loc"
NO_ROS = (
    "the node needs rclpy, which is part of ROS 2; source a ROS 2 installation with the Python of tactile-loc, such as "
    "`source /opt/ros/jazzy/setup.bash`"
)
QUEUE = 10  # messages of a publisher
TF_QUEUE = 100
RETRY_S = 0.02  # between two lookups of the sensor's pose or of its camera
CAMERA_WAIT_S = 30.0  # longest wait for the first CameraInfo
WARN_S = 1.0  # least time between two warnings


def import_ros(module: str) -> Any:
    """Return a module of ROS 2. Raises MissingLibraryError if the module is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingLibraryError(f"{NO_ROS} ({error})") from error


def find_ros_type(name: str) -> Any:
    """Return the class of a type such as `std_msgs/msg/String`. Raises MissingLibraryError if it is not installed."""
    package, kind, type_name = name.split("/")
    return getattr(import_ros(f"{package}.{kind}"), type_name)


@dataclass(frozen=True)
class Ros:
    """The parts of ROS that the node needs: types, and qualities of service for images and constant transforms."""

    find_type: FindType
    newest: Any
    latched: Any

    @classmethod
    def load(cls) -> Ros:
        """Load the parts from rclpy. Raises MissingLibraryError without ROS."""
        qos = import_ros("rclpy.qos")
        newest = qos.QoSProfile(depth=1, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
        latched = qos.QoSProfile(depth=TF_QUEUE, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        return cls(find_ros_type, newest, latched)


class TactileLocNode:
    """Publishes a verdict for each image and a pose if one was found, and serves the collected touches.

    `node` is a node of rclpy. While an image is located, only the newest of the following images is kept.
    """

    def __init__(
        self, node: Any, ros: Ros, options: NodeOptions, locator: ImageLocator, library: Sequence[Localizer] = ()
    ) -> None:
        self._node, self._options, self._locator = node, options, locator
        self._frames = LiveFrames(options.tf_keep_s, options.object_frame)
        self._touches = TouchSet(
            locator.localizer, library, options.approaches, options.approach_count, options.most_touches
        )
        self._maker = MessageMaker(ros.find_type)
        self._markers: MarkerMaker | None = None
        if options.markers:
            obj = locator.localizer.object
            self._markers = MarkerMaker(self._maker, obj, options.mesh_resource, options.mesh_scale)
        self._images = ImageQueue(self._look_up_sensor, options.tf_wait_s)
        self._publish(ros)
        self._subscribe(ros)
        self._serve(ros)

    def _publish(self, ros: Ros) -> None:
        def advertise(type_name: str, topic: str, depth: int = QUEUE) -> Callable[[Any], None]:
            publish: Callable[[Any], None] = self._node.create_publisher(ros.find_type(type_name), topic, depth).publish
            return publish

        self._send_pose = advertise(POSE_WITH_COVARIANCE, self._options.pose_topic)
        self._send_verdict = advertise(TEXT, self._options.verdict_topic)
        self._send_result = advertise(TEXT, "~/result")
        self._send_slipped = advertise(FLAG, "~/slipped") if self._options.track else None
        self._send_detections = advertise(DETECTIONS, "~/detections") if self._options.detections else None
        self._points = self._node.create_publisher(ros.find_type(POINTS), "~/touch_points", QUEUE)
        self._shown = self._node.create_publisher(ros.find_type(MARKERS), "~/markers", QUEUE) if self._markers else None
        self._send_located_pose = advertise(POSE_WITH_COVARIANCE, "~/located_pose")
        self._send_located_verdict = advertise(TEXT, "~/located_verdict")
        self._send_next_touch = advertise(POSE, "~/next_touch_pose")
        self._send_next_nats = advertise(NUMBER, "~/next_touch_nats")
        self._send_transforms = advertise(TRANSFORMS, "/tf", TF_QUEUE) if self._options.tf != NEVER else None

    def _subscribe(self, ros: Ros) -> None:
        kind = ros.find_type(COMPRESSED_IMAGE if self._options.compressed else IMAGE)
        self._node.create_subscription(kind, self._options.image_topic, self._take_image, ros.newest)
        if self._options.base_frame:
            transforms = ros.find_type(TRANSFORMS)
            self._node.create_subscription(transforms, "/tf", self._take_transforms, TF_QUEUE)
            self._node.create_subscription(transforms, "/tf_static", self._take_fixed_transforms, ros.latched)
            self._node.create_timer(RETRY_S, self._locate_newest)

    def _serve(self, ros: Ros) -> None:
        trigger = ros.find_type("std_srvs/srv/Trigger")
        served: Mapping[str, Callable[[], Reply]] = {
            "add_touch": self._add_touch,
            "clear": self._touches.clear,
            "locate": self._locate_touches,
            "identify": self._touches.identify,
            "next_touch": self._suggest_touch,
        }
        for name, serve in served.items():
            self._node.create_service(trigger, f"~/{name}", Service(serve))

    # images

    def _take_image(self, image: Any) -> None:
        self._images.add(image, time.monotonic(), self._options.continuous)
        self._locate_newest()

    def _take_transforms(self, message: Any) -> None:
        for problem in self._frames.add(message, fixed=False):
            self._warn(problem)

    def _take_fixed_transforms(self, message: Any) -> None:
        for problem in self._frames.add(message, fixed=True):
            self._warn(problem)

    def _locate_newest(self) -> None:
        """Locate the newest image whose sensor pose is known, and refuse images whose sensor pose does not come."""
        placed = self._images.take()
        if placed is not None:
            start = time.perf_counter()
            found = self._locator.locate(placed.image, placed.T_base_sensor)
            seconds = time.perf_counter() - start
            self._report(found.located, placed.image, placed.T_base_sensor, found.slipped, seconds)
            if self._points.get_subscription_count():
                stamp_ns, frame = read_stamp_ns(placed.image.header), self._name_sensor(placed.image)
                self._points.publish(self._maker.make_points(found.contact_points_m, stamp_ns, frame))
        for image, error in self._images.expire(time.monotonic()):
            self._report(LocatedFrame.of_error(error), image, None, slipped=False)

    def _look_up_sensor(self, image: Any) -> Floats | None:
        """Return T_base_sensor (4, 4), metres; None without a base frame. Raises FrameError if it is unknown."""
        if not self._options.base_frame:
            return None
        return self._frames.look_up(self._options.base_frame, self._name_sensor(image), read_stamp_ns(image.header))

    def _name_sensor(self, image: Any) -> str:
        return str(self._options.frame or image.header.frame_id)

    def _report(
        self, located: LocatedFrame, image: Any, T_base_sensor: Floats | None, slipped: bool, seconds: float = math.nan
    ) -> None:
        """Publish the result of an image."""
        stamp_ns, frame = read_stamp_ns(image.header), self._options.base_frame or self._name_sensor(image)
        if T_base_sensor is not None:
            located = located.view_from(T_base_sensor)
        if located.T_sensor_object is None and located.says and located.verdict is not Verdict.NO_CONTACT:
            self._warn(located.says)
        self._send_poses(located, stamp_ns, frame, self._send_pose)
        if located.verdict is not None:
            self._send_verdict(self._maker.make_text(located.verdict.value))
        if self._send_slipped:
            self._send_slipped(self._maker.make_flag(slipped))
        self._send_result(self._maker.make_text(describe_result(located, stamp_ns, frame, slipped, seconds)))
        self._show(located, stamp_ns, frame)

    def _send_poses(self, located: LocatedFrame, stamp_ns: int, frame: str, send: Callable[[Any], None]) -> None:
        """Publish the pose of a result that is in `frame`, and the object's frame if the verdict allows it."""
        T = located.T_sensor_object
        if T is not None and self._locator.is_published(located):
            send(self._maker.make_pose_with_covariance(T, located.covariance, stamp_ns, frame))
        if self._send_detections:
            obj = self._locator.localizer.object
            self._send_detections(self._maker.make_detections(located, obj, stamp_ns, frame))
        if self._send_transforms and T is not None and self._options.allows_tf(located.verdict):
            edge = (frame, self._options.object_frame)
            self._send_transforms(self._maker.make_transforms({edge: T}, stamp_ns))

    def _show(self, located: LocatedFrame, stamp_ns: int, frame: str) -> None:
        """Publish the markers of a result that is in `frame`, if a node displays them."""
        if self._markers and self._shown and located.verdict is not None and self._shown.get_subscription_count():
            self._shown.publish(self._markers.make(located, stamp_ns, frame))

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(text, throttle_duration_sec=WARN_S)

    # services

    def _add_touch(self) -> Reply:
        try:
            placed = self._images.find_newest(self._options.image_topic)
        except TactileLocError as error:
            return Reply.of_error(error)
        image, T_base_sensor = placed.image, placed.T_base_sensor
        frame = self._options.base_frame or self._name_sensor(image)
        return self._touches.add(
            lambda: self._locator.read_touch(image, T_base_sensor), read_stamp_ns(image.header), frame
        )

    def _locate_touches(self) -> Reply:
        reply = self._touches.locate()
        if reply.found is not None:
            located = view_in_base(reply.found)
            self._send_poses(located, self._touches.stamp_ns, self._touches.frame, self._send_located_pose)
            self._send_located_verdict(self._maker.make_text(reply.found.verdict.value))
            self._show(located, self._touches.stamp_ns, self._touches.frame)
        return reply

    def _suggest_touch(self) -> Reply:
        reply = self._touches.suggest()
        if reply.suggested is not None:
            T = reply.suggested.approach.T_base_sensor
            self._send_next_touch(self._maker.make_pose(T, self._touches.stamp_ns, self._touches.frame))
            self._send_next_nats(self._maker.make_number(reply.suggested.information))
        return reply


@dataclass(frozen=True)
class Service:
    """Answers the requests of a std_srvs Trigger service with the replies of `serve`."""

    serve: Callable[[], Reply]

    def __call__(self, request: Any, response: Any) -> Any:
        """Fill and return the response."""
        reply = self.serve()
        response.success, response.message = reply.success, reply.message
        return response


def describe_result(located: LocatedFrame, stamp_ns: int, frame: str, slipped: bool, seconds: float) -> str:
    """Return the result of an image as JSON, in SI units."""
    measured = {"says": located.says, "slipped": slipped, "seconds": round_known(seconds)}
    return json.dumps({"stamp_ns": stamp_ns, **describe_located(located, frame), **measured})


def declare_options(node: Any, given: Mapping[str, Any]) -> NodeOptions:
    """Declare the options as parameters of a node, with the values of the command line as defaults.

    A value that ROS gives, for instance from a file, replaces that of the command line. Parameters cannot be changed
    later. Raises ConfigError for a value of a wrong type, and for impossible values.
    """
    exceptions, messages = import_ros("rclpy.exceptions"), import_ros("rcl_interfaces.msg")
    values = {}
    for one in OPTIONS:
        value = given[one.name]
        descriptor = messages.ParameterDescriptor(description=one.metadata["help"], read_only=True)
        default = (list(value) or [""]) if one.name in LISTS else value  # rclpy takes an empty list for bytes
        try:
            values[one.name] = node.declare_parameter(one.name, default, descriptor).value
        except exceptions.InvalidParameterTypeException as error:
            kind = type(one.default).__name__
            raise ConfigError(f"the parameter {one.name} has a wrong type; give a {kind} ({error})") from error
    return NodeOptions.of(values)


def wait_for_camera(node: Any, ros: Ros, topic: str) -> Any:
    """Return the next sensor_msgs CameraInfo on a topic. Raises TouchError if none comes within CAMERA_WAIT_S."""
    came: list[Any] = []
    subscription = node.create_subscription(ros.find_type(CAMERA), topic, came.append, ros.newest)
    end_s = time.monotonic() + CAMERA_WAIT_S
    while not came:
        if time.monotonic() > end_s:
            raise TouchError(f"no CameraInfo has arrived on {topic} within {CAMERA_WAIT_S:.0f} s; check the topic")
        import_ros("rclpy").spin_once(node, timeout_sec=RETRY_S)
    node.destroy_subscription(subscription)
    return came[0]


def build(options: NodeOptions, camera: Any = None) -> tuple[ImageLocator, list[Localizer]]:
    """Make the locator, and the localizers of the objects to identify.

    `camera` is a CameraInfo, or None, as in `NodeOptions.make_localizers`. Models are built and functions compiled now,
    which may take minutes.
    """
    localizer, others = options.make_localizers(camera)
    for one in (localizer, *others):
        one.localize(one.simulate(1)[0])
    library = [localizer, *others] if others else []
    locator = ImageLocator(localizer, options.press_depth_m, required=options.required, track=options.track)
    return locator, library


def run(words: Sequence[str]) -> None:
    """Run the node with the arguments of a command line, until ROS shuts down."""
    ours, of_ros = split_arguments(words)
    given = vars(make_parser().parse_args(ours))
    rclpy, signals, ros = import_ros("rclpy"), import_ros("rclpy.signals"), Ros.load()
    # rclpy's handlers would let a model be built to its end before the process stops
    rclpy.init(args=of_ros, signal_handler_options=signals.SignalHandlerOptions.NO)
    node = rclpy.create_node(NODE)
    try:
        options = declare_options(node, given)
        topic = options.camera_info_topic
        locator, library = build(options, wait_for_camera(node, ros, topic) if topic else None)
        signals.install_signal_handlers(signals.SignalHandlerOptions.ALL)
        TactileLocNode(node, ros, options, locator, library)
        node.get_logger().info(f"locating {locator.localizer.object.name} in the images on {options.image_topic}")
        rclpy.spin(node)
    except (KeyboardInterrupt, import_ros("rclpy.executors").ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def main(words: Sequence[str] | None = None) -> int:
    """Run the node, and return the exit code: 2 after an error, which is printed in one sentence."""
    try:
        run(sys.argv[1:] if words is None else words)
    except TactileLocError as error:
        sys.stderr.write(f"error: {type(error).__name__}: {error}\n")
        return 2
    return 0
