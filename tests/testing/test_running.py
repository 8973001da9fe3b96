"""Checks without a test runner: the result of each, for any error of a component."""

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


def raising(error: BaseException):
    """A matcher whose `scores` raises this error."""

    def scores(self, queries, weights=None):
        raise error

    return made(DenseMatcher, scores=scores), scores.__code__.co_firstlineno + 1


def test_a_broken_contract_gives_a_result_with_the_fault():
    doubled = made(DenseMatcher, scores=lambda self, *given: 2 * DenseMatcher.scores(self, *given))
    failed = problems(run_checks(doubled))
    assert "||query - row||^2" in failed["check_definition"]
    assert "check_output" not in failed


@pytest.mark.parametrize("error", [ZeroDivisionError("of\n  nothing"), AssertionError()])
def test_another_exception_is_named_with_its_location(error):
    matcher, line = raising(error)
    failed = problems(run_checks(matcher))
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"
    assert failed["check_output"] == " ".join(f"{said} ({Path(__file__).name}, line {line})".split())
    assert "check_declaration" not in failed


def test_results_come_one_by_one_and_an_interruption_passes_through():
    results = iter_checks(raising(KeyboardInterrupt())[0])
    assert next(results).name == "check_declaration"
    with pytest.raises(KeyboardInterrupt):
        list(results)


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
