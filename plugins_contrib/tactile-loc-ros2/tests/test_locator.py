"""The node's logic without ROS, and the node with a stand-in for rclpy that records the published messages."""

from __future__ import annotations

import sys
from io import BytesIO
from types import ModuleType
from types import SimpleNamespace as Fields

import numpy as np
import pytest
from PIL import Image
from tactile_loc import Localizer, LocatedFrame, TactileLocError, Verdict
from tactile_loc.plugin import MissingLibraryError

from tactile_loc_ros2 import node
from tactile_loc_ros2.locator import ImageLocator

T = np.array([[0, -1, 0, 0.001], [1, 0, 0, 0.002], [0, 0, 1, 0.003], [0, 0, 0, 1.0]])
C = np.diag(np.arange(1.0, 7.0))
DEPTH = np.full((200, 200), 0.002, np.float32)
DEPTH[50:90, 60:150] = 0.0
STAMP = Fields(sec=5, nanosec=7)


def depth_image(depth: np.ndarray = DEPTH, **fields) -> Fields:
    h, w = depth.shape
    given = {"encoding": "32FC1", "is_bigendian": 0, "step": 4 * w, "data": depth.tobytes(), **fields}
    return Fields(header=Fields(stamp=STAMP, frame_id="gel"), height=h, width=w, **given)


def pose_message() -> Fields:
    """Return an empty message with the fields of rclpy's message."""
    at = Fields(position=Fields(x=0.0, y=0.0, z=0.0), orientation=Fields(x=0.0, y=0.0, z=0.0, w=1.0))
    return Fields(header=Fields(stamp=None, frame_id=""), pose=Fields(pose=at, covariance=[0.0] * 36))


@pytest.fixture(scope="module")
def localizer() -> Localizer:
    return Localizer.create("pin", sensor="gelslim", grid={"name": "face", "spacing_mm": 10}, temperature=1e-3)


def estimated(touch) -> LocatedFrame:
    return LocatedFrame(Verdict.CERTAIN, T[None], np.ones(1), C, 0.9)


@pytest.fixture
def locator(localizer) -> ImageLocator:
    return ImageLocator(localizer, estimator=estimated)


def test_an_image_gives_a_pose(locator):
    image = depth_image()
    message = locator.fill(pose_message(), locator.locate(image), image)
    assert (message.header.stamp, message.header.frame_id) == (STAMP, "gel")
    p, q = message.pose.pose.position, message.pose.pose.orientation
    assert (p.x, p.y, p.z) == (0.001, 0.002, 0.003)
    np.testing.assert_allclose((q.x, q.y, q.z, q.w), (0, 0, 0.5**0.5, 0.5**0.5))
    assert message.pose.covariance[::7] == [1, 2, 3, 4, 5, 6]


def test_the_frame_name_can_be_set(localizer):
    locator = ImageLocator(localizer, "finger", estimator=estimated)
    image = depth_image()
    assert locator.fill(pose_message(), locator.locate(image), image).header.frame_id == "finger"


def test_the_localizer_locates_a_simulated_touch(localizer):
    touch = localizer.simulate(1, seed=2)[0]
    locator = ImageLocator(localizer, press_depth_m=touch.press_depth_m)
    located = locator.locate(depth_image(touch.contact_shape.depth_m))
    expected = localizer.localize(touch)
    np.testing.assert_allclose(located.T_sensor_object[:3, 3], expected.best.T_sensor_object[:3, 3], atol=1e-3)
    assert located.verdict is expected.verdict


def test_the_press_depth_is_used(localizer):
    seen = []

    def keep(touch) -> LocatedFrame:
        seen.append(touch.press_depth_m)
        return estimated(touch)

    ImageLocator(localizer, press_depth_m=1e-3, estimator=keep).locate(depth_image())
    assert seen == [1e-3]


def test_an_image_without_contact_is_no_error(locator):
    located = locator.locate(depth_image(np.full((200, 200), 0.002, np.float32)))
    assert located.T_sensor_object is None
    assert located.verdict is Verdict.NO_CONTACT


@pytest.mark.parametrize(
    ("image", "mentioned"),
    [
        (depth_image(encoding="yuv422"), "yuv422"),
        (depth_image(np.zeros((20, 20), np.float32)), "20, 20"),
        (depth_image(data=b"123"), "has 3 bytes"),
        (depth_image(-DEPTH), "negative"),
    ],
)
def test_an_unreadable_image_gives_an_error(locator, image, mentioned):
    located = locator.locate(image)
    assert located.T_sensor_object is None
    assert located.verdict is None
    assert mentioned in located.says


def test_a_compressed_photo_needs_a_calibrated_sensor(locator):
    file = BytesIO()
    Image.fromarray(np.zeros((200, 200, 3), np.uint8)).save(file, "png")
    located = locator.locate(Fields(format="png", data=file.getvalue(), header=None))
    assert "not calibrated for images" in located.says


def test_a_missing_ros_gives_a_one_sentence_error(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(MissingLibraryError, match="source a ROS 2 installation"):
        node.ros("rclpy")
    assert issubclass(MissingLibraryError, TactileLocError)
    assert node.main(["--object", "pin", "--sensor", "gelslim", "--image-topic", "/gel"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


class StandIn:
    """The parts of rclpy and its messages that the node uses. Spinning passes the images and interrupts the node."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, images: list[Fields]) -> None:
        self.images, self.published, self.warned, self.began, self.ended = images, {}, [], [], 0
        policy = Fields(BEST_EFFORT="best effort")
        modules = {
            "rclpy": {
                "init": self._init, "create_node": lambda name: self, "spin": self._spin, "try_shutdown": self._end,
            },
            "rclpy.qos": {"QoSProfile": lambda **given: given, "ReliabilityPolicy": policy},
            "sensor_msgs": {}, "sensor_msgs.msg": {"Image": "Image", "CompressedImage": "CompressedImage"},
            "std_msgs": {}, "std_msgs.msg": {"String": Fields},
            "geometry_msgs": {}, "geometry_msgs.msg": {"PoseWithCovarianceStamped": pose_message},
        }  # fmt: skip
        for name, things in modules.items():
            module = ModuleType(name)
            module.__dict__.update(things)
            monkeypatch.setitem(sys.modules, name, module)

    def _init(self, args):
        self.began.append(args)

    def _spin(self, spun):
        for image in self.images:
            self.on_image(image)
        raise KeyboardInterrupt

    def _end(self):
        self.ended += 1

    def create_publisher(self, kind, topic, depth):
        return Fields(publish=self.published.setdefault(topic, []).append)

    def create_subscription(self, kind, topic, on_image, quality):
        self.kind, self.image_topic, self.on_image, self.quality = kind, topic, on_image, quality

    def get_logger(self):
        return Fields(info=lambda text: None, warning=lambda text, throttle_duration_sec: self.warned.append(text))

    def destroy_node(self):
        self.ended += 1


def test_the_node_publishes_poses_and_verdicts(monkeypatch, locator):
    untouched = depth_image(np.full((200, 200), 0.002, np.float32))
    ros = StandIn(monkeypatch, [depth_image(), untouched, depth_image(data=b""), depth_image()])
    node.run(locator, "/gel/image", False, "/pose", "/verdict", ["--ros-args"])
    assert (ros.kind, ros.image_topic) == ("Image", "/gel/image")
    assert [message.header.stamp for message in ros.published["/pose"]] == [STAMP, STAMP]
    assert [message.data for message in ros.published["/verdict"]] == ["certain", "no contact", "certain"]
    assert len(ros.warned) == 1
    assert ros.quality["depth"] == 1
    assert (ros.began, ros.ended) == ([["--ros-args"]], 2)


def test_compressed_images_have_another_message_type(monkeypatch, locator):
    ros = StandIn(monkeypatch, [])
    node.run(locator, "/gel/image/compressed", True, "/pose", "/verdict", [])
    assert ros.kind == "CompressedImage"
    assert ros.published == {"/pose": [], "/verdict": []}


@pytest.mark.parametrize(("verdict", "poses"), [(Verdict.CERTAIN, 1), (Verdict.AMBIGUOUS, 0), (Verdict.POOR_FIT, 0)])
def test_only_poses_with_the_required_verdict_are_published(monkeypatch, localizer, verdict, poses):
    def judged(touch) -> LocatedFrame:
        return LocatedFrame(verdict, T[None], np.ones(1), C, 0.9)

    for required, expected in ((Verdict.CERTAIN, poses), (None, 1)):
        ros = StandIn(monkeypatch, [depth_image()])
        locator = ImageLocator(localizer, estimator=judged, required=required)
        node.run(locator, "/gel/image", False, "/pose", "/verdict", [])
        assert len(ros.published["/pose"]) == expected
        assert [message.data for message in ros.published["/verdict"]] == [verdict.value]
        assert ros.warned == []


def test_the_node_takes_the_required_verdict_as_an_argument(capsys):
    words = ["--object", "pin", "--sensor", "gelslim", "--image-topic", "/gel"]
    assert node._parser().parse_args([*words, "--require", "certain"]).require == "certain"
    assert node._parser().parse_args(words).require is None
    with pytest.raises(SystemExit):
        node._parser().parse_args([*words, "--require", "perhaps"])
    assert "certain" in capsys.readouterr().err
