"""Messages: their fields after serialisation, the order of covariances, quaternions, stamps, and markers."""

import numpy as np
import pytest
from tactile_loc import LocatedFrame, Verdict
from tactile_loc.plugin.helpers import draw_rotations

from tactile_loc_ros2 import messages
from tactile_loc_ros2.frames import read_stamp_ns
from tactile_loc_ros2.messages import MarkerMaker, MessageMaker

NS = 1_000_000_000
STAMP_NS = 1_700_000_000 * NS + 123_456_789
T = np.array([[0, -1, 0, 0.001], [1, 0, 0, 0.002], [0, 0, 1, 0.003], [0, 0, 0, 1.0]])
HALF = 0.5**0.5


@pytest.fixture
def maker(each_types) -> MessageMaker:
    return MessageMaker(each_types.find)


def test_a_pose_has_its_stamp_frame_and_quaternion(maker, each_types):
    message = each_types.pass_on(maker.make_pose_with_covariance(T, np.eye(6), STAMP_NS, "base"))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert read_stamp_ns(message.header) == STAMP_NS
    assert message.header.frame_id == "base"
    p, q = message.pose.pose.position, message.pose.pose.orientation
    assert (p.x, p.y, p.z) == (0.001, 0.002, 0.003)
    np.testing.assert_allclose((q.x, q.y, q.z, q.w), (0, 0, HALF, HALF))


def test_a_covariance_is_translation_then_rotation_row_by_row(maker, each_types):
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    C = A @ A.T
    message = each_types.pass_on(maker.make_pose_with_covariance(T, C, STAMP_NS, "base"))
    assert len(message.pose.covariance) == 36
    np.testing.assert_array_equal(np.reshape(message.pose.covariance, (6, 6)), C)
    assert message.pose.covariance[1 * 6 + 5] == C[1, 5]  # y and the rotation about z


def test_an_unknown_covariance_begins_with_minus_one(maker, each_types):
    message = each_types.pass_on(maker.make_pose_with_covariance(T, None, STAMP_NS, "base"))
    assert message.pose.covariance[0] == -1
    assert not np.any(message.pose.covariance[1:])


def test_transforms_name_parent_and_child(maker, each_types):
    (one,) = each_types.pass_on(maker.make_transforms({("base", "object"): T}, STAMP_NS)).transforms
    assert (one.header.frame_id, one.child_frame_id, read_stamp_ns(one.header)) == ("base", "object", STAMP_NS)
    assert (one.transform.translation.x, one.transform.translation.z) == (0.001, 0.003)
    assert one.transform.rotation.w == pytest.approx(HALF)


def located(verdict: Verdict | None = Verdict.AMBIGUOUS, count: int = 3, covariance=None) -> LocatedFrame:
    poses = np.stack([T] * count) if count else np.empty((0, 4, 4))
    shares = np.array([0.6, 0.3, 0.1, 0.0, 0.0, 0.0, 0.0][:count])
    return LocatedFrame(verdict, poses, shares, covariance, 0.9)


def test_a_detection_has_all_poses_with_their_covariances(maker, each_types, localizer):
    other = T.copy()
    other[0, 3] = 0.5
    C = np.stack([np.eye(6), np.full((6, 6), np.nan)])
    found = LocatedFrame(Verdict.AMBIGUOUS, np.stack([T, other]), np.array([0.7, 0.3]), C[0], covariances=C)
    array = each_types.pass_on(maker.make_detections(found, localizer.object, STAMP_NS, "base"))
    (one,) = array.detections
    assert (array.header.frame_id, one.header.frame_id, read_stamp_ns(one.header)) == ("base", "base", STAMP_NS)
    assert [result.hypothesis.class_id for result in one.results] == [localizer.object.name] * 2
    assert [result.hypothesis.score for result in one.results] == [0.7, 0.3]
    assert [result.pose.pose.position.x for result in one.results] == [0.001, 0.5]
    np.testing.assert_array_equal(np.reshape(one.results[0].pose.covariance, (6, 6)), np.eye(6))
    assert one.results[1].pose.covariance[0] == -1


def test_the_box_of_a_detection_encloses_the_object(maker, each_types, localizer):
    (one,) = each_types.pass_on(maker.make_detections(located(count=1), localizer.object, 0, "base")).detections
    q, c, s = one.bbox.center.orientation, one.bbox.center.position, one.bbox.size
    vertices_m = localizer.object.mesh.vertices_m @ T[:3, :3].T + T[:3, 3] - [c.x, c.y, c.z]
    turned = np.abs([rotate([-q.x, -q.y, -q.z, q.w], v) for v in vertices_m])
    np.testing.assert_allclose(turned.max(axis=0), [s.x / 2, s.y / 2, s.z / 2], atol=1e-7)


def test_a_result_without_a_pose_detects_nothing(maker, each_types, localizer):
    assert not each_types.pass_on(maker.make_detections(located(count=0), localizer.object, 0, "gel")).detections


def test_a_cloud_has_its_points(maker, each_types):
    points_m = np.arange(12.0).reshape(4, 3) / 8
    cloud = each_types.pass_on(maker.make_points(points_m, STAMP_NS, "gel"))
    assert [(f.name, f.offset, f.datatype == f.FLOAT32, f.count) for f in cloud.fields] == [
        ("x", 0, True, 1), ("y", 4, True, 1), ("z", 8, True, 1)
    ]  # fmt: skip
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, 4, 12, 48)
    np.testing.assert_array_equal(cloud.data.view("<f4").reshape(4, 3), points_m)
    assert each_types.pass_on(maker.make_points(points_m[:0], 0, "gel")).width == 0


def names(array) -> list[tuple[str, int]]:
    return [(one.ns, one.id) for one in array.markers]


def test_markers_replace_the_earlier_ones_and_show_alternatives(maker, each_types, localizer):
    made = MarkerMaker(maker, localizer.object)
    array = each_types.pass_on(made.make(located(covariance=np.eye(6)), STAMP_NS, "gel"))
    assert array.markers[0].action == array.markers[0].DELETEALL == messages.DELETE_ALL
    assert names(array)[1:] == [("object", 0), ("alternatives", 1), ("alternatives", 2), ("uncertainty", 0)]
    assert {one.header.frame_id for one in array.markers} == {"gel"}
    best, second, third = array.markers[1:4]
    assert best.color.a > second.color.a > third.color.a > 0
    assert best.pose.position.x == 0.001


def test_colours_depend_on_the_verdict(maker, localizer):
    made = MarkerMaker(maker, localizer.object)
    seen = {tuple(vars(made.make(located(verdict), 0, "gel").markers[1].color).values()) for verdict in Verdict}
    assert len(seen) == len(Verdict)


def test_few_alternatives_are_shown(maker, localizer):
    made = MarkerMaker(maker, localizer.object).make(located(count=7), 0, "gel")
    assert len(made.markers) == 2 + messages.MOST_ALTERNATIVES
    assert len(MarkerMaker(maker, localizer.object).make(located(count=0), 0, "gel").markers) == 1


def test_triangles_are_corners_of_the_object(maker, each_types, localizer):
    array = each_types.pass_on(MarkerMaker(maker, localizer.object).make(located(), 0, "gel"))
    one = array.markers[1]
    points = np.array([(p.x, p.y, p.z) for p in one.points])
    assert one.type == one.TRIANGLE_LIST
    assert len(points) % 3 == 0
    assert 0 < len(points) <= 3 * 1.1 * messages.MOST_TRIANGLES
    box_m = np.ptp(localizer.object.mesh.vertices_m, axis=0)
    np.testing.assert_allclose(np.ptp(points, axis=0), box_m, atol=2e-4)


def test_a_mesh_resource_has_a_scale(maker, each_types, localizer):
    made = MarkerMaker(maker, localizer.object, "package://parts/pin.stl", 1e-3)
    one = each_types.pass_on(made.make(located(), 0, "gel")).markers[1]
    assert (one.type, one.mesh_resource) == (one.MESH_RESOURCE, "package://parts/pin.stl")
    assert (one.scale.x, one.scale.y, one.scale.z) == (1e-3, 1e-3, 1e-3)
    assert len(one.points) == 0


@pytest.mark.parametrize("seed", [0, 9])  # the eigenvectors of seed 9 are left-handed
def test_the_ellipsoid_has_two_standard_deviations_along_its_axes(maker, each_types, localizer, seed):
    (R,) = draw_rotations(1, np.random.default_rng(seed))
    C = np.zeros((6, 6))
    C[:3, :3] = R @ np.diag([1e-6, 9e-6, 4e-6]) @ R.T
    array = each_types.pass_on(MarkerMaker(maker, localizer.object).make(located(covariance=C), 0, "gel"))
    one = array.markers[-1]
    assert (one.ns, one.type) == ("uncertainty", one.SPHERE)
    lengths_m = np.array([one.scale.x, one.scale.y, one.scale.z])
    q = one.pose.orientation
    q_xyzw = [q.x, q.y, q.z, q.w]
    assert np.linalg.norm(q_xyzw) == pytest.approx(1)
    axes = np.stack([rotate(q_xyzw, e) for e in np.eye(3)])
    np.testing.assert_allclose(axes.T @ np.diag((lengths_m / 4) ** 2) @ axes, C[:3, :3], atol=1e-9)


def rotate(q_xyzw: list[float], v: np.ndarray) -> np.ndarray:
    """Rotate a vector by a unit quaternion."""
    u, w = np.array(q_xyzw[:3]), q_xyzw[3]
    return v + 2 * np.cross(u, np.cross(u, v) + w * v)


def test_an_exact_position_still_has_a_visible_ellipsoid(maker, localizer):
    one = MarkerMaker(maker, localizer.object).make(located(covariance=np.zeros((6, 6))), 0, "gel").markers[-1]
    assert min(one.scale.x, one.scale.y, one.scale.z) == messages.LEAST_AXIS_M
