"""A refiner for tactile-loc that moves the centre of the contact to that of the touch."""

from __future__ import annotations

from tactile_loc.plugin import ComponentSpec, hookimpl


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components that this package offers; a class is imported when it is used."""
    return [
        ComponentSpec(
            slot="refiner",
            name="centroid",
            target="tactile_loc_centroid.refiner:CentroidRefiner",
            summary="slides the contact's centre onto the touch's",
            interface=2,
        )
    ]
