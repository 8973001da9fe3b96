"""Rotations and directions follow the formulas, are valid and distinct, and are evenly spread."""

import numpy as np
import pytest
from tactile_loc.plugin.helpers import SymmetryGroup, is_rigid, make_transform, rotation_about

from tactile_loc_super_fibonacci.coverage import least_covering, spread_of
from tactile_loc_super_fibonacci.spirals import (
    PSI,
    fibonacci_directions,
    rotations_of_axis,
    super_fibonacci_quaternions,
    super_fibonacci_rotations,
)


@pytest.mark.parametrize("count", [1, 2, 7, 72, 1000])
def test_rotations_are_proper_and_have_the_requested_number(count):
    R = super_fibonacci_rotations(count)
    assert R.shape == (count, 3, 3)
    assert is_rigid(make_transform(R, np.zeros(3)))


def test_the_first_point_follows_the_formula():
    assert abs(PSI**4 - PSI - 4) < 1e-14
    s, n = 0.5, 10
    a, b, inner, outer = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / PSI, np.sqrt(s / n), np.sqrt(1 - s / n)
    first = [inner * np.sin(a), inner * np.cos(a), outer * np.sin(b), outer * np.cos(b)]
    np.testing.assert_allclose(super_fibonacci_quaternions(n)[0], first, atol=1e-15)
    x, y, z, w = first
    half = rotation_about([x, y, z], 2 * np.arccos(w))
    np.testing.assert_allclose(super_fibonacci_rotations(n)[0], half, atol=1e-12)


@pytest.mark.parametrize("count", [10, 100, 1000, 10_000])
def test_every_quaternion_is_far_from_others_and_their_antipodes(count):
    """The closest rotations are at least half as far apart as the side of a cube with one rotation's share of SO(3)."""
    q = super_fibonacci_quaternions(count)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1)
    R = super_fibonacci_rotations(count)
    assert spread_of(R, asked=10).closest_rad > 0.5 * (8 * np.pi**2 / count) ** (1 / 3)


def test_known_sets_have_their_known_covering_radius():
    """The covering radius is 180 degrees for the identity, and 62.8 degrees for a cube's 24 rotations (Karney 2007)."""
    assert spread_of(np.stack([np.eye(3), np.eye(3)]), asked=100_000).covering_rad == pytest.approx(np.pi, abs=0.05)
    cube = SymmetryGroup.parse("z4*x4", np.zeros(3)).rotations
    assert len(cube) == 24
    assert np.degrees(spread_of(cube, asked=300_000).covering_rad) == pytest.approx(62.80, abs=1.0)
    assert np.degrees(least_covering(1)) == pytest.approx(180)


def test_directions_are_uniform_and_an_axis_is_rotated_to_them():
    directions = fibonacci_directions(500)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    apart = np.sort(np.arccos(np.clip(directions @ directions.T, -1, 1)), axis=1)[:, 1]
    assert apart.min() > 0.8 * np.sqrt(4 * np.pi / 500)
    axis = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    R = rotations_of_axis(axis, directions)
    np.testing.assert_allclose(R @ axis, directions, atol=1e-12)
    assert is_rigid(make_transform(R, np.zeros(3)))
