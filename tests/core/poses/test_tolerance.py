"""Tolerances: their texts, which poses are within them, and how far poses are."""

import dataclasses
import math

import numpy as np
import pytest
from pose_helpers import random_poses

from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.core.poses.tolerance import Tolerance, measure_shape_distances
from tactile_loc.plugin import ConfigError
from tactile_loc.plugin.helpers import SymmetryGroup, make_transform, make_translation, rotation_about, transform_points

SIZE_M = (0.04, 0.03, 0.02)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1mm", Tolerance(1e-3, None)),
        ("0.5mm,2deg", Tolerance(5e-4, math.radians(2))),
        (" 2 DEG , .5 mm ", Tolerance(5e-4, math.radians(2))),
        ("2deg", Tolerance(None, math.radians(2))),
        ("shape:1mm", Tolerance(1e-3, of_shape=True)),
        ("Shape: 1 mm, 2 deg", Tolerance(1e-3, math.radians(2), of_shape=True)),
        ("tip:0.5mm@0,0,30", Tolerance(5e-4, tip_m=(0.0, 0.0, 0.03))),
        ("tip:0.5mm,2deg @ -1.5, +2, .5e1", Tolerance(5e-4, math.radians(2), tip_m=(-0.0015, 0.002, 0.005))),
    ],
)
def test_a_text_gives_a_distance_a_rotation_or_both_and_what_the_distance_is_of(text, expected):
    found = Tolerance.parse(text)
    assert found == expected
    assert Tolerance.parse(str(found)) == found


@pytest.mark.parametrize(
    "text",
    [
        *("", "1", "mm", "-1mm", "0mm", "nanmm", "1mm,2mm", "1mm,", "1m", "1mm 2deg", "1e9999deg", "face:1mm"),
        *("shape:", "shape:2deg", "shape:1mm@0,0,1", "tip:1mm", "tip:1mm@0,0", "tip:1mm@0,0,z", "tip:2deg@0,0,1"),
        *("1mm@0,0,1", "tip:shape:1mm@0,0,1", "tip:1mm@0,0,nan", "tip:1mm@0,0,1e999"),
    ],
)
def test_other_texts_are_refused(text):
    with pytest.raises(ConfigError):
        Tolerance.parse(text)


@pytest.mark.parametrize(
    "limits",
    [
        *((None, None), (0.0, None), (1e-3, -1.0), (math.nan, None), (math.inf, None)),
        *((None, 0.1, True), (None, 0.1, False, (0, 0, 0)), (1e-3, None, True, (0, 0, 0))),
    ],
)
def test_a_tolerance_needs_a_positive_finite_limit_and_one_kind_of_distance(limits):
    with pytest.raises(ConfigError):
        Tolerance(*limits)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("2deg,0.5mm", "0.5 mm and 2 degrees"),
        ("shape:1mm", "1 mm of the shape"),
        ("tip:0.5mm@0,0,30", "0.5 mm at the tip"),
    ],
)
def test_the_words_state_each_limit(text, words):
    assert Tolerance.parse(text).describe() == words


def test_a_distance_is_the_pose_error_the_shape_distance_or_the_displacement_of_the_tip(make_box):
    box, T, tip_m = make_box(*SIZE_M, symmetry="z2"), random_poses(1, 0)[0], np.array([0.0, 0.0, 0.03])
    others = np.concatenate([T @ make_transform(rotation_about([1, 2, 1], [0.01, 0.1]), [3e-4, 0, 0]), [T]])
    found_m = {t: Tolerance.parse(t).measure_distances(box, T, others) for t in ("1mm", "shape:1mm", "tip:1mm@0,0,30")}
    assert found_m["1mm"] == pytest.approx(measure_pose_errors(box, others, T))
    assert found_m["shape:1mm"] == pytest.approx(measure_shape_distances(box.mesh, T, others))
    moved_m = transform_points(others, tip_m[None])[:, 0] - transform_points(T, tip_m)  # on the axis of symmetry
    assert found_m["tip:1mm@0,0,30"] == pytest.approx(np.linalg.norm(moved_m, axis=1))
    angles_deg = np.degrees(box.symmetry.measure_least_angle(T[:3, :3], others[:, :3, :3]))
    for text in found_m:
        alone, both = (
            Tolerance.parse(one).measure_ratios(box, T, others) for one in (text, text.replace("1mm", "2mm,3deg"))
        )
        assert alone == pytest.approx(1e3 * found_m[text])
        assert both == pytest.approx(np.maximum(500 * found_m[text], angles_deg / 3))
        assert (Tolerance.parse(text).find_within(box, T, others) == (alone <= 1)).all()


def test_the_shape_forgives_a_turned_shaft_and_a_tip_forgives_what_moves_elsewhere(cylinder):
    plain = dataclasses.replace(cylinder, symmetry=SymmetryGroup.parse("none", cylinder.mesh.centroid_m))
    turned = make_transform(rotation_about([0, 0, 1], 1.0), np.zeros(3))[None]
    for text, within in (("1mm", False), ("shape:0.1mm", True), ("tip:0.1mm@0,0,15", True), ("tip:1mm@8,0,0", False)):
        assert Tolerance.parse(text).find_within(plain, np.eye(4), turned).item() is within


def test_the_shape_distance_is_the_mean_over_the_surface(make_box):
    box, shift_m = make_box(*SIZE_M), 4e-4
    x, y, z = SIZE_M
    moved = make_translation([[0, 0, 0], [shift_m, 0, 0]])
    nearest_m = shift_m * y * z / (x * y + y * z + z * x)  # only the points of two faces leave the surface
    beyond_m = shift_m * shift_m / x / 2  # and those that overhang at the end
    found_m = measure_shape_distances(box.mesh, np.eye(4), moved)
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
    found_m = measure_shape_distances(box.mesh, np.eye(4), moved)
    assert found_m == pytest.approx(expected_m, rel=0.1)
    assert not Tolerance.parse("shape:5mm").find_within(box, np.eye(4), moved).any()


def test_a_mean_above_the_largest_one_is_never_returned_as_smaller(make_box):
    mesh, moved = make_box(0.2, 0.01, 0.01).mesh, make_translation([[0.002, 0, 0], [0.05, 0, 0], [1, 0, 0]])
    right_m = measure_shape_distances(mesh, np.eye(4), moved)
    for most_m in (1e-4, 1e-3, 5e-3):
        found_m = measure_shape_distances(mesh, np.eye(4), moved, most_m)
        assert found_m[right_m <= most_m] == pytest.approx(right_m[right_m <= most_m])
        assert (found_m[right_m > most_m] > most_m).all()


def test_poses_equal_by_symmetry_are_within_every_tolerance(make_box):
    half_turn = make_transform(rotation_about([0, 0, 1], math.pi), np.zeros(3))[None]
    assert Tolerance.parse("0.01mm,0.01deg").find_within(make_box(*SIZE_M, symmetry="z2"), np.eye(4), half_turn).all()
    plain = make_box(*SIZE_M, symmetry="none")
    for text, within in (("1deg", False), ("1mm", False), ("shape:0.01mm", True)):
        assert Tolerance.parse(text).find_within(plain, np.eye(4), half_turn).item() is within


def test_both_limits_must_hold(make_box):
    box, turn = make_box(*SIZE_M, symmetry="none"), rotation_about([0, 0, 1], math.radians(3))
    others = np.stack([make_translation([0, 0, 5e-3]), make_transform(turn, np.zeros(3)), np.eye(4)])
    assert Tolerance.parse("2mm").find_within(box, np.eye(4), others).tolist() == [False, True, True]
    assert Tolerance.parse("2deg").find_within(box, np.eye(4), others).tolist() == [True, False, True]
    assert Tolerance.parse("2mm,2deg").find_within(box, np.eye(4), others).tolist() == [False, False, True]
