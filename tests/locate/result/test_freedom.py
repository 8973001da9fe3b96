"""The freedom that touches leave: equally good poses, slides and turns, and their words."""

import dataclasses
import math

import numpy as np
import pytest
import trimesh

from tactile_loc import ObjectModel, TriangleMesh
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.locate.result.freedom import AS_WELL, WIDE, explain_as_well, find_as_well, find_freedom
from tactile_loc.plugin.helpers import SymmetryGroup, invert, make_transform, make_translation, rotation_about

CONTACT_M = np.array([0.0, 0.0, 0.02])
PLACED = trimesh.creation.box((0.03, 0.02, 0.01)).apply_translation([0.001, 0.002, 0.003])
OBJECT = ObjectModel("box", TriangleMesh(PLACED.vertices, PLACED.faces), SymmetryGroup(np.zeros(3)))
CENTROID_M = OBJECT.mesh.centroid_m
SHARP = np.diag([1e-5**2] * 3 + [1e-4**2] * 3)
FIRST = make_transform(rotation_about([1, 2, 3], 0.5), np.array([0.01, 0.0, 0.03]))
R = FIRST[:3, :3]
TOUCHED_M = invert(FIRST)[:3, :3] @ CONTACT_M + invert(FIRST)[:3, 3]


def turn_at_contact(axis, deg):
    """A motion in the object's frame that leaves the point of contact where it is."""
    S = rotation_about(axis, math.radians(deg))
    return make_transform(S, TOUCHED_M - S @ TOUCHED_M)


def free(*motions, covariance=SHARP, as_well=None, is_open=True):
    """The freedom, given other poses that follow from the first one by motions in the object's frame."""
    poses = np.stack([FIRST, *(FIRST @ motion for motion in motions)])
    as_well = np.arange(len(poses)) > 0 if as_well is None else np.array(as_well)
    return find_freedom(poses, as_well, covariance, CONTACT_M, OBJECT, is_open=is_open)


def test_a_single_sharp_pose_leaves_nothing_open():
    assert str(free()) == ""
    assert free().contact_std_m == pytest.approx(1e-5, rel=0.5)


def test_an_equally_good_shifted_pose_is_a_slide_along_the_object():
    found = free(make_translation([0.004, 0, 0]), make_translation([0.002, 0, 0]))
    assert found.others == 2
    assert found.slide_m == pytest.approx([0.004, 0, 0])
    assert found.other_shift_m == pytest.approx([0.004, 0, 0])
    assert not found.turn_rad.any()
    assert "4.0 mm along x" in str(found)


def test_an_equally_good_pose_turned_in_place_is_a_turn_of_the_object():
    found = free(turn_at_contact([0, 0, 1], 90))
    assert found.turn_rad == pytest.approx([0, 0, math.pi / 2])
    assert found.other_turn_rad == pytest.approx([0, 0, math.pi / 2])
    assert not found.slide_m.any()
    assert "90 degrees about z" in str(found)


def test_a_pose_with_another_contact_is_named_but_is_neither_a_slide_nor_a_turn():
    motion = make_translation([0.02, 0, 0]) @ turn_at_contact([1, 0, 0], 120)
    found = free(motion)
    assert (found.others, found.slide_m.any(), found.turn_rad.any()) == (1, False, False)
    assert found.other_turn_rad == pytest.approx([math.radians(120), 0, 0])
    assert found.other_shift_m == pytest.approx(motion[:3, :3] @ CENTROID_M + motion[:3, 3] - CENTROID_M)
    assert "120 degrees about x" in str(found)


def test_only_poses_that_explain_the_touches_as_well_count():
    found = free(make_translation([0.004, 0, 0]), as_well=[False, False])
    assert (found.others, str(found)) == (0, "")


def test_the_covariance_gives_free_directions_at_the_contact():
    wide = SHARP.copy()
    direction = R @ np.array([1.0, 1.0, 0.0]) / math.sqrt(2)
    wide[:3, :3] += 0.003**2 * np.outer(direction, direction)
    found = free(covariance=wide)
    assert np.linalg.norm(found.slide_m) == pytest.approx(WIDE * 0.003, rel=0.01)
    assert found.contact_std_m == pytest.approx(0.003, rel=0.01)
    assert "(0.71, 0.71, 0.00)" in str(found)


def test_a_rotation_about_the_contact_is_no_slide_and_its_position_is_known():
    """Its covariance, given at the object's origin, has large translations there."""
    lever = CONTACT_M - FIRST[:3, 3]
    std_rad, axis = math.radians(10), R @ np.array([0.0, 0.0, 1.0])
    column = std_rad * np.concatenate([-np.cross(axis, lever), axis])  # the origin moves, the contact stays
    found = free(covariance=np.outer(column, column) + SHARP)
    assert not found.slide_m.any()
    assert np.degrees(np.linalg.norm(found.turn_rad)) == pytest.approx(WIDE * 10, rel=0.01)
    known = f"{format_mm(WIDE * found.contact_std_m)} mm"
    assert found.contact_std_m == pytest.approx(1e-5, rel=0.2)
    assert all(words in str(found) for words in ("position", known, "about z"))


def test_a_loose_covariance_opens_nothing_if_no_probe_fits():
    found = free(covariance=1e4 * SHARP, is_open=False)
    assert (str(found), found.contact_std_m) == ("", pytest.approx(1e-3, rel=0.2))


def test_an_unknown_covariance_opens_nothing():
    found = free(covariance=None)
    assert (str(found), found.contact_std_m) == ("", None)


def test_several_touches_with_uncertain_sensor_poses_distinguish_poses_less_sharply(localizer):
    (touch,) = localizer.simulate(1, seed=1)
    exact = dataclasses.replace(touch, T_base_sensor_std_m=0.0, T_base_sensor_std_rad=0.0)
    assert find_as_well([touch]) == find_as_well([exact, exact]) == AS_WELL
    several = find_as_well([exact, touch])
    assert several > AS_WELL
    rival = np.array([0.9 - AS_WELL - 0.001])
    assert explain_as_well(rival, 0.9, several).all()
    assert not explain_as_well(rival, 0.9).any()


def test_no_turn_is_more_than_half_a_turn_and_no_slide_longer_than_the_object():
    found = free(covariance=np.diag([1.0] * 3 + [100.0] * 3))
    assert np.linalg.norm(found.turn_rad) == pytest.approx(math.pi)
    assert np.linalg.norm(found.slide_m) == pytest.approx(np.linalg.norm(OBJECT.mesh.extents_m))
