"""Tolerances: their texts, and which poses are within them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.core.poses.tolerance import Tolerance, measure_surface_distances
from tactile_loc.core.runtime.errors import ConfigError

SIZE_M = (0.04, 0.03, 0.02)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1mm", Tolerance(1e-3, None)),
        ("0.5mm,2deg", Tolerance(5e-4, math.radians(2))),
        (" 2 DEG , .5 mm ", Tolerance(5e-4, math.radians(2))),
        ("2deg", Tolerance(None, math.radians(2))),
    ],
)
def test_a_text_gives_a_distance_a_rotation_or_both(text, expected):
    found = Tolerance.parse(text)
    assert found == expected
    assert Tolerance.parse(str(found)) == found


@pytest.mark.parametrize(
    "text", ["", "1", "mm", "-1mm", "0mm", "nanmm", "1mm,2mm", "1mm,", "1m", "1mm 2deg", "1e9999deg"]
)
def test_other_texts_are_refused(text):
    with pytest.raises(ConfigError):
        Tolerance.parse(text)


@pytest.mark.parametrize("limits", [(None, None), (0.0, None), (1e-3, -1.0), (math.nan, None), (math.inf, None)])
def test_a_tolerance_needs_a_positive_finite_limit(limits):
    with pytest.raises(ConfigError):
        Tolerance(*limits)


def test_the_words_state_each_limit():
    assert Tolerance.parse("2deg,0.5mm").describe() == "0.5 mm and 2 degrees"


def test_the_surface_distance_is_the_mean_over_the_surface(make_box):
    box, shift_m = make_box(*SIZE_M), 4e-4
    x, y, z = SIZE_M
    moved = make_translation([[0, 0, 0], [shift_m, 0, 0]])
    nearest_m = shift_m * y * z / (x * y + y * z + z * x)  # only the points of two faces leave the surface
    beyond_m = shift_m * shift_m / x / 2  # and those that overhang at the end
    found_m = measure_surface_distances(box.mesh, np.eye(4), moved)
    assert found_m[0] == pytest.approx(0, abs=1e-5)
    assert found_m[1] == pytest.approx(nearest_m + beyond_m, rel=0.25)


def test_points_far_from_the_surface_count_fully(make_box):
    """A long box that is shifted along itself by half of its length: most of it is at the same place."""
    x, y, z = 0.2, 0.01, 0.01
    box, shift_m = make_box(x, y, z), np.array([0.05, 0.1, 1.0])
    moved = make_translation(shift_m[:, None] * [1.0, 0, 0])
    sides, ends = 4 * x * y, 2 * y * z
    overhang_m = np.minimum(shift_m, x)  # its points are up to this far from the other box's end
    on_sides_m = overhang_m / x * (shift_m - overhang_m / 2)  # the mean over a side
    expected_m = (sides * on_sides_m + ends / 2 * shift_m) / (sides + ends)
    found_m = measure_surface_distances(box.mesh, np.eye(4), moved)
    assert found_m == pytest.approx(expected_m, rel=0.1)
    assert not Tolerance.parse("5mm").find_within(box, np.eye(4), moved).any()


def test_a_mean_above_the_largest_one_is_never_returned_as_smaller(make_box):
    mesh, moved = make_box(0.2, 0.01, 0.01).mesh, make_translation([[0.002, 0, 0], [0.05, 0, 0], [1, 0, 0]])
    right_m = measure_surface_distances(mesh, np.eye(4), moved)
    for most_m in (1e-4, 1e-3, 5e-3):
        found_m = measure_surface_distances(mesh, np.eye(4), moved, most_m)
        assert found_m[right_m <= most_m] == pytest.approx(right_m[right_m <= most_m])
        assert (found_m[right_m > most_m] > most_m).all()


def test_poses_equal_by_symmetry_are_within_every_tolerance(make_box):
    half_turn = make_transform(rotation_about([0, 0, 1], math.pi), np.zeros(3))[None]
    assert Tolerance.parse("0.01mm,0.01deg").find_within(make_box(*SIZE_M, symmetry="z2"), np.eye(4), half_turn).all()
    plain = make_box(*SIZE_M, symmetry="none")
    assert not Tolerance.parse("1deg").find_within(plain, np.eye(4), half_turn).any()
    assert Tolerance.parse("0.01mm").find_within(plain, np.eye(4), half_turn).all()


def test_both_limits_must_hold(make_box):
    box, turn = make_box(*SIZE_M, symmetry="none"), rotation_about([0, 0, 1], math.radians(3))
    others = np.stack([make_translation([0, 0, 5e-3]), make_transform(turn, np.zeros(3)), np.eye(4)])
    assert Tolerance.parse("1mm").find_within(box, np.eye(4), others).tolist() == [False, True, True]
    assert Tolerance.parse("2deg").find_within(box, np.eye(4), others).tolist() == [True, False, True]
    assert Tolerance.parse("1mm,2deg").find_within(box, np.eye(4), others).tolist() == [False, False, True]
