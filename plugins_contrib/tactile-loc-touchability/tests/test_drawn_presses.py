"""Presses on a block with a pocket: where they touch, from which directions, and which places are out of reach."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from tactile_loc import Clearance, Localizer, make_box_finger
from tactile_loc.plugin import GridError, ObjectModel, TriangleMesh
from tactile_loc.plugin.helpers import SymmetryGroup, invert, transform_points

from tactile_loc_touchability.presses import PressingSensor, draw_places, draw_presses, find_clear

PRESS_M, TILT_RAD = 6e-4, np.radians(20.0)


@pytest.fixture(scope="module")
def block() -> ObjectModel:
    """A block of 30 x 20 x 10 mm with a pocket that is 4 mm wide and 8 mm deep."""
    made = trimesh.creation.box((30, 20, 10)).difference(
        trimesh.creation.box((4, 4, 16)).apply_translation([0, 0, 5]), engine="manifold"
    )
    mesh = TriangleMesh(1e-3 * np.asarray(made.vertices), np.asarray(made.faces, np.int64))
    return ObjectModel("block", mesh, SymmetryGroup(np.zeros(3)))


@pytest.fixture(scope="module")
def geometry():
    return Localizer.create("pin", sensor="gelsight-mini").scene.geometry


@pytest.fixture(scope="module")
def presses(block, geometry):
    return draw_presses(block, PressingSensor(geometry, PRESS_M, TILT_RAD), 300, np.random.default_rng(3))


def test_places_are_on_the_surface_in_proportion_to_area(block):
    places, normals = draw_places(block, 20_000, np.random.default_rng(0))
    top = (np.abs(places[:, 2] - 5e-3) < 1e-9) & (normals[:, 2] > 0.99)
    area = block.mesh.face_areas.sum()
    assert top.mean() == pytest.approx((30 * 20 - 16) * 1e-6 / area, abs=0.02)


def test_the_gel_touches_each_place_and_nothing_is_pressed_deeper(block, geometry, presses):
    assert len(presses) == 300
    for T, place in zip(presses.T_sensor_object, presses.places_m, strict=True):
        assert transform_points(T, place[None])[0, 2] < geometry.standoff_m
        lowest = transform_points(T, block.mesh.vertices_m)[:, 2].min()
        assert lowest > geometry.standoff_m - PRESS_M - 0.02  # vertices beside the gel may be lower


def test_presses_are_tilted_by_at_most_the_tilt(presses):
    directions = invert(presses.T_sensor_object)[:, :3, 2]
    angles = np.arccos(np.clip(-np.einsum("nj,nj->n", directions, presses.normals), -1, 1))
    assert angles.max() <= TILT_RAD + 1e-6
    assert angles.max() > TILT_RAD / 2


def test_the_floor_of_the_pocket_is_out_of_reach(presses):
    inside = (np.abs(presses.places_m[:, :2]) < 1.9e-3).all(axis=1) & (presses.places_m[:, 2] < 0)
    in_pocket = inside & (presses.places_m[:, 2] > -4e-3)
    assert not in_pocket.any()
    assert 0 < presses.reached < 1


def test_a_part_that_no_press_reaches_is_refused(block, geometry):
    with pytest.raises(GridError, match="hardly any place"):
        draw_presses(block, PressingSensor(geometry, -1e-3, TILT_RAD), 5, np.random.default_rng(0))


def test_a_wide_finger_cannot_touch_the_step_below_a_wall(geometry):
    """The gel touches a step of 24 mm beside a wall of 30 mm height, and a body of 120 mm width hits the wall."""
    pytest.importorskip("fcl")
    made = trimesh.boolean.union(
        [trimesh.creation.box((60, 40, 10)), trimesh.creation.box((5, 40, 40)).apply_translation([27, 0, 15])],
        engine="manifold",
    )
    mesh = TriangleMesh(1e-3 * np.asarray(made.vertices), np.asarray(made.faces, np.int64))
    obj = ObjectModel("wall", mesh, SymmetryGroup(np.zeros(3)))
    sensor = PressingSensor(geometry, PRESS_M, TILT_RAD)
    presses = draw_presses(obj, sensor, 60, np.random.default_rng(1))
    step = (np.abs(presses.places_m[:, 2] - 5e-3) < 1e-6) & (presses.places_m[:, 0] < 0.02)
    narrow, wide = (
        find_clear(obj, replace(sensor, clearance=Clearance(make_box_finger((side, side, 0.05), geometry))), T)
        for side in (0.012, 0.12)
        for T in [presses.T_sensor_object[step]]
    )
    assert step.sum() > 5
    assert narrow.mean() > 0.8
    assert wide.mean() < 0.2
