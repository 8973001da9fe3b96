"""Shifts of a boss on a plate: found at its place with its size, and none on clean plates."""

import json

import numpy as np
import pytest
import trimesh
from inspect_helpers import make_plate, misplace, press
from tactile_loc import ObjectModel
from tactile_loc.plugin import View

from tactile_loc_inspect.inspection import inspect_part
from tactile_loc_inspect.shifts import shift_depths, weigh_distances

BOSS_M = np.array([1.5e-3, 1e-3, 2e-3])  # the foot of the boss, in the middle
ALONG = np.array([0.6, 0.8, 0])


def make_bossed(shift_mm: float = 0.0) -> ObjectModel:
    """Return the plate with a boss of radius 1 mm, 0.4 mm high, on its step, shifted along the step."""
    middle_mm = 1e3 * BOSS_M + shift_mm * ALONG
    return make_plate(trimesh.creation.cylinder(1.0, 0.8, sections=64).apply_translation(middle_mm))


def touch_bossed(shift_mm: float, seed: int = 0) -> list[View]:
    """Return touches of the plate with a shifted boss, beside the model with the boss in its place."""
    return press(make_bossed(shift_mm), seed, model=make_bossed())


@pytest.mark.parametrize("seed", range(4))
def test_a_boss_in_its_place_raises_no_alarm(seed):
    views = touch_bossed(0.0, seed)
    found = inspect_part(views, misplace(views, seed))
    assert found.shift is None
    assert found.verdict == "as the model"
    assert found.to_json()["shift"] is None


@pytest.mark.parametrize("shift_mm", [0.2, 0.3])
def test_a_shifted_boss_is_found_with_its_shift(shift_mm):
    views = touch_bossed(shift_mm)
    found = inspect_part(views, misplace(views))
    assert found.verdict == "differs"
    moved = found.shift
    assert moved is not None
    assert np.linalg.norm(moved.point_m - BOSS_M) < 2e-3
    assert np.linalg.norm(moved.shift_m - 1e-3 * shift_mm * ALONG) < 5e-5
    assert json.loads(json.dumps(found.to_json()))["shift"]["statistic"] > found.limits.shift
    assert moved.describe() in [found.describe().removeprefix("differs here: ").split(";")[0], *found.list_notes()]


def test_a_ramp_that_moves_along_itself_sinks():
    ramp_m = np.tile(1e-2 * np.arange(40) * 1e-4, (30, 1))  # 1 % steep along x
    moved = shift_depths(ramp_m[None], np.ones((30, 40)), np.array([5e-4, 0, 1e-6]), 1e-4)[0]
    assert moved[:, 10:] == pytest.approx(ramp_m[:, 10:] - 5e-6 + 1e-6, abs=1e-12)


def test_a_window_moves_whole_near_its_middle_and_not_outside():
    assert weigh_distances(np.array([0, 0.7, 1.0, 2.0]), 1.0).tolist() == [1, 1, 0, 0]
