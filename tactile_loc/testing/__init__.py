"""Contract checks for the components of every slot, as functions that a plugin's tests run.

    from tactile_loc.testing import parametrize_with_checks, parametrize_with_properties

    @parametrize_with_checks([MyRefiner()])
    def test_contract(component, check):
        check(component)

    @parametrize_with_properties([MyRefiner()])
    def test_property(component, check):
        check(component)

A check takes the component. It raises ContractError if the component breaks the contract; the message states the
contract and how it was broken. The checks depend on the slot and the declared capabilities.

A property is a check on drawn cases: frames, orders, symmetric copies, image sizes and mirror images. The cases are few
and always the same. The message names a simple case that fails. Properties need hypothesis:
pip install 'tactile-loc[testing]'.

If an encoder needs training, train it first, for instance on `tactile_loc.testing.problems.make_training_problem()`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from typing import Any

from tactile_loc.slots.component import Component
from tactile_loc.slots.registry import CommandSpec, registry
from tactile_loc.testing import commands, contract
from tactile_loc.testing.contract import Check, ContractError

__all__ = [
    "Check",
    "ContractError",
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
    if isinstance(component, CommandSpec):
        return commands.checks()
    of_slot = _find_slot_module(component)
    common = contract.checks(component.capabilities)
    return common if of_slot is None else [*common, *of_slot.checks(component.capabilities)]


def list_properties(component: Component | CommandSpec) -> list[Check]:
    """Return the properties, functions of one component, for the component's slot and declared capabilities.

    A property raises MissingLibraryError if hypothesis is not installed. Raises TypeError if `component` is not a
    component.
    """
    if isinstance(component, CommandSpec):
        return []
    of_slot = _find_slot_module(component)
    return [] if of_slot is None else list(of_slot.properties(component.capabilities))


def parametrize_with_checks(components: Iterable[Component | CommandSpec]) -> Any:
    """Return a pytest mark with one case for every component and check: arguments `component` and `check`."""
    return _parametrize(components, list_checks)


def parametrize_with_properties(components: Iterable[Component]) -> Any:
    """Return a pytest mark with one case for every component and property: arguments `component` and `check`."""
    return _parametrize(components, list_properties)


def _find_slot_module(component: Component) -> Any:
    """Return the checks' module for the component's kind, or None if the kind is unknown."""
    if not isinstance(component, Component):
        raise TypeError(f"checks need an instance of a component, not {component!r}")
    kinds = registry().kinds
    if component.slot not in kinds:
        return None
    kind = kinds[component.slot]
    return importlib.import_module(kind.checks if kind else f"tactile_loc.testing.{component.slot}s")


def _parametrize(
    components: Iterable[Component | CommandSpec], chosen: Callable[[Component | CommandSpec], list[Check]]
) -> Any:
    import pytest

    cases = [
        pytest.param(component, check, id=f"{getattr(component, 'name', type(component).__name__)}-{check.__name__}")
        for component in components
        for check in chosen(component)
    ]
    return pytest.mark.parametrize(("component", "check"), cases)
