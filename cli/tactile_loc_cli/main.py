"""The command `tactile-loc`."""

import gc
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import groupby
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from tactile_loc.core.runtime.errors import MissingLibraryError, PluginLoadError, TactileLocError
from tactile_loc.slots.registry import BUILT_IN, COMMAND, Offer, import_target, registry
from tactile_loc_cli import ANNEXES
from tactile_loc_cli.command import Quiet, Verbose, build_command, build_failing_command, make_typer
from tactile_loc_cli.failures import INTERRUPTED, TO_BE_RESUMED, USAGE_ERROR, UsageError, describe_usage_error, tell

# Imports make many objects that stay. To look for garbage among them as often as usual takes a twentieth of a run.
MADE_OBJECTS = 50_000  # objects between two searches for garbage


class OfferedCommands(Mapping[str, Any]):
    """The parsers of all commands that packages offer. A command's module is imported when its parser is read."""

    def __iter__(self) -> Iterator[str]:
        """Yield the names of the offered commands, in the order found."""
        return iter(registry().names(COMMAND))

    def __len__(self) -> int:
        return len(registry().names(COMMAND))

    def __contains__(self, name: object) -> bool:
        return name in registry().names(COMMAND) or name in ANNEXES

    def __getitem__(self, name: str) -> Any:
        """Return the parser of a command. If the command cannot be loaded, its parser raises the reason."""
        if name not in self:
            raise KeyError(name)
        try:
            if name not in registry().names(COMMAND):
                _report_missing(name)
            return _load_command(registry().find(COMMAND, name))
        except TactileLocError as error:
            return build_failing_command(name, error)


@cache
def _load_command(found: Offer) -> Any:
    """Import a command, and return its parser. Raises PluginLoadError or MissingLibraryError."""
    return build_command(found.spec, import_target(found))


def _report_missing(name: str) -> NoReturn:
    """Raise the reason why a command of an annex is not offered."""
    annex = ANNEXES[name]
    for failure in registry().failures:
        if failure.distribution == annex:
            raise PluginLoadError(f"the command {name!r} of {annex} could not be loaded ({failure.error})")
    raise MissingLibraryError(
        f"the command {name!r} needs {annex}, which is not installed; in a clone of tactile-loc, run "
        f"pip install ./plugins_contrib/{annex}"
    )


class Commands(TyperGroup):
    """The commands of all packages.

    This class reports a wrong command line in one line on stderr, and ends with an exit code. `make_command` handles
    all other failures.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = OfferedCommands()

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands, without loading them."""
        return list(self.commands)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that the words choose. If there is none, the error also names the broken plugins."""
        try:
            return super().resolve_command(ctx, args)
        except UsageError as error:
            broken = [f"The plugin {f.plugin} could not be loaded ({f.error})" for f in registry().failures]
            error.message = ". ".join([error.message.removesuffix("."), *broken])
            raise

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands and their summaries by package, without loading them."""
        for distribution, offered in groupby(registry().commands, key=lambda c: c.distribution):
            title = "Commands" if distribution == BUILT_IN else f"Commands of {distribution}"
            with formatter.section(title):
                formatter.write_dl([(c.spec.name, c.spec.summary) for c in offered])

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


app = make_typer(cls=Commands, invoke_without_command=True)


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


def main() -> None:
    """Run the command line."""
    gc.set_threshold(MADE_OBJECTS)
    try:
        app(prog_name="tactile-loc")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    finally:
        gc.freeze()  # the end of the process does not look for garbage


if __name__ == "__main__":
    main()
