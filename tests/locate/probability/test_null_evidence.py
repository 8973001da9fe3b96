"""The probability of "none of these" grows with the misfit that touches have together, but not separately."""

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.locate.probability.null_evidence import NullEvidence

CLEAN = np.zeros(2)


def say(misfits, floors, **given) -> tuple[list[float], float]:
    p, none = NullEvidence(**given).probabilities(np.array(misfits), np.array(floors))
    assert p.sum() + none == pytest.approx(1.0)
    return p.tolist(), none


def test_objects_share_what_none_of_these_leaves():
    p, none = say([1.0, 1.0 + np.log(3), np.inf], CLEAN, temperature=1.0)
    assert p == pytest.approx([0.75 * (1 - none), 0.25 * (1 - none), 0.0])


def test_the_misfit_beyond_the_floors_decides():
    assert say([0.0, 9.0], CLEAN)[1] < 0.1
    assert say([12.0, 15.0], CLEAN)[1] > 0.9
    assert say([12.0, 15.0], [6.0, 5.5])[1] < 0.1  # as noisy touches, which no object explains separately either
    assert say([29.0, 30.0], [14.0, 15.0])[1] > 0.85  # more than noise
    assert say([np.inf, np.inf], CLEAN) == ([0.0, 0.0], 1.0)


def test_more_touches_that_are_explained_betray_unknown_objects():
    none = [say([0.0], np.zeros(touches))[1] for touches in (1, 2, 3, 6)]
    assert none == sorted(none, reverse=True)
    assert none[0] == pytest.approx(0.2, abs=0.03)  # one touch tells little
    assert none[-1] < 0.01
    excess = np.linspace(0, 30, 50)
    assert (np.diff(NullEvidence().compute_none(excess, 2)) >= 0).all()


def test_noise_makes_an_excess_count_less():
    null = NullEvidence(growth=0.25, noise=8.0)
    for floors, divisor in (([0.0, 0.0], 1.0), ([4.0, 4.0], 3.0), ([9.0, 99.0], 5.0)):
        explained = np.minimum(floors, 8.0).sum()
        assert null.measure_excess(np.array([explained + 6.0, 99.0]), np.array(floors)) == pytest.approx(6.0 / divisor)
        assert null.measure_excess(np.array([explained - 1.0]), np.array(floors)) == 0.0


def test_the_prior_is_the_share_of_unknown_objects_without_evidence():
    for prior in (0.1, 0.5):
        null = NullEvidence(prior=prior, chance=0.99, missed=0.01)
        assert null.compute_none(0.0, 1) == pytest.approx(prior, abs=0.02)
        odds = null.compute_none(6.0, 2) / (1 - null.compute_none(6.0, 2))
        even = NullEvidence(prior=0.5, chance=0.99, missed=0.01).compute_none(6.0, 2)
        assert odds == pytest.approx(prior / (1 - prior) * even / (1 - even))


def test_impossible_numbers_are_refused():
    with pytest.raises(ConfigError, match=naming("gap=0.0")):
        NullEvidence(gap=0.0)
    with pytest.raises(ConfigError, match=naming("growth=-0.1")):
        NullEvidence(growth=-0.1)
    with pytest.raises(ConfigError, match=naming("prior=1.0")):
        NullEvidence(prior=1.0)
