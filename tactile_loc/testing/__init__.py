"""Contract checks: what every component of a slot must do, as functions that a plugin's tests run.

    from tactile_loc.testing import parametrize_with_checks

    @parametrize_with_checks([MyRefiner()])
    def test_contract(component, check):
        check(component)

A check takes the component and raises ContractError, a sentence that says what the contract is and how it was broken.
Which checks apply follows from the slot and the declared capabilities. An encoder that needs training is passed
trained, for instance on `tactile_loc.testing.problems.training_problem()`.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from typing import Any

from tactile_loc.core.interfaces import Component
from tactile_loc.core.registry import SLOTS
from tactile_loc.testing import contract
from tactile_loc.testing.contract import Check, ContractError

__all__ = ["Check", "ContractError", "checks_for", "parametrize_with_checks"]


def checks_for(component: Component) -> list[Check]:
    """Return the checks (functions of one component) for the component's slot and declared capabilities.

    Raises TypeError for anything that is no component, such as a class instead of an instance.
    """
    if not isinstance(component, Component):
        raise TypeError(f"checks are for an instance of a component, not {component!r}")
    if component.slot not in SLOTS:
        return contract.checks(component.capabilities)
    of_slot = importlib.import_module(f"tactile_loc.testing.{component.slot}s")
    return [*contract.checks(component.capabilities), *of_slot.checks(component.capabilities)]


def parametrize_with_checks(components: Iterable[Component]) -> Any:
    """Return the pytest mark that makes one case for every component and check: arguments `component` and `check`."""
    import pytest

    cases = [
        pytest.param(component, check, id=f"{type(component).__name__}-{check.__name__}")
        for component in components
        for check in checks_for(component)
    ]
    return pytest.mark.parametrize(("component", "check"), cases)
