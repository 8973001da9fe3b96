"""An approximate matcher for tactile-loc that searches a graph of neighbours with usearch."""

from __future__ import annotations

from tactile_loc.plugin import ComponentSpec, hookimpl


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components that this package offers."""
    summary, target = "approximate, a graph of neighbours by usearch", "tactile_loc_usearch.matcher:UsearchMatcher"
    return [ComponentSpec("matcher", "usearch", target, summary, requires="usearch", interface=2)]
