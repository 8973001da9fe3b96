"""The command `tactile-loc`."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from tactile_loc.core.errors import TactileLocError
from tactile_loc_cli.commands.build import build
from tactile_loc_cli.commands.calibrate import calibrate
from tactile_loc_cli.commands.evaluate import evaluate
from tactile_loc_cli.commands.objects import objects
from tactile_loc_cli.commands.plugins import plugins
from tactile_loc_cli.commands.run import run
from tactile_loc_cli.commands.simulate import simulate
from tactile_loc_cli.console import complain, warnings_shown

USAGE_ERROR, INTERRUPTED = 2, 130
UsageError: Any = typer.BadParameter.__mro__[1]  # typer brings its own click or uses the installed one


class PlainErrors(TyperGroup):
    """Turns every expected failure into one line on stderr and an exit code."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run; a wrong command line is one line too."""
        kwargs["standalone_mode"] = False
        try:
            code = super().main(*args, **kwargs)
        except UsageError as error:
            context = getattr(error, "ctx", None)
            path = context.command_path if context else "tactile-loc"
            complain("error", f"{error.format_message().rstrip('.')}; see {path} -h")
            code = USAGE_ERROR
        sys.exit(code if isinstance(code, int) else 0)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; what it raises on purpose ends it without a traceback."""
        try:
            with warnings_shown():
                return super().invoke(ctx)
        except TactileLocError as error:
            complain("error", str(error))
            raise typer.Exit(USAGE_ERROR) from error
        except KeyboardInterrupt as error:
            complain("interrupted", "what was finished is kept, run the same command again to resume")
            raise typer.Exit(INTERRUPTED) from error


app = typer.Typer(
    cls=PlainErrors,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


def _version(asked: bool) -> None:
    if asked:
        from tactile_loc import __version__

        typer.echo(f"tactile-loc {__version__}")
        raise typer.Exit


@app.callback()
def tactile_loc(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Touch an object once; know where it is.

    A CAD model and a tactile image in, a distribution over 6-DoF poses out. Lengths in mm, angles in degrees.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


for command in (run, build, simulate, evaluate, calibrate, objects, plugins):
    app.command()(command)


def main() -> None:
    """Run the command line."""
    try:
        app(prog_name="tactile-loc")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
