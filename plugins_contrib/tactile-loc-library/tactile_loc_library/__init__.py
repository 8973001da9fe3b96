"""Libraries of parts for tactile-loc: which of thousands of parts was touched, and where it is."""

from tactile_loc.plugin import CommandSpec, hookimpl


@hookimpl
def register_commands() -> list[CommandSpec]:
    """Return the commands that this package adds to `tactile-loc`."""
    summary = "Build, change or check a library of parts, or identify one of them."
    return [CommandSpec("library", summary, "tactile_loc_library.commands:application")]
