"""The node with substitutes for rclpy's node and services. Its messages are real types, serialised and read again."""

import json
import sys
import time
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from tactile_loc import Freedom, LocatedFrame, TactileLocError, Verdict
from tactile_loc.plugin import MissingLibraryError

from tactile_loc_ros2 import node
from tactile_loc_ros2.frames import read_stamp_ns
from tactile_loc_ros2.locator import ImageLocator
from tactile_loc_ros2.messages import MessageMaker
from tactile_loc_ros2.options import NodeOptions

NS = 1_000_000_000
T = np.array([[0, -1, 0, 0.001], [1, 0, 0, 0.002], [0, 0, 1, 0.003], [0, 0, 0, 1.0]])
C = np.diag(np.arange(1.0, 7.0))


class StandIn:
    """The methods of rclpy's node that ours calls. Published messages are serialised and read again."""

    def __init__(self, types) -> None:
        self.types, self.published, self.subscribed, self.services, self.timers = types, {}, {}, {}, []
        self.warned: list[str] = []
        self.displays = 1

    def create_publisher(self, kind, topic, depth):
        sent = self.published.setdefault(topic, [])
        return SimpleNamespace(
            publish=lambda message: sent.append(self.types.pass_on(message)),
            get_subscription_count=lambda: self.displays,
        )

    def create_subscription(self, kind, topic, take, quality):
        self.subscribed[topic] = (take, quality)

    def create_service(self, kind, name, answer):
        self.services[name] = answer

    def create_timer(self, period_s, call):
        self.timers.append(call)

    def get_logger(self):
        return SimpleNamespace(warning=lambda text, throttle_duration_sec: self.warned.append(text))

    def receive(self, topic, message) -> None:
        self.subscribed[topic][0](message)

    def call(self, name) -> dict:
        response = self.services[name](None, SimpleNamespace(success=None, message=None))
        return json.loads(response.message) | {"success": response.success}

    def last(self, topic):
        return self.published[topic][-1]


@pytest.fixture
def start(types, localizer):
    """Return a function that starts the node with options, and an estimator with a given verdict."""

    def start(verdict=Verdict.CERTAIN, press_depth_m=None, estimator=None, **options) -> StandIn:
        def estimate(touch) -> LocatedFrame:
            return LocatedFrame(verdict, T[None], np.ones(1), C, 0.9)

        chosen = NodeOptions(**{"object": "pin", "sensor": "gelslim", "image_topic": "/gel/image", **options})
        ros = node.Ros(types.find, "newest", "latched")
        plumbing = StandIn(types)
        locator = ImageLocator(
            localizer, press_depth_m, estimator or estimate, required=chosen.required, track=chosen.track
        )
        node.TactileLocNode(plumbing, ros, chosen, locator)
        return plumbing

    return start


def test_each_image_gets_a_pose_a_verdict_a_result_and_markers(start, make_image, depth_m):
    ros = start()
    assert ros.subscribed["/gel/image"][1] == "newest"
    ros.receive("/gel/image", make_image(depth_m, stamp_ns=5 * NS + 7))
    pose = ros.last("/object/pose")
    assert (pose.header.frame_id, read_stamp_ns(pose.header)) == ("gel", 5 * NS + 7)
    np.testing.assert_array_equal(pose.pose.covariance[::7], [1, 2, 3, 4, 5, 6])
    assert ros.last("/object/verdict").data == "certain"
    result = json.loads(ros.last("~/result").data)
    assert (result["verdict"], result["frame"], result["stamp_ns"]) == ("certain", "gel", 5 * NS + 7)
    np.testing.assert_allclose(result["T_frame_object"], T)
    assert len(ros.last("~/markers").markers) == 3
    assert "/tf" not in ros.published
    assert ros.warned == []


def test_the_result_states_a_possible_slide_and_turn(start, make_image, depth_m):
    slide, turn = np.array([0.0, 0.0, 0.004]), np.array([0.0, np.pi, 0.0])
    freedom = Freedom(0, slide, turn, np.zeros(3), np.zeros(3), 1e-4)

    def estimate(touch) -> LocatedFrame:
        return LocatedFrame(Verdict.AMBIGUOUS, T[None], np.ones(1), C, 0.9, freedom=freedom)

    ros = start(estimator=estimate)
    ros.receive("/gel/image", make_image(depth_m))
    result = json.loads(ros.last("~/result").data)["freedom"]
    assert (result["slide_m"], result["turn_rad"]) == (slide.tolist(), turn.tolist())
    assert "4.0 mm along z of the object" in result["says"]
    assert (result["others"], result["contact_std_m"]) == (0, 1e-4)
    ros = start()  # an estimator that does not know it, such as a track
    ros.receive("/gel/image", make_image(depth_m))
    assert json.loads(ros.last("~/result").data)["freedom"] is None


def test_a_result_lists_all_hypotheses_in_the_base_frame(start, make_image, localizer, send_frames):
    touch = localizer.simulate(1, seed=2)[0]
    expected = localizer.localize(touch)
    ros = start(
        estimator=lambda seen: LocatedFrame.of(localizer.localize(seen)), base_frame="base", detections=True,
        press_depth_m=touch.press_depth_m,
    )  # fmt: skip
    send_frames(ros, 0, 0.25)
    ros.receive("/gel/image", make_image(touch.contact_shape.depth_m, stamp_ns=0))
    (one,) = ros.last("~/detections").detections
    assert one.header.frame_id == "base"
    assert len(one.results) == len(expected.hypotheses) > 1
    for result, hypothesis in zip(one.results, expected.hypotheses, strict=True):
        assert result.pose.pose.position.x == pytest.approx(hypothesis.T_sensor_object[0, 3] + 0.25, abs=1e-6)
        if hypothesis.covariance is not None:
            np.testing.assert_allclose(
                np.reshape(result.pose.covariance, (6, 6)), hypothesis.covariance, rtol=1e-3, atol=1e-12
            )
    assert "~/detections" not in start().published


def test_the_points_of_a_touch_are_on_the_touched_object(start, make_image, localizer):
    touch = localizer.simulate(1, seed=2)[0]
    ros = start(press_depth_m=touch.press_depth_m)
    ros.receive("/gel/image", make_image(touch.contact_shape.depth_m))
    cloud = ros.last("~/touch_points")
    points_m = cloud.data.view("<f4").reshape(-1, 3).astype(float)
    assert len(points_m) == (touch.contact_shape.contact & touch.geometry.observed_mask).sum()
    T = np.linalg.inv(touch.T_sensor_object)
    distances_m = measure_distances_m(localizer.object.mesh, points_m @ T[:3, :3].T + T[:3, 3])
    assert np.quantile(distances_m, 0.9) < 1e-4


def measure_distances_m(mesh, points_m) -> np.ndarray:
    trimesh = pytest.importorskip("trimesh")
    return trimesh.proximity.closest_point(trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False), points_m)[1]


def test_markers_are_made_only_for_a_display(start, make_image, depth_m):
    ros = start()
    ros.displays = 0
    ros.receive("/gel/image", make_image(depth_m))
    assert ros.published["~/markers"] == []
    assert len(ros.published["/object/pose"]) == 1
    assert "~/markers" not in start(markers=False).published


def test_images_without_contact_have_a_verdict_but_no_pose(start, make_image, untouched_m):
    ros = start()
    ros.receive("/gel/image", make_image(untouched_m))
    assert ros.last("/object/verdict").data == "no contact"
    assert ros.published["/object/pose"] == []
    assert [one.action for one in ros.last("~/markers").markers] == [3]
    assert ros.warned == []


def test_unreadable_images_are_warned_of(start, make_image, depth_m):
    ros = start()
    ros.receive("/gel/image", make_image(depth_m, data=np.zeros(0, np.uint8)))
    assert (len(ros.warned), ros.published["/object/verdict"]) == (1, [])
    assert json.loads(ros.last("~/result").data)["verdict"] is None


@pytest.mark.parametrize(("verdict", "poses"), [(Verdict.CERTAIN, 1), (Verdict.AMBIGUOUS, 0), (Verdict.POOR_FIT, 0)])
def test_a_required_verdict_holds_back_poses_but_not_verdicts(start, make_image, depth_m, verdict, poses):
    for require, expected in (("certain", poses), ("", 1)):
        ros = start(verdict, require=require)
        ros.receive("/gel/image", make_image(depth_m))
        assert len(ros.published["/object/pose"]) == expected
        assert ros.last("/object/verdict").data == verdict.value


@pytest.mark.parametrize(
    ("tf", "verdict", "sent"),
    [
        ("certain", Verdict.CERTAIN, 1), ("certain", Verdict.AMBIGUOUS, 0), ("any", Verdict.POOR_FIT, 1),
        ("any", Verdict.CERTAIN, 1),
    ],
)  # fmt: skip
def test_the_object_goes_to_tf_if_the_verdict_allows(start, make_image, depth_m, tf, verdict, sent):
    ros = start(verdict, tf=tf, object_frame="part")
    ros.receive("/gel/image", make_image(depth_m))
    assert len(ros.published["/tf"]) == sent
    if sent:
        (one,) = ros.last("/tf").transforms
        assert (one.header.frame_id, one.child_frame_id) == ("gel", "part")
        assert one.transform.translation.y == 0.002


@pytest.fixture
def send_frames(types):
    """Return a function that sends T_base_gel, a shift along x, to a node."""
    maker = MessageMaker(types.find)

    def send(ros, stamp_ns: int, x_m: float) -> None:
        moved = np.eye(4)
        moved[0, 3] = x_m
        ros.receive("/tf", types.pass_on(maker.make_transforms({("base", "gel"): moved}, stamp_ns)))

    return send


def test_poses_are_in_the_base_frame_at_the_stamp(start, make_image, depth_m, send_frames):
    ros = start(base_frame="base")
    assert ros.subscribed["/tf_static"][1] == "latched"
    send_frames(ros, 0, 0.0)
    send_frames(ros, NS, 1.0)
    ros.receive("/gel/image", make_image(depth_m, stamp_ns=NS // 2))
    pose = ros.last("/object/pose")
    assert pose.header.frame_id == "base"
    assert pose.pose.pose.position.x == pytest.approx(0.501)


def test_an_image_waits_for_its_transform(start, make_image, depth_m, send_frames):
    ros = start(base_frame="base", tf_wait_s=60.0)
    send_frames(ros, 0, 0.0)
    ros.receive("/gel/image", make_image(depth_m, stamp_ns=NS // 2))
    for call in ros.timers:
        call()
    assert ros.published["/object/verdict"] == []
    send_frames(ros, NS, 1.0)
    for call in ros.timers:
        call()
    assert len(ros.published["/object/pose"]) == 1
    for call in ros.timers:
        call()
    assert len(ros.published["/object/pose"]) == 1


def test_images_that_arrive_before_their_transforms_do_not_starve(start, make_image, depth_m, send_frames):
    ros = start(base_frame="base", tf_wait_s=60.0)
    send_frames(ros, 0, 0.0)
    for k in range(1, 6):  # each transform comes after two more images
        ros.receive("/gel/image", make_image(depth_m, stamp_ns=(k + 1) * NS))
        send_frames(ros, k * NS, float(k))
    for call in ros.timers:
        call()
    stamps_s = [pose.header.stamp.sec for pose in ros.published["/object/pose"]]
    assert stamps_s == [2, 3, 4, 5]


def test_an_image_whose_transform_does_not_come_is_refused(start, make_image, depth_m):
    ros = start(base_frame="base", tf_wait_s=0.0)
    ros.receive("/gel/image", make_image(depth_m))
    assert "no frame" in ros.warned[0]
    assert json.loads(ros.last("~/result").data)["verdict"] is None
    assert ros.published["/object/verdict"] == []


def test_the_sensor_frame_can_be_set(start, make_image, depth_m):
    ros = start(frame="finger")
    ros.receive("/gel/image", make_image(depth_m, frame=""))
    assert ros.last("/object/pose").header.frame_id == "finger"


def test_a_track_publishes_slips(start, make_image, localizer):
    touch = localizer.simulate(1, seed=2)[0]
    ros = start(track=True, press_depth_m=touch.press_depth_m)
    end_s = time.monotonic() + 120
    for k in count():
        ros.receive("/gel/image", make_image(touch.contact_shape.depth_m, stamp_ns=k * NS // 10))
        if ros.published["/object/pose"]:
            break
        assert time.monotonic() < end_s
        time.sleep(0.02)
    assert [message.data for message in ros.published["~/slipped"]] == [False] * (k + 1)
    assert "~/slipped" not in start().published


def test_services_collect_and_locate_touches(start, make_image, send_frames, localizer):
    def refuse(touch) -> LocatedFrame:
        raise AssertionError("the image was located, but only services locate")

    touch = localizer.simulate(1, seed=2)[0]
    ros = start(
        continuous=False, base_frame="base", tf="any", estimator=refuse, press_depth_m=touch.press_depth_m,
        approach_count=10,
    )  # fmt: skip
    assert "no image" in ros.call("~/add_touch")["error"]
    send_frames(ros, 0, 0.0)
    send_frames(ros, NS, 1.0)
    ros.receive("/gel/image", make_image(touch.contact_shape.depth_m, stamp_ns=NS // 2))
    assert ros.published["/object/verdict"] == []
    assert ros.call("~/add_touch")["success"]
    located = ros.call("~/locate")
    pose = ros.last("~/located_pose")
    assert (located["frame"], pose.header.frame_id, read_stamp_ns(pose.header)) == ("base", "base", NS // 2)
    assert pose.pose.pose.position.x == pytest.approx(located["T_frame_object"][0][3])
    assert pose.pose.pose.position.x > 0.4  # the sensor is at 0.5 m
    assert ros.last("~/located_verdict").data == located["verdict"]
    assert ros.last("/tf").transforms[0].header.frame_id == "base"
    suggested = ros.call("~/next_touch")
    assert ros.last("~/next_touch_pose").pose.position.z == pytest.approx(suggested["T_frame_sensor"][2][3])
    assert ros.last("~/next_touch_nats").data == pytest.approx(suggested["information_nats"], abs=1e-4)
    assert not ros.call("~/identify")["success"]
    assert ros.call("~/clear") == {"touches": 0, "cleared": 1, "success": True}


def test_a_touch_whose_transform_is_unknown_is_not_added(start, make_image, depth_m):
    ros = start(continuous=False, base_frame="base")
    ros.receive("/gel/image", make_image(depth_m))
    assert "no frame" in ros.call("~/add_touch")["error"]
    assert "no touch" in ros.call("~/locate")["error"]


def test_a_missing_ros_gives_a_one_sentence_error(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(MissingLibraryError, match="source a ROS 2 installation"):
        node.import_ros("rclpy")
    assert issubclass(MissingLibraryError, TactileLocError)
    assert node.main(["--object", "pin", "--sensor", "gelslim", "--image-topic", "/gel"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
