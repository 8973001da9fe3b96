"""The command line, as a plugin that offers the commands of tactile-loc by the hook for commands."""

from tactile_loc.slots.registry import COMMAND, CommandSpec, ComponentKind, hookimpl

# name, function or application, summary
COMMANDS = (
    ("run", "commands.run:run", "Locate an object from one touch or several."),
    ("build", "commands.build:build", "Build an object's model ahead of time, and compile what its touches need."),
    ("simulate", "commands.simulate:simulate", "Simulate touches with known poses."),
    ("evaluate", "evaluate.command:evaluate", "Measure how often `run` is right."),
    ("paper", "evaluate.paper:paper", "Measure the errors that the paper reports."),
    ("sweep", "commands.sweep:sweep", "Evaluate every combination of components."),
    ("report", "commands.report:report", "Show a result as one HTML file."),
    ("live", "commands.live:live", "Locate an object in each frame as it arrives."),
    ("replay", "commands.replay:replay", "Locate an object in each image of a ROS recording, or of a folder."),
    ("calibrate", "commands.calibrate:calibrate", "Calibrate a sensor to read its images."),
    ("mount", "commands.mount:mount", "Find where a sensor is mounted on a flange."),
    ("next-touch", "commands.next_touch:next_touch", "Choose where to touch next."),
    ("identify", "commands.identify:identify", "Find which of several objects was touched."),
    ("objects", "commands.plugins:objects", "List the demo objects."),
    ("plugins", "commands.plugins:plugins", "List components and their options, or check one."),
    ("new-plugin", "scaffold.command:new_plugin", "Write a package for a new component."),
    ("doctor", "doctor.command:doctor", "Check the installation, or a calibrated sensor."),
    ("store", "commands.store:application", "List, measure or prune the built models."),
)
# Commands of packages in plugins_contrib, which are installed separately.
ANNEXES = {
    "app": "tactile-loc-app",
    "benchmark": "tactile-loc-benchmark",
    "inspect": "tactile-loc-inspect",
    "library": "tactile-loc-library",
    "test-object": "tactile-loc-test-object",
    "touchability": "tactile-loc-touchability",
}
KINDS_OF_ANNEXES = {"method": "tactile-loc-benchmark", "touch-source": "tactile-loc-benchmark"}


@hookimpl
def register_kinds() -> list[ComponentKind]:
    """Return the kind of plugin that is a command: how it is checked, and what `new-plugin` writes."""
    usage = "tactile-loc {name} --object pin"
    return [
        ComponentKind(COMMAND, f"{__name__}.command_checks", f"{__name__}.scaffold", "the size of an object", usage)
    ]


@hookimpl
def register_commands() -> list[CommandSpec]:
    """Return the commands that come with tactile-loc."""
    return [CommandSpec(name, summary, f"{__name__}.{target}") for name, target, summary in COMMANDS]
