"""Training on places: touches get the label and the yaw of the nearest place."""

import numpy as np
import pytest
import trimesh
from pose_helpers import random_poses

from tactile_loc import ObjectModel, PoseMetric, TriangleMesh, make_noise
from tactile_loc.plugin import ConfigError
from tactile_loc.plugin.helpers import PATCH_PX, SymmetryGroup, make_transform, rotation_about
from tactile_loc.simulate.place_training import PlaceProblem, RotatedPoses, move_to_anchors
from tactile_loc.testing.problems import make_place_training_problem

COUNT, PRESS_M = 16, 1.2e-3


@pytest.fixture(scope="module")
def problem() -> PlaceProblem:
    return make_place_training_problem()


@pytest.fixture(scope="module")
def touches(problem):
    return problem.draw(COUNT, make_noise("none"), np.random.default_rng(1))


@pytest.fixture(scope="module")
def batch(touches):
    return touches.batch(COUNT, np.random.default_rng(2), PRESS_M)


def test_a_batch_has_a_patch_of_every_touch(batch):
    assert batch.depth_m.shape == batch.seen.shape == (COUNT, PATCH_PX, PATCH_PX)
    assert len(batch) == COUNT
    assert batch.depth_m.min() >= 0
    assert batch.depth_m.max() <= np.float32(PRESS_M)
    assert (batch.press_m == PRESS_M).all()
    assert not batch.seen.all(), "sensors see a part of each patch"


def test_a_touch_is_near_its_label(problem, touches):
    shown = [problem.touch(np.minimum(depth, np.float32(PRESS_M)), PRESS_M) for depth in touches.depth_m]
    labels = problem.labels(shown, touches.T_sensor_object)
    assert (labels.off_m <= problem.reach_m).all()
    turn = make_transform(rotation_about([0, 0, 1], labels.yaw_rad), np.zeros(3))
    T = turn @ problem.places.T_place_object[labels.numbers]
    seen_m = problem.rotated.metric.symmetric_distance(move_to_anchors(shown, touches.T_sensor_object), T)
    np.testing.assert_allclose(seen_m, labels.off_m, atol=1e-9)


def test_a_touch_is_more_similar_to_its_key_than_to_the_key_rotated(problem, batch):
    keys = np.concatenate(list(problem.clean_keys(PRESS_M)))[batch.labels]

    def measure_off(shapes):
        return (np.abs(batch.depth_m - shapes) * batch.seen).sum(axis=(1, 2)) / batch.seen.sum(axis=(1, 2))

    assert np.median(measure_off(keys)) < 0.1 * PRESS_M
    assert (measure_off(np.rot90(keys, axes=(1, 2))) > measure_off(keys)).mean() > 0.8


def test_noise_leaves_contact_in_every_touch(problem):
    rng = np.random.default_rng(3)
    touches = problem.draw(COUNT, make_noise("strong"), rng)
    for press_m in problem.key_presses_m[[0, -1]]:
        batch = touches.batch(COUNT, rng, press_m)
        assert (batch.depth_m < np.float32(press_m)).any(axis=(1, 2)).all()


def test_the_same_seed_gives_the_same_batch(problem, batch, touches):
    again = touches.batch(COUNT, np.random.default_rng(2), PRESS_M)
    np.testing.assert_array_equal(again.depth_m, batch.depth_m)
    np.testing.assert_array_equal(again.labels, batch.labels)


def test_keys_are_cut_at_their_press_and_given_in_shards(problem):
    assert 0.2 * 2e-3 < problem.key_presses_m[0] < problem.key_presses_m[-1] <= problem.scene.geometry.max_depth_m
    shards = list(problem.clean_keys(PRESS_M))
    assert sum(map(len, shards)) == len(problem)
    assert max(shard.max() for shard in shards) == np.float32(PRESS_M)


def test_key_distances_are_pose_distances_at_the_best_yaw(problem):
    numbers = np.array([0, 1, len(problem) - 1])
    np.testing.assert_allclose(problem.key_distances(numbers, numbers), 0.0, atol=1e-6)
    assert (problem.key_distances(numbers, numbers[::-1])[[0, 2]] > 1e-3).all()


def test_a_request_for_listed_poses_is_refused(problem):
    with pytest.raises(ConfigError, match="`grid` face"):
        _ = problem.grid
    with pytest.raises(ConfigError, match="`grid` face"):
        problem.shapes()


YAWS_RAD = np.radians(np.arange(0, 360, 0.5))


@pytest.fixture(params=["none", "z3", "x2*y2", "zinf", "zinf*x2"])
def metric(request) -> PoseMetric:
    mesh = trimesh.creation.cylinder(0.004, 0.03, sections=24)
    surface = TriangleMesh(np.asarray(mesh.vertices, float), np.asarray(mesh.faces))
    return PoseMetric(ObjectModel("rod", surface, SymmetryGroup.parse(request.param, [0, 0, 0])))


def turned(T: np.ndarray) -> np.ndarray:
    """Return a pose (4, 4) rotated by each of YAWS_RAD (V, 4, 4)."""
    return make_transform(rotation_about([0, 0, 1], YAWS_RAD), np.zeros(3)) @ T


def test_the_nearest_pose_agrees_with_a_search_over_yaws(metric):
    places, truths = random_poses(7, 1, 0.005), random_poses(5, 2, 0.005)
    off_m, index, yaw_rad = RotatedPoses(places, metric).nearest(truths)
    for k, truth in enumerate(truths):
        tried = np.stack(
            [
                metric.symmetric_distance(np.broadcast_to(truth, (len(YAWS_RAD), 4, 4)), turned(place))
                for place in places
            ]
        )
        assert off_m[k] == pytest.approx(tried.min(), abs=2e-5)
        assert off_m[k] <= tried.min() + 1e-12
        at_yaw = make_transform(rotation_about([0, 0, 1], yaw_rad[k]), np.zeros(3)) @ places[index[k]]
        assert metric.symmetric_distance(truth[None], at_yaw[None])[0] == pytest.approx(off_m[k], abs=1e-9)


def test_a_large_search_in_parts_gives_the_same_result(metric, monkeypatch):
    places, truths = random_poses(6, 5, 0.005), random_poses(9, 6, 0.005)
    whole = RotatedPoses(places, metric).nearest(truths)
    monkeypatch.setattr("tactile_loc.simulate.place_training.AT_ONCE", 12)
    for one, other in zip(whole, RotatedPoses(places, metric).nearest(truths), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
