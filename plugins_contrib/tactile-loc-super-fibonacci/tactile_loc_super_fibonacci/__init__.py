"""A pose grid for tactile-loc with any number of rotations, which lie on super-Fibonacci spirals."""

from tactile_loc.plugin import ComponentSpec, hookimpl


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components that this package offers. A component's class is imported on first use."""
    return [
        ComponentSpec(
            slot="grid",
            name="super-fibonacci",
            target="tactile_loc_super_fibonacci.grid:SuperFibonacciGrid",
            summary="all of SO(3) times the plane, any number of rotations, by spirals",
            interface=2,
        )
    ]
