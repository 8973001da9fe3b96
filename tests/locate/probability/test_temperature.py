"""Probabilities from scores: fits recover known parameters, and several touches share their errors."""

import dataclasses

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc import Localizer, PoseGrid, PoseMetric, PosteriorPrior, StageStore
from tactile_loc.locate.probability import temperature as module
from tactile_loc.locate.probability.temperature import (
    SHARED,
    TAIL_HEAT,
    TAILS,
    TemperatureScaling,
    fit_temperature_scaling,
)
from tactile_loc.locate.several_touches import compute_posterior_together
from tactile_loc.plugin import ConfigError, GridError
from tactile_loc.plugin.helpers import make_transform

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


def test_several_touches_are_fused_with_the_power_of_shared_errors(tmp_path):
    localizer = Localizer.create("pin", store=StageStore(tmp_path), **COARSE)
    touches = [
        dataclasses.replace(t, T_base_sensor=np.linalg.inv(t.T_sensor_object)) for t in localizer.simulate(3, seed=2)
    ]
    observations = [(localizer, touch) for touch in touches]
    product = localizer.fuser.fuse(list(map(localizer.posterior_alone, touches)), [t.T_base_sensor for t in touches])
    fused = compute_posterior_together(observations)
    np.testing.assert_allclose(fused.probabilities, product.temper(3**-SHARED).probabilities, atol=1e-6)
    assert fused.touches == 3
    plain = Localizer.create("pin", store=localizer.store, temperature=0.01, **COARSE)
    product = plain.fuser.fuse(list(map(plain.posterior_alone, touches)), [t.T_base_sensor for t in touches])
    fused = compute_posterior_together([(plain, touch) for touch in touches])
    np.testing.assert_allclose(fused.probabilities, product.probabilities, atol=1e-6)


def test_a_posterior_as_prior_gives_the_certainty_of_all_touches(tmp_path):
    """Two touches in sequence give the same certainty as both together."""
    localizer = Localizer.create("pin", store=StageStore(tmp_path), **COARSE)
    first, second = localizer.simulate(2, seed=2)
    earlier = localizer.posterior(first)
    motion = second.T_sensor_object @ np.linalg.inv(first.T_sensor_object)
    found = localizer.posterior(second, PosteriorPrior(earlier, motion))
    assert found.touches == 2
    known = PosteriorPrior(earlier, motion)(found.grid.T_sensor_object)
    weights = 2**-SHARED * (localizer.posterior(second).log_p + known)
    np.testing.assert_allclose(np.diff(found.log_p), np.diff(weights), atol=1e-6)


def test_one_impossible_truth_does_not_dominate_the_fit():
    scores, truth = drawn(TemperatureScaling(0.1), 500, np.random.default_rng(4))
    scores[0] = np.where(np.arange(60) == truth[0], -np.inf, scores[0])
    assert fit_temperature_scaling(scores, truth).temperature == pytest.approx(0.1, rel=0.5)


@pytest.mark.parametrize("values", [(0.0,), (-1.0,), (np.inf,), (np.nan,), (1.0, 1.0), (1.0, -0.1)])
def test_invalid_scaling_parameters_are_refused(values):
    with pytest.raises(ConfigError, match=naming(*values)):
        TemperatureScaling(*values)


UNKNOWN = {"name": "pixel", "cells": 8}


def ship(localizer, monkeypatch, values):
    """Let the encoder state a temperature and a tail, or None."""
    changed = dataclasses.replace(localizer.encoder.capabilities, temperature=values)
    monkeypatch.setattr(type(localizer.encoder), "capabilities", changed)


def test_a_listed_grid_uses_the_temperature_of_the_user_of_the_encoder_or_else_a_stored_fit(tmp_path, monkeypatch):
    store = StageStore(tmp_path)
    first, other = (Localizer.create("pin", store=store, **some, **COARSE) for some in ({}, {"encoder": UNKNOWN}))
    ship(first, monkeypatch, (0.3, 0.2))
    assert Localizer.create("pin", store=store, **COARSE).source.temperature_scaling == TemperatureScaling(0.3, 0.2)
    assert module.STAGE not in [key.stage for key in store.built]
    ship(first, monkeypatch, None)
    fitted = first.source.temperature_scaling
    assert fitted.tail in TAILS
    assert other.source.temperature_scaling != fitted
    monkeypatch.setattr(module, "fit_temperature_scaling", None)
    again = Localizer.create("pin", store=store, **COARSE)
    assert again.source.temperature_scaling == fitted
    given = Localizer.create("pin", store=StageStore(tmp_path / "new"), temperature=0.5, **COARSE)
    assert given.source.temperature_scaling == TemperatureScaling(0.5)
    keys = {localizer.source.temperature_key().digest for localizer in (again, other)}
    monkeypatch.setattr(module, "SEED", 1)
    assert len({*keys, again.source.temperature_key().digest}) == 3


@pytest.mark.slow
def test_the_fit_is_to_the_stated_number_of_touches_and_calibrated(tmp_path, monkeypatch, shipped_touches):
    """The one localizer of the suite that simulates all touches."""
    monkeypatch.setattr(module, "TOUCHES", shipped_touches)
    localizer, fitted_to = Localizer.create("pin", store=StageStore(tmp_path), **COARSE), []
    ship(localizer, monkeypatch, None)

    def fit(scores, *others):
        fitted_to.append(len(scores))
        return fit_temperature_scaling(scores, *others)

    monkeypatch.setattr(module, "fit_temperature_scaling", fit)
    assert localizer.source.temperature_scaling.temperature > 0
    assert fitted_to == [shipped_touches]
    held = 0
    for touch in localizer.simulate(60, seed=99, noise="strong"):  # the fit did not use this seed
        posterior = localizer.posterior(touch)
        p, truth = posterior.probabilities, localizer.model.grid.nearest(touch.T_sensor_object[None])[1][0]
        held += p[p > p[truth]].sum() < 0.95
    assert 0.85 <= held / 60 <= 1.0
