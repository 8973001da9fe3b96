"""Priors equal their formulas in every frame, symmetry included."""

import dataclasses

import numpy as np
import pytest
from message_helpers import naming
from pose_helpers import random_poses

from tactile_loc import PoseGrid, PoseMetric, PosePosterior
from tactile_loc.core.poses.priors import (
    GaussianPrior,
    HypothesesPrior,
    PosteriorPrior,
    ProductPrior,
    RegionPrior,
    SeenFrom,
    count_touches,
    temper,
)
from tactile_loc.plugin import ConfigError
from tactile_loc.plugin.helpers import (
    draw_rotations,
    invert,
    make_transform,
    make_translation,
    rotation_about,
    rotation_angle,
)


def posterior_of(obj, count: int = 80, seed: int = 0) -> PosePosterior:
    grid = PoseGrid(random_poses(count, seed), PoseMetric(obj))
    return PosePosterior(grid, np.random.default_rng(seed + 1).normal(scale=3.0, size=count))


class TestGaussian:
    def test_the_prior_equals_the_formula_of_a_gaussian(self):
        T, poses = random_poses(1, 0)[0], random_poses(50, 1)
        moved_m = np.linalg.norm(poses[:, :3, 3] - T[:3, 3], axis=1)
        angle_rad = rotation_angle(T[:3, :3].T @ poses[:, :3, :3])
        expected = -(moved_m**2) / (2 * 0.004**2) - angle_rad**2 / (2 * 0.2**2)
        np.testing.assert_allclose(GaussianPrior(T, 0.004, 0.2)(poses), expected, rtol=1e-9)

    def test_one_standard_deviation_gives_a_log_weight_of_minus_half(self):
        T = random_poses(1, 2)[0]
        turned = T @ make_transform(rotation_about([1, 2, 3], 0.2), np.zeros(3))
        poses = np.stack([T, make_translation([0, 0.004, 0]) @ T, turned])
        np.testing.assert_allclose(GaussianPrior(T, 0.004, 0.2)(poses), [0, -0.5, -0.5], atol=1e-9)

    def test_an_unknown_rotation_is_ignored(self):
        T = random_poses(1, 3)[0]
        turned = T @ make_transform(draw_rotations(9, np.random.default_rng(0)), np.zeros(3))
        np.testing.assert_allclose(GaussianPrior(T, 0.004, np.inf)(turned), 0, atol=1e-12)

    @pytest.mark.parametrize("symmetry", ["none", "z2", "x2*y2"])
    def test_the_prior_uses_the_nearest_equivalent_pose(self, make_box, symmetry):
        obj = make_box(0.03, 0.02, 0.01, symmetry=symmetry)
        T, poses = random_poses(1, 4)[0], random_poses(40, 5)
        same = poses[None] @ obj.symmetry.list_elements()[:, None]
        expected = np.max([GaussianPrior(T, 0.01, 0.5)(p) for p in same], axis=0)
        np.testing.assert_allclose(GaussianPrior(T, 0.01, 0.5, obj.symmetry)(poses), expected, atol=1e-9)

    def test_a_rotation_about_a_continuous_axis_does_not_change_the_prior(self, cylinder):
        T, poses = random_poses(1, 6)[0], random_poses(40, 7)
        prior = GaussianPrior(T, 0.01, 0.5, cylinder.symmetry)
        for S in cylinder.symmetry.list_elements(0.7):
            np.testing.assert_allclose(prior(poses @ S), prior(poses), atol=1e-7)
            assert prior((T @ S)[None]) == pytest.approx(0, abs=1e-9)
        finely = cylinder.symmetry.list_elements(0.01)
        expected = np.max([GaussianPrior(T, 0.01, 0.5)(poses @ S) for S in finely], axis=0)
        np.testing.assert_allclose(prior(poses), expected, atol=1e-3)

    @pytest.mark.parametrize(
        ("change", "value"),
        [
            ({"translation_std_m": 0.0}, "translation_std_m"),
            ({"rotation_std_rad": -1.0}, "rotation_std_rad"),
            ({"T": np.zeros((4, 4))}, "rigid"),
        ],
    )
    def test_invalid_means_and_deviations_are_refused(self, change, value):
        with pytest.raises(ConfigError, match=naming(value)):
            GaussianPrior(**{"T": np.eye(4), "translation_std_m": 0.01, "rotation_std_rad": 0.1, **change})


class TestHypotheses:
    def test_the_weight_is_the_sum_of_the_gaussians_and_the_floor(self):
        T, poses, p = random_poses(3, 0), random_poses(50, 1), np.array([0.5, 0.3, 0.2])
        listed = tuple(GaussianPrior(one, 0.02, 0.8) for one in T)
        expected = np.sum([p_k * np.exp(one(poses)) for p_k, one in zip(p, listed, strict=True)], axis=0) + 1e-3
        np.testing.assert_allclose(HypothesesPrior(listed, p, 1e-3)(poses), np.log(expected), rtol=1e-9)

    def test_located_poses_rank_the_hypotheses_by_bayes_theorem(self):
        T, p = random_poses(3, 2), np.array([0.5, 0.3, 0.2])
        prior = HypothesesPrior(tuple(GaussianPrior(one, 0.001, 0.02) for one in T), p)
        far = random_poses(1, 9)
        np.testing.assert_allclose(
            prior.rank(np.concatenate([T[1:2], far]), np.array([0.3, 0.1])), [0, 0.75, 0], atol=1e-3
        )
        twice = HypothesesPrior(tuple(GaussianPrior(T[0], 0.001, 0.02) for _ in p), p)
        np.testing.assert_allclose(twice.rank(T[:1], np.array([0.2])), p, atol=1e-4)

    def test_the_frame_changes_nothing(self):
        T, T_base_sensor, poses = random_poses(2, 3), random_poses(1, 4)[0], random_poses(20, 5)
        prior = HypothesesPrior(tuple(GaussianPrior(one, 0.02, 0.8) for one in T), np.array([0.5, 0.5]))
        seen = prior.view_from(T_base_sensor)
        np.testing.assert_allclose(seen(poses), prior(T_base_sensor @ poses))
        np.testing.assert_allclose(T_base_sensor @ seen.list_peaks(), T, atol=1e-12)
        both = seen * GaussianPrior(np.eye(4), 1.0, 9.0)
        np.testing.assert_allclose(both.list_peaks(), seen.list_peaks())

    @pytest.mark.parametrize(
        ("count", "probabilities", "floor"),
        [
            (0, [], 1e-6),
            (2, [1.0], 1e-6),
            (2, [0.5, 0.6], 1e-6),
            (2, [-0.5, 1.5], 1e-6),
            (1, [1.0], 1.0),
            (1, [1.0], -1),
        ],
    )
    def test_wrong_numbers_are_refused(self, count, probabilities, floor):
        with pytest.raises(ConfigError):
            HypothesesPrior((GaussianPrior(np.eye(4), 0.01, 0.5),) * count, np.array(probabilities), floor)


class TestRegion:
    def test_a_half_space_follows_the_sign_of_the_distance(self):
        poses, normal, border = random_poses(60, 8), np.array([1.0, -2.0, 0.5]), np.array([0.001, 0.002, -0.003])
        point = np.array([0.004, 0.0, 0.001])
        where = poses[:, :3, :3] @ point + poses[:, :3, 3]
        side = (where - border) @ normal > 0
        assert 10 < side.sum() < 50
        found = RegionPrior.half_space(normal, border, point)(poses)
        assert np.array_equal(found, np.where(side, 0.0, -np.inf))

    def test_a_box_may_be_open(self):
        poses = make_translation([[0, 0, 0], [0.002, 5, 0], [0.004, 0, 0], [0.002, 0, -0.1]])
        prior = RegionPrior([0.001, -np.inf, -0.01], [0.003, np.inf, np.inf], np.zeros(3))
        assert prior(poses).tolist() == [-np.inf, 0, -np.inf, -np.inf]

    def test_an_invalid_region_is_refused(self):
        with pytest.raises(ConfigError, match=naming("[1. 1. 1.]", "[0. 0. 0.]")):
            RegionPrior(np.ones(3), np.zeros(3), np.zeros(3))
        with pytest.raises(ConfigError, match=naming("[0. 0. 0.]")):
            RegionPrior.half_space(np.zeros(3), np.zeros(3), np.zeros(3))
        with pytest.raises(ConfigError, match="low_m"):
            RegionPrior(np.zeros(2), np.ones(3), np.zeros(3))


class TestFrames:
    def test_a_prior_in_the_base_frame_moves_with_the_sensor(self):
        T_base_sensor, T_base_object = random_poses(2, 9)
        prior = GaussianPrior(T_base_object, 0.01, 0.5).view_from(T_base_sensor)
        T_sensor_object = invert(T_base_sensor) @ T_base_object
        poses = random_poses(20, 10)
        np.testing.assert_allclose(prior(poses), GaussianPrior(T_sensor_object, 0.01, 0.5)(poses), atol=1e-9)
        with pytest.raises(ConfigError, match="T_base_sensor"):
            SeenFrom(prior, 2 * np.eye(4))

    def test_a_product_adds_the_logarithms(self):
        one, poses = GaussianPrior(np.eye(4), 0.01, 0.5), random_poses(20, 11)
        other = RegionPrior.half_space([0, 0, 1], np.zeros(3), np.zeros(3))
        np.testing.assert_array_equal((one * other)(poses), one(poses) + other(poses))
        assert ProductPrior(())(poses).tolist() == [0.0] * 20


class TestPosterior:
    @pytest.mark.parametrize("symmetry", ["none", "z2"])
    def test_the_prior_equals_the_formula_of_kernels(self, make_box, symmetry):
        earlier = posterior_of(make_box(0.03, 0.02, 0.01, symmetry=symmetry))
        motion, poses = random_poses(1, 12)[0], random_poses(30, 13)
        d = _distances(earlier.grid.metric, poses, motion @ earlier.grid.T_sensor_object)
        std_m = 0.02
        kernels = earlier.probabilities * np.exp(-(d**2) / (2 * std_m**2))
        expected = np.log(0.9 * kernels.sum(axis=1) + 0.1 / len(earlier.grid))
        found = PosteriorPrior(earlier, motion, std_m, floor=0.1)(poses)
        np.testing.assert_allclose(found, expected, atol=1e-4)  # a millionth of the mass is dropped

    def test_a_known_motion_finds_the_moved_pose(self, box):
        earlier = posterior_of(box)
        best, motion = int(earlier.log_p.argmax()), random_poses(1, 14)[0]
        here = motion @ earlier.grid.T_sensor_object
        assert PosteriorPrior(earlier, motion)(here).argmax() == best
        unmoved = PosteriorPrior(earlier, np.eye(4))(here)
        assert unmoved[best] < PosteriorPrior(earlier, motion)(here)[best] - 3

    def test_a_rotation_about_a_continuous_axis_does_not_change_the_posterior_prior(self, cylinder):
        earlier = posterior_of(cylinder)
        prior, T = PosteriorPrior(earlier, np.eye(4), 0.004), earlier.grid.T_sensor_object
        np.testing.assert_allclose(prior(T @ cylinder.symmetry.list_elements(0.3)[5]), prior(T), atol=1e-6)

    def test_the_prior_far_away_equals_the_floor(self, box):
        earlier = posterior_of(box)
        far = make_translation([1.0, 0, 0])[None]
        assert PosteriorPrior(earlier, np.eye(4), 0.001, floor=0.1)(far) == pytest.approx(np.log(0.1 / 80))
        assert PosteriorPrior(earlier, np.eye(4), 0.001, floor=0.0)(far)[0] == -np.inf

    def test_more_uncertainty_flattens_the_prior(self, box):
        earlier = posterior_of(box)
        T = earlier.grid.T_sensor_object
        sharp, flat = (np.ptp(PosteriorPrior(earlier, np.eye(4), std_m, 0.0)(T)) for std_m in (0.005, 0.05))
        assert flat < 0.2 * sharp

    def test_tempering_affects_only_priors_from_touches(self, box):
        earlier = dataclasses.replace(posterior_of(box), touches=3)
        prior, vision = PosteriorPrior(earlier, np.eye(4)), GaussianPrior(np.eye(4), 0.01, 0.5)
        both = (prior * vision).view_from(random_poses(1, 15)[0])
        asked = []
        found = temper(both, lambda touches: asked.append(touches) or 0.25)
        T = random_poses(20, 16)
        there = both.T_base_sensor @ T
        np.testing.assert_allclose(found(T), 0.25 * prior(there) + vision(there))
        assert asked == [count_touches(both)] == [3]
        assert temper(len, lambda _: 0.25) is len
        assert count_touches(len) == count_touches(None) == count_touches(vision) == 0

    def test_grids_with_an_offset_still_overlap(self, box):
        """The motion has no uncertainty and the grid is shifted by half a spacing."""
        x = np.stack(np.meshgrid(np.arange(5), np.arange(5), [0]), -1).reshape(-1, 3) * 0.004
        metric = PoseMetric(box)
        earlier = PosePosterior(PoseGrid(make_translation(x), metric), np.where(np.arange(25) == 12, 0.0, -40.0))
        prior = PosteriorPrior(earlier, np.eye(4))(make_translation(x + np.array([0.002, 0, 0])))
        assert set(np.flatnonzero(prior > prior.max() - 1e-9)) == {11, 12}
        assert prior.max() - prior.min() > 4

    @pytest.mark.parametrize(
        "change", [{"std_m": -1.0}, {"std_m": np.inf}, {"floor": 1.0}, {"T_new_old": np.ones((4, 4))}]
    )
    def test_invalid_motions_and_floors_are_refused(self, box, change):
        with pytest.raises(ConfigError, match=rf"\b{next(iter(change))}\b"):
            PosteriorPrior(**{"posterior": posterior_of(box), "T_new_old": np.eye(4), **change})


def _distances(metric: PoseMetric, T1: np.ndarray, T2: np.ndarray) -> np.ndarray:
    """Return the distances (M, N) up to symmetry, computed pair by pair."""
    return np.array([[metric.symmetric_distance(a[None], b[None])[0] for b in T2] for a in T1])


def test_the_share_elsewhere_of_an_earlier_posterior_is_spread_evenly(box):
    grid = PoseGrid(np.stack([make_translation([x, 0, 0]) for x in (0.0, 0.01)]), PoseMetric(box))
    far = make_translation([0.1, 0, 0])[None]
    sure, doubtful = (PosteriorPrior(PosePosterior(grid, np.zeros(2), elsewhere=e), np.eye(4)) for e in (0.0, 0.4))
    assert np.exp(sure(far)) == pytest.approx(1e-3 / 2)
    assert np.exp(doubtful(far)) == pytest.approx((1e-3 + 0.999 * 0.4) / 2)


@pytest.mark.parametrize("std_m", [1e-300, 1e300])
def test_a_gaussian_of_extreme_width_has_valid_weights(std_m):
    prior = GaussianPrior(np.eye(4), std_m, 1.0)
    away = make_transform(np.eye(3), [0.1, 0, 0])
    weights = prior(np.stack([np.eye(4), away]))
    assert weights[0] == 0
    assert weights[1] == (-np.inf if std_m < 1 else 0)
