"""An encoder for tactile-loc: describes the distances to the contact's outline by a few dozen numbers."""

from __future__ import annotations

from tactile_loc.plugin import ComponentSpec, hookimpl


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components that this package offers; a class is imported when it is used."""
    return [
        ComponentSpec(
            slot="encoder",
            name="outline",
            target="tactile_loc_outline.encoder:OutlineEncoder",
            summary="distance to the contact's outline, in low frequencies; no training",
            interface=2,
        )
    ]
