"""A printable test object for tactile sensors, and a score of the photos that a sensor takes of it."""

from tactile_loc.plugin import CommandSpec, hookimpl


@hookimpl
def register_commands() -> list[CommandSpec]:
    """Return the commands that this package adds to `tactile-loc`."""
    summary = "Make a test object to print, or score a sensor's photos of it."
    return [CommandSpec("test-object", summary, "tactile_loc_test_object.commands:application")]
