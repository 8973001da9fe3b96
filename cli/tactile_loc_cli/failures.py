"""Failures of commands: one line on stderr, an exit code and, with --json, a document on stdout.

A traceback appears only with -vv.
"""

import errno
import logging
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, NoReturn

import typer
from pydantic import ValidationError

from tactile_loc.core.runtime.errors import TactileLocError, quote
from tactile_loc.slots.options import explain_allowed
from tactile_loc.slots.registry import registry
from tactile_loc_cli.console import complain, is_shown, say_json, write_flags

UNEXPECTED, USAGE_ERROR, NOT_AS_REQUIRED, INTERRUPTED = 1, 2, 3, 130
DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
UsageError: Any = typer.BadParameter.__mro__[1]  # from typer, because typer may have its own copy of click
TO_BE_RESUMED = "finished parts are kept; run the same command again to resume"


class Finding(typer.Exit):
    """Ends a command with a result, and with an exit code that tells a script about the result."""

    def __init__(self, code: int, result: dict[str, Any]) -> None:
        super().__init__(code)
        self.result = result


@contextmanager
def report_failures(command: str, as_json: bool) -> Iterator[None]:
    """Report a failure of the block in one line, and raise typer.Exit."""
    try:
        yield
    except (typer.Exit, typer.Abort, UsageError, BrokenPipeError):
        raise
    except TactileLocError as error:
        _show_traceback()
        end(USAGE_ERROR, type(error).__name__, str(error), as_json)
    except KeyboardInterrupt:
        end(INTERRUPTED, "Interrupted", TO_BE_RESUMED, as_json, "interrupted")
    except Exception as error:  # noqa: BLE001 - a component may raise anything
        _show_traceback()
        if isinstance(error, OSError) and error.errno in DISK_FULL:
            end(USAGE_ERROR, type(error).__name__, _describe_full_disk(error), as_json)
        end(UNEXPECTED, type(error).__name__, _describe_unexpected(error, command), as_json)


def end(code: int, kind: str, text: str, as_json: bool, prefix: str = "error") -> NoReturn:
    """Report a failure, and raise typer.Exit to end the program."""
    tell(kind, text, as_json, prefix)
    raise typer.Exit(code)


def tell(kind: str, text: str, as_json: bool, prefix: str = "error") -> None:
    """Report a failure: a line on stderr and, with --json, a document on stdout."""
    complain(prefix, text)
    if as_json:
        say_json({"error": {"kind": kind, "message": " ".join(write_flags(text).split())}})


def describe_usage_error(error: Any, command: str) -> str:
    """Describe a wrong command line. For an invalid value, use the words of the same error in a configuration."""
    flags, cause = getattr(getattr(error, "param", None), "opts", []), error.__cause__
    if flags and isinstance(cause, ValidationError):
        problem = cause.errors()[0]
        value = str(problem["input"])
        shown = value if value.lstrip("+-").isdecimal() else quote(value)
        return f"{flags[-1]} cannot be {shown}; {_list_choices(explain_allowed(problem))}"
    return f"{error.format_message().rstrip('.')}; see {command} -h"


def _list_choices(allowed: str) -> str:
    """Rewrite "'x' is not one of 'a', 'b', 'c'" as "give a, b or c"; return other texts unchanged."""
    _, listed, choices = allowed.partition(" is not one of ")
    *others, last = choices.replace("'", "").split(", ")
    return f"give {', '.join(others)} or {last}" if listed and others else allowed


def _show_traceback() -> None:
    """Write the traceback of the exception being handled, if -vv was given."""
    if is_shown(logging.DEBUG):
        sys.stderr.write(traceback.format_exc())


def _describe_full_disk(error: OSError) -> str:
    """Describe a full disk of caches or temporary files. Results and the store raise their own errors."""
    where = f" for {error.filename}" if error.filename else ""
    return f"the disk has no space{where}; free some, for instance with `tactile-loc store prune`, and run this again"


def _describe_unexpected(error: Exception, command: str) -> str:
    where = _find_component(error.__traceback__) or command
    text = f"unexpected {type(error).__name__} in {where}" + (f": {error}" if str(error) else "")
    return text if is_shown(logging.DEBUG) else f"{text}; run with -vv for the traceback"


def _find_component(trace: TracebackType | None) -> str | None:
    """Name the innermost component whose method raised the error. Return None if no component's method did."""
    from tactile_loc.slots.component import Component

    for frame, _ in reversed(list(traceback.walk_tb(trace))):
        owner = frame.f_locals.get("self")
        if isinstance(owner, Component):
            return f"the {owner.slot} {_find_name(owner)!r}"
    return None


def _find_name(component: Any) -> str:
    """Return the name that selects a component, or the name of its class if the component is not registered."""
    kind = type(component)
    target = f"{kind.__module__}:{kind.__qualname__}"
    names = (c.spec.name for c in registry().components if c.spec.target == target)
    return next(names, kind.__name__)
