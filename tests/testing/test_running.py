"""Checks without a test runner: the result of each, for any error of a component."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from broken_components import made

from tactile_loc.plugins.encoders.pixel import PixelEncoder
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.slots.component import Capabilities
from tactile_loc.testing import list_checks
from tactile_loc.testing.running import CheckResult, iter_checks, run_checks


def problems(results: list[CheckResult]) -> dict[str, str]:
    return {result.name: result.problem for result in results if not result.passed}


def test_a_sound_component_passes_every_check_in_order():
    results = run_checks(DenseMatcher())
    assert [r.name for r in results] == [check.name for check in list_checks(DenseMatcher())]
    assert problems(results) == {}
    assert all(r.seconds >= 0 and r.demands.endswith(".") and "\n" not in r.demands for r in results)


def test_a_broken_contract_gives_a_result_with_the_fault():
    doubled = made(DenseMatcher, scores=lambda self, *given: 2 * DenseMatcher.scores(self, *given))
    failed = problems(run_checks(doubled))
    assert "check_definition" in failed
    assert "||query - row||^2" in failed["check_definition"]
    assert "check_output" not in failed


def test_another_exception_is_named_with_its_location():
    def scores(self, queries, weights=None):
        raise ZeroDivisionError("of\n  nothing")

    failed = problems(run_checks(made(DenseMatcher, scores=scores)))
    line = scores.__code__.co_firstlineno + 1
    assert failed["check_output"] == f"ZeroDivisionError: of nothing ({Path(__file__).name}, line {line})"
    assert "check_declaration" not in failed


def test_a_bare_assertion_does_not_count_as_a_contract_error():
    def scores(self, queries, weights=None):
        raise AssertionError

    problem = problems(run_checks(made(DenseMatcher, scores=scores)))["check_output"]
    assert problem.startswith("AssertionError")


def test_an_interruption_passes_through():
    def scores(self, queries, weights=None):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_checks(made(DenseMatcher, scores=scores))


def test_results_come_one_by_one():
    def scores(self, queries, weights=None):
        raise KeyboardInterrupt

    first = next(iter_checks(made(DenseMatcher, scores=scores)))
    assert first.name == "check_declaration"


def test_undeclared_capabilities_fail_the_declaration():
    failed = problems(run_checks(made(DenseMatcher, capabilities=None)))
    assert "capabilities" in failed["check_declaration"]


LEARNS = Capabilities(follows_press_depth=True, needs_training=True)


def test_an_untrained_encoder_is_trained_on_listed_poses_and_then_on_places():
    seen = []

    def encode(self, depth_m, press_depth_m, geometry):
        assert seen, "the training must come first"
        return PixelEncoder.encode(self, depth_m, press_depth_m, geometry)

    encoder = made(PixelEncoder, capabilities=LEARNS, fit=lambda self, p: seen.append(p), encode=encode)
    results = run_checks(encoder)
    assert problems(results) == {}
    assert len(results) == len(list_checks(encoder))
    listed, places = seen
    assert np.concatenate(list(listed.shapes())).shape[0] == len(listed.grid)
    assert sum(map(len, places.clean_keys(1e-3))) == len(places)


def test_a_failed_training_is_the_only_result():
    def fit(self, problem):
        raise ValueError("diverged")

    (result,) = run_checks(made(PixelEncoder, capabilities=LEARNS, fit=fit))
    assert result.name == "train"
    assert result.problem.startswith("ValueError: diverged (")
