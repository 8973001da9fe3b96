"""The matcher keeps every contract of its slot with chunks of any size, and finds the same poses as dense."""

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from tactile_loc import Localizer
from tactile_loc.plugin import ConfigError, registry
from tactile_loc.testing import parametrize_with_checks, parametrize_with_properties

from tactile_loc_torch_matcher.matcher import TorchMatcher

cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device")


def with_options(**options) -> TorchMatcher:
    return TorchMatcher(TorchMatcher.Options(**options))


VARIANTS = [TorchMatcher(), with_options(rows=7), with_options(device="cpu", rows=100)]


@pytest.fixture(scope="module")
def problem() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return queries, their weights, and a bank."""
    rng = np.random.default_rng(0)
    return tuple(rng.uniform(size=(rows, 32)).astype(np.float32) for rows in (5, 5, 300))


def truth(queries: np.ndarray, weights: np.ndarray, bank: np.ndarray) -> np.ndarray:
    difference = queries[:, None].astype(float) - bank
    return -0.5 * (weights[:, None] * difference**2).sum(axis=-1)


@parametrize_with_checks(VARIANTS)
def test_contract(component, check):
    check(component)


@parametrize_with_properties(VARIANTS[:2])
def test_property(component, check):
    check(component)


@pytest.mark.parametrize("rows", [1, 7, 299, 300, 301])
def test_chunks_of_any_size_give_the_same_scores(problem, rows):
    queries, weights, bank = problem
    matcher = with_options(rows=rows)
    matcher.index(bank)
    np.testing.assert_allclose(matcher.scores(queries, weights), truth(queries, weights, bank), rtol=1e-5)
    np.testing.assert_allclose(matcher.scores(queries), truth(queries, np.ones_like(weights), bank), rtol=1e-5)


def test_a_bank_far_from_the_origin_costs_no_accuracy(problem):
    queries, weights, bank = problem
    matcher = TorchMatcher()
    matcher.index(bank + 100)
    moved = truth(queries + np.float32(100), weights, bank + np.float32(100))
    np.testing.assert_allclose(matcher.scores(queries + 100, weights), moved, rtol=1e-4)


def test_a_read_only_bank_is_accepted_without_a_warning(problem, recwarn):
    queries, _, bank = problem
    bank = bank.copy()
    bank.setflags(write=False)
    matcher = TorchMatcher()
    matcher.index(bank)
    assert matcher.scores(queries).shape == (5, 300)
    assert not recwarn.list


def test_a_second_bank_replaces_the_cached_weighted_bank(problem):
    queries, weights, bank = problem
    matcher = TorchMatcher()
    for some in (bank, bank[:50] + 1):
        matcher.index(some)
        np.testing.assert_allclose(matcher.scores(queries, weights), truth(queries, weights, some), rtol=1e-5)


def test_a_missing_cuda_device_gives_a_one_sentence_error(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match=r"no CUDA device.*matcher\.device"):
        with_options(device="cuda")
    assert with_options(device="auto").device.type == "cpu"


def test_an_unknown_device_is_refused():
    with pytest.raises(ValidationError):
        with_options(device="abacus")


@cuda
def test_a_gpu_gives_the_same_scores(problem):
    queries, weights, bank = problem
    matcher = with_options(device="cuda")
    matcher.index(bank)
    np.testing.assert_allclose(matcher.scores(queries, weights), truth(queries, weights, bank), rtol=1e-4)


@pytest.mark.skipif("torch-matcher" not in registry().names("matcher"), reason="not installed")
def test_the_matcher_locates_with_the_default_grid_like_dense(tmp_path):
    few = {"store": tmp_path, "grid": {"name": "whole", "directions": 300}, "temperature": 0.05}
    ours, dense = (Localizer.create("damping_pin", matcher=name, **few) for name in ("torch-matcher", "dense"))
    touch = dense.simulate(1, seed=2)[0]
    found, expected = (localizer.localize(touch).best.T_sensor_object for localizer in (ours, dense))
    np.testing.assert_allclose(found, expected, atol=1e-5)
