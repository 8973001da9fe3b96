"""Posteriors, their modes, and orders that rounding cannot change."""

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import ObjectModel, PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import TIE_NATS, PosePosterior, group_ties, rank_poses
from tactile_loc.plugin import GridError
from tactile_loc.plugin.helpers import draw_rotations, make_transform, make_translation, rotation_about
from tactile_loc.testing.problems import make_block


def line(obj: ObjectModel, x_m: np.ndarray) -> PoseGrid:
    """Return a grid of poses along x at `x_m` (metres)."""
    return PoseGrid(make_translation(np.column_stack([x_m, 0 * x_m, 0 * x_m])), PoseMetric(obj))


@pytest.fixture
def grid(box) -> PoseGrid:
    return line(box, 0.002 * np.arange(6.0))


@pytest.fixture
def posterior(grid) -> PosePosterior:
    with np.errstate(divide="ignore"):
        return PosePosterior(grid, np.log([0.5, 0.2, 0.0, 0.2, 0.1, 0.0]), touches=3)


def test_probabilities_are_normalised_at_any_scale(grid):
    weights = np.array([1.0, 2, 3, 4, 0, 6])
    with np.errstate(divide="ignore"):
        log_weights = np.log(weights)
    for shift in (0.0, 1e4, -1e4):
        posterior = PosePosterior(grid, log_weights + shift)
        np.testing.assert_allclose(posterior.probabilities, weights / weights.sum(), atol=1e-11)
        assert posterior.probabilities.sum() == pytest.approx(1.0)
        assert posterior.log_p[4] == -np.inf


@pytest.mark.parametrize(
    "log_p",
    [
        np.full(6, -np.inf),
        np.array([0, 0, np.nan, 0, 0, 0.0]),
        np.array([0, 0, np.inf, 0, 0, 0.0]),
        np.zeros(5),
        np.zeros((6, 1)),
    ],
)
def test_an_invalid_distribution_is_refused(grid, log_p):
    with pytest.raises(GridError):
        PosePosterior(grid, log_p)


def test_top_poses_are_ordered_with_ties_by_index(grid):
    posterior = PosePosterior(grid, np.array([-2.0, -1, -3, -1, -np.inf, 0]))
    assert posterior.top(6).tolist() == [5, 1, 3, 0, 2, 4]
    assert posterior.top(2).tolist() == [5, 1]
    assert posterior.top(3).tolist() == [5, 1, 3]
    assert posterior.top(100).tolist() == posterior.top(6).tolist()
    assert posterior.top(1).tolist() == [5]


def test_entropy_has_known_values(grid):
    assert PosePosterior(grid, np.full(6, 3.0)).entropy == pytest.approx(np.log(6))
    certain = np.full(6, -np.inf)
    certain[2] = 0
    assert PosePosterior(grid, certain).entropy == 0.0
    halves = certain.copy()
    halves[4] = 0
    assert PosePosterior(grid, halves).entropy == pytest.approx(np.log(2))


def test_sample_frequencies_equal_the_probabilities(posterior):
    drawn = posterior.sample(20_000, np.random.default_rng(0))
    assert drawn.shape == (20_000, 4, 4)
    frequency = np.bincount(np.rint(drawn[:, 0, 3] / 0.002).astype(int), minlength=6) / 20_000
    np.testing.assert_allclose(frequency, posterior.probabilities, atol=0.015)
    assert frequency[2] == frequency[5] == 0
    again, other = (posterior.sample(20_000, np.random.default_rng(seed)) for seed in (0, 1))
    assert np.array_equal(again, drawn)
    assert not np.array_equal(other, drawn)


def test_a_credible_set_has_the_fewest_poses_of_its_mass(posterior):
    assert posterior.credible_set(0.0).tolist() == [0]
    assert posterior.credible_set(0.49).tolist() == [0]
    assert sorted(posterior.credible_set(0.6)) == [0, 1, 3], "both of two equally probable poses are included"
    assert sorted(posterior.credible_set(1.0)) == [0, 1, 3, 4], "poses of zero probability are excluded"


def test_a_pose_is_in_all_credible_sets_from_its_level(grid):
    posterior = PosePosterior(grid, np.random.default_rng(3).normal(size=6))
    for index in range(6):
        level = posterior.credible_level(index)
        assert index in posterior.credible_set(level)
        assert index not in posterior.credible_set(level - 1e-9)
        assert posterior.credible_level(index, 0.5) == pytest.approx(level + 0.5 * posterior.probabilities[index])


def test_a_tempered_posterior_has_powers_of_the_probabilities(posterior):
    found = posterior.temper(0.5)
    np.testing.assert_allclose(found.probabilities, (root := np.sqrt(posterior.probabilities)) / root.sum())
    surer = posterior.temper(2.0).probabilities
    np.testing.assert_allclose(surer, (square := posterior.probabilities**2) / square.sum())
    assert found.touches == 3
    assert found.log_train is None
    assert found.entropy > posterior.entropy


def test_tempering_includes_the_training_distribution(grid):
    log_train = np.log([1.0, 2, 3, 4, 5, 6])
    posterior = PosePosterior(grid, np.zeros(6), log_train)
    np.testing.assert_allclose(posterior.temper(0.3).log_train, 0.3 * log_train)
    assert posterior.temper(1.0) is posterior


def test_modes_are_clusters_of_poses(box):
    x_m = np.array([0.0, 1, 2, 50, 51, 90]) * 1e-3
    weights = np.array([0.1, 0.3, 0.1, 0.15, 0.25, 0.1])
    modes = PosePosterior(line(box, x_m), np.log(weights)).modes(radius_m=1.5e-3, mass=1.0)
    assert [m.index for m in modes] == [1, 4, 5]
    assert [sorted(m.members) for m in modes] == [[0, 1, 2], [3, 4], [5]]
    np.testing.assert_allclose([m.probability for m in modes], [0.5, 0.4, 0.1])
    np.testing.assert_allclose(modes[1].T_sensor_object, make_translation([0.051, 0, 0]))


def test_modes_are_ordered_by_their_mass_and_exclude_the_tail(box):
    def find(x_mm: list[float], weights: list[float], **limits: float) -> list[int]:
        with np.errstate(divide="ignore"):
            posterior = PosePosterior(line(box, 1e-3 * np.array(x_mm)), np.log(weights))
        return [mode.index for mode in posterior.modes(1.5e-3, **limits)]

    assert find([0.0, 50, 51, 52], [0.34, 0.22, 0.22, 0.22], mass=1.0) == [1, 0]
    assert find([0.0, 100, 200], [0.9, 0.08, 0.02], mass=0.95) == [0, 1]
    assert find([0.0, 100, 200], [0.9, 0.08, 0.02], mass=0.5) == [0]
    assert sorted(find([0.0, 100, 200], [0.5, 0.0, 0.5])) == [0, 2], "excluded poses form no mode"


def test_mode_masses_sum_to_one_and_count_limits_the_modes(box):
    rng = np.random.default_rng(1)
    posterior = PosePosterior(line(box, rng.uniform(0, 0.5, 200)), rng.normal(size=200))
    modes = posterior.modes(radius_m=1e-3, count=1000, mass=1.0)
    assert sum(m.probability for m in modes) == pytest.approx(1.0)
    members = np.concatenate([m.members for m in modes])
    assert sorted(members) == list(range(200)), "every pose is in one mode"
    p = [m.probability for m in modes]
    assert p == sorted(p, reverse=True)
    assert [m.index for m in posterior.modes(1e-3, count=4, mass=1.0)] == [m.index for m in modes[:4]]
    for mode in modes:
        assert mode.index == mode.members[posterior.log_p[mode.members].argmax()]
        assert mode.probability == pytest.approx(posterior.probabilities[mode.members].sum())


@pytest.mark.parametrize(("symmetry", "count"), [("none", 4), ("z2", 2), ("x2*y2", 1)])
def test_equivalent_poses_form_one_mode(make_box, symmetry, count):
    turns = make_box(0.03, 0.02, 0.01, symmetry="x2*y2").symmetry.list_elements()
    obj = make_box(0.03, 0.02, 0.01, symmetry=symmetry)
    rng = np.random.default_rng(2)
    T = make_transform(draw_rotations(1, rng), rng.normal(size=(1, 3)) * 0.01)
    posterior = PosePosterior(PoseGrid(T @ turns, PoseMetric(obj)), np.log([0.4, 0.3, 0.2, 0.1]))
    modes = posterior.modes(radius_m=1e-3, mass=1.0)
    assert len(modes) == count
    assert sum(m.probability for m in modes) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "log_train", [np.zeros(2), np.zeros(4), np.array([0.0, -np.inf, 0.0]), np.array([0.0, np.nan, 0.0])]
)
def test_a_training_distribution_requires_one_finite_value_per_pose(box, log_train):
    grid = PoseGrid(make_translation([[0.001 * k, 0, 0] for k in range(3)]), PoseMetric(box))
    assert PosePosterior(grid, np.zeros(3)).log_train is None
    with pytest.raises(GridError, match=naming(np.shape(log_train), 3)):
        PosePosterior(grid, np.zeros(3), log_train)


def test_probabilities_and_the_share_elsewhere_sum_to_one(box):
    posterior = PosePosterior(line(box, np.arange(4) * 0.01), np.log([0.1, 0.2, 0.3, 0.4]), elsewhere=0.5)
    assert posterior.probabilities == pytest.approx([0.05, 0.1, 0.15, 0.2])
    all_five = np.array([0.05, 0.1, 0.15, 0.2, 0.5])
    assert posterior.entropy == pytest.approx(-(all_five * np.log(all_five)).sum())
    assert len(posterior.sample(10, np.random.default_rng(0))) == 10
    assert posterior.credible_set(0.4).tolist() == [3, 2, 1]
    assert posterior.temper(0.5).elsewhere == 0.5


@pytest.mark.parametrize("elsewhere", [-0.1, 1.0, float("nan")])
def test_an_impossible_share_elsewhere_is_refused(box, elsewhere):
    with pytest.raises(GridError, match=f"{elsewhere}"):
        PosePosterior(line(box, np.arange(2) * 0.01), np.zeros(2), elsewhere=elsewhere)


METRIC = PoseMetric(make_block())


def draw_poses(count: int, rng: np.random.Generator) -> np.ndarray:
    R = np.stack([rotation_about(rng.normal(size=3), rng.uniform(0, 3)) for _ in range(count)])
    return make_transform(R, rng.normal(scale=0.01, size=(count, 3)))


def test_a_group_has_the_values_within_the_tie_of_its_greatest():
    worth = np.array([0.5, 1.0, 0.95, 0.87, -np.inf, 0.79, -np.inf])
    assert group_ties(worth, 0.1).tolist() == [2, 0, 0, 1, 3, 1, 3]
    assert group_ties(np.full(3, -np.inf), 0.1).tolist() == [0, 0, 0]
    assert group_ties(np.zeros(0), 0.1).tolist() == []


def test_equal_poses_have_one_order_however_they_are_given():
    rng = np.random.default_rng(4)
    poses, worth = draw_poses(8, rng), np.repeat([0.0, 1.0], 4)
    expected = poses[rank_poses(group_ties(worth, TIE_NATS), poses, METRIC)]
    assert sorted(rank_poses(group_ties(worth, TIE_NATS), poses, METRIC)[:4]) == [4, 5, 6, 7]
    for _ in range(5):
        order = rng.permutation(8)
        noisy = worth[order] + rng.uniform(-1, 1, 8) * TIE_NATS / 3
        assert np.array_equal(poses[order][rank_poses(group_ties(noisy, TIE_NATS), poses[order], METRIC)], expected)
