"""What all commands have in common: --json, -v, -q, completion of names, and failures told in one line."""

from __future__ import annotations

import copy
import functools
import inspect
import logging
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.models import ParameterInfo

from tactile_loc.core.slots.registry import SLOTS, registry
from tactile_loc_cli.console import hide_results, say_json, show_log
from tactile_loc_cli.failures import Finding, report_failures
from tactile_loc_cli.options import RunOptions, Takes

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


def make_command(function: Callable[..., dict[str, Any] | None]) -> Callable[..., None]:
    """Make a command of a function that writes for people and returns what it found or wrote, as JSON values.

    Each option of a parameter of type RunOptions becomes one of the command's; `options.takes` says which.
    """
    name = function.__name__.replace("_", "-")
    own = list(inspect.signature(function, eval_str=True).parameters.values())
    taken = {p.name: names for p in own if (names := _read_taken(p.annotation))}

    @functools.wraps(function)
    def command(context_: typer.Context, as_json: bool, verbose: int, quiet: bool, **options: Any) -> None:
        with show_log((context_.obj or 0) + verbose - quiet), report_failures(name, as_json):
            start = time.perf_counter()
            for parameter, names in taken.items():
                options[parameter] = RunOptions(**{key: options.pop(key) for key in names})
            result, code = _call(function, options, as_json)
            logger.info("%s took %.1f s.", name, time.perf_counter() - start)
            if as_json:
                say_json(result)
        if code:
            raise typer.Exit(code)

    command.__signature__ = inspect.Signature(list(_list_parameters(own, taken)))  # type: ignore[attr-defined]
    return command


def _call(
    function: Callable[..., dict[str, Any] | None], options: dict[str, Any], as_json: bool
) -> tuple[dict[str, Any], int]:
    """What the function found, and the exit code."""
    try:
        with hide_results() if as_json else nullcontext():
            return function(**options) or {}, 0
    except Finding as finding:
        return finding.result, finding.exit_code


def _read_taken(annotation: Any) -> tuple[str, ...]:
    """The names of the shared options that a parameter stands for; empty if it is an option itself."""
    found = [extra.names for extra in getattr(annotation, "__metadata__", ()) if isinstance(extra, Takes)]
    return found[0] if found else ()


def _list_parameters(
    own: Sequence[inspect.Parameter], taken: Mapping[str, Sequence[str]]
) -> Iterator[inspect.Parameter]:
    """The command's parameters: the function's, those that name components completed, and those of all commands."""
    keyword = inspect.Parameter.KEYWORD_ONLY
    declared, defaults = get_type_hints(RunOptions, include_extras=True), RunOptions()
    yield inspect.Parameter("context_", keyword, annotation=typer.Context)
    for p in own:
        if p.name not in taken:
            yield p.replace(kind=keyword, annotation=complete_parameter(p.name, p.annotation))
        for name in taken.get(p.name, ()):
            annotation = complete_parameter(name, declared[name])
            yield inspect.Parameter(name, keyword, default=getattr(defaults, name), annotation=annotation)
    for name, (annotation, default) in SHARED.items():
        yield inspect.Parameter(name, keyword, default=default, annotation=annotation)


LONGEST = 60  # characters of an explanation: a longer one could be broken into lines, which shells take for names

Offers = Iterator[tuple[str, str]]  # names, and what they mean
Completer = Callable[[typer.Context, str], list[tuple[str, str]]]


def complete_parameter(parameter: str, annotation: Any) -> Any:
    """Return the annotation of a command's parameter, completed if its name is one of those that name something."""
    offers = OFFERS.get(parameter)
    if offers is None or get_origin(annotation) is not Annotated:
        return annotation
    base, *extras = get_args(annotation)
    return Annotated[(base, *(_attach_completer(extra, offers) for extra in extras))]


def _attach_completer(extra: Any, offers: Callable[[typer.Context], Offers]) -> Any:
    if not isinstance(extra, ParameterInfo) or extra.autocompletion is not None:
        return extra
    info = copy.copy(extra)
    info.autocompletion = _make_completer(offers)
    return info


def _make_completer(offers: Callable[[typer.Context], Offers]) -> Completer:
    def complete(ctx: typer.Context, incomplete: str) -> list[tuple[str, str]]:
        found = [(name, about) for name, about in offers(ctx) if name.startswith(incomplete)]
        return [(name, textwrap.shorten(about, LONGEST, placeholder=" ...")) for name, about in found]

    return complete


def _offer_components(slot: str, _: typer.Context) -> Offers:
    yield from {c.spec.name: c.spec.summary for c in registry().components if c.spec.slot == slot}.items()


def _offer_demo_objects(_: typer.Context) -> Offers:
    from tactile_loc.data import DEMO_OBJECTS

    yield from ((demo.name, demo.description) for demo in DEMO_OBJECTS.values())


def _offer_slots(_: typer.Context) -> Offers:
    yield from ((slot, "") for slot in SLOTS)


def _offer_components_of_slot(context: typer.Context) -> Offers:
    """The components of the slot that was named before."""
    slot = context.params.get("slot")
    yield from _offer_components(slot, context) if slot in SLOTS and context.info_name == "plugins" else ()


OFFERS: Mapping[str, Callable[[typer.Context], Offers]] = {
    "object": _offer_demo_objects,
    "slot": _offer_slots,
    "name": _offer_components_of_slot,
    **{slot: functools.partial(_offer_components, slot) for slot in SLOTS},
}
