"""An exact matcher for tactile-loc that uses torch, on a GPU if there is one."""

from tactile_loc.plugin import ComponentSpec, hookimpl


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components that this package offers. A component's class is imported on first use."""
    return [
        ComponentSpec(
            slot="matcher",
            name="torch-matcher",
            target="tactile_loc_torch_matcher.matcher:TorchMatcher",
            summary="exact, by torch on CPU or GPU, in chunks of the bank's rows",
            requires="torch",
            interface=2,
        )
    ]
