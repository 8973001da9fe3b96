"""Sets of poses contain the true pose with the requested coverage, even for wrong probabilities."""

import math

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.probability.conformal import ELSEWHERE, RARE, RIGHT_M, PoseSet, Ranking, find_level


def draw(rng: np.random.Generator, sureness: float) -> tuple[Ranking, int]:
    """Return a ranking whose logits are `sureness` times too large, and the right item."""
    logits = rng.normal(size=12) * rng.uniform(0.3, 3)
    p = np.exp(logits) / np.exp(logits).sum()
    right = int(rng.choice(12, p=p))
    said = np.exp(sureness * logits) / np.exp(sureness * logits).sum()
    order = np.argsort(-said[:-1])
    poses = said[:-1][order] / said[:-1].sum()
    return Ranking(poses, said[-1]), ELSEWHERE if right == 11 else int(np.flatnonzero(order == right)[0])


def holds(found: PoseSet, right: int) -> bool:
    return found.elsewhere if right == ELSEWHERE else right < found.poses


@pytest.mark.parametrize("sureness", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("coverage", [0.5, 0.9])
def test_the_set_contains_the_right_item_with_the_requested_coverage(sureness, coverage):
    rng, held = np.random.default_rng(0), []
    for _ in range(150):
        drawn = [draw(rng, sureness) for _ in range(38)]
        ranking, right = draw(rng, sureness)
        held.append(holds(PoseSet.of(ranking, np.array([r.score(k) for r, k in drawn]), coverage), right))
    assert np.mean(held) > coverage - 0.06


def test_a_score_is_the_probability_of_all_likelier_poses():
    ranking = Ranking(np.array([0.5, 0.25, 0.25]), 0.3)
    assert [ranking.score(k) for k in (0, 1, 2)] == pytest.approx([0.0, 0.5, 0.5])
    assert [ranking.count(level) for level in (0.0, 0.4, 0.5, math.inf)] == [1, 1, 3, 3]


def test_the_score_of_elsewhere_falls_with_its_probability():
    scores = [Ranking(np.ones(1), e).score(ELSEWHERE) for e in (0.0, RARE / 20, 1.0)]
    assert scores == pytest.approx([1.0, 0.95, 1 - 1 / RARE])


def test_a_ranking_scales_probabilities_to_a_sum_of_one():
    assert Ranking.of([0.6, 0.2], 0.3).probabilities == pytest.approx([0.75, 0.25])
    assert Ranking.of([0.0, 0.0], 0.5).probabilities == pytest.approx([0.5, 0.5])


def test_the_level_is_the_finite_sample_quantile():
    scores = np.array([0.4, 0.1, 0.3, 0.2])
    assert [find_level(scores, c) for c in (0.2, 0.21, 0.4, 0.8, 0.81)] == [0.1, 0.2, 0.2, 0.4, math.inf]


@pytest.mark.parametrize("coverage", [1.0, 0.0, -1.0, math.nan])
def test_an_impossible_coverage_is_refused(coverage):
    with pytest.raises(ConfigError, match="coverage"):
        PoseSet.of(Ranking.of([1.0], 0.0), np.array([0.4]), coverage)


def test_a_promised_set_has_no_reason_and_a_doubt_is_one():
    ranking, scores = Ranking.of([0.9, 0.1], 0.01), np.zeros(30)
    found = PoseSet.of(ranking, scores, 0.95)
    assert (found.poses, found.elsewhere, found.promised, found.reason) == (1, False, True, "")
    assert (found.coverage, found.level, found.examples, found.radius_m) == (0.95, 0.0, 30, RIGHT_M)
    doubted = PoseSet.of(ranking, scores, 0.95, "The touches contradict.")
    assert (doubted.poses, doubted.promised, doubted.meaning) == (1, False, "The touches contradict.")


def test_a_set_includes_elsewhere_if_its_coverage_needs_it():
    ranking, scores = Ranking.of([0.9, 0.1], 0.4), np.array([0.0, 0.3, 1.0, 1.0])
    few, many = (PoseSet.of(ranking, scores, coverage) for coverage in (0.2, 0.8))
    assert (few.poses, few.elsewhere, few.promised) == (1, False, True)
    assert (many.poses, many.elsewhere, many.promised, many.missed) == (2, True, False, 0.4)
    assert "40 %" in many.reason


def test_a_coverage_that_too_few_examples_support_is_not_promised():
    found = PoseSet.of(Ranking.of([0.9, 0.1], 0.01), np.zeros(4), 0.9)
    assert (found.poses, found.elsewhere, found.promised) == (2, True, False)
    assert "4 simulated examples" in found.reason
    assert "80 %" in found.reason


def test_a_result_lists_the_poses_of_the_set_that_is_asked_for_or_configured(localizer):
    touch = localizer.simulate(1, seed=3, noise="strong")[0]
    few, many = (localizer.localize(touch, top=1, coverage=c) for c in (0.2, 0.8))
    assert [len(found.hypotheses) for found in (few, many)] == [few.pose_set.poses, many.pose_set.poses]
    assert few.pose_set.poses <= many.pose_set.poses
    assert localizer.localize(touch).pose_set is None
    asking = Localizer(localizer.config.model_copy(update={"coverage": 0.8}), localizer.object, localizer.store)
    assert vars(asking.localize(touch).pose_set) == vars(many.pose_set)
