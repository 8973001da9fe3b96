"""Declared capabilities decide which components can be combined."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import pytest

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.slots.compatibility import INCOMPATIBILITIES, Declared, require_compatible
from tactile_loc.slots.component import Capabilities
from tactile_loc.slots.registry import SLOTS


def declaring(*declared: Declared) -> dict:
    """Return components by slot that declare these capabilities, and defaults otherwise."""
    made = {}
    for one in declared:
        capabilities = dataclasses.replace(Capabilities(), **{one.capability: one.value})
        made[one.slot] = SimpleNamespace(capabilities=capabilities)
    return made


def names(components: dict) -> dict:
    return {slot: f"my-{slot}" for slot in components}


@pytest.mark.parametrize("rule", INCOMPATIBILITIES, ids=str)
def test_incompatible_components_are_refused_with_names_and_reason(rule):
    components = declaring(rule.first, rule.second)
    with pytest.raises(ConfigError) as caught:
        require_compatible(components, names(components))
    sentence = str(caught.value)
    for part in (f"my-{rule.first.slot}", f"my-{rule.second.slot}", rule.reason, rule.advice):
        assert part in sentence
    assert "\n" not in sentence


@pytest.mark.parametrize("rule", INCOMPATIBILITIES, ids=str)
def test_either_component_is_accepted_alone(rule):
    for one, other in ((rule.first, rule.second), (rule.second, rule.first)):
        components = declaring(one, dataclasses.replace(other, value=not other.value))
        require_compatible(components, names(components))
        require_compatible(declaring(one), names(components))


def test_rules_name_existing_slots_and_capabilities():
    fields = {field.name for field in dataclasses.fields(Capabilities)}
    for rule in INCOMPATIBILITIES:
        for declared in (rule.first, rule.second):
            assert declared.slot in SLOTS
            assert declared.capability in fields
