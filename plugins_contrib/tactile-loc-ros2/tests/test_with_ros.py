"""The node in a process of its own, with a real rclpy: images in; poses, verdicts and answers of services out.

Without rclpy, these tests are skipped.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tactile_loc import Localizer
from tactile_loc.plugin import SensorGeometry

rclpy = pytest.importorskip("rclpy", reason="rclpy, which is part of ROS 2, is not installed")

START_S, ANSWER_S = 300.0, 60.0  # the model is built at the start
CONFIG = """temperature = 1e-3
object = {path = "pin"}
sensor = {name = "gelslim"}
grid = {name = "face", spacing_mm = 10}
"""
RUN = "import sys; from tactile_loc_ros2.node import main; sys.exit(main())"


@pytest.fixture(scope="module", autouse=True)
def network() -> Iterator[None]:
    """Keep the messages of these tests on this machine, apart from those of other nodes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        rclpy.init(args=[])
        yield
        rclpy.try_shutdown()


class Client:
    """A node that sends images and transforms, and keeps all answers."""

    def __init__(self) -> None:
        from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
        from sensor_msgs.msg import CameraInfo, Image, PointCloud2
        from std_msgs.msg import Bool, Float64, String
        from visualization_msgs.msg import MarkerArray

        self.node = rclpy.create_node("client")
        self.got: dict[str, list[Any]] = defaultdict(list)
        self._images = self.node.create_publisher(Image, "/gel/image", 1)
        self._image, self._info = Image, CameraInfo
        self._infos = self.node.create_publisher(CameraInfo, "/gel/camera_info", 1)
        topics = {
            "/object/pose": PoseWithCovarianceStamped, "/object/verdict": String, "/tactile_loc/result": String,
            "/tactile_loc/touch_points": PointCloud2, "/tactile_loc/markers": MarkerArray, "/tactile_loc/slipped": Bool,
            "/tactile_loc/located_pose": PoseWithCovarianceStamped, "/tactile_loc/next_touch_pose": PoseStamped,
            "/tactile_loc/next_touch_nats": Float64,
        }  # fmt: skip
        for topic, kind in topics.items():
            self.node.create_subscription(kind, topic, self.got[topic].append, 10)

    def send_image(self, depth_m: np.ndarray, stamp_s: int) -> None:
        h, w = depth_m.shape
        data = np.ascontiguousarray(depth_m, "<f4").tobytes()
        image = self._image(height=h, width=w, encoding="32FC1", step=4 * w, data=data)
        image.header.frame_id, image.header.stamp.sec = "gel", stamp_s
        self._images.publish(image)

    def send_camera(self, geometry: SensorGeometry) -> None:
        info = self._info(width=geometry.width_px, height=geometry.height_px)
        info.k = np.array([geometry.fx, 0, geometry.cx, 0, geometry.fy, geometry.cy, 0, 0, 1])
        self._infos.publish(info)

    def wait(self, done: Callable[[], Any], limit_s: float = ANSWER_S, again: Callable[[], None] | None = None) -> None:
        """Spin until something is done; call `again` every half a second."""
        end = time.monotonic() + limit_s
        called = -np.inf
        while not done():
            assert time.monotonic() < end, {topic: len(messages) for topic, messages in self.got.items()}
            if again is not None and time.monotonic() > called + 0.5:
                again()
                called = time.monotonic()
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def call(self, name: str) -> dict[str, Any]:
        """Return the answer of a service of the node."""
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, f"/tactile_loc/{name}")
        assert client.wait_for_service(ANSWER_S)
        future = client.call_async(Trigger.Request())
        self.wait(future.done)
        answer = future.result()
        return json.loads(answer.message) | {"success": answer.success}


@pytest.fixture
def client() -> Iterator[Client]:
    client = Client()
    yield client
    client.node.destroy_node()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Return a function that starts the node with arguments."""
    file = tmp_path / "run.toml"
    file.write_text(CONFIG)
    running = []

    def start(*words: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", RUN, *words, "--ros-args", "-p", f"config:={file}"]
        running.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=dict(os.environ)))
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.wait()
        process.stderr.close()


@pytest.fixture(scope="module")
def depth_m(localizer: Localizer) -> np.ndarray:
    return localizer.simulate(1, seed=2)[0].contact_shape.depth_m


def test_an_image_gets_a_pose_and_a_verdict(start, client, depth_m, localizer):
    process = start("--image-topic", "/gel/image")
    client.wait(lambda: client.got["/object/pose"], START_S, lambda: client.send_image(depth_m, 5))
    pose = client.got["/object/pose"][0]
    others = ("/object/verdict", "/tactile_loc/markers", "/tactile_loc/result", "/tactile_loc/touch_points")
    client.wait(lambda: all(client.got[topic] for topic in others))
    assert (pose.header.frame_id, pose.header.stamp.sec) == ("gel", 5)
    touch = localizer.simulate(1, seed=2)[0]
    found = localizer.localize(touch).best
    p = pose.pose.pose.position
    np.testing.assert_allclose([p.x, p.y, p.z], found.T_sensor_object[:3, 3], atol=2e-3)
    assert np.linalg.eigvalsh(np.reshape(pose.pose.covariance, (6, 6))).min() > 0
    result = json.loads(client.got["/tactile_loc/result"][0].data)
    assert client.got["/object/verdict"][0].data == result["verdict"]
    assert result["freedom"]["others"] >= 0
    assert client.got["/tactile_loc/markers"][0].markers[1].ns == "object"
    cloud = client.got["/tactile_loc/touch_points"][0]
    z_m = np.frombuffer(bytes(cloud.data), "<f4").reshape(cloud.width, 3)[:, 2]
    assert cloud.header.frame_id == "gel"
    assert z_m.min() == pytest.approx(touch.geometry.standoff_m, abs=3e-4)  # the node measures the press
    process.send_signal(signal.SIGINT)
    assert process.wait(ANSWER_S) == 0, process.stderr.read()


def test_camera_info_gives_the_camera_of_depths(start, client):
    small = Localizer.create("pin", sensor={"name": "gelslim", "options": {"image_size_px": (160, 160)}})
    (touch,) = small.simulate(1, seed=2)
    start("--image-topic", "/gel/image", "--camera-info-topic", "/gel/camera_info")

    def send() -> None:
        client.send_camera(small.sensor.geometry)
        client.send_image(touch.contact_shape.depth_m, 5)

    client.wait(lambda: client.got["/tactile_loc/result"], START_S, send)
    assert json.loads(client.got["/tactile_loc/result"][0].data)["verdict"]  # an image of another size has none


def test_services_locate_touches_and_suggest_the_next(start, client, depth_m):
    process = start("--image-topic", "/gel/image", "--no-continuous", "--approach-count", "10")
    client.wait(lambda: client.node.get_subscriptions_info_by_topic("/gel/image"), START_S)
    client.wait(lambda: client.call("add_touch")["success"], again=lambda: client.send_image(depth_m, 5))
    located = client.call("locate")
    suggested = client.call("next_touch")
    client.wait(lambda: client.got["/tactile_loc/located_pose"] and client.got["/tactile_loc/next_touch_nats"])
    assert client.got["/tactile_loc/located_pose"][0].pose.pose.position.x == located["T_frame_object"][0][3]
    nats = client.got["/tactile_loc/next_touch_nats"][0].data
    assert nats == pytest.approx(suggested["information_nats"], abs=1e-4)
    assert "already been added" in client.call("add_touch")["error"]
    assert client.call("clear")["cleared"] == 1
    assert not client.call("locate")["success"]
    assert client.got["/object/verdict"] == []
    process.send_signal(signal.SIGTERM)
    assert process.wait(ANSWER_S) == 0, process.stderr.read()


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        ((), "image_topic"),
        (("--image-topic", "/gel/image", "--ros-args", "-p", "require:=perhaps"), "require"),
        (("--image-topic", "/gel/image", "--ros-args", "-p", "track:=3"), "track"),
    ],
)
def test_wrong_parameters_give_a_one_sentence_error(start, words, mentioned):
    process = start(*words)
    assert process.wait(ANSWER_S) == 2
    (line,) = [line for line in process.stderr.read().splitlines() if line.startswith("error: ")]
    assert "ConfigError" in line
    assert mentioned in line
