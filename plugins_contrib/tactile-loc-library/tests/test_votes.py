"""Votes support each other if places are related as touches are; mirror images differ, and bad touches cost little.

A shortlist chooses the same objects from upper bounds as from the log-likelihoods of all.
"""

import itertools

import numpy as np
import pytest
from tactile_loc.plugin.helpers import draw_rotations

from tactile_loc_library.descriptor import STEPS
from tactile_loc_library.votes import (
    MOST_LOST,
    NEAR_M,
    STD_M,
    STD_RAD,
    DescribedPlaces,
    DescribedTouches,
    Shortlist,
    join_votes,
    measure_pair,
    rate_object,
)

DIMENSIONS, TEMPERATURE = 16, 0.05
NO_COPIES = np.eye(4)[None]


def draw_units(rng: np.random.Generator, count: int, dimensions: int) -> np.ndarray:
    vectors = rng.normal(size=(count, dimensions))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(4)


@pytest.fixture
def places(rng) -> DescribedPlaces:
    """Return random places with random descriptors."""
    vectors = np.rint(STEPS * draw_units(rng, 200, DIMENSIONS)).astype(np.int8)
    at = np.concatenate([rng.uniform(-0.02, 0.02, (200, 3)), draw_units(rng, 200, 3)], axis=1).astype(np.float32)
    return DescribedPlaces(vectors, at, NO_COPIES)


def touch_at(
    places: DescribedPlaces, numbers: list[int], rng: np.random.Generator, mirror: float = 1.0
) -> DescribedTouches:
    """Return touches of the places with these numbers, with the object at a random pose, or mirrored."""
    R = draw_rotations(1, rng)[0] @ np.diag([mirror, 1, 1])
    at = places.at[numbers].astype(float)
    moved = np.concatenate([at[:, :3] @ R.T + rng.normal(size=3), at[:, 3:] @ R.T], axis=1)
    return DescribedTouches((places.vectors[numbers] / STEPS).astype(np.float32), moved)


def rate_slowly(places: DescribedPlaces, asked: DescribedTouches) -> float:
    """Return the best log-likelihood of two touches, from the definition."""
    similar = places.vectors.astype(float) @ asked.vectors.T / STEPS / TEMPERATURE
    truth = np.array(measure_pair(*asked.at))
    best = -np.inf
    for i, j in itertools.product(range(len(places)), repeat=2):
        pair = np.array(measure_pair(*places.at[[i, j]].astype(float)))
        weight = np.array([1 / STD_M, 1 / STD_RAD, *(min(1, truth[0] / NEAR_M) / STD_RAD,) * 3])
        nats = similar[j, 1] - 0.5 * np.sum((weight * (pair - truth)) ** 2)
        best = max(best, similar[i, 0] + max(nats, similar[:, 1].max() - MOST_LOST))
    return best


def test_the_rating_is_that_of_the_definition(places, rng):
    few = DescribedPlaces(places.vectors[:40], places.at[:40], NO_COPIES)
    asked = touch_at(few, [3, 17], rng)
    asked.vectors[:] = draw_units(rng, 2, DIMENSIONS)
    assert rate_object(few, asked, TEMPERATURE) == pytest.approx(rate_slowly(few, asked), rel=1e-4)


@pytest.mark.parametrize("numbers", [[5], [5, 60], [5, 60, 131], [5, 5, 60, 131]])
def test_a_rating_is_exact_unless_it_is_below_the_least_one(places, rng, numbers):
    asked = touch_at(places, numbers, rng)
    asked.vectors[:] = 0.7 * asked.vectors + 0.7 * draw_units(rng, len(numbers), DIMENSIONS).astype(np.float32)
    symmetric = DescribedPlaces(places.vectors, places.at, np.stack([np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])]))
    for some in (places, symmetric):
        votes = join_votes(some, asked, TEMPERATURE).nats
        exact = votes[:1].max() if len(numbers) < 3 else votes[:2].max()
        for less in (np.inf, 10.0, 1.0, 0.0):
            assert rate_object(some, asked, TEMPERATURE, exact - less) == exact
        for more in (0.1, 3.0, 100.0):
            assert rate_object(some, asked, TEMPERATURE, exact + more) <= exact


def test_touches_vote_for_their_places_and_against_a_mirrored_object(places, rng):
    numbers = [5, 60, 131]
    votes = join_votes(places, touch_at(places, numbers, rng), TEMPERATURE)
    assert votes.numbers[np.arange(3), votes.nats.argmax(axis=1)].tolist() == numbers
    assert rate_object(places, touch_at(places, numbers, rng), TEMPERATURE) == pytest.approx(votes.nats.max())
    own, mirrored = (rate_object(places, touch_at(places, [5, 60], rng, sign), TEMPERATURE) for sign in (1, -1))
    assert own > mirrored + 1


def test_one_bad_touch_of_three_costs_at_most_a_bound(places, rng):
    asked = touch_at(places, [5, 60, 131], rng)
    good = rate_object(places, asked, TEMPERATURE)
    for bad in range(3):
        at = asked.at.copy()
        at[bad, :3] += 1.0
        assert good - 2 * MOST_LOST <= rate_object(places, DescribedTouches(asked.vectors, at), TEMPERATURE) < good


def test_copies_of_places_support_each_other(places, rng):
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    symmetric = DescribedPlaces(places.vectors, places.at, np.stack([np.eye(4), half_turn]))
    at = places.at[[5, 60]].astype(float)
    at[1] *= [-1, -1, 1, -1, -1, 1]
    asked = DescribedTouches((places.vectors[[5, 60]] / STEPS).astype(np.float32), at)
    alone = 2 / TEMPERATURE
    assert rate_object(symmetric, asked, TEMPERATURE) == pytest.approx(alone, rel=0.02)
    assert rate_object(places, asked, TEMPERATURE) < 0.9 * alone


@pytest.mark.parametrize("count", [1, 3, 8, 64, 65, 400])
@pytest.mark.parametrize("steps", [0.0, 1.0], ids=["any", "tied"])
@pytest.mark.parametrize("spread", [1.0, 5.0, 30.0])
def test_the_same_objects_are_chosen_from_bounds(count, steps, spread):
    shortlist, rng = Shortlist(13.0), np.random.default_rng(count)
    nats = rng.normal(50, spread, count)
    nats = np.rint(nats) if steps else nats
    bounds = nats + np.rint(rng.exponential(2, count))
    rated = []

    def rate(k: int, least: float) -> float:
        rated.append(k)
        return nats[k] if nats[k] >= least else nats[k] - rng.exponential()

    found = shortlist.rate(bounds, rate)
    chosen = shortlist.choose(nats)
    assert shortlist.choose(found) == chosen
    assert np.array_equal(found[chosen], nats[chosen])
    assert (found >= nats).all()
    assert (found <= bounds).all()
    assert len(set(rated)) == len(rated)
    assert len(rated) < count or count < 400 or spread < 5, "most objects are not rated"


def test_the_number_of_chosen_objects_has_bounds():
    nats = np.array([9.0, 10.0, 10.0, 3.0, 0.0])
    assert Shortlist(1.0, 1, 9).choose(nats) == [1, 2, 0]
    assert Shortlist(1.0, 4, 9).choose(nats) == [1, 2, 0, 3]
    assert Shortlist(1.0, 1, 2).choose(nats) == [1, 2]
