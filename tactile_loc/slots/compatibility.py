"""Rules for components that cannot be combined, according to their capabilities; checked with each configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.slots.component import Component


@dataclass(frozen=True)
class Declared:
    """A capability and its value, as declared by a component of a slot."""

    slot: str
    capability: str
    value: bool

    def holds(self, component: Component) -> bool:
        """Return whether a component of the slot declares this value."""
        return bool(getattr(component.capabilities, self.capability)) is self.value

    def __str__(self) -> str:
        return f"{self.capability}={self.value}"


@dataclass(frozen=True)
class Incompatibility:
    """Two declarations that exclude each other, with the reason and the advice for the message."""

    first: Declared
    second: Declared
    reason: str
    advice: str

    def applies(self, components: Mapping[str, Component]) -> bool:
        """Return whether two of the components, given by slot, make these two declarations."""
        return all(one.slot in components and one.holds(components[one.slot]) for one in (self.first, self.second))


INCOMPATIBILITIES = (
    Incompatibility(
        Declared("grid", "places", True),
        Declared("matcher", "weights", False),
        "a touch shows only a part of a place, and this matcher cannot compare parts",
        "choose another matcher, such as dense, or a grid that lists poses, such as face",
    ),
)


def require_compatible(components: Mapping[str, Component], names: Mapping[str, str]) -> None:
    """Raise ConfigError if two of the components, given by slot, cannot be combined.

    `names`, by slot, are the components' names in the configuration. Missing slots are ignored.
    """
    for rule in INCOMPATIBILITIES:
        if rule.applies(components):
            slots = (rule.first.slot, rule.second.slot)
            pair = " and ".join(f"the {slot} {names[slot]!r}" for slot in slots)
            raise ConfigError(f"{pair} cannot be combined: {rule.reason}; {rule.advice}")
