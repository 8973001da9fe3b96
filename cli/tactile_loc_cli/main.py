"""The command `tactile-loc`."""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from tactile_loc_cli.command import Quiet, Verbose, make_command
from tactile_loc_cli.commands import library as library_commands
from tactile_loc_cli.commands import store as store_commands
from tactile_loc_cli.commands.app import app as serve_app
from tactile_loc_cli.commands.benchmark import benchmark
from tactile_loc_cli.commands.build import build
from tactile_loc_cli.commands.calibrate import calibrate
from tactile_loc_cli.commands.identify import identify
from tactile_loc_cli.commands.live import live
from tactile_loc_cli.commands.mount import mount
from tactile_loc_cli.commands.next_touch import next_touch
from tactile_loc_cli.commands.plugins import objects, plugins
from tactile_loc_cli.commands.replay import replay
from tactile_loc_cli.commands.report import report
from tactile_loc_cli.commands.run import run
from tactile_loc_cli.commands.simulate import simulate
from tactile_loc_cli.commands.sweep import sweep
from tactile_loc_cli.doctor.command import doctor
from tactile_loc_cli.evaluate.command import evaluate
from tactile_loc_cli.failures import INTERRUPTED, TO_BE_RESUMED, USAGE_ERROR, UsageError, describe_usage_error, tell
from tactile_loc_cli.scaffold.command import new_plugin

# Imports make many objects that stay. To look for garbage among them as often as usual takes a twentieth of a run.
MADE_OBJECTS = 50_000  # objects between two searches for garbage


class PlainErrors(TyperGroup):
    """Reports a wrong command line in one line on stderr and an exit code; make_command handles all other failures."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command line and end the process."""
        kwargs["standalone_mode"] = False
        words = sys.argv[1:] if kwargs.get("args") is None else list(kwargs["args"])
        as_json = "--json" in words
        try:
            code = super().main(*args, **kwargs)
        except UsageError as error:
            context = getattr(error, "ctx", None)  # None if the parser finds the error
            path = context.command_path if context else " ".join(["tactile-loc", *_find_command(self, words)])
            tell("UsageError", describe_usage_error(error, path), as_json)
            code = USAGE_ERROR
        except typer.Abort:
            tell("Interrupted", TO_BE_RESUMED, as_json, "interrupted")
            code = INTERRUPTED
        sys.exit(code if isinstance(code, int) else 0)


def _find_command(group: TyperGroup, words: Sequence[str]) -> list[str]:
    """Return the names of the command, and of its group if there is one, that the words of a command line choose."""
    name = next((word for word in words if word in group.commands), None)
    if name is None:
        return []
    found = group.commands[name]
    return [name, *(_find_command(found, words[words.index(name) + 1 :]) if isinstance(found, TyperGroup) else [])]


def _make_app(**settings: Any) -> typer.Typer:
    return typer.Typer(
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
        **settings,
    )


app = _make_app(cls=PlainErrors, invoke_without_command=True)
store = _make_app(help="List, measure or prune the built models.")
library = _make_app(help="Build, change or check a library of parts.")


def _show_version(asked: bool) -> None:
    if asked:
        from tactile_loc import __version__

        typer.echo(f"tactile-loc {__version__}")
        raise typer.Exit


@app.callback()
def begin(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> None:
    """Locate a known object by touch.

    The input is a CAD model and tactile images. The result is a distribution over 6-DoF poses. Lengths are in mm,
    angles in degrees.
    """
    context.obj = verbose - quiet
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


for command in (
    run, build, simulate, evaluate, sweep, benchmark, report, live, replay, calibrate, mount, next_touch, identify,
    objects, plugins, new_plugin,
):  # fmt: skip
    app.command()(make_command(command))
for name, command in store_commands.COMMANDS.items():
    store.command(name)(make_command(command))
for name, command in library_commands.COMMANDS.items():
    library.command(name)(make_command(command))
app.command("app")(make_command(serve_app))
app.add_typer(library, name="library")
app.add_typer(store, name="store")
app.command()(make_command(doctor))


def main() -> None:
    """Run the command line."""
    gc.set_threshold(MADE_OBJECTS)
    try:
        app(prog_name="tactile-loc")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
