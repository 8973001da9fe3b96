"""The next touch distinguishes the poses if a touch can, and respects reach and cost."""

import dataclasses

import numpy as np
import pytest
import trimesh
from message_helpers import naming
from planning_helpers import GEL, PRESS_M, join_boxes, modes_of

from tactile_loc import Approach, Clearance, ObjectModel, make_box_finger
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.planning.next_touch import choose_next_touch, compute_expected_entropy, find_groups, foresee
from tactile_loc.plugin import ConfigError, TouchError
from tactile_loc.plugin.helpers import align_to_z, invert, make_transform, rotation_about
from tactile_loc.tracking.pose_modes import PoseModes, join_modes

HALF_TURN = make_transform(rotation_about([0, 0, 1], np.pi), np.zeros(3))


@pytest.fixture
def knobbed(make_object) -> ObjectModel:
    """Return a box, 40 x 30 x 20 mm, symmetric about z except for a knob on its side +x."""
    return make_object(join_boxes(((0.04, 0.03, 0.02), [0, 0, 0]), ((0.004, 0.006, 0.006), [0.021, 0, 0])))


@pytest.fixture
def drilled(make_object) -> ObjectModel:
    """Return a block, 40 x 30 x 20 mm, with two blind holes in its top: that at +x is 8 mm deep, the other 2 mm."""
    block = trimesh.creation.box((0.04, 0.03, 0.02))
    bores = [
        trimesh.creation.cylinder(0.005, 2 * depth_m, sections=32).apply_translation([x, 0.0, 0.01])
        for x, depth_m in ((0.012, 8e-3), (-0.012, 2e-3))
    ]
    return make_object(trimesh.boolean.difference([block, *bores], engine="manifold"))


def towards(direction, beside_m: float = 0.0, **given) -> Approach:
    """An approach along a direction; its gel starts 50 mm before the object's origin, shifted by `beside_m`."""
    R = align_to_z(direction).T
    start = -0.05 * R[:, 2] - GEL.standoff_m * R[:, 2] + beside_m * R[:, 0]
    return Approach(make_transform(R, start), **given)


def edge_of(direction, **given) -> Approach:
    """The same, shifted so that an edge of the box is on the sensor: a flat face alone is not a touch."""
    return towards(direction, beside_m=0.009, **given)


TOP, FRONT, KNOB = (
    edge_of(to, name=name) for name, to in (("top", [0, 0, -1]), ("front", [0, -1, 0]), ("knob", [-1, 0, 0]))
)


@pytest.fixture
def turned(knobbed) -> PoseModes:
    """Return two equally probable poses, which differ by a half turn: only a touch of the knob tells them apart."""
    return modes_of(knobbed, np.eye(4), HALF_TURN)


def test_the_side_that_distinguishes_two_poses_is_chosen(turned):
    found = choose_next_touch(turned, [TOP, FRONT, KNOB])
    assert found.best.approach.name == "knob"
    assert found.best.information == pytest.approx(np.log(2), abs=0.01)
    assert found.best.entropy == pytest.approx(0.0, abs=0.01)
    assert [rated.information for rated in found.ranked[1:]] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert found.alike == ()
    assert found.doubt_left == 0
    travel_m = choose_next_touch(turned, [towards([-1, 0, 0])]).best.travel_m
    assert np.sort(travel_m) == pytest.approx([0.027, 0.030], abs=1e-6)  # 50 mm less 23 to the knob, or 20


def test_poses_that_no_touch_distinguishes_are_reported(make_box):
    box = make_box(0.04, 0.03, 0.02, symmetry="none")  # although the box has a symmetry
    found = choose_next_touch(
        modes_of(box, np.eye(4), HALF_TURN, make_transform(np.eye(3), [0, 0, 3e-3]), p=[0.5, 0.3, 0.2]), [KNOB, TOP]
    )
    assert found.alike == ((0, 1),)
    assert found.doubt_left == pytest.approx(0.3)


def test_touching_stops_if_only_a_blind_hole_differs(drilled):
    # the surface of both poses differs only below holes that are deeper than any press
    given = [*(edge_of(d) for d in ([-1, 0, 0], [1, 0, 0], [0, 1, 0])), towards([0, 0, -1], beside_m=0.012)]
    modes = modes_of(drilled, np.eye(4), HALF_TURN, p=[0.6, 0.4])
    found = choose_next_touch(modes, given)
    assert found.stops
    assert found.alike == ((0, 1),)
    assert found.doubt_left == pytest.approx(0.4)
    deeper = dataclasses.replace(modes, geometry=dataclasses.replace(GEL, max_depth_m=3e-3, standoff_m=0.02))
    assert not choose_next_touch(deeper, [towards([0, 0, -1], beside_m=0.012, press_m=2.5e-3)]).stops


def test_touching_goes_on_while_a_touch_can_help(knobbed, turned):
    assert choose_next_touch(turned, [TOP]).stops
    assert not choose_next_touch(turned, [TOP, KNOB]).stops
    assert not choose_next_touch(dataclasses.replace(turned, unlisted=0.6), [TOP]).stops
    assert not choose_next_touch(modes_of(knobbed, np.eye(4)), [TOP]).stops  # one pose: nothing to tell apart
    third, beside = make_transform(np.eye(3), [0, 0, 3e-3]), towards([0, 0, -1], beside_m=0.015)
    assert choose_next_touch(turned, [beside]).stops
    assert not choose_next_touch(modes_of(knobbed, np.eye(4), HALF_TURN, third), [beside]).stops


def test_touching_stops_if_the_finger_cannot_reach_what_differs(turned):
    pytest.importorskip("fcl", reason="python-fcl is not installed")
    clearance = Clearance(make_box_finger((0.06, 0.06, 0.03), GEL), floor_m=-0.015)
    found = choose_next_touch(turned, [TOP, KNOB], clearance=clearance)
    assert [approach.name for approach, _ in found.out_of_reach] == ["knob"]
    assert found.stops


def test_poses_that_are_equal_by_symmetry_are_merged(make_box):
    box = make_box(0.04, 0.03, 0.02, symmetry="x2*y2")
    modes = modes_of(box, np.eye(4), HALF_TURN, make_transform(np.eye(3), [0, 0, 3e-3]), p=[0.3, 0.3, 0.4])
    assert modes.probabilities.tolist() == pytest.approx([0.6, 0.4])
    assert np.allclose(modes.T_base_object[0], np.eye(4))


def test_each_mode_needs_its_object_and_probability(turned):
    with pytest.raises(TouchError, match=naming("2 objects", "4 poses", "2 probabilities")):
        dataclasses.replace(turned, T_base_object=np.tile(turned.T_base_object, (2, 1, 1)))


def test_an_approach_out_of_reach_is_never_chosen(turned):
    inside = Approach(make_transform(align_to_z([-1, 0, 0]).T, np.zeros(3)))
    far = towards([-1, 0, 0], cost=np.inf, name="far")
    found = choose_next_touch(turned, [far, TOP, inside])
    assert [rated.approach.name for rated in found.ranked] == ["top"]
    assert [name.name for name, _ in found.out_of_reach] == ["far", ""]
    assert "inside" in found.out_of_reach[1][1]
    with pytest.raises(ConfigError, match=naming(1, "infinite")):
        choose_next_touch(turned, [KNOB], cost=lambda approach: np.inf)


def test_information_is_divided_by_its_cost(turned):
    both = [KNOB, edge_of([1, 0, 0])]
    for cheap in both:
        found = choose_next_touch(turned, both, cost=lambda approach, cheap=cheap: 1.0 if approach is cheap else 3.0)
        assert found.best.approach is cheap
        assert found.best.worth == pytest.approx(3 * found.ranked[1].worth, rel=0.01)


def test_a_press_without_contact_has_no_information(turned):
    (short,) = choose_next_touch(turned, [towards([-1, 0, 0], travel_m=0.02)]).ranked
    assert (short.information, short.meets) == (0.0, 0.0)
    assert np.isnan(short.travel_m).all()


def test_a_rotation_of_the_base_does_not_change_the_choice(knobbed):
    T = make_transform(rotation_about([1, 2, 3], 1.0), [0.1, -0.2, 0.3])
    modes = modes_of(knobbed, np.eye(4), HALF_TURN, make_transform(np.eye(3), [2e-3, 0, 0]))
    moved = dataclasses.replace(modes, T_base_object=T @ modes.T_base_object)
    here = [KNOB, TOP]
    there = [dataclasses.replace(a, T_base_sensor=T @ a.T_base_sensor) for a in here]
    one, other = (choose_next_touch(*given).ranked for given in ((modes, here), (moved, there)))
    assert [r.information for r in one] == pytest.approx([r.information for r in other], abs=0.02)


def test_the_pressed_sensor_sees_the_object_at_the_predicted_pose(knobbed):
    modes, approach = modes_of(knobbed, np.eye(4)), towards([-1, 0, 0])
    scene = choose_next_touch(modes, [approach]).scene
    seen = foresee(scene, modes, [approach])
    moved = approach.T_base_sensor @ make_transform(np.eye(3), [0, 0, seen.travel_m[0, 0] + PRESS_M])
    assert np.allclose(seen.T_sensor_object[0, 0], invert(moved))


def test_two_modes_have_the_known_expected_entropy():
    p, apart, none = np.array([0.25, 0.75]), np.array([[0.0, 50.0], [50.0, 0.0]]), np.zeros((2, 2))
    before = -(p * np.log(p)).sum()
    told = np.array([[True, True], [True, True], [True, False]])
    after = compute_expected_entropy(np.stack([apart, none, apart]), p, told)
    assert after == pytest.approx([0.0, before, 0.75 * before])
    half = compute_expected_entropy(apart[None], np.array([0.5, 0.5]), np.array([[0.5, 0.5]]))  # half of the time
    assert half == pytest.approx([0.5 * np.log(2)])


def test_a_large_contact_is_preferred_to_a_small_one(make_object):
    # both knobs tell the poses apart, but noise would hide the small one
    knobs = ((0.003, 0.0015, 0.0015), [0.03, 0, 0]), ((0.012, 0.003, 0.012), [0, 0.03, 0])
    obj = make_object(join_boxes(((0.06, 0.06, 0.02), [0, 0, 0]), *knobs))
    small, large = towards([-1, 0, 0], name="small"), towards([0, -1, 0], name="large")
    found = choose_next_touch(modes_of(obj, np.eye(4), HALF_TURN), [small, large])
    assert [rated.approach.name for rated in found.ranked] == ["large", "small"]
    assert found.ranked[0].safe > 1.5 * found.ranked[1].safe > 0
    assert found.ranked[0].information == pytest.approx(found.ranked[1].information, rel=0.1)
    assert all(rated.safe < rated.information for rated in found.ranked)


def test_the_side_that_distinguishes_two_objects_is_chosen(knobbed, make_box):
    plain = make_box(0.04, 0.03, 0.02, symmetry="none")
    modes = join_modes([modes_of(plain, np.eye(4)), modes_of(knobbed, np.eye(4), p=[1.0])], [0.5, 0.4])
    assert [obj for obj, _ in modes.by_object] == [plain, knobbed]
    assert modes.probabilities.tolist() == pytest.approx([5 / 9, 4 / 9])
    assert modes.unlisted == pytest.approx(0.1)
    found = choose_next_touch(modes, [TOP, FRONT, KNOB])
    assert found.best.approach.name == "knob"
    assert found.best.entropy == pytest.approx(0.0, abs=0.01)
    assert [rated.information for rated in found.ranked[1:]] == pytest.approx([0.0, 0.0], abs=1e-3)
    plain_m, knobbed_m = found.best.travel_m
    assert plain_m - knobbed_m == pytest.approx(0.003, abs=1e-6)
    shown = found.contacts(found.ranked[-1])
    assert np.array_equal(shown[0], shown[1])
    assert not np.array_equal(*found.contacts(found.best))
    assert choose_next_touch(modes, [TOP]).stops


def test_the_likeliest_pairs_of_object_and_pose_are_kept(knobbed, make_box):
    plain = make_box(0.04, 0.03, 0.02, symmetry="none")
    third = make_transform(np.eye(3), [0, 0, 3e-3])
    modes = join_modes([modes_of(plain, np.eye(4), third, p=[0.9, 0.1]), modes_of(knobbed, HALF_TURN)], [0.5, 0.5])
    assert modes.probabilities.tolist() == pytest.approx([0.5, 0.45, 0.05])
    assert modes.objects == (knobbed, plain, plain)
    assert np.array_equal(modes.T_base_object, [HALF_TURN, np.eye(4), third])
    with pytest.raises(TouchError):
        join_modes([], [])


def test_groups_join_modes_that_are_alike_directly_or_indirectly():
    alike = np.eye(5, dtype=bool)
    alike[0, 2] = alike[2, 4] = True
    assert find_groups(alike) == ((0, 2, 4),)
    assert find_groups(np.eye(3, dtype=bool)) == ()


def test_an_approach_may_be_given_by_its_start_pose_alone(turned):
    alone = choose_next_touch(turned, [approach.T_base_sensor for approach in (TOP, KNOB)])
    named = choose_next_touch(turned, [TOP, KNOB])
    assert [r.information for r in alone.ranked] == [r.information for r in named.ranked]
    assert {r.approach.name for r in alone.ranked} <= {"1", "2"}


def test_invalid_approaches_and_modes_are_refused(knobbed):
    modes = modes_of(knobbed, np.eye(4))
    for approaches, words in (
        ([], []),
        ([np.eye(4), 2 * np.eye(4)], ["T_base_sensor", 2, "rigid"]),
        ([towards([0, 0, 1], cost=0.0)], ["approach 1", "cost", 0]),
        ([towards([0, 0, 1]), towards([0, 0, 1], press_m=0.02)], ["approach 2", "20 mm"]),
    ):
        with pytest.raises(ConfigError, match=naming(*words)):
            choose_next_touch(modes, approaches)


def test_an_elastic_gel_is_predicted_with_its_surface(turned):
    soft = dataclasses.replace(turned, geometry=dataclasses.replace(GEL, gel=Gel(4e-3)))
    found, rigid = (choose_next_touch(modes, [KNOB, TOP]) for modes in (soft, turned))
    assert found.best.approach.name == "knob"
    press = np.float32(PRESS_M)
    shown, sharp = (chosen.contacts(chosen.best)[0] < press for chosen in (found, rigid))
    assert shown[sharp].all()
    assert np.count_nonzero(shown) > 1.2 * np.count_nonzero(sharp)
