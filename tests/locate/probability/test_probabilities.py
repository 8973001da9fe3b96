"""Probabilities from scores: fits recover known parameters, and probabilities are calibrated."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc.core.geometry.rigid import make_transform
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.priors import PosteriorPrior
from tactile_loc.core.runtime.errors import ConfigError, GridError
from tactile_loc.locate.localizer import Localizer, compute_posterior_together
from tactile_loc.locate.probability import probabilities as module
from tactile_loc.locate.probability.probabilities import (
    TAIL_HEAT,
    TAILS,
    FusedExample,
    FusedScaling,
    TemperatureScaling,
    fit_fused_scaling,
    fit_temperature_scaling,
)
from tactile_loc.store.store import StageStore

COARSE = {"grid": {"name": "face", "spacing_mm": 8}, "refiner": "none"}
SCORES = np.array([0.1, 0.5, 0.2, 0.0, -3.0, 0.5], np.float32)


def drawn(scaling: TemperatureScaling, touches: int, rng: np.random.Generator, poses: int = 60):
    """Return scores of touches, with true poses drawn from the probabilities of the scaling."""
    scores = rng.normal(size=(touches, poses))
    p = np.exp(scaling.log_p(scores))
    return list(scores), np.array([rng.choice(poses, p=row) for row in p])


def test_scores_become_a_softmax_and_the_tail_mixes_in_a_share_of_a_hotter_one():
    expected = np.exp(SCORES.astype(float) / 0.05)
    sharp, wide = (np.exp(TemperatureScaling(t).log_p(SCORES)) for t in (0.05, TAIL_HEAT * 0.05))
    np.testing.assert_allclose(sharp, expected / expected.sum(), rtol=1e-5)
    np.testing.assert_allclose(np.exp(TemperatureScaling(0.05, 0.3).log_p(SCORES)), 0.7 * sharp + 0.3 * wide, rtol=1e-9)


def test_probabilities_sum_to_one_and_excluded_poses_stay_excluded():
    with_gap = np.where(np.arange(6) == 2, -np.inf, SCORES)
    log_p = TemperatureScaling(0.01, 0.1).log_p(np.stack([with_gap, with_gap + 7]))
    np.testing.assert_allclose(np.exp(log_p).sum(axis=1), 1)
    np.testing.assert_allclose(log_p[0], log_p[1], atol=1e-5)  # a constant added to all scores changes nothing
    assert (log_p[:, 2] == -np.inf).all()


def test_the_posterior_covers_the_grid(make_object):
    part = make_object(trimesh.creation.box((0.02, 0.01, 0.01)))
    poses = make_transform(np.eye(3), np.column_stack([np.arange(6) * 1e-3, np.zeros((6, 2))]))
    grid = PoseGrid(poses, PoseMetric(part))
    np.testing.assert_allclose(
        TemperatureScaling(0.1, 0.2).posterior(grid, SCORES).log_p, TemperatureScaling(0.1, 0.2).log_p(SCORES)
    )
    with pytest.raises(GridError):
        TemperatureScaling(0.1).posterior(grid, np.full(6, -np.inf))


@pytest.mark.slow
@pytest.mark.parametrize("temperature", [0.15, 0.6])
def test_the_fit_finds_the_true_temperature(temperature):
    made = TemperatureScaling(temperature, 0.1)
    found = fit_temperature_scaling(*drawn(made, 3000, np.random.default_rng(1)))
    assert found.temperature == pytest.approx(temperature, rel=0.3)
    assert found.tail in (0.05, 0.1, 0.2)


@pytest.mark.slow
def test_touches_with_one_pose_each_say_nothing_about_the_temperature():
    scores, truth = drawn(TemperatureScaling(0.1), 50, np.random.default_rng(3))
    alone = [np.array([0.5])] * 100
    assert fit_temperature_scaling(alone, np.zeros(100, int)).temperature == 1.0
    both = fit_temperature_scaling([*scores, *alone], np.concatenate([truth, np.zeros(100, int)]))
    assert both == fit_temperature_scaling(scores, truth)


def test_misleading_touches_widen_the_tail():
    rng = np.random.default_rng(2)
    scores, truth = drawn(TemperatureScaling(0.15), 1000, rng)
    lost = rng.random(1000) < 0.25
    wide = np.exp(TemperatureScaling(0.15 * TAIL_HEAT).log_p(np.array(scores)))
    truth[lost] = [rng.choice(60, p=p) for p in wide[lost]]
    clean = fit_temperature_scaling(*drawn(TemperatureScaling(0.15), 1000, rng))
    assert clean.tail == TAILS[0]
    assert fit_temperature_scaling(scores, truth).tail > clean.tail


def test_fitted_credible_sets_hold_the_truth_at_their_level():
    rng = np.random.default_rng(3)
    made = TemperatureScaling(0.25, 0.1)
    fitted = fit_temperature_scaling(*drawn(made, 150, rng))
    scores, truth = drawn(made, 4000, rng)
    p = np.exp(fitted.log_p(np.array(scores)))
    rank = np.where(p > p[np.arange(4000), truth][:, None], p, 0).sum(axis=1)  # mass of the more probable poses
    assert 0.92 < (rank < 0.95).mean() <= 1
    assert 0.4 < (rank < 0.5).mean() < 0.75


@pytest.mark.parametrize(("alike", "exponent"), [(False, 0.0), (True, 1.0)])
def test_equal_errors_add_no_evidence_and_independent_errors_add_all(alike, exponent):
    """All touches repeat the scores of the first touch, or each touch has independent scores."""
    rng, made, fused = np.random.default_rng(5), TemperatureScaling(1.0), []
    for touches in (2, 5):
        for _ in range(400):
            truth = int(rng.integers(40))
            # Gaussian observations of the truth's unit vector: scores are exact log-likelihoods
            seen = np.eye(40)[truth] + 0.5 * rng.normal(size=(touches, 40))
            seen = np.repeat(seen[:1], touches, axis=0) if alike else seen
            fused.append(FusedExample(touches, made.log_p(seen / 0.25).sum(axis=0), truth))
    assert fit_fused_scaling(fused).exponent == pytest.approx(exponent, abs=0.12)


@pytest.mark.slow
def test_the_fit_finds_the_probability_of_elsewhere_from_the_best_score():
    """The probability that examples are found grows with their score: the fit recovers it."""
    rng = np.random.default_rng(8)
    explained = rng.random(3000)
    truth = np.where(rng.random(3000) < 1 / (1 + np.exp(4 - 8 * explained)), 0, -1)
    fused = [FusedExample(3, np.log([0.7, 0.3]), int(t), float(b)) for t, b in zip(truth, explained, strict=True)]
    fitted = fit_fused_scaling(fused, misses=True)
    for best in (0.1, 0.5, 0.9):
        assert fitted.elsewhere(best, 3) == pytest.approx(1 / (1 + np.exp(8 * best - 4)), abs=0.04)
    always = [example for example in fused if example.truth >= 0]
    assert fit_fused_scaling(always).elsewhere(0.0, 3) == 0, "a grid that lists all poses has no elsewhere"
    few = fit_fused_scaling([FusedExample(3, np.log([0.7, 0.3]), 0, 0.9)] * 5, misses=True)
    assert few.elsewhere(0.95, 3) < 0.15
    assert few.elsewhere(0.0, 3) > 0.4, "a low score means elsewhere, although no example was missed"


def test_more_touches_explained_equally_well_are_more_surely_found():
    """Two touches need a better explanation than five touches: the fit is over all that the best pose explains."""
    rng = np.random.default_rng(9)
    touches, explained = rng.choice([2, 3, 5], 2000), rng.random(2000)
    truth = np.where(touches * explained > 0.9, 0, -1)
    examples = zip(touches, truth, explained, strict=True)
    fused = [FusedExample(int(n), np.log([0.7, 0.3]), int(t), float(b)) for n, t, b in examples]
    fitted = fit_fused_scaling(fused, misses=True)
    assert fitted.elsewhere(0.3, 2) > 0.9
    assert fitted.elsewhere(0.3, 5) < 0.1


def test_the_power_of_one_touch_is_one():
    assert FusedScaling(0.8).power(1) == 1
    assert FusedScaling(0.5).power(4) == pytest.approx(0.5)
    assert FusedScaling().power(7) == 1


def test_several_touches_are_fused_with_the_fitted_power(tmp_path, monkeypatch):
    localizer = Localizer.create("pin", store=StageStore(tmp_path), **COARSE)
    touches = [
        dataclasses.replace(t, T_base_sensor=np.linalg.inv(t.T_sensor_object)) for t in localizer.simulate(3, seed=2)
    ]
    observations = [(localizer, touch) for touch in touches]
    product = localizer.fuser.fuse(localizer.posteriors(touches), [t.T_base_sensor for t in touches])
    monkeypatch.setattr(localizer.probabilities, "fused_scaling", FusedScaling(0.75))
    fused = compute_posterior_together(observations)
    np.testing.assert_allclose(fused.probabilities, product.temper(3**-0.75).probabilities, atol=1e-6)
    assert fused.touches == 3
    plain = Localizer.create("pin", store=localizer.store, temperature=0.01, **COARSE)
    assert plain.probabilities.fused_scaling == FusedScaling(0.0)


def test_a_posterior_as_prior_gives_the_certainty_of_all_touches(tmp_path, monkeypatch):
    """Two touches in sequence give the same certainty as both together."""
    localizer = Localizer.create("pin", store=StageStore(tmp_path), **COARSE)
    monkeypatch.setattr(localizer.probabilities, "fused_scaling", FusedScaling(0.75))
    first, second = localizer.simulate(2, seed=2)
    earlier = localizer.posterior(first)
    motion = second.T_sensor_object @ np.linalg.inv(first.T_sensor_object)
    found = localizer.posterior(second, PosteriorPrior(earlier, motion))
    assert found.touches == 2
    known = PosteriorPrior(earlier, motion)(found.grid.T_sensor_object)
    weights = 2**-0.75 * (localizer.posterior(second).log_p + known)
    np.testing.assert_allclose(np.diff(found.log_p), np.diff(weights), atol=1e-6)


def test_one_impossible_truth_does_not_dominate_the_fit():
    scores, truth = drawn(TemperatureScaling(0.1), 500, np.random.default_rng(4))
    scores[0] = np.where(np.arange(60) == truth[0], -np.inf, scores[0])
    assert fit_temperature_scaling(scores, truth).temperature == pytest.approx(0.1, rel=0.5)


@pytest.mark.parametrize("values", [(0.0,), (-1.0,), (np.inf,), (np.nan,), (1.0, 1.0), (1.0, -0.1)])
def test_invalid_scaling_parameters_are_refused(values):
    with pytest.raises(ConfigError, match=naming(*values)):
        TemperatureScaling(*values)


def test_a_localizer_fits_once_per_encoder_unless_a_temperature_is_configured(tmp_path, monkeypatch):
    store = StageStore(tmp_path)
    first = Localizer.create("pin", store=store, **COARSE).probabilities.temperature_scaling
    assert first.tail in TAILS
    other = Localizer.create("pin", store=store, encoder={"name": "pixel", "cells": 8}, **COARSE)
    assert other.probabilities.temperature_scaling != first
    monkeypatch.setattr("tactile_loc.locate.probability.probabilities.fit_temperature_scaling", None)
    again = Localizer.create("pin", store=store, **COARSE)
    assert again.probabilities.temperature_scaling == first
    given = Localizer.create("pin", store=StageStore(tmp_path / "new"), temperature=0.5, **COARSE)
    assert given.probabilities.temperature_scaling == TemperatureScaling(0.5)
    keys = {localizer.probabilities.temperature_key().digest for localizer in (again, other)}
    monkeypatch.setattr(module, "SEED", 1)
    assert len({*keys, again.probabilities.temperature_key().digest}) == 3


@pytest.mark.slow
def test_the_default_scaling_is_fitted_to_the_stated_number_of_touches(tmp_path, monkeypatch, shipped_touches):
    """The one localizer of the suite that simulates all touches."""
    monkeypatch.setattr(module, "TOUCHES", shipped_touches)
    localizer = Localizer.create("pin", store=StageStore(tmp_path), **COARSE)
    fitted_to: list[int] = []

    def fit(scores, *others):
        fitted_to.append(len(scores))
        return fit_temperature_scaling(scores, *others)

    monkeypatch.setattr("tactile_loc.locate.probability.probabilities.fit_temperature_scaling", fit)
    scaling = localizer.probabilities.temperature_scaling
    assert fitted_to == [shipped_touches]
    held = 0
    for touch in localizer.simulate(60, seed=99, noise="strong"):  # the fit did not use this seed
        posterior = localizer.posterior(touch)
        p, truth = posterior.probabilities, localizer.model.grid.nearest(touch.T_sensor_object[None])[1][0]
        held += p[p > p[truth]].sum() < 0.95
    assert 0.85 <= held / 60 <= 1.0
    assert scaling.temperature > 0
