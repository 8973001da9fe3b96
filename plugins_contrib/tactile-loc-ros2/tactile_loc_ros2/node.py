"""The node `tactile_loc`: subscribes to images of the gel, and publishes the object's pose."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from tactile_loc import Localizer, TactileLocError, Verdict
from tactile_loc.plugin import MissingLibraryError

from tactile_loc_ros2.locator import ImageLocator

NO_ROS = (
    "the node needs rclpy, which is part of ROS 2; source a ROS 2 installation with the Python of tactile-loc, such as "
    "`source /opt/ros/jazzy/setup.bash`"
)


def ros(module: str) -> Any:
    """Return a module of ROS 2. Raises MissingLibraryError if the module is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingLibraryError(f"{NO_ROS} ({error})") from error


def run(
    locator: ImageLocator, image_topic: str, compressed: bool, pose_topic: str, verdict_topic: str,
    arguments: Sequence[str],
) -> None:  # fmt: skip
    """Publish a verdict for each image, and a pose unless another verdict is required, until ROS shuts down.

    While the node locates one image, it keeps only the newest of the following images.
    """
    rclpy, qos = ros("rclpy"), ros("rclpy.qos")
    kind = ros("sensor_msgs.msg").CompressedImage if compressed else ros("sensor_msgs.msg").Image
    answered, text = ros("geometry_msgs.msg").PoseWithCovarianceStamped, ros("std_msgs.msg").String
    rclpy.init(args=list(arguments))
    node = rclpy.create_node("tactile_loc")
    poses, verdicts = node.create_publisher(answered, pose_topic, 10), node.create_publisher(text, verdict_topic, 10)

    def on_image(image: Any) -> None:
        located = locator.locate(image)
        if locator.is_published(located):
            poses.publish(locator.fill(answered(), located, image))
        if located.T_sensor_object is None and located.verdict is not Verdict.NO_CONTACT:
            node.get_logger().warning(located.says, throttle_duration_sec=1.0)
        if located.verdict is not None:
            verdicts.publish(text(data=located.verdict.value))

    newest = qos.QoSProfile(depth=1, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(kind, image_topic, on_image, newest)
    node.get_logger().info(
        f"locating the object in the images on {image_topic}; its poses are published on {pose_topic}"
    )
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        node.get_logger().info("interrupted")
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def main(words: Sequence[str] | None = None) -> int:
    """Run the node with the arguments of the command line, and return the exit code. ROS gets unknown arguments."""
    given, rest = _parser().parse_known_args(words)
    try:
        ros("rclpy")  # raises an error before the model is built, which takes minutes
        localizer = Localizer.create(given.object, units=given.units, sensor=_sensor(given.sensor))
        localizer.localize(localizer.simulate(1)[0])  # builds the model and compiles
        press_m = None if given.press_depth is None else 1e-3 * given.press_depth
        required = None if given.require is None else Verdict(given.require)
        locator = ImageLocator(localizer, given.frame, press_m, required=required)
        run(locator, given.image_topic, given.compressed, given.pose_topic, given.verdict_topic, rest)
    except TactileLocError as error:
        sys.stderr.write(f"error: {type(error).__name__}: {error}\n")
        return 2
    return 0


def _sensor(given: str) -> str | dict[str, str]:
    """Return the sensor as given, or as a component if a sensor file or a calibration folder is given."""
    if given.endswith(".toml"):
        return {"name": "file", "path": given}
    return {"name": "calibrated", "path": given} if Path(given).is_dir() else given


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="tactile-loc-ros2", description=__doc__)
    parser.add_argument("--object", required=True, help="mesh file or demo object")
    parser.add_argument("--units", default="auto", help="unit of the mesh file: m, mm, cm, inch")
    parser.add_argument("--sensor", required=True, help="sensor name, sensor file (.toml), or calibration folder")
    parser.add_argument("--image-topic", required=True, help="images of the gel, or contact shapes (32FC1, metres)")
    parser.add_argument("--compressed", action="store_true", help="the images are CompressedImage")
    parser.add_argument("--pose-topic", default="/object/pose", help="topic of the poses")
    parser.add_argument("--verdict-topic", default="/object/verdict", help="topic of the verdicts")
    parser.add_argument("--require", choices=[Verdict.CERTAIN.value], help="publish only poses with this verdict")
    parser.add_argument("--frame", default="", help="the sensor's frame; by default the images' frame")
    parser.add_argument("--press-depth", type=float, help="press depth, mm; by default measured in the image")
    return parser
