"""What all commands have in common: --json, -v, -q, completion of names, and failures told in one line."""

from __future__ import annotations

import copy
import functools
import inspect
import logging
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.models import ParameterInfo

from tactile_loc.core.slots.registry import SLOTS
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


LONGEST = 60  # characters of an explanation: a longer one could be broken into lines, which shells take for names

Offers = Iterator[tuple[str, str]]  # names, and what they mean
Completer = Callable[[typer.Context, str], list[tuple[str, str]]]


def completing(parameter: str, annotation: Any) -> Any:
    """Return the annotation of a command's parameter, completed if its name is one of those that name something."""
    offers = OFFERS.get(parameter)
    if offers is None or get_origin(annotation) is not Annotated:
        return annotation
    base, *extras = get_args(annotation)
    return Annotated[(base, *(_with(extra, offers) for extra in extras))]


def _with(extra: Any, offers: Callable[[typer.Context], Offers]) -> Any:
    if not isinstance(extra, ParameterInfo) or extra.autocompletion is not None:
        return extra
    info = copy.copy(extra)
    info.autocompletion = _completer(offers)
    return info


def _completer(offers: Callable[[typer.Context], Offers]) -> Completer:
    def complete(ctx: typer.Context, incomplete: str) -> list[tuple[str, str]]:
        found = [(name, about) for name, about in offers(ctx) if name.startswith(incomplete)]
        return [(name, textwrap.shorten(about, LONGEST, placeholder=" ...")) for name, about in found]

    return complete


def _components(slot: str) -> Callable[[typer.Context], Offers]:
    def offers(_: typer.Context) -> Offers:
        from tactile_loc.core.slots.registry import registry

        found = {c.spec.name: c.spec.summary for c in registry().components if c.spec.slot == slot}
        yield from found.items()

    return offers


def _demo_objects(_: typer.Context) -> Offers:
    from tactile_loc.data import DEMO_OBJECTS

    yield from ((demo.name, demo.description) for demo in DEMO_OBJECTS.values())


def _slots(_: typer.Context) -> Offers:
    yield from ((slot, "") for slot in SLOTS)


def _of_the_slot(context: typer.Context) -> Offers:
    """The components of the slot that was named before."""
    slot = context.params.get("slot")
    yield from _components(slot)(context) if slot in SLOTS and context.info_name == "plugins" else ()


OFFERS: Mapping[str, Callable[[typer.Context], Offers]] = {
    "object": _demo_objects,
    "slot": _slots,
    "name": _of_the_slot,
    **{slot: _components(slot) for slot in SLOTS},
}
