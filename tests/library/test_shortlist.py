"""A shortlist chooses the same objects from upper bounds as from the log-likelihoods of all."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.tasks.shortlist import Shortlist


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
