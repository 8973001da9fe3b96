"""A touch is ambiguous if, and only if, a distant pose makes the same contact."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.special import ndtr

from tactile_loc import ContactShape, Localizer, RunConfig, Touch
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.paper.ambiguity import (
    DISTANT_M,
    RIVALS,
    choose_judging_noise,
    compute_noise_ratio,
    find_rivals,
    measure_ambiguity,
)
from tactile_loc.plugin.helpers import make_transform, rotation_about

MILD = NOISE["mild"]
SENSOR, GRID = {"name": "gelsight-mini", "gel": "rigid"}, {"name": "face", "spacing_mm": 2.5, "face": "+z"}
SETTINGS = RunConfig.from_dict({"sensor": SENSOR, "grid": GRID})


def ratios(localizer: Localizer, touches: list[Touch], seed: int = 0) -> np.ndarray:
    return measure_ambiguity(localizer, touches, MILD, [np.random.default_rng([seed, i]) for i in range(len(touches))])


def test_the_noise_ratio_gives_the_rate_of_wrong_matches_for_gaussian_noise():
    rng = np.random.default_rng(0)
    mixing = np.diag(rng.uniform(0.2, 2, 12)) @ np.linalg.qr(rng.normal(size=(12, 12)))[0]
    true, other = rng.normal(size=(2, 12))
    measured = true + rng.normal(size=(200_000, 12)) @ mixing
    for share in (0.3, 0.7, 1.5):
        rival = true + share * (other - true)
        wrong = np.linalg.norm(measured - rival, axis=1) < np.linalg.norm(measured - true, axis=1)
        (ratio,) = compute_noise_ratio(true, rival[None], measured[:5000])
        assert ndtr(-ratio / np.sqrt(2)) == pytest.approx(wrong.mean(), abs=0.01)
    assert compute_noise_ratio(true, true[None], measured[:20]) == 0
    true, other = np.zeros(3), np.array([[1.0, 0.0, 0.0]])
    measured = np.array([[0.1, 9.0, -9.0], [-0.1, -9.0, 9.0]])
    ratio = compute_noise_ratio(true, other, measured)
    assert ratio == pytest.approx([1 / np.hypot(0.2, 0)]), "noise in other directions hides the difference"


@pytest.fixture(scope="module")
def plates(store, make_object) -> dict[str, Localizer]:
    """A plate of 17 x 6 mm, and one with a notch in one corner, for each declared symmetry."""
    plate = trimesh.creation.box((0.017, 0.006, 0.004))
    corner = trimesh.creation.box((0.004, 0.004, 0.02), make_transform(np.eye(3), [0.0085, 0.003, 0.0]))
    notched = trimesh.boolean.difference([plate, corner], engine="manifold")
    objects = {"symmetric": (plate, "z2*x2", "plate"), "alike": (plate, "none", "plate")}
    objects["notched"] = (notched, "none", "notched")
    return {name: Localizer(SETTINGS, make_object(*about), store) for name, about in objects.items()}


def touch_at(localizer: Localizer, x_m: float, yaw_rad: float = 0.3) -> Touch:
    """The plate's face on the sensor, its centre `x_m` metres from the sensor's centre along the plate."""
    R = rotation_about([0, 0, 1], yaw_rad) @ rotation_about([1, 0, 0], np.pi)
    scene = localizer.scene.press(5e-4)
    T = scene.bring_to_contact(make_transform(R, R @ [x_m, 0.001, 0.0])[None])[0][0]
    return Touch(
        ContactShape(scene.render_contact_depths(T[None])[0], 5e-4), localizer.scene.geometry, "t", T_sensor_object=T
    )


def test_two_poses_that_look_the_same_are_ambiguous_unless_a_symmetry_joins_them(plates):
    """A plate rotated by 180 degrees is a rival, unless that is declared as its symmetry."""
    whole = [touch_at(plates["alike"], x) for x in (0.0, 0.001, -0.002)]
    assert (ratios(plates["alike"], whole) < 1).all()
    assert (ratios(plates["symmetric"], whole) > 3).all()


def test_a_notch_distinguishes_the_poses(plates):
    """The view contains either the notch or the end without a notch."""
    assert (ratios(plates["notched"], [touch_at(plates["notched"], x) for x in (0.0, 0.012)]) > 2).all()


def test_equal_seeds_give_equal_ratios_and_more_noise_lowers_the_ratio(plates):
    touch = touch_at(plates["notched"], 0.0)
    (mild,) = ratios(plates["notched"], [touch])
    assert mild == ratios(plates["notched"], [touch])[0]
    assert measure_ambiguity(plates["notched"], [touch], NOISE["strong"], [np.random.default_rng([0, 0])])[0] < mild


def test_rivals_are_distant_from_the_truth_and_from_each_other(localizer):
    grid, rng = localizer.model.grid, np.random.default_rng(0)
    truth, apart = grid.T_sensor_object[100], rng.random(len(grid)).astype(np.float32)
    rivals = find_rivals(grid, truth, apart, 0.012)
    assert len(rivals) == RIVALS
    assert (grid.metric.symmetric_distance(np.repeat(truth[None], RIVALS, 0), rivals) > DISTANT_M).all()
    phi = grid.metric.embed(rivals)
    assert (np.linalg.norm(phi[:, None] - phi[None], axis=-1)[~np.eye(RIVALS, dtype=bool)] > 0.012).all()
    distant = grid.distances(truth) > DISTANT_M
    assert (rivals[0] == grid.T_sensor_object[np.flatnonzero(distant)[apart[distant].argmin()]]).all()


def test_a_touch_without_distant_poses_is_not_ambiguous(plates):
    touch = touch_at(plates["symmetric"], 0.0)
    grid = plates["symmetric"].model.grid
    near = grid.distances(touch.T_sensor_object) < DISTANT_M
    few = dataclasses.replace(grid, T_sensor_object=grid.T_sensor_object[near])
    assert find_rivals(few, touch.T_sensor_object, np.zeros(len(few), np.float32), 1e-3).shape == (0, 4, 4)


def test_clean_touches_are_judged_against_mild_noise():
    assert [choose_judging_noise(name) for name in ("none", "mild", "strong")] == ["mild", "mild", "strong"]
