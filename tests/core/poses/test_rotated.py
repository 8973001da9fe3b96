"""Poses with a free yaw: the closed form agrees with a search over all yaws."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import draw_rotations, make_transform, rotation_about
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.rotated import RotatedPoses

YAWS_RAD = np.radians(np.arange(0, 360, 0.5))


def poses(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return make_transform(draw_rotations(count, rng), rng.normal(scale=0.005, size=(count, 3)))


@pytest.fixture(params=["none", "z3", "x2*y2", "zinf", "zinf*x2"])
def metric(request) -> PoseMetric:
    mesh = trimesh.creation.cylinder(0.004, 0.03, sections=24)
    surface = TriangleMesh(np.asarray(mesh.vertices, float), np.asarray(mesh.faces))
    return PoseMetric(ObjectModel("rod", surface, SymmetryGroup.parse(request.param, [0, 0, 0])))


def turned(T: np.ndarray) -> np.ndarray:
    """Return a pose (4, 4) rotated by each of YAWS_RAD (V, 4, 4)."""
    return make_transform(rotation_about([0, 0, 1], YAWS_RAD), np.zeros(3)) @ T


def test_the_nearest_pose_agrees_with_a_search_over_yaws(metric):
    places, truths = poses(7, 1), poses(5, 2)
    off_m, index, yaw_rad = RotatedPoses(places, metric).nearest(truths)
    for k, truth in enumerate(truths):
        tried = np.stack([
            metric.symmetric_distance(np.broadcast_to(truth, (len(YAWS_RAD), 4, 4)), turned(place)) for place in places
        ])  # fmt: skip
        assert off_m[k] == pytest.approx(tried.min(), abs=2e-5)
        assert off_m[k] <= tried.min() + 1e-12
        at_yaw = make_transform(rotation_about([0, 0, 1], yaw_rad[k]), np.zeros(3)) @ places[index[k]]
        assert metric.symmetric_distance(truth[None], at_yaw[None])[0] == pytest.approx(off_m[k], abs=1e-9)


def test_distances_at_given_yaws_equal_the_metric(metric):
    places, truths, numbers = poses(6, 3), poses(4, 4), np.array([5, 0, 2, 2])
    off_m = RotatedPoses(places, metric).distances(truths, numbers, np.tile(YAWS_RAD[::40], (4, 1)))
    for k, truth in enumerate(truths):
        some = turned(places[numbers[k]])[::40]
        expected = metric.symmetric_distance(np.broadcast_to(truth, some.shape), some)
        np.testing.assert_allclose(off_m[k], expected, atol=1e-9)


def test_a_large_search_in_parts_gives_the_same_result(metric, monkeypatch):
    places, truths = poses(6, 5), poses(9, 6)
    whole = RotatedPoses(places, metric).nearest(truths)
    monkeypatch.setattr("tactile_loc.core.poses.rotated.AT_ONCE", 12)
    for one, other in zip(whole, RotatedPoses(places, metric).nearest(truths), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
