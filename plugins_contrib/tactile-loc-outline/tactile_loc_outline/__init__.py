"""An encoder for tactile-loc that describes the distances to the contact's outline with a few dozen numbers."""

from tactile_loc.plugin import ComponentSpec, hookimpl


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components that this package offers. A component's class is imported on first use."""
    return [
        ComponentSpec(
            slot="encoder",
            name="outline",
            target="tactile_loc_outline.encoder:OutlineEncoder",
            summary="distance to the contact's outline, in low frequencies; no training",
            interface=2,
        )
    ]
