"""The local web page of tactile-loc: its command, its sessions, its view and its server."""

from tactile_loc.plugin import CommandSpec, hookimpl


@hookimpl
def register_commands() -> list[CommandSpec]:
    """Return the command of this package."""
    summary = "Press a virtual finger on an object, and locate it, on a local web page."
    return [CommandSpec("app", summary, "tactile_loc_app.command:app")]
