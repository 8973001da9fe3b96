"""Mounts are found among wrong hypotheses, up to symmetry; outliers and poor motions are named."""

import dataclasses

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import Localizer, PoseMetric
from tactile_loc.core.geometry.hand_eye import predict
from tactile_loc.core.geometry.lie import compute_pose_errors, move
from tactile_loc.core.runtime.errors import MountError
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.io.mount_files import Mount, read_mount, write_mount
from tactile_loc.locate.result.localization import Hypothesis
from tactile_loc.planning import hand_eye_calibration as module
from tactile_loc.planning.hand_eye_calibration import (
    FlangeTouches,
    calibrate_hand_eye,
    make_hand_eye_record,
    require_determined,
    require_motions,
)
from tactile_loc.planning.hand_eye_starts import AGREES_M, list_hand_eye_starts
from tactile_loc.plugin import RefinedPose, Scene
from tactile_loc.plugin.helpers import draw_rotations, invert, make_transform, make_translation, rotation_about
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer
from tactile_loc.simulate.touch_simulation import simulate_touches

COUNT = 8


def poses(count: int, std_m: float, rng: np.random.Generator) -> np.ndarray:
    return make_transform(draw_rotations(count, rng), std_m * rng.normal(size=(count, 3)))


@pytest.fixture(scope="module")
def truth():
    rng = np.random.default_rng(1)
    return poses(1, 0.05, rng)[0], poses(1, 0.3, rng)[0]


def hypotheses_of(S: np.ndarray, obj, rng: np.random.Generator) -> list[np.ndarray]:
    """Return, for each touch, nine wrong poses and one near the true pose or an equivalent."""
    same = obj.symmetry.list_elements()
    found = []
    for T in move(S, np.array([1e-4] * 3 + [5e-3] * 3) * rng.normal(size=(len(S), 6))):
        found.append(np.concatenate([poses(9, 0.02, rng), [T @ same[rng.integers(len(same))]]]))
    return found


@pytest.mark.parametrize("which", ["none", "x2*y2", "zinf*x2"])
def test_the_mount_is_found_among_wrong_and_equivalent_hypotheses(make_box, cylinder, truth, which):
    obj = cylinder if which == "zinf*x2" else make_box(0.03, 0.02, 0.012, symmetry=which)
    rng, (X, Y) = np.random.default_rng(5), truth
    S = poses(COUNT, 0.02, rng)
    F = Y @ invert(S) @ invert(X)
    hypotheses = hypotheses_of(S, obj, rng)
    hypotheses[2] = poses(10, 0.02, rng)  # not found at all
    (guess, *_) = list_hand_eye_starts(F, hypotheses, PoseMetric(obj), 2)
    off = compute_pose_errors(X, guess.T_flange_sensor)
    assert np.linalg.norm(off[:3]) < 1.5e-3
    assert np.linalg.norm(off[3:]) < np.radians(4.0)
    assert (guess.off_m < AGREES_M).tolist() == [k != 2 for k in range(COUNT)]


def test_a_nominal_mount_excludes_other_mounts(box, truth):
    rng, (X, Y) = np.random.default_rng(5), truth
    S = poses(COUNT, 0.02, rng)
    F, hypotheses = Y @ invert(S) @ invert(X), hypotheses_of(S, box, rng)
    nominal = (X @ make_translation([x, 0, 0]) for x in (0.01, 0.1))
    allowed = [lambda T, N=N: module._is_near(T, N) for N in nominal]
    near, far = (list_hand_eye_starts(F, hypotheses, PoseMetric(box), 1, some) for some in allowed)
    assert (near[0].off_m < AGREES_M).all()
    assert not far or (far[0].off_m < AGREES_M).sum() < COUNT / 2


class Case:
    """Return simulated touches of the pin with given hypotheses, to test the use of the hypotheses."""

    def __init__(self, localizer: Localizer, truth) -> None:
        rng, (self.X, self.Y) = np.random.default_rng(2), truth
        scene = Scene(localizer.object, localizer.scene.geometry, ZBufferRenderer())
        touches = simulate_touches(localizer.sampler, scene, COUNT, rng, None, NOISE["mild"])
        S = np.stack([touch.T_sensor_object for touch in touches])
        self.localizer, self.seen = localizer, S
        self.given = FlangeTouches(tuple(touches), self.Y @ invert(S) @ invert(self.X))

    def located(self, localizer, touches) -> list[tuple[Hypothesis, ...]]:
        rng = np.random.default_rng(3)
        off = np.array([5e-4] * 3 + [0.02] * 3) * rng.normal(size=(len(touches), 6))
        poses = move(np.stack([touch.T_sensor_object for touch in touches]), off)
        ious = [float(localizer.scene.imprint_ious(t.T_sensor_object[None], t)[0]) for t in touches]
        return [
            (Hypothesis(1.0, T, RefinedPose(T, 1.0, True, 1), 0, 1, iou),) for T, iou in zip(poses, ious, strict=True)
        ]


@pytest.fixture(scope="module")
def case(store, truth):
    localizer = Localizer.create("pin", sensor="gelsight-mini", store=store)
    made = Case(localizer, truth)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_locate", made.located)
        yield made


def test_the_mount_is_found_and_written(case, tmp_path):
    found = calibrate_hand_eye(case.localizer, case.given)
    e = compute_pose_errors(case.X, found.mount.T_flange_sensor)
    assert np.linalg.norm(e[:3]) < 5e-4
    assert np.linalg.norm(e[3:]) < np.radians(1.5)
    assert e @ np.linalg.solve(found.mount.covariance, e) < 17  # 99 %
    assert found.kept.all()
    assert np.median(found.residuals[:, 0]) < np.median(found.first_residuals[:, 0])
    seen = predict(case.given.T_base_flange, found.fit.T_flange_sensor, found.fit.T_base_object)
    off_m = PoseMetric(case.localizer.object).symmetric_distance(seen, case.seen)
    assert off_m.max() < 1e-3
    record = make_hand_eye_record(case.localizer, found)
    again = read_mount(write_mount(tmp_path / "mount.toml", record))
    np.testing.assert_array_equal(again.T_flange_sensor, found.mount.T_flange_sensor)
    assert [touch.left_out for touch in record.touch] == [""] * COUNT


def test_a_wrong_touch_is_named_and_excluded(case):
    T = case.given.T_base_flange.copy()
    T[3] = T[3] @ make_translation([0.0, 0.006, 0.0])
    found = calibrate_hand_eye(case.localizer, dataclasses.replace(case.given, T_base_flange=T), Mount(case.X))
    assert np.flatnonzero(~found.kept).tolist() == [3]
    assert "imprint" in found.explain_left_out(3) or "mm" in found.explain_left_out(3)
    assert found.explain_left_out(0) == ""
    assert np.linalg.norm(compute_pose_errors(case.X, found.mount.T_flange_sensor)[:3]) < 5e-4


def test_contradicting_touches_are_refused(case):
    T = case.given.T_base_flange.copy()
    T[::2, :3, 3] += 0.05 * np.random.default_rng(0).normal(size=(COUNT // 2, 3))
    T[1, :3, 3] += 0.03
    with pytest.raises(MountError, match=naming(8, "T_base_flange")):
        calibrate_hand_eye(case.localizer, dataclasses.replace(case.given, T_base_flange=T))
    elsewhere = Mount(case.X @ make_translation([0.2, 0.0, 0.0]))
    with pytest.raises(MountError, match=naming(0, 8, "nominal")):
        calibrate_hand_eye(case.localizer, case.given, elsewhere)


def test_too_few_touches_and_poor_motions_are_named(case):
    few = case.given.select(np.arange(COUNT) < 3)
    with pytest.raises(MountError, match=naming(4, 3)):
        require_motions(few)
    shifted = make_transform(np.eye(3), 0.1 * np.random.default_rng(0).normal(size=(COUNT, 3)))
    with pytest.raises(MountError, match=naming("30 deg")):
        require_motions(dataclasses.replace(case.given, T_base_flange=shifted))
    for axis, name in (([0, 0, 1], r"\bz\b"), ([1, 2, 2], r"\(0.33, 0.67, 0.67\)")):
        turned = make_transform(rotation_about(axis, np.linspace(0, 2, COUNT)), shifted[:, :3, 3])
        with pytest.raises(MountError, match=naming("axis") + f".*{name}"):
            calibrate_hand_eye(case.localizer, dataclasses.replace(case.given, T_base_flange=turned))


def test_an_undetermined_direction_is_named():
    known = np.array([1e-8] * 3 + [1e-6] * 3)
    require_determined(np.diag(known))
    for number, std, words in ((1, 0.005, naming("5.0 mm") + r".*\by\b"), (5, 0.1, naming("5.7 deg") + r".*\bz\b")):
        with pytest.raises(MountError, match=words):
            require_determined(np.diag(np.where(np.arange(6) == number, std**2, known)))
