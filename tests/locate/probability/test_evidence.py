"""The evidence for a first pose: what it leaves unexplained, how other poses compare, and how noisy the touches are."""

from dataclasses import replace

import numpy as np
import pytest

from tactile_loc import ContactShape, Tolerance, Touch
from tactile_loc.core.sensing.scene import NATS_PER_IOU
from tactile_loc.locate.hypotheses import LEAST_UNEXPLAINED
from tactile_loc.locate.probability.evidence import (
    FEATURES,
    NO_GAP,
    SURFACE,
    Evidence,
    Question,
    describe_surface,
    gather_evidence,
)
from tactile_loc.locate.probability.probes import DIRECTIONS
from tactile_loc.locate.result.localization import Hypothesis
from tactile_loc.plugin import RefinedPose, Scene, View
from tactile_loc.plugin.helpers import make_translation

PRESS_M = 1e-3
SIDES_M = (0.012, 0.008, 0.006)
SURE = np.diag([1e-6] * 3 + [1e-3] * 3)


@pytest.fixture(scope="module")
def scene(make_box, make_scene, flat_camera) -> Scene:
    return make_scene(make_box(*SIDES_M), flat_camera)


@pytest.fixture(scope="module")
def true_pose(scene) -> np.ndarray:
    return scene.press(PRESS_M).bring_to_contact(np.eye(4)[None])[0][0]


@pytest.fixture(scope="module")
def view(scene, true_pose) -> View:
    touch = Touch(scene.contact_shape(true_pose, PRESS_M), scene.geometry)
    return View(touch, scene.match_touch(touch))


def refine(T: np.ndarray, covariance: np.ndarray | None = None, **more) -> RefinedPose:
    return RefinedPose(T, 1.0, True, 3, covariance, **more)


def suppose(view: View, T: np.ndarray, covariance: np.ndarray | None = None, prior_nats: float = 0.0) -> Hypothesis:
    iou = float(view.imprint_ious(T[None])[0])
    return Hypothesis(0.5, T, refine(T, covariance), 0, 1, iou, (iou,), prior_nats=prior_nats)


def name_values(found: Evidence) -> dict[str, float]:
    assert np.isfinite(found.values).all()
    return dict(zip(FEATURES, found.values.tolist(), strict=True))


def test_a_lone_pose_that_explains_all_has_no_rival_and_leaves_nothing(view, true_pose):
    found = gather_evidence([view], [suppose(view, true_pose)], Question(view.scene.object, Tolerance()))
    said = name_values(found)
    assert (said["touches"], said["hypotheses"], said["same"], said["mask"], said["contradictory"]) == (1, 1, 1, 0, 0)
    assert said["imprint_iou"] == pytest.approx(1, abs=1e-3)
    assert said["mean_unexplained"] == said["most_unexplained"] == pytest.approx(np.log(LEAST_UNEXPLAINED), abs=0.2)
    assert said["gap"] == said["probe_gap"] == NO_GAP
    assert (found.near.tolist(), found.probes, found.probe_losses.shape) == ([True], None, (0,))
    assert found.press_m == pytest.approx([0], abs=1e-6)


def test_the_rival_is_the_best_pose_beyond_the_tolerance_after_its_prior(view, true_pose):
    near, beside, far = (make_translation([x_m, 0, 0]) @ true_pose for x_m in (5e-4, 2e-3, 4e-3))
    some = [suppose(view, T) for T in (true_pose, near, far, beside)]
    asked = Question(view.scene.object, Tolerance())
    found = gather_evidence([view], some, asked)
    said = name_values(found)
    assert found.near.tolist() == [True, True, False, False]
    assert (said["hypotheses"], said["same"]) == (4, 2)
    assert said["iou_gap"] == pytest.approx(some[0].imprint_iou - some[3].imprint_iou)
    assert said["distance"] == pytest.approx(np.log(2 + 1e-3))
    assert said["rival_missing"] == pytest.approx(np.log((2 / 12 + 0.02) / 0.02), abs=0.1)
    unlikely = [*some[:3], suppose(view, beside, prior_nats=-3.0)]
    said = name_values(gather_evidence([view], unlikely, asked))
    assert said["iou_gap"] == pytest.approx(some[0].imprint_iou - some[3].imprint_iou + 3 / NATS_PER_IOU)
    assert name_values(gather_evidence([view], some, Question(asked.object, Tolerance(1e-2))))["gap"] == NO_GAP


@pytest.mark.parametrize(
    ("seen_m", "above_m", "deeper_m"),
    [(0.3e-3, 0, -0.3e-3), (0, 0.5e-3, 0.25e-3), (0, 0.2e-3, 0), (0.1e-3, 0, -0.1e-3)],
)
def test_the_press_is_how_much_deeper_the_touch_shows_the_object_than_the_pose(
    scene, true_pose, seen_m, above_m, deeper_m
):
    """The pose may move along z by the error of the measured press, 0.25 mm."""
    depth_m = scene.contact_shape(true_pose, PRESS_M).depth_m
    shown = np.where(depth_m < PRESS_M, seen_m, PRESS_M).astype(np.float32)  # the block is flat
    touch = Touch(ContactShape(shown, PRESS_M), scene.geometry)
    wrong, T = View(touch, scene.match_touch(touch)), make_translation([0, 0, above_m]) @ true_pose
    found = gather_evidence([wrong], [suppose(wrong, T)], Question(scene.object, Tolerance()))
    assert found.press_m == pytest.approx([deeper_m], abs=1e-6)
    assert name_values(found)["mean_press"] == pytest.approx(np.log(1e3 * abs(deeper_m) + 0.01), abs=0.01)


def test_probes_along_an_open_slide_lose_nothing_and_others_lose(make_box, make_scene, flat_camera, view, true_pose):
    """The sensor sees all of the block, but of a long rail only a part."""
    losses = []
    for sides_m in (SIDES_M, (0.1, 0.008, 0.006)):
        scene = make_scene(make_box(*sides_m), flat_camera)
        T = scene.press(PRESS_M).bring_to_contact(np.eye(4)[None])[0][0]
        touch = Touch(scene.contact_shape(T, PRESS_M), scene.geometry)
        seen, along = View(touch, scene.match_touch(touch)), np.diag([1e-6, *[1e-10] * 2, *[1e-8] * 3])
        found = gather_evidence([seen], [suppose(seen, T, along)], Question(scene.object, Tolerance()))
        assert found.probe_losses.shape == (2 * DIRECTIONS,)
        losses.append(found.probe_losses[:2])
        said = name_values(found)
        assert said["near_probes"] == (found.probe_losses <= 0.02).sum()
        assert said["std_0"] == pytest.approx(np.log(1e-3), abs=0.05)
    assert losses[0].min() > 0.1
    assert np.abs(losses[1]).max() < 0.01


def test_a_probe_that_the_prior_excludes_loses_more(view, true_pose):
    first = suppose(view, true_pose, SURE)
    free, held = (
        gather_evidence([view], [first], Question(view.scene.object, Tolerance(), prior)).probe_losses
        for prior in (None, lambda T: np.full(len(T), -6.0))
    )
    assert held == pytest.approx(free + 6 / NATS_PER_IOU)


def test_the_error_of_a_sensor_pose_costs_its_nats(view, true_pose):
    views = [replace(view, sensor_std_m=1e-3, sensor_std_rad=0.01)] * 2
    moved = np.stack([true_pose, make_translation([2e-3, 0, 0]) @ true_pose])
    first = replace(suppose(view, true_pose), refined=refine(true_pose, T_sensors_object=moved))
    said = name_values(gather_evidence(views, [first], Question(view.scene.object, Tolerance())))
    assert said["most_sensor_nats"] == pytest.approx(2**2 / 2 / 2)  # both sensors may be off
    assert said["mean_sensor_nats"] == pytest.approx(said["most_sensor_nats"] / 2)
    assert said["touches"] == 2


def describe(touch: Touch) -> dict[str, float]:
    return dict(zip(SURFACE, describe_surface(touch).tolist(), strict=True))


def test_a_clean_flat_touch_has_its_area_its_outline_and_no_roughness(view):
    said = describe(view.touch)
    assert np.exp(said["area"]) == pytest.approx(1e6 * SIDES_M[0] * SIDES_M[1] + 0.05, rel=0.1)
    assert np.exp(said["outline_length"]) == pytest.approx(2e3 * sum(SIDES_M[:2]), rel=0.1)
    assert said["roughness"] == said["least_roughness"] == pytest.approx(np.log(1e-3))
    assert (said["indentation"], said["elastic"]) == (pytest.approx(1e3 * PRESS_M), 0)
    assert said["raggedness"] < 0.1


def test_the_roughness_is_that_of_the_noise_and_a_ragged_outline_is_seen(view):
    shape, rng = view.touch.contact_shape, np.random.default_rng(0)
    rough = []
    for std_m in (5e-6, 2e-5, 8e-5):
        noise_m = 4e-4 + std_m * rng.normal(size=shape.depth_m.shape)
        depth_m = np.where(shape.contact, noise_m, PRESS_M).astype(np.float32)
        said = describe(replace(view.touch, contact_shape=replace(shape, depth_m=depth_m)))
        mean_mm = 1e3 * std_m * np.sqrt(6) * np.sqrt(2 / np.pi)  # of |a - 2 b + c|, three normal errors
        assert np.exp(said["roughness"]) == pytest.approx(mean_mm + 1e-3, rel=0.1)
        rough.append((said["roughness"], said["least_roughness"]))
    assert (np.diff(rough, axis=0) > 0.5).all()
    flipped = rng.random(shape.depth_m.shape) < 0.05
    depth_m = np.where(shape.contact ^ flipped, 4e-4, PRESS_M).astype(np.float32)
    ragged = describe(replace(view.touch, contact_shape=replace(shape, depth_m=depth_m)))
    assert ragged["raggedness"] > describe(view.touch)["raggedness"] + 0.1
