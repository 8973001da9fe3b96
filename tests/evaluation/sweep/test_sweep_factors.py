"""A decomposition finds planted shares of the variance, and attributes nothing to chance."""

import numpy as np
import pytest

from tactile_loc.evaluation.sweep.factors import LEAST_MM, REST, decompose, write_sentence
from tactile_loc.evaluation.sweep.uncertainty import LEAST_TOUCHES

SLOTS = ("encoder", "matcher", "refiner")
REFINER = np.array([-0.6, 0.1, 0.5])  # planted logarithms, which add up to zero
ENCODER = np.array([-0.2, 0.2])
VARIANCES = {"encoder": np.mean(ENCODER**2), "refiner": np.mean(REFINER**2)}


def plant(touches: int = 40, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Errors (encoder 2, matcher 2, refiner 3, T), mm; touches differ by far more than any choice."""
    rng = np.random.default_rng(seed)
    logs = ENCODER[:, None, None, None] + REFINER[:, None] + np.zeros((2, 2, 3, touches))
    return np.exp(logs + rng.normal(0, 2, touches) + noise * rng.normal(size=(2, 2, 3, touches)))


def test_planted_main_effects_have_their_shares():
    found = decompose([plant()], SLOTS, "object")
    total = sum(VARIANCES.values())
    for slot, variance in VARIANCES.items():
        assert found.shares[slot] == pytest.approx((variance / total,) * 3)
    assert max(found.shares[term].value for term in found.shares if term not in VARIANCES) == pytest.approx(0, abs=1e-9)
    assert found.ratios["refiner"].value == pytest.approx(np.exp(1.1))
    sentence = write_sentence(found, SLOTS)
    assert sentence == (
        "refiner explains 84 % of the variance (84 to 84 %); encoder explains 16 % (16 to 16 %); "
        "matcher nothing that 40 touches show."
    )


def test_intervals_of_shares_hold_the_planted_share():
    truth = VARIANCES["refiner"] / sum(VARIANCES.values())
    shares = [decompose([plant(60, 0.4, seed)], SLOTS, "object").shares["refiner"] for seed in range(40)]
    assert np.mean([low <= truth <= high for _, low, high in shares]) >= 0.85
    assert np.mean([value for value, _, _ in shares]) == pytest.approx(truth, abs=0.02), "chance is subtracted"


def test_chance_explains_nothing():
    rng = np.random.default_rng(1)
    found = [decompose([rng.lognormal(0, 1, (2, 2, 3, 12))], SLOTS, "object") for _ in range(40)]
    explained = [sum(map(one.explains, SLOTS)) for one in found]
    assert np.mean(explained) <= 0.2
    silent = next(one for one in found if not any(map(one.explains, one.shares)))
    assert write_sentence(silent, SLOTS) == "12 touches show no effect of encoder, matcher or refiner."


def test_interactions_are_named_as_such():
    errors = plant()
    errors[1, :, 0] *= np.exp(1.5)
    found = decompose([errors], SLOTS, "object")
    assert found.explains("encoder x refiner")
    assert not found.explains("encoder x matcher")
    assert "the interaction encoder x refiner explains" in write_sentence(found, SLOTS)
    assert sum(share.value for share in found.shares.values()) == pytest.approx(1)


def test_an_effect_that_differs_between_objects_is_an_interaction_with_them():
    second = plant(seed=1)
    second[:, 1] *= 3  # this matcher is worse on the second object only
    found = decompose([plant(), second], SLOTS, "object")
    assert found.explains("matcher x object")
    assert found.shares["matcher x object"].value == pytest.approx(found.shares["matcher"].value)
    assert REST in found.shares


def test_errors_of_whole_objects_are_no_effect():
    """An object that is harder with every combination does not count."""
    once, twice = decompose([plant(), plant()], SLOTS, "object"), decompose([plant(), 50 * plant()], SLOTS, "object")
    assert twice.shares["refiner"].value == pytest.approx(once.shares["refiner"].value)


def test_ties_are_equal_errors():
    errors = np.broadcast_to(plant()[:1, :1, :1], (2, 2, 3, 40))
    found = decompose([errors], SLOTS, "object")
    assert not found.shares
    assert write_sentence(found, SLOTS) == "All combinations have the same errors."
    tiny = np.full((2, 2, 3, 40), LEAST_MM / 10)
    tiny[1] /= 100
    assert not decompose([tiny], SLOTS, "object").shares, "errors below a micrometre are equal"


def test_one_factor_is_stated_as_a_ratio_and_not_as_a_share():
    errors = plant()[0, 0]
    sentence = write_sentence(decompose([errors], ("refiner",), ""), ("refiner",))
    assert "%" not in sentence.replace("95 %", "")
    assert "3 " in sentence  # exp(1.1)
    same = decompose([np.random.default_rng(2).lognormal(size=(2, 40))], ("refiner",), "")
    assert write_sentence(same, ("refiner",)) == "40 touches show no effect of refiner."


def test_too_few_touches_or_failures_give_no_shares_in_words():
    few = decompose([plant(LEAST_TOUCHES - 1)], SLOTS, "object")
    assert "%" not in write_sentence(few, SLOTS)
    assert "%" not in write_sentence(None, SLOTS)
    assert write_sentence(None, ()) == ""
