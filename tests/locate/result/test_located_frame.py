"""The covariances of all poses of a frame, in the sensor's frame and in another one."""

import numpy as np

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.locate.result.located_frame import LocatedFrame, stack_covariances
from tactile_loc.locate.result.verdict import Verdict


def test_unknown_covariances_are_nan():
    stacked = stack_covariances([np.eye(6), None])
    np.testing.assert_array_equal(stacked[0], np.eye(6))
    assert np.isnan(stacked[1]).all()
    assert stack_covariances([]).shape == (0, 6, 6)


def test_covariances_turn_with_the_frame():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(2, 6, 6))
    covariances = A @ A.transpose(0, 2, 1)
    frame = LocatedFrame(
        Verdict.AMBIGUOUS, np.stack([np.eye(4)] * 2), np.array([0.6, 0.4]), covariances[0], covariances=covariances
    )
    R = rotation_about([1, 2, 3], 0.7)
    moved = frame.view_from(make_transform(R, [0.1, 0.2, 0.3]))
    errors = rng.multivariate_normal(np.zeros(6), covariances[1], 200_000)
    turned = np.hstack([errors[:, :3] @ R.T, errors[:, 3:] @ R.T])
    np.testing.assert_allclose(moved.covariances[1], np.cov(turned.T), atol=0.03 * np.abs(covariances[1]).max())
    np.testing.assert_array_equal(moved.covariances[0], moved.covariance)
