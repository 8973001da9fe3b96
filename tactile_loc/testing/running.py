"""Runs the contract checks of a component without a test runner, and says what came of each."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tactile_loc.core.slots.component import Capabilities, Component
from tactile_loc.core.slots.encoder import Encoder
from tactile_loc.testing import contract, list_checks, list_properties
from tactile_loc.testing.contract import Check, ContractError
from tactile_loc.testing.properties import require_hypothesis


@dataclass(frozen=True)
class CheckResult:
    """What came of one check: its name, what it demands, what is wrong ("" if nothing is), and how long it took."""

    name: str
    demands: str
    problem: str
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether the component keeps this contract."""
        return not self.problem


def run_checks(component: Component, properties: bool = False) -> list[CheckResult]:
    """Run all checks that apply to the component, in their order, and properties if asked for; say what came of each.

    An encoder that needs training is trained first, on `make_training_problem()`; that is a result of its own where
    it fails, and no other follows. A check that raises anything but ContractError has failed, and the exception is
    named. Raises TypeError for anything that is no component, such as a class instead of an instance, and
    MissingLibraryError for properties without hypothesis.
    """
    return list(iter_checks(component, properties))


def iter_checks(component: Component, properties: bool = False) -> Iterator[CheckResult]:
    """Yield what `run_checks` returns, each as soon as it is known."""
    if properties:
        require_hypothesis()
    chosen = _select_checks(component, properties)
    if isinstance(component, Encoder) and component.capabilities.needs_training:
        trained = _run_check(train, partial(train, component))
        if not trained.passed:
            yield trained
            return
    for check in chosen:
        yield _run_check(check, partial(check, component))


def train(encoder: Encoder) -> None:
    """An encoder that needs training learns from a tiny problem, made in simulation."""
    from tactile_loc.testing.problems import make_training_problem

    encoder.fit(make_training_problem())


def _select_checks(component: Component, properties: bool) -> list[Check]:
    """The checks that apply; those of every slot alone where the capabilities cannot tell more."""
    if isinstance(component, Component) and not isinstance(component.capabilities, Capabilities):
        return contract.checks(Capabilities())
    return [*list_checks(component), *(list_properties(component) if properties else [])]


def _run_check(check: Callable[..., None], run: Callable[[], None]) -> CheckResult:
    demands = (check.__doc__ or "").strip().partition("\n")[0]
    start = time.perf_counter()
    problem = _describe_problem(run)
    return CheckResult(check.__name__, demands, problem, time.perf_counter() - start)


def _describe_problem(run: Callable[[], None]) -> str:
    """What is wrong, as one line; nothing if nothing is."""
    try:
        run()
    except ContractError as error:
        return " ".join(str(error).split()) or "the contract is broken"
    except Exception as error:  # noqa: BLE001 - a stranger's component may raise anything
        return " ".join(f"{type(error).__name__}: {error} ({_locate_error(error)})".split())
    return ""


def _locate_error(error: Exception) -> str:
    """Where an exception was raised: "refiner.py, line 33"."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).name}, line {last.lineno}"
