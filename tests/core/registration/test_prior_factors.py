"""The factors of a prior in registration, fitted to the prior's values."""

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about, rotation_angle
from tactile_loc.core.poses.priors import GaussianPrior, RegionPrior
from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.registration.prior_factors import draw_around, fit_prior_factors
from tactile_loc.core.sensing.scene import View
from tactile_loc.core.sensing.touch import Touch

PRESS_M = 1e-3
STD_M, STD_RAD = 4e-3, 0.15
PEAK = make_transform(rotation_about([1, 2, 3], 0.7), np.array([2e-3, -1e-3, 3e-2]))
MIDDLE_M = np.array([1e-3, 4e-3, -6e-3])


def draw_poses(count: int, shift_m: float, turn_rad: float) -> np.ndarray:
    rng = np.random.default_rng(3)
    turns = [rotation_about(rng.normal(size=3), turn_rad * rng.uniform()) for _ in range(count)]
    return np.stack([make_transform(R, shift_m * rng.normal(size=3)) @ PEAK for R in turns])


def test_the_peak_and_the_information_of_a_gaussian_prior_are_found_from_its_values():
    prior = GaussianPrior(PEAK, STD_M, STD_RAD)
    factors = fit_prior_factors(prior, draw_poses(20, 5e-3, 0.5), MIDDLE_M)
    assert np.abs(factors.T[:, :3, 3] - PEAK[:3, 3]).max() < 2e-4
    assert rotation_angle(factors.T[:, :3, :3] @ PEAK[:3, :3].T).max() < 0.02
    assert factors.information[:, range(3, 6), range(3, 6)] == pytest.approx(1 / STD_M**2, rel=0.02)
    weights = prior(draw_around(fit_prior_factors(prior, PEAK[None], MIDDLE_M), 400, MIDDLE_M))
    assert weights[0] == pytest.approx(0, abs=1e-3)
    assert -weights.mean() == pytest.approx(3, rel=0.2)  # half of the six degrees of freedom


def test_no_factor_where_a_prior_is_flat_or_excludes_neighbours():
    poses = draw_poses(5, 1e-3, 0.1)
    region = RegionPrior([-1, -1, -1], [1, 1, 1], [0, 0, 0])
    outside = RegionPrior([-1, -1, -1], [1, 1, poses[:, 2, 3].max() + 5e-5], [0, 0, 0])
    for prior, some in ((region, slice(None)), (outside, [poses[:, 2, 3].argmax()])):
        factors = fit_prior_factors(prior, poses[some], np.zeros(3))
        assert not factors.information.any()
        np.testing.assert_array_equal(factors.T, poses[some])


@pytest.fixture
def edge_touch(make_box, make_scene, flat_camera):
    """Return the view of a touch of a long edge, and the true pose. A shift along the edge changes nothing."""
    scene = make_scene(make_box(0.08, 0.01, 0.01), flat_camera).press(PRESS_M)
    true = scene.bring_to_contact(make_transform(rotation_about([1, 0, 0], np.pi / 4), np.zeros(3))[None])[0][0]
    return View(Touch(scene.contact_shape(true, PRESS_M), scene.geometry), scene), true


def test_a_prior_decides_only_what_a_touch_leaves_open(edge_touch):
    view, true = edge_touch
    expected = make_translation([3e-3, -2e-3, 2e-3]) @ true  # the touch contradicts the shifts along y and z
    prior = GaussianPrior(expected, STD_M, STD_RAD)
    engine = JointRegistration()
    alone, pulled = (engine.register_coarsely([view], true[None], prior=one)[0] for one in (None, prior))
    assert pulled[0, 3] == pytest.approx(expected[0, 3], abs=2e-4)
    assert np.abs(alone[0, 3] - expected[0, 3]) > 2e-3
    assert pulled[1:3, 3] == pytest.approx(alone[1:3, 3], abs=2e-5)
    assert rotation_angle(pulled[:3, :3] @ alone[:3, :3].T) < 0.01


def test_registration_with_factors_of_zero_is_that_without_a_prior(edge_touch):
    view, true = edge_touch
    starts = np.stack(
        [
            make_translation([0, 0, z]) @ make_transform(rotation_about([1, 1, 0], a), np.zeros(3)) @ true
            for z in (-3e-4, 4e-4)
            for a in (0.05, -0.08)
        ]
    )
    both = [View(view.touch, view.scene), View(view.touch, view.scene, make_translation([1e-3, 0, 0]), 1e-4, 1e-3)]
    for views in (both[:1], both):
        alone, flat = (
            JointRegistration().register_coarsely(views, starts, prior=prior)
            for prior in (None, lambda poses: np.zeros(len(poses)))
        )
        np.testing.assert_array_equal(alone, flat)
        assert not np.array_equal(alone, starts)
