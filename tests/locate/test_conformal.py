"""Sets hold the truth with the requested coverage, even for wrong probabilities."""

from __future__ import annotations

import math

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.geometry.rigid import make_transform
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.locate import conformal as module
from tactile_loc.locate.conformal import ConformalSets, PoseSet
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.store import StageStore

COARSE = {"grid": {"name": "face", "spacing_mm": 8}, "refiner": "none"}


@pytest.fixture(scope="module")
def grid(box):
    return PoseGrid(make_transform(np.eye(3), np.arange(30)[:, None] * np.array([1e-3, 0, 0])), PoseMetric(box))


def example(grid: PoseGrid, rng: np.random.Generator, sureness: float) -> tuple[PosePosterior, int]:
    """Return a posterior whose logits are `sureness` times too large, and a truth."""
    logits = rng.normal(size=len(grid)) * rng.uniform(0.3, 3)
    truth = rng.choice(len(grid), p=np.exp(logits) / np.exp(logits).sum())
    return PosePosterior(grid, sureness * logits), int(truth)


@pytest.mark.parametrize("sureness", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("coverage", [0.5, 0.9])
def test_the_set_holds_the_truth_with_the_requested_coverage(grid, sureness, coverage):
    rng, held = np.random.default_rng(0), []
    for _ in range(150):
        drawn = [example(grid, rng, sureness) for _ in range(76)]
        sets = ConformalSets([p.credible_level(t) for p, t in drawn], [p.entropy for p, _ in drawn])
        posterior, truth = example(grid, rng, sureness)
        held.append(truth in PoseSet.of(posterior, sets, coverage).indices)
    assert abs(np.mean(held) - coverage) < 0.09


def test_the_level_is_the_finite_sample_quantile():
    sets = ConformalSets([0.4, 0.1, 0.3, 0.2], [1.0] * 4)
    assert [sets.level(c, 1.0) for c in (0.2, 0.21, 0.4, 0.8)] == [0.1, 0.2, 0.2, 0.4]


def test_uncertain_posteriors_use_the_levels_of_the_most_uncertain_quarter():
    sets = ConformalSets([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.9, 0.95], [1.0, 1, 1, 1, 1, 1, 5, 6])
    assert sets.find_alike(5.5).tolist() == [0.9, 0.95]
    assert sets.level(0.5, 1.5) == 0.4
    assert sets.level(0.5, 7.0) == 0.95


@pytest.mark.parametrize("coverage", [0.81, 0.99, 1.0, 0.0, -1.0, math.nan])
def test_a_coverage_that_too_few_examples_support_is_refused(coverage):
    with pytest.raises(ConfigError, match=naming(f"{coverage:g}", 4, 0.8)):
        ConformalSets([0.4, 0.1, 0.3, 0.2], [1.0] * 4).level(coverage, 1.0)


def test_a_set_reports_its_coverage_level_and_examples(grid):
    posterior = PosePosterior(grid, -np.arange(30.0))
    found = PoseSet.of(posterior, ConformalSets([0.0, 0.7, 0.2], [0.5] * 3), 0.75)
    assert (found.coverage, found.level, found.examples) == (0.75, 0.7, 3)
    assert found.indices.tolist() == [0, 1], "the first pose has a probability of 0.63, the first two 0.86"


def test_a_set_includes_elsewhere_if_its_coverage_needs_it(grid):
    missed = ConformalSets([0.0, 0.3, 1.0, 1.0], [0.5] * 4)
    posterior = PosePosterior(grid, -np.arange(30.0), elsewhere=0.4)
    few, all_found = (PoseSet.of(posterior, missed, coverage) for coverage in (0.4, 0.8))
    assert not few.elsewhere
    assert all_found.elsewhere
    assert len(all_found.indices) == 30
    assert not PoseSet.of(PosePosterior(grid, -np.arange(30.0)), missed, 0.8).elsewhere, (
        "a grid that lists all poses needs no elsewhere"
    )


def test_a_localisation_lists_all_modes_of_the_set(store):
    localizer = Localizer.create("pin", store=store, **COARSE)
    touch = localizer.simulate(1, seed=3, noise="strong")[0]
    sets = localizer.probabilities.conformal_sets(1)
    assert len(sets.scores) == module.EXAMPLES
    assert all(0 <= score <= 1 for score in sets.scores)
    assert all(0 <= entropy <= np.log(localizer.model.size) for entropy in sets.entropies)
    few, many = (localizer.localize(touch, top=1, coverage=c) for c in (0.5, 0.9))
    assert len(few.hypotheses) <= len(many.hypotheses)
    assert len(many.pose_set.indices) == sum(h.grid_poses for h in many.hypotheses)
    assert sum(h.probability for h in many.hypotheses) == pytest.approx(
        many.posterior.probabilities[many.pose_set.indices].sum()
    )
    assert localizer.localize(touch).pose_set is None


def test_examples_are_held_out_once_for_each_number_of_touches(tmp_path, monkeypatch):
    store = StageStore(tmp_path)
    monkeypatch.setattr(module, "EXAMPLES", 4)
    localizer = Localizer.create("pin", store=store, temperature=0.01, **COARSE)
    one, two = localizer.probabilities.conformal_sets(1), localizer.probabilities.conformal_sets(2)
    assert one != two
    assert localizer.probabilities.conformal_sets(9) == localizer.probabilities.conformal_sets(module.MOST_TOUCHES)
    again = Localizer.create("pin", store=store, temperature=0.01, **COARSE)
    monkeypatch.setattr(Localizer, "simulate", None)
    assert again.probabilities.conformal_sets(1) == one
