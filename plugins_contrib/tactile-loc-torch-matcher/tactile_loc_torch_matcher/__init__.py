"""A matcher for tactile-loc: exact, by torch, on a GPU if there is one."""

from __future__ import annotations

from tactile_loc.plugin import ComponentSpec, hookimpl


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components that this package offers; a class is imported when it is used."""
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
