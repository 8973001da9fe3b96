"""A finger hits what is in its way, and nothing else."""

import sys
from contextlib import nullcontext

import numpy as np
import pytest
import trimesh
from message_helpers import naming
from planning_helpers import GEL, PRESS_M, join_boxes, modes_of

from tactile_loc import Approach, ObjectModel, TriangleMesh, choose_next_touch, draw_approaches_to_modes
from tactile_loc.planning.clearance import Clearance, cut_gel, find_first_hit_m, make_box_finger
from tactile_loc.plugin import ConfigError, MissingLibraryError
from tactile_loc.plugin.helpers import align_to_z, make_transform, make_translation, rotation_about

pytest.importorskip("fcl", reason="python-fcl is not installed")

SIDES_M = (0.026, 0.022, 0.03)
DOWN = align_to_z([0, 0, -1]).T


@pytest.fixture
def step(make_object) -> ObjectModel:
    """Return a plate, 40 x 30 x 10 mm, with a block on its half x > 8 mm that is 10 mm higher."""
    return make_object(join_boxes(((0.04, 0.03, 0.01), [0, 0, 0]), ((0.012, 0.03, 0.01), [0.014, 0, 0.01])))


def from_above(x_m: float, **given) -> Approach:
    """An approach from above whose gel starts 60 mm above the origin, with its middle at x."""
    return Approach(make_transform(DOWN, [x_m, 0.0, 0.06 + GEL.standoff_m]), travel_m=0.06, **given)


def reasons(found) -> dict[str, str]:
    return {approach.name: reason for approach, reason in found.out_of_reach}


def test_a_finger_wider_than_the_gel_hits_a_step_beside_it(step):
    # the block begins at x = 8 mm; the gel is 20 mm wide, and the finger 26 mm
    approaches = [from_above(-0.003, name="beside"), from_above(-0.006, name="clear"), from_above(0.006, name="on top")]
    found = choose_next_touch(modes_of(step, np.eye(4)), approaches, clearance=Clearance(make_box_finger(SIDES_M, GEL)))
    assert {one.approach.name for one in found.ranked} == {"clear", "on top"}
    assert "after 46 mm in pose 1" in reasons(found)["beside"]  # 45 mm to the block, and 0.8 mm are soft
    free = choose_next_touch(modes_of(step, np.eye(4)), approaches)
    assert free.out_of_reach == ()


def test_only_probable_poses_are_in_the_way(step):
    shifted = make_translation([-0.001, 0.0, 0.0])
    clearance = Clearance(make_box_finger(SIDES_M, GEL))
    for p, expected in ((0.02, {"edge": 2}), (0.005, {})):
        modes = modes_of(step, make_translation([0.003, 0, 0]), shifted, p=[1 - p, p])
        approaches = [from_above(-0.0045, name="edge"), from_above(-0.02, name="far")]
        found = choose_next_touch(modes, approaches, clearance=clearance)
        assert all(f"pose {number}" in reasons(found)[name] for name, number in expected.items())
        assert len(found.out_of_reach) == len(expected)


def test_a_floor_and_a_fixture_are_avoided(step, make_box):
    modes = modes_of(step, np.eye(4))
    level = Approach(make_transform(align_to_z([1, 0, 0]).T, [-0.06, 0.0, 0.0]), travel_m=0.06, name="level")
    finger = make_box_finger(SIDES_M, GEL)
    below = choose_next_touch(modes, [level, from_above(-0.006)], clearance=Clearance(finger, floor_m=-0.005))
    assert list(reasons(below)) == ["level"]
    assert "floor" in reasons(below)["level"]
    deep = choose_next_touch(modes, [level], clearance=Clearance(finger, floor_m=-0.02))
    assert deep.out_of_reach == ()
    wall = make_box(0.002, 0.1, 0.1).mesh
    for x_m, hits in ((-0.03, True), (-0.1, False)):  # between the sensor and the object, or behind the sensor
        moved = TriangleMesh(wall.vertices_m + np.array([x_m, 0.0, 0.0]), wall.faces)
        clearance = Clearance(finger, fixture=moved)
        expected = pytest.raises(ConfigError, match=r"fixture .* (19|20) mm") if hits else nullcontext()
        with expected:  # where they touch, or a step later
            assert choose_next_touch(modes, [level], clearance=clearance).out_of_reach == ()


def test_the_first_hit_is_where_the_surfaces_meet():
    ball = trimesh.creation.icosphere(5, 0.01)
    mesh, finger = TriangleMesh(np.asarray(ball.vertices), np.asarray(ball.faces)), make_box_finger(SIDES_M, GEL)
    T = make_translation([0.0, 0.0, GEL.surface_m + 0.05])
    assert find_first_hit_m(finger, mesh, T, 0.1) == pytest.approx(0.04, abs=1.1e-3)
    assert find_first_hit_m(finger, mesh, T, 0.03) == np.inf
    assert find_first_hit_m(finger, mesh, T @ make_translation([0.024, 0.0, 0.0]), 0.2) == np.inf
    beside = find_first_hit_m(finger, mesh, T @ make_translation([0.019, 0.0, 0.0]), 0.2)
    assert beside == pytest.approx(0.05 - np.sqrt(0.01**2 - 0.006**2), abs=1.1e-3)


def test_the_soft_layer_of_a_finger_is_cut_away():
    finger = make_box_finger(SIDES_M, GEL)
    rigid = cut_gel(finger, GEL, PRESS_M)
    assert rigid.corners_m[:, 2].max() == pytest.approx(GEL.surface_m - PRESS_M, abs=3e-5)
    assert np.allclose(rigid.corners_m.min(axis=0), finger.corners_m.min(axis=0))
    camera = trimesh.creation.box(bounds=[[0.02, 0, 0], [0.03, 0.01, GEL.surface_m + 0.02]])
    ahead = cut_gel(TriangleMesh(np.asarray(camera.vertices), np.asarray(camera.faces)), GEL, PRESS_M)
    assert ahead.corners_m[:, 2].max() == pytest.approx(GEL.surface_m + 0.02)


def test_the_rest_of_a_finger_is_closed_for_objects_that_are_narrower():
    ball = trimesh.creation.icosphere(3, 0.003)
    mesh = TriangleMesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    T = make_translation([0.0, 0.0, GEL.surface_m + 0.05])
    rigid = cut_gel(make_box_finger(SIDES_M, GEL), GEL, PRESS_M)
    assert find_first_hit_m(rigid, mesh, T, 0.1) == pytest.approx(0.047 + PRESS_M, abs=1.1e-3)
    assert find_first_hit_m(rigid, mesh, T, 0.047 + PRESS_M) == np.inf


def test_drawn_approaches_touch_with_the_gel_first(step):
    finger = make_box_finger(SIDES_M, GEL)
    modes = modes_of(step, make_transform(rotation_about([1, 2, 3], 1.0), [0.4, 0.1, -0.2]))
    reached = []
    for given in (None, finger):
        drawn = draw_approaches_to_modes(modes, 60, np.random.default_rng(0), given)
        reached.append(len(choose_next_touch(modes, drawn, clearance=Clearance(finger)).ranked))
    assert reached[1] > 1.5 * reached[0]


def test_a_missing_library_is_named(step, monkeypatch):
    monkeypatch.setitem(sys.modules, "fcl", None)
    clearance = Clearance(make_box_finger(SIDES_M, GEL))
    with pytest.raises(MissingLibraryError, match=naming("python-fcl", "tactile-loc[clearance]")):
        choose_next_touch(modes_of(step, np.eye(4)), [from_above(0.0)], clearance=clearance)
