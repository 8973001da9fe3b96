"""Locates an object in tactile images of LeRobot and Hugging Face data sets."""

from tactile_loc.plugin import CommandSpec, hookimpl


@hookimpl
def register_commands() -> list[CommandSpec]:
    """Return the command that this package adds to `tactile-loc`."""
    summary = "Locate the object in a LeRobot or Hugging Face data set."
    return [CommandSpec("replay-dataset", summary, "tactile_loc_datasets.command:replay_dataset")]
