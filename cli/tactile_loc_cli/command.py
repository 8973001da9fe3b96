"""What all commands have in common: --json, -v, -q, completion of names, and failures told in one line."""

from __future__ import annotations

import functools
import inspect
import logging
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import Annotated, Any

import typer

from tactile_loc_cli.completion import completing
from tactile_loc_cli.console import log_shown, results_hidden, say_json
from tactile_loc_cli.failures import Finding, failures_told

logger = logging.getLogger(__name__)

Verbose = Annotated[
    int,
    typer.Option(
        "-v", "--verbose", count=True, metavar="", show_default=False, help="Say what is being done; -vv: all details."
    ),
]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="No warnings, no progress bars: errors only.")]
Json = Annotated[bool, typer.Option("--json", help="Write the result as one JSON document, in SI units.")]

SHARED = {"as_json": (Json, False), "verbose": (Verbose, 0), "quiet": (Quiet, False)}


def as_command(function: Callable[..., dict[str, Any] | None]) -> Callable[..., None]:
    """Make a command of a function that writes for people and returns what it found or wrote, as JSON values."""
    name = function.__name__.replace("_", "-")

    @functools.wraps(function)
    def command(context_: typer.Context, as_json: bool, verbose: int, quiet: bool, **options: Any) -> None:
        with log_shown((context_.obj or 0) + verbose - quiet), failures_told(name, as_json):
            start = time.perf_counter()
            result, code = _result(function, options, as_json)
            logger.info("%s took %.1f s.", name, time.perf_counter() - start)
            if as_json:
                say_json(result)
        if code:
            raise typer.Exit(code)

    command.__signature__ = _signature(function)  # type: ignore[attr-defined]
    return command


def _result(
    function: Callable[..., dict[str, Any] | None], options: dict[str, Any], as_json: bool
) -> tuple[dict[str, Any], int]:
    """What the function found, and the exit code."""
    try:
        with results_hidden() if as_json else nullcontext():
            return function(**options) or {}, 0
    except Finding as finding:
        return finding.result, finding.exit_code


def _signature(function: Callable[..., Any]) -> inspect.Signature:
    """The function's options, those that name components completed, and the shared ones."""
    own = inspect.signature(function, eval_str=True)
    keyword = inspect.Parameter.KEYWORD_ONLY
    context = inspect.Parameter("context_", keyword, annotation=typer.Context)
    options = [p.replace(kind=keyword, annotation=completing(p.name, p.annotation)) for p in own.parameters.values()]
    shared = [inspect.Parameter(n, keyword, default=d, annotation=a) for n, (a, d) in SHARED.items()]
    return inspect.Signature([context, *options, *shared])
