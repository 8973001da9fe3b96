"""Functions that run the contract checks of a component without a test runner."""

import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tactile_loc.slots.component import Component
from tactile_loc.slots.encoder import Encoder
from tactile_loc.slots.registry import CommandSpec
from tactile_loc.testing import list_checks, list_properties
from tactile_loc.testing.contract import Check, ContractError


@dataclass(frozen=True)
class CheckResult:
    """The result of one check: its name, its requirement, the problem ("" if there is none), and its duration."""

    name: str
    demands: str
    problem: str
    seconds: float

    @property
    def passed(self) -> bool:
        """True if the component fulfils the requirement."""
        return not self.problem


def run_checks(component: Component | CommandSpec, properties: bool = False) -> list[CheckResult]:
    """Run all checks that apply to the component, in order. If `properties` is true, then run its properties.

    An encoder that needs training is first trained on `make_training_problem()`. If the training fails, its result is
    the only one. A check that raises another exception than ContractError has failed too; the result names the
    exception. Raises TypeError if `component` is not a component.
    """
    return list(iter_checks(component, properties))


def iter_checks(component: Component | CommandSpec, properties: bool = False) -> Iterator[CheckResult]:
    """Yield the results of `run_checks`, each as soon as it is known."""
    chosen = [*list_checks(component), *(list_properties(component) if properties else [])]
    if isinstance(component, Encoder) and component.capabilities.needs_training:
        trained = _run_check(Check("train", "encoder", (), train), component)
        if not trained.passed:
            yield trained
            return
    for check in chosen:
        yield _run_check(check, component)


def train(encoder: Encoder) -> None:
    """An encoder that needs training can be trained on a tiny simulated problem."""
    from tactile_loc.testing.problems import make_training_problem

    encoder.fit(make_training_problem())


def _find_file(component: Component | CommandSpec) -> str:
    """Return the path of the module of a component's class."""
    return getattr(sys.modules.get(type(component).__module__), "__file__", None) or ""


def _run_check(check: Check, component: Component | CommandSpec) -> CheckResult:
    """Run a check. Its problem is one line. That of another exception than ContractError has the component's line."""
    start, problem = time.perf_counter(), ""
    try:
        check(component)
    except ContractError as error:
        problem = str(error) or "the contract is broken"
    except Exception as error:  # noqa: BLE001 - a plugin's component may raise anything
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if frame.filename == _find_file(component)]
        last = (own or frames)[-1]
        problem = f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
    return CheckResult(check.name, check.demands, " ".join(problem.split()), time.perf_counter() - start)
