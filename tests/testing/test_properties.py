"""Draws of properties are always the same, and a failing case is named."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import is_rigid
from tactile_loc.core.runtime.errors import MissingLibraryError
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.plugins.refiners.none import NoRefiner
from tactile_loc.testing import ContractError, list_properties
from tactile_loc.testing.properties import hold, motions, one_of, orders, places, shifts, signed, slides, whole
from tactile_loc.testing.running import run_checks


def test_draws_are_reproducible_and_begin_with_the_simplest():
    def drawn() -> list[dict]:
        seen: list[dict] = []
        hold(lambda **values: seen.append(values), examples=8, order=orders(4), motion=motions(), place=places(30, 9))
        return seen

    first = drawn()
    assert first == drawn()
    assert len({tuple(one["order"]) for one in first}) > 3
    assert first[0]["order"] == [3, 2, 1, 0]
    assert (first[0]["motion"].turn_deg, first[0]["place"].yaw_deg) == (15, 0)


def test_draws_leave_no_folder_and_do_not_depend_on_imports(tmp_path):
    """A separate process with few imports draws the same values as this process."""
    lines = "lambda n, s: print(n, s), examples=9, n=whole(0, 10**6), s=slides()"
    code = f"from tactile_loc.testing.properties import hold, slides, whole; hold({lines})"
    alone = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, check=True, text=True)
    here: list[str] = []
    hold(lambda n, s: here.append(f"{n} {s}"), examples=9, n=whole(0, 10**6), s=slides())
    assert alone.stdout.splitlines() == here
    assert len(here) == 9
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("strategy", "least", "most"),
    [(whole(3, 7), 3, 7), (signed(2), -2, 2), (one_of([4, 5, 6]), 4, 6), (whole(5, 5), 5, 5)],
)
def test_exactly_the_allowed_numbers_are_drawn(strategy, least, most):
    seen: list[int] = []
    hold(lambda n: seen.append(n), examples=200, n=strategy)
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


def test_a_simple_case_is_named():
    def claim(turn_deg, order):
        if turn_deg > 60 and order[0] != 0:
            raise ContractError("turned too far")

    with pytest.raises(ContractError) as caught:
        hold(claim, examples=20, turn_deg=whole(0, 180), order=orders(3))
    named = re.search(r"turned too far .*turn_deg=(\d+), order=\[2, 1, 0\]", str(caught.value))
    assert named, caught.value
    assert 60 < int(named[1]) < 100


def test_an_intermittent_failure_is_reported_as_intermittent():
    calls = iter(range(1000))

    def claim(number):
        if next(calls) == 0:
            raise ContractError("first call")

    with pytest.raises(ContractError, match=r"\A(?!first call)"):
        hold(claim, number=whole(0, 9))


def test_another_exception_passes_through():
    with pytest.raises(ZeroDivisionError):
        hold(lambda number: 1 / (number - 3), examples=50, number=whole(0, 5))


def test_a_missing_hypothesis_gives_an_error_with_the_package_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "hypothesis", None)
    with pytest.raises(MissingLibraryError, match=r"pip install 'tactile-loc\[testing\]'"):
        list_properties(NoRefiner())[0](NoRefiner())
    with pytest.raises(MissingLibraryError):
        run_checks(DenseMatcher(), properties=True)
    assert all(result.passed for result in run_checks(DenseMatcher()))


def test_properties_run_after_the_checks_on_request():
    results = run_checks(DenseMatcher(), properties=True)
    assert [r.name for r in results if r.name.startswith("property_")] == [
        check.name for check in list_properties(DenseMatcher())
    ]
    assert all(result.passed for result in results)
