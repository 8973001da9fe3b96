"""Whether touch determines the pose of a part: where, with which sensor, and with how many touches.

Data flow: presses are drawn at places spread evenly over the part's surface (`presses`). Worker processes simulate
their touches, and locate each of them, and some together, as `tactile-loc run` does (`locating`). The results give the
shares of a study (`study`). The wrong poses that explain a touch give the pairs of poses that touches confuse
(`rivals`), the presses that separate them best (`together`), and features that would remove the confusion
(`features`). `files` and `page` write all this.
"""

from tactile_loc.plugin import CommandSpec, hookimpl


@hookimpl
def register_commands() -> list[CommandSpec]:
    """Return the command of this package."""
    summary = "Predict whether touch determines the pose of a part."
    return [CommandSpec("touchability", summary, "tactile_loc_touchability.command:touchability")]
