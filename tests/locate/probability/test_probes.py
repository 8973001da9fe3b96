"""Probes: just beyond the tolerance, along the directions that a covariance leaves open, never along symmetries."""

import dataclasses

import numpy as np
import pytest
from pose_helpers import random_poses
from scipy.spatial.transform import Rotation

from tactile_loc import PoseMetric, Tolerance
from tactile_loc.core.geometry.lie import move
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.locate.probability.probes import BEYOND, DIRECTIONS, place_probes
from tactile_loc.plugin.helpers import SymmetryGroup

T = random_poses(1, 4)[0]


def draw_covariance(seed=0):
    mixed = np.random.default_rng(seed).normal(size=(6, 6)) * np.repeat([2e-4, 8e-3], 3)[:, None]
    return mixed @ mixed.T


def test_a_motion_shifts_the_origin_and_turns_about_it_along_the_sensors_axes():
    motion = np.array([1e-3, -2e-3, 3e-3, 0.1, 0.2, -0.3])
    (moved,) = move(T, motion[None])
    assert moved[:3, 3] - T[:3, 3] == pytest.approx(motion[:3], rel=0.2)
    (turned,) = move(T, np.array([[0, 0, 0, *motion[3:]]]))
    assert turned[:3, 3] == pytest.approx(T[:3, 3], abs=1e-12)
    assert turned[:3, :3] == pytest.approx(Rotation.from_rotvec(motion[3:]).as_matrix() @ T[:3, :3], abs=1e-12)


@pytest.mark.parametrize("text", ["1mm", "0.2mm", "5mm", "2deg", "0.5mm,2deg", "tip:1mm@0,0,60"])
def test_probes_lie_on_either_side_of_the_pose_beyond_the_tolerance(box, text):
    tolerance = Tolerance.parse(text)
    probes = place_probes(T, draw_covariance(), box, tolerance)
    assert probes.T.shape == (2 * DIRECTIONS, 4, 4)
    assert tolerance.measure_ratios(box, T, probes.T) == pytest.approx(BEYOND, rel=0.01)
    assert not tolerance.find_within(box, T, probes.T).any()
    np.testing.assert_allclose(probes.T, move(T, probes.motions))
    units = probes.motions / np.linalg.norm(probes.motions, axis=1, keepdims=True)
    assert units[::2] == pytest.approx(-units[1::2], abs=1e-9)


def test_the_first_probes_are_along_the_motions_that_move_the_surface_most_for_their_covariance(box):
    """All motions of one standard deviation are on an ellipsoid. None of them moves the surface farther."""
    C, metric = draw_covariance(1), PoseMetric(box)
    probes = place_probes(T, C, box, Tolerance())

    def displace_m(motions):
        small = 1e-4
        return metric.distance(np.broadcast_to(T, (len(motions), 4, 4)), move(T, small * motions)) / small

    own = (
        probes.motions[::2]
        / np.sqrt(np.einsum("ki,ij,kj->k", probes.motions[::2], np.linalg.inv(C), probes.motions[::2]))[:, None]
    )
    assert displace_m(own) == pytest.approx(probes.std_m, rel=1e-3)
    assert (np.diff(probes.std_m) < 0).all()
    sphere = np.random.default_rng(0).normal(size=(20_000, 6))
    ellipsoid = sphere / np.linalg.norm(sphere, axis=1, keepdims=True) @ np.linalg.cholesky(C).T
    largest_m = displace_m(ellipsoid).max()
    assert 0.9 * probes.std_m[0] < largest_m < 1.001 * probes.std_m[0]


@pytest.mark.parametrize("symmetry", ["none", "zinf"])
def test_a_turn_that_the_touches_leave_open_is_probed_unless_it_is_a_symmetry(cylinder, symmetry):
    shaft = dataclasses.replace(cylinder, symmetry=SymmetryGroup.parse(symmetry, cylinder.mesh.centroid_m))
    axis = T[:3, :3] @ [0, 0, 1]
    turn = np.concatenate([np.zeros(3), axis])
    C = np.diag([1e-9] * 3 + [1e-6] * 3) + 1e2 * np.outer(turn, turn)
    probes = place_probes(T, C, shaft, Tolerance())
    assert measure_pose_errors(shaft, probes.T, T) == pytest.approx(1e-3 * BEYOND, rel=0.02)
    turns = probes.motions[:2, 3:]
    about_axis = np.abs(turns @ axis) > 0.99 * np.linalg.norm(turns, axis=1)
    assert (about_axis & turns.any(axis=1)).all() == (symmetry == "none")
    assert probes.std_m[0] > 1e-3 or symmetry == "zinf"


def test_probes_of_a_finite_symmetry_are_beyond_the_tolerance_up_to_symmetry(make_box):
    cube = make_box(0.02, 0.02, 0.02, symmetry="z4*x4")
    probes = place_probes(T, draw_covariance(), cube, Tolerance())
    assert measure_pose_errors(cube, probes.T, T) == pytest.approx(1e-3 * BEYOND, rel=0.01)
