"""Intervals of medians and of paired differences hold the truth as often as they say."""

import math

import numpy as np
import pytest

from tactile_loc.evaluation.sweep.uncertainty import (
    CHANCE,
    EQUAL,
    FEW,
    LEAST_TOUCHES,
    ComparedMedian,
    draw_median_ranks,
    estimate_median,
    resample_medians,
)

WORDS = ("better", "worse")


def compare(values, base) -> ComparedMedian:
    return ComparedMedian.of(np.array([values], float), np.array([base], float), *WORDS)


@pytest.mark.parametrize("count", [7, 8])
def test_medians_by_ranks_are_medians_of_samples(count):
    """The same draws, taken from the values themselves."""
    values = np.random.default_rng(1).lognormal(size=(1, count))
    rng = np.random.default_rng(0)
    expected = [
        np.median(np.sort(values[0])[rng.integers(count, size=count)]) for _ in range(len(draw_median_ranks(7)))
    ]
    assert resample_medians(values)[0] == pytest.approx(expected)


def test_an_interval_of_a_median_holds_the_true_median_as_often_as_it_says():
    rng = np.random.default_rng(3)
    held = [low <= 1 <= high for _, low, high in (estimate_median(rng.lognormal(size=(1, 60))) for _ in range(400))]
    assert 0.90 <= np.mean(held) <= 0.99


@pytest.mark.parametrize("count", [LEAST_TOUCHES, 15, 60])
def test_equal_methods_rarely_seem_different(count):
    """Touches differ far more than methods do, as in a sweep."""
    rng, verdicts = np.random.default_rng(4), []
    for _ in range(400):
        both = rng.lognormal(sigma=1.5, size=count) * rng.lognormal(sigma=0.3, size=(2, count))
        verdicts.append(compare(*both).verdict)
    assert verdicts.count(CHANCE) >= 0.88 * len(verdicts)


def test_a_true_difference_is_found_although_touches_differ_more():
    rng = np.random.default_rng(5)
    base = rng.lognormal(sigma=1.5, size=60)
    found = compare(0.8 * base * rng.lognormal(sigma=0.2, size=60), base)
    assert found.verdict == "better"
    assert found.difference.low < found.difference.value < found.difference.high < 0
    assert compare(base, 0.8 * base).verdict == "worse"


def test_ties_are_no_difference():
    base = np.arange(1.0, 21.0)
    found = compare(base, base)
    assert found.difference == (0, 0, 0)
    assert found.verdict == EQUAL
    assert compare(np.where(base < 4, base + 1, base), base).verdict == CHANCE, "most touches are equal"


def test_too_few_touches_have_no_interval():
    base = np.arange(1.0, LEAST_TOUCHES)
    found = compare(base + 1, base)
    assert found.verdict == FEW
    assert found.difference.value == 1
    assert math.isnan(found.median.low)
    assert math.isnan(found.difference.high)


def test_series_are_sampled_independently():
    """The mean of many equally distributed series varies less than each of them."""
    values = np.tile(np.random.default_rng(6).lognormal(size=50), (16, 1))
    single, many = (estimate_median(values[:count]) for count in (1, 16))
    assert single.value == pytest.approx(many.value)
    assert (many.high - many.low) / (single.high - single.low) == pytest.approx(1 / 4, abs=0.08)
