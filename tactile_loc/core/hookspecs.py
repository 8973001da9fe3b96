"""The whole plugin interface: one hook that returns specs, and no class is imported before it is used."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pluggy

PROJECT = "tactile_loc"
SLOTS = ("sensor", "renderer", "grid", "encoder", "matcher", "refiner", "fuser")

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@dataclass(frozen=True)
class ComponentSpec:
    """One component offered for one slot.

    `target` is "package.module:Class", imported at first use; `requires` names the pip distribution of the library it
    needs beyond tactile-loc's own, if any.
    """

    slot: str
    name: str
    target: str
    summary: str
    requires: str = ""


@hookspec
def tactile_loc_components() -> Iterable[ComponentSpec]:  # type: ignore[empty-body]
    """Return the components that this plugin offers."""
