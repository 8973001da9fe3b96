"""A refiner for tactile-loc: generalised ICP from the small_gicp library."""

from tactile_loc.plugin import ComponentSpec, hookimpl


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components that this package offers. A component's class is imported on first use."""
    return [
        ComponentSpec(
            slot="refiner",
            name="small-gicp",
            target="tactile_loc_small_gicp.refiner:SmallGicpRefiner",
            summary="generalised ICP of contact clouds, by small_gicp",
            requires="small-gicp",
            interface=2,
        )
    ]
