"""Draws of properties are always the same, and a failing case is named."""

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import is_rigid
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.testing import ContractError, list_properties
from tactile_loc.testing.properties import hold, motions, one_of, orders, places, shifts, slides, whole
from tactile_loc.testing.running import run_checks


def test_draws_are_reproducible():
    def drawn() -> list[dict]:
        seen: list[dict] = []
        hold(lambda **values: seen.append(values), examples=8, order=orders(4), motion=motions(), place=places(30, 9))
        return seen

    assert drawn() == drawn()
    assert len({tuple(one["order"]) for one in drawn()}) > 3


@pytest.mark.parametrize(
    ("draw", "least", "most"), [(whole(3, 7), 3, 7), (one_of([4, 5, 6]), 4, 6), (whole(5, 5), 5, 5)]
)
def test_exactly_the_allowed_numbers_are_drawn(draw, least, most):
    seen: list[int] = []
    hold(lambda n: seen.append(n), examples=200, n=draw)
    assert set(seen) == set(range(least, most + 1))


def test_orders_are_permutations_and_motions_are_rigid():
    def claim(order, motion, place, slide, shift):
        assert sorted(order) == list(range(5))
        assert is_rigid(motion.T)
        assert is_rigid(place.pose)
        assert np.linalg.norm(slide.slide[:2]) < 1.2e-3
        assert all(20 <= abs(part) <= 150 for part in shift)
        assert np.trace(motion.T[:3, :3]) < 1 + 2 * np.cos(np.radians(14.9))

    hold(claim, examples=30, order=orders(5), motion=motions(), place=places(20, 8), slide=slides(), shift=shifts())


def test_a_failing_case_is_named_and_another_exception_passes_through():
    def claim(turn_deg, order):
        if turn_deg > 60 and order[0] != 0:
            raise ContractError("turned too far")

    with pytest.raises(ContractError, match=r"turned too far \(with turn_deg=\d+, order=\[[12], \d, \d\]\)"):
        hold(claim, examples=20, turn_deg=whole(0, 180), order=orders(3))
    with pytest.raises(ZeroDivisionError):
        hold(lambda number: 1 / (number - 3), examples=50, number=whole(0, 5))


def test_properties_run_after_the_checks_on_request():
    results = run_checks(DenseMatcher(), properties=True)
    assert [r.name for r in results if r.name.startswith("property_")] == [
        check.name for check in list_properties(DenseMatcher())
    ]
    assert all(result.passed for result in results)
