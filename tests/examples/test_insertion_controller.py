"""examples/insertion: decisions, placements and trials, with fake results."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'tactile-loc[sim]'")

import controller
from controller import MOST_GRASPS, Action, decide, find_chance, list_placements
from shapes import PARTS
from trials import CLEARANCES_MM, MOST_OFF_M, MOST_OFF_RAD, list_trials

from tactile_loc import Verdict
from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about, rotation_angle


@pytest.mark.parametrize(
    ("verdict", "chance", "grasps", "action"),
    [
        (Verdict.CERTAIN, 0.8, 1, Action.INSERT),
        (Verdict.CERTAIN, 0.8, MOST_GRASPS, Action.INSERT),
        (Verdict.AMBIGUOUS, 0.8, 2, Action.INSERT),
        (Verdict.AMBIGUOUS, 0.7, 1, Action.TOUCH),
        (Verdict.AMBIGUOUS, 0.7, MOST_GRASPS, Action.STOP),
        (Verdict.POOR_FIT, 0.9, 2, Action.TOUCH),
        (Verdict.NOT_FOUND, 0.9, MOST_GRASPS, Action.STOP),
    ],
)
def test_the_controller_inserts_only_if_the_tip_is_known(verdict, chance, grasps, action):
    assert decide(verdict, chance, grasps) is action


@pytest.mark.parametrize(
    ("part", "shift_m", "yaw_deg", "works"),
    [
        ("peg", (0, 0, 2e-3), 0, True),  # along the hole, the arm gives way
        ("peg", (0, 0, 4e-3), 0, False),
        ("peg", (8e-4, 0, 0), 0, True),
        ("peg", (1.2e-3, 0, 0), 0, False),
        ("peg", (0, 0, 0), 90, True),
        ("peg", (0, 0, 0), 12, False),
        ("plug", (0, 0, 0), 90, False),
        ("bolt", (0, 0, 0), 12, True),
    ],
)
def test_other_poses_add_to_the_chance_if_the_insertion_works_with_them(part, shift_m, yaw_deg, works):
    first = make_transform(rotation_about([1, 2, 3], 0.4), np.array([0.1, 0.2, 0.3]))
    other = first @ make_transform(rotation_about([0, 0, 1], np.radians(yaw_deg)), np.array(shift_m))
    listed = [SimpleNamespace(T_base_object=T, probability=p) for T, p in ((first, 0.5), (other, 0.3))]
    chance = find_chance(SimpleNamespace(hypotheses=listed), PARTS[part]())
    assert chance == pytest.approx(0.8 if works else 0.5)


@pytest.mark.parametrize("name", PARTS)
def test_all_placements_hold_the_upright_part(name):
    part = PARTS[name]()
    T = make_translation([0.1, 0.2, 0.3])
    placements = list_placements(T, part)
    assert len({placement.name for placement in placements}) == len(part.yaws_deg) * len(part.shifts_m)
    for placement in placements:
        gripper = invert(T) @ placement.T_world_gripper
        assert gripper[2, 2] == pytest.approx(1.0)
        assert -10e-3 < gripper[2, 3] < 20e-3


def rate(monkeypatch, gains, blocked):
    """Let `choose_next_touch` return these gains of single gels, and these approaches out of reach, by placement."""
    ranked = [SimpleNamespace(approach=SimpleNamespace(name=str(k)), information=gain) for k, gain in gains]
    outside = [(SimpleNamespace(name=str(k)), "would start inside") for k in blocked]
    monkeypatch.setattr(controller, "spread_modes", lambda found: found)
    monkeypatch.setattr(
        controller, "choose_next_touch", lambda found, approaches: SimpleNamespace(ranked=ranked, out_of_reach=outside)
    )
    return SimpleNamespace(touch=SimpleNamespace(geometry=SimpleNamespace(surface_m=0.01)))


@pytest.mark.parametrize(
    ("gains", "blocked", "used", "chosen"),
    [
        ([(0, 0.9), (1, 0.6), (1, 0.5), (2, 0.8)], [], [], 1),  # its two gels tell most together
        ([(0, 0.9), (1, 2.0), (2, 0.8)], [1], [], 0),  # a gel of the best one cannot start
        ([(0, 0.9), (1, 0.1)], [], [0], 1),
        ([(0, 0.9), (1, 0.1)], [], [0, 1, 2], 0),  # a used one is the last resort
    ],
)
def test_the_free_unused_placement_that_tells_most_is_chosen(monkeypatch, gains, blocked, used, chosen):
    placements = list_placements(np.eye(4), PARTS["peg"]())[:3]
    found = rate(monkeypatch, gains, blocked)
    names = [placements[k].name for k in used]
    assert controller.choose_placement(found, placements, names) is placements[chosen]


def test_trials_are_fixed_and_cover_all_parts_and_clearances():
    trials = list_trials(100)
    assert trials == list_trials(100)
    assert [trial.seed for trial in trials] == list(range(1, 101))
    assert {(trial.part, trial.clearance_mm) for trial in trials[:12]} == {(p, c) for p in PARTS for c in CLEARANCES_MM}
    errors = [trial.draw_error(np.random.default_rng(trial.seed)) for trial in trials]
    again = [trial.draw_error(np.random.default_rng(trial.seed)) for trial in trials]
    np.testing.assert_array_equal(errors, again)
    shifts_m = np.linalg.norm(np.array(errors)[:, :3, 3], axis=1)
    turns_rad = rotation_angle(np.array(errors)[:, :3, :3])
    assert 0.8 * MOST_OFF_M < shifts_m.max() <= MOST_OFF_M
    assert 0.8 * MOST_OFF_RAD < turns_rad.max() <= MOST_OFF_RAD
