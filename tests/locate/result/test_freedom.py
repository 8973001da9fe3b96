"""The freedom that touches leave: equally good poses, slides and turns, and their words."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.locate.result.freedom import AS_WELL, explain_as_well, find_as_well, find_freedom

CONTACT_M = np.array([0.0, 0.0, 0.02])
SHARP = np.diag([1e-5**2] * 3 + [1e-4**2] * 3)
FIRST = make_transform(rotation_about([1, 2, 3], 0.5), np.array([0.01, 0.0, 0.03]))


def turn_at_contact(axis, deg):
    R = rotation_about(axis, math.radians(deg))
    return make_transform(R, CONTACT_M - R @ CONTACT_M)


def free(*motions, ious=None, covariance=SHARP, same=None):
    poses = np.stack([FIRST, *(motion @ FIRST for motion in motions)])
    ious = np.full(len(poses), 0.9) if ious is None else np.array(ious)
    same = np.arange(len(poses)) == 0 if same is None else np.array(same)
    return find_freedom(poses, ious, covariance, CONTACT_M, same)


def test_a_single_sharp_pose_leaves_nothing_open():
    assert str(free()) == ""


def test_an_equally_good_shifted_pose_is_a_slide():
    found = free(make_translation([0.004, 0, 0]), make_translation([0.002, 0, 0]))
    assert found.others == 2
    assert found.slide_m == pytest.approx([0.004, 0, 0])
    assert not found.turn_rad.any()
    assert "4.0 mm along x" in str(found)


def test_an_equally_good_pose_turned_in_place_is_a_turn():
    found = free(turn_at_contact([0, 0, 1], 90))
    assert found.turn_rad == pytest.approx([0, 0, math.pi / 2])
    assert not found.slide_m.any()
    assert "90 degrees about z" in str(found)


def test_a_pose_with_another_contact_counts_but_is_neither_a_slide_nor_a_turn():
    found = free(make_translation([0.02, 0, 0]) @ turn_at_contact([1, 0, 0], 120))
    assert (found.others, found.slide_m.any(), found.turn_rad.any()) == (1, False, False)


def test_worse_poses_and_poses_within_the_tolerance_do_not_count():
    moved = make_translation([0.004, 0, 0])
    assert free(moved, ious=[0.9, 0.9 - AS_WELL - 0.001]).others == 0
    assert free(moved, same=[True, True]).others == 0


def test_the_covariance_gives_free_directions_at_the_contact():
    wide = SHARP.copy()
    direction = np.array([1.0, 1.0, 0.0]) / math.sqrt(2)
    wide[:3, :3] += 0.003**2 * np.outer(direction, direction)
    found = free(covariance=wide)
    assert np.linalg.norm(found.slide_m) == pytest.approx(0.006, rel=0.01)
    assert "along (0.71, 0.71, 0.00)" in str(found)


def test_a_rotation_about_the_contact_is_no_slide():
    """Its covariance, given at the object's origin, has large translations there."""
    lever = CONTACT_M - FIRST[:3, 3]
    std_rad, axis = math.radians(10), np.array([0.0, 0.0, 1.0])
    column = std_rad * np.concatenate([-np.cross(axis, lever), axis])  # the origin moves, the contact stays
    found = free(covariance=np.outer(column, column) + SHARP)
    assert not found.slide_m.any()
    assert np.degrees(np.linalg.norm(found.turn_rad)) == pytest.approx(20, rel=0.01)


def test_an_unknown_covariance_opens_nothing():
    assert str(free(covariance=None)) == ""


def test_several_touches_with_uncertain_sensor_poses_distinguish_poses_less_sharply(localizer):
    (touch,) = localizer.simulate(1, seed=1)
    exact = dataclasses.replace(touch, T_base_sensor_std_m=0.0, T_base_sensor_std_rad=0.0)
    assert find_as_well([touch]) == find_as_well([exact, exact]) == AS_WELL
    several = find_as_well([exact, touch])
    assert several > AS_WELL
    rival = np.array([0.9 - AS_WELL - 0.001])
    assert explain_as_well(rival, 0.9, several).all()
    assert not explain_as_well(rival, 0.9).any()
