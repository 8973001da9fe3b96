"""Inspection by touch: where a located part differs from its model."""

from tactile_loc.plugin import CommandSpec, hookimpl


@hookimpl
def register_commands() -> list[CommandSpec]:
    """Return the command that this package adds to `tactile-loc`."""
    summary = "Find where a located part differs from its model."
    return [CommandSpec("inspect", summary, "tactile_loc_inspect.commands:inspect")]
