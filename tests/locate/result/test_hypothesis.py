"""A hypothesis's pose in the sensor frame and in the base frame, with its quaternions and covariances."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactile_loc import Hypothesis, PoseModes, RosPose, localize_together
from tactile_loc.plugin import RefinedPose
from tactile_loc.plugin.helpers import invert, make_transform


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return make_transform(Rotation.random(random_state=rng.integers(1 << 31)).as_matrix(), rng.normal(0, 0.1, 3))


def random_covariance(rng: np.random.Generator) -> np.ndarray:
    mixed = rng.normal(size=(6, 6)) * np.repeat([2e-4, 4e-3], 3)[:, None]
    return mixed @ mixed.T


@pytest.fixture
def hypothesis() -> Hypothesis:
    rng = np.random.default_rng(3)
    T = random_pose(rng)
    refined = RefinedPose(
        T, 1.0, True, 5, random_covariance(rng), T_reported_object=T, reported_covariance=random_covariance(rng)
    )
    return Hypothesis(0.5, T, refined, 0, 1, 1.0, T_base_sensor=random_pose(rng))


def seen_from_base(localizer, seed, std_m=2e-4, std_rad=3.5e-3):
    """A simulated touch whose sensor has a pose in the base frame, and this frame's true T_base_object."""
    (touch,) = localizer.simulate(1, seed=seed)
    T_base_sensor = random_pose(np.random.default_rng(seed))
    known = dataclasses.replace(
        touch, T_base_sensor=T_base_sensor, T_base_sensor_std_m=std_m, T_base_sensor_std_rad=std_rad
    )
    return known, T_base_sensor @ touch.T_sensor_object


def test_without_the_sensors_pose_there_is_no_pose_in_the_base_frame(hypothesis):
    unknown = dataclasses.replace(hypothesis, T_base_sensor=None)
    assert unknown.T_base_object is None
    assert unknown.base_quaternion_xyzw is None
    assert unknown.base_covariance is None


def test_quaternions_are_those_of_scipy_and_the_base_pose_is_a_message_of_ros_and_back(hypothesis):
    for q, T in (
        (hypothesis.quaternion_xyzw, hypothesis.T_sensor_object),
        (hypothesis.base_quaternion_xyzw, hypothesis.T_base_object),
    ):
        np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), T[:3, :3], atol=1e-12)
    message = RosPose.of(hypothesis.T_base_object, hypothesis.base_covariance)
    np.testing.assert_allclose(message.T, hypothesis.T_base_object, atol=1e-12)
    np.testing.assert_allclose(message.quaternion_xyzw, hypothesis.base_quaternion_xyzw)
    np.testing.assert_allclose(np.reshape(message.covariance, (6, 6)), hypothesis.base_covariance)


def test_the_base_covariance_is_that_of_drawn_errors(hypothesis):
    """Errors drawn in the sensor frame are carried to the base frame as poses, and measured there."""
    rng, T = np.random.default_rng(0), hypothesis.T_sensor_object
    errors = rng.multivariate_normal(np.zeros(6), hypothesis.refined.reported_covariance, 20_000)
    R = Rotation.from_rotvec(errors[:, 3:]).as_matrix() @ T[:3, :3]
    in_base = hypothesis.T_base_sensor @ make_transform(R, T[:3, 3] + errors[:, :3])
    estimate = hypothesis.T_base_object
    turned = Rotation.from_matrix(in_base[:, :3, :3] @ estimate[:3, :3].T).as_rotvec()
    measured = np.cov(np.concatenate([in_base[:, :3, 3] - estimate[:3, 3], turned], axis=1).T)
    std = np.sqrt(np.diag(hypothesis.base_covariance))
    np.testing.assert_allclose(
        measured / np.outer(std, std), hypothesis.base_covariance / np.outer(std, std), atol=0.05
    )


def test_the_error_of_the_sensors_pose_is_in_the_base_covariance(localizer):
    """Reported sensor poses with drawn errors: the base poses scatter as the covariance states, the sensor's do not."""
    std_m, std_rad = 1e-3, 0.02
    touch, _ = seen_from_base(localizer, 2, std_m, std_rad)
    best = localizer.localize(touch).best
    rng, gel_m = np.random.default_rng(1), localizer.sensor.geometry.gel_middle_m
    turn = Rotation.from_rotvec(rng.normal(0, std_rad, (20_000, 3))).as_matrix()
    shift = gel_m + rng.normal(0, std_m, (20_000, 3)) - turn @ gel_m
    in_base = touch.T_base_sensor @ make_transform(turn, shift) @ best.T_sensor_object
    turned = Rotation.from_matrix(in_base[:, :3, :3] @ best.T_base_object[:3, :3].T).as_rotvec()
    added = np.cov(np.concatenate([in_base[:, :3, 3] - best.T_base_object[:3, 3], turned], axis=1).T)
    own = np.kron(np.eye(2), touch.T_base_sensor[:3, :3])
    expected = own @ best.covariance @ own.T + added
    std = np.sqrt(np.diag(expected))
    # the registration counts the error about the middle of the contact, which is near the middle of the gel
    np.testing.assert_allclose(np.sqrt(np.diag(best.base_covariance)), std, rtol=0.25)


@pytest.mark.parametrize("refiner", ["joint", "icp"])
def test_one_touch_with_a_sensor_pose_has_a_pose_in_the_base_frame(localizer, refiner):
    touch, T_true = seen_from_base(localizer, 2)
    other = type(localizer)(
        localizer.config.model_copy(update={"refiner": localizer.config.refiner.model_copy(update={"name": refiner})}),
        localizer.object,
        localizer.store,
    )
    found = other.localize(touch)
    for one in found.hypotheses:
        np.testing.assert_allclose(one.T_base_object, touch.T_base_sensor @ one.T_sensor_object, atol=1e-9)
    T = min((one.T_base_object for one in found.hypotheses), key=lambda T: np.linalg.norm(T[:3, 3] - T_true[:3, 3]))
    assert np.linalg.norm(T[:3, 3] - T_true[:3, 3]) < 3e-3
    assert (np.diag(found.best.base_covariance)[3:] > 0.0035**2 * 0.99).all()
    assert "base frame" in found.summary()


def test_a_refiner_without_poses_of_several_sensors_gets_the_sensors_error(localizer, monkeypatch):
    """A covariance of the refiner's own is kept, and the error of the sensor's pose is added about the gel's middle."""
    from tactile_loc.core.geometry.lie import rotate_covariance

    touch, _ = seen_from_base(localizer, 2, 1e-3, 0.0)
    own = np.diag([1e-8] * 3 + [1e-6] * 3)
    refine = type(localizer.refinement.refiner).refine_together

    def refine_alone(self, views, candidates):
        return [
            RefinedPose(r.T_sensor_object, r.contact_iou, r.converged, r.iterations, own)
            for r in refine(self, views, candidates)
        ]

    monkeypatch.setattr(type(localizer.refinement.refiner), "refine_together", refine_alone)
    best = localizer.localize(touch).best
    expected = rotate_covariance(own + np.diag([1e-6] * 3 + [0.0] * 3), touch.T_base_sensor[:3, :3])
    np.testing.assert_allclose(best.base_covariance, expected, atol=1e-12)


def test_several_touches_average_the_errors_of_their_sensors_poses(localizer):
    """One of three sensors is reported 0.6 mm away. The base frame's pose moves less than that sensor's error."""
    touches = localizer.simulate(3, seed=4)
    T_base_object = random_pose(np.random.default_rng(8))
    placed = [dataclasses.replace(t, T_base_sensor=T_base_object @ invert(t.T_sensor_object)) for t in touches]
    wrong = placed[0].T_base_sensor.copy()
    wrong[:3, 3] += 6e-4 * wrong[:3, 0]
    placed[0] = dataclasses.replace(placed[0], T_base_sensor=wrong)
    best = localize_together([(localizer, touch) for touch in placed]).best
    off_m = np.linalg.norm(best.T_base_object[:3, 3] - T_base_object[:3, 3])
    alone_m = np.linalg.norm((wrong @ best.T_sensor_object)[:3, 3] - T_base_object[:3, 3])
    assert off_m < 0.8 * alone_m
    assert off_m < 4e-4


def test_the_next_touch_starts_from_the_pose_in_the_base_frame(localizer):
    touch, _ = seen_from_base(localizer, 2)
    found = localizer.localize(touch)
    modes = PoseModes.of(found)
    assert any(np.allclose(modes.T_base_object[0], h.T_base_object) for h in found.hypotheses)
