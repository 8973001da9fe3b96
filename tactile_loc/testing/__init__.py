"""Contract checks for the components of every slot, as functions that a plugin's tests run.

    from tactile_loc.testing import parametrize_with_checks, parametrize_with_properties

    @parametrize_with_checks([MyRefiner()])
    def test_contract(component, check):
        check(component)

    @parametrize_with_properties([MyRefiner()])
    def test_property(component, check):
        check(component)

A check takes the component. It raises ContractError if the component breaks the contract; the message states the
contract and how it was broken. All checks are in one list. A component gets those whose slot and tags fit its declared
capabilities. A package with a kind of its own adds its checks with the decorator `check`.

A property is a check on many drawn cases, which takes longer: frames, symmetric copies, image sizes and mirror images.
The cases are always the same. The message names the case that fails.

If an encoder needs training, train it first, for instance on `tactile_loc.testing.problems.make_training_problem()`.
"""

import importlib
from collections.abc import Callable, Iterable
from typing import Any

from tactile_loc.slots.component import Component
from tactile_loc.slots.registry import COMMAND, CommandSpec, registry
from tactile_loc.testing.contract import CHECKS, Check, ContractError, check

__all__ = [
    "Check",
    "ContractError",
    "check",
    "list_checks",
    "list_properties",
    "parametrize_with_checks",
    "parametrize_with_properties",
]


def list_checks(component: Component | CommandSpec) -> list[Check]:
    """Return the checks, functions of one component, for the component's slot and declared capabilities.

    For the spec of a command, return the checks of commands. Raises TypeError if `component` is not a component, for
    instance a class instead of an instance.
    """
    return [check for check in _list_all(component) if not check.is_property]


def list_properties(component: Component | CommandSpec) -> list[Check]:
    """Return the properties, functions of one component, for the component's slot and declared capabilities.

    Raises TypeError if `component` is not a component.
    """
    return [check for check in _list_all(component) if check.is_property]


def parametrize_with_checks(components: Iterable[Component | CommandSpec]) -> Any:
    """Return a pytest mark with one case for every component and check: arguments `component` and `check`."""
    return _parametrize(components, list_checks)


def parametrize_with_properties(components: Iterable[Component]) -> Any:
    """Return a pytest mark with one case for every component and property: arguments `component` and `check`."""
    return _parametrize(components, list_properties)


def _list_all(component: Component | CommandSpec) -> list[Check]:
    """Import the checks of the component's kind. Return the checks and properties that apply to the component."""
    if not isinstance(component, Component | CommandSpec):
        raise TypeError(f"checks need an instance of a component, not {component!r}")
    slot, kinds = COMMAND if isinstance(component, CommandSpec) else component.slot, registry().kinds
    if slot in kinds:
        kind = kinds[slot]
        importlib.import_module(kind.checks if kind else f"tactile_loc.testing.{slot}s")
    if isinstance(component, CommandSpec):
        return [check for check in CHECKS if check.slot == COMMAND]
    return [check for check in CHECKS if check.applies_to(component)]


def _parametrize(
    components: Iterable[Component | CommandSpec], chosen: Callable[[Component | CommandSpec], list[Check]]
) -> Any:
    import pytest

    cases = [
        pytest.param(component, check, id=f"{getattr(component, 'name', type(component).__name__)}-{check.name}")
        for component in components
        for check in chosen(component)
    ]
    return pytest.mark.parametrize(("component", "check"), cases)
