"""Commands made from functions: the options --json, -v and -q, the error handling, and the completion of names."""

import copy
import functools
import inspect
import logging
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command, get_group
from typer.models import ParameterInfo

from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.slots.registry import SLOTS, CommandSpec, registry
from tactile_loc_cli.console import hide_results, name_flags, say_json, show_log
from tactile_loc_cli.failures import Finding, report_failures
from tactile_loc_cli.options import Takes, declare

logger = logging.getLogger(__name__)

Verbose = Annotated[
    int,
    typer.Option(
        "-v", "--verbose", count=True, metavar="", show_default=False, help="Log each step; -vv logs all details."
    ),
]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Hide warnings and progress.")]
Json = Annotated[
    bool, declare("--json", "Print the result on stdout as one JSON document, in SI units, instead of text.")
]

SHARED = {"as_json": (Json, False), "verbose": (Verbose, 0), "quiet": (Quiet, False)}


def make_command(function: Callable[..., dict[str, Any] | None]) -> Callable[..., None]:
    """Make a command from a function, which prints its result and returns the result as JSON values.

    A parameter whose type is a dataclass, such as RunOptions, becomes several options of the command: one for each
    field, or those that `options.Takes` names.
    """
    name = function.__name__.replace("_", "-")
    own = list(inspect.signature(function, eval_str=True).parameters.values())
    taken = {p.name: found for p in own if (found := _read_taken(p.annotation))}

    @functools.wraps(function)
    def command(context_: typer.Context, as_json: bool, verbose: int, quiet: bool, **options: Any) -> None:
        with (
            name_flags(_list_flags(context_.command.params)),
            show_log((context_.obj or 0) + verbose - quiet),
            report_failures(name, as_json),
        ):
            start = time.perf_counter()
            for parameter, (kind, takes) in taken.items():
                options[parameter] = kind(**{key: options.pop(key) for key in takes.choose(kind)})
            result, code = _call(function, options, as_json)
            logger.info("%s took %.1f s.", name, time.perf_counter() - start)
            if as_json:
                say_json(result)
        if code:
            raise typer.Exit(code)

    command.__signature__ = inspect.Signature(list(_list_parameters(own, taken)))  # type: ignore[attr-defined]
    return command


def _list_flags(parameters: Sequence[Any]) -> dict[str, str]:
    """Return the flags of a command by the settings that they give, and the arguments as its help names them."""
    flags = {flag.removeprefix("--").replace("-", "_"): flag for p in parameters for flag in p.opts if flag[:2] == "--"}
    return {p.name: p.metavar for p in parameters if p.param_type_name == "argument" and p.metavar} | flags


# Each command has these settings itself, because its parser is also used without that of the whole command line.
HELP_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


def make_typer(**settings: Any) -> typer.Typer:
    """Return an empty typer application whose help is plain text."""
    settings = {"context_settings": HELP_SETTINGS, **settings}
    return typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, **settings)


def build_command(spec: CommandSpec, target: Any) -> TyperCommand | TyperGroup:
    """Return the parser of a command, or of a group of commands if `target` is a typer application."""
    if isinstance(target, typer.Typer):
        return get_group(_make_group(target, spec.summary))
    return _build_single(spec.name, target)


def build_failing_command(name: str, error: TactileLocError) -> TyperCommand | TyperGroup:
    """Return the parser of a hidden command that takes any words and raises the error."""

    def fail() -> None:
        raise error

    anything = {**HELP_SETTINGS, "ignore_unknown_options": True, "allow_extra_args": True}
    return _build_single(name, fail, hidden=True, add_help_option=False, context_settings=anything)


def _build_single(name: str, function: Callable[..., Any], **settings: Any) -> TyperCommand | TyperGroup:
    application = make_typer(add_completion=False)
    application.command(name, **{"context_settings": HELP_SETTINGS, **settings})(make_command(function))
    return get_command(application)  # type: ignore[return-value]


def _make_group(application: typer.Typer, summary: str) -> typer.Typer:
    """Return a typer application with the same commands, made by `make_command`."""
    group = make_typer(help=summary)
    for info in application.registered_commands:
        if info.callback is not None:
            group.command(info.name, hidden=info.hidden, context_settings=HELP_SETTINGS)(make_command(info.callback))
    for inner in application.registered_groups:
        if inner.typer_instance is not None:
            about = inner.help if isinstance(inner.help, str) else ""
            group.add_typer(_make_group(inner.typer_instance, about), name=inner.name)
    return group


def _call(
    function: Callable[..., dict[str, Any] | None], options: dict[str, Any], as_json: bool
) -> tuple[dict[str, Any], int]:
    """Return the function's result and the exit code."""
    try:
        with hide_results() if as_json else nullcontext():
            return function(**options) or {}, 0
    except Finding as finding:
        return finding.result, finding.exit_code


def _read_taken(annotation: Any) -> tuple[type, Takes] | None:
    """Return the options that a parameter stands for, and which of them are taken; None if it is a single option."""
    kind, *extras = get_args(annotation) or (annotation,)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        return None
    return kind, next((one for one in extras if isinstance(one, Takes)), Takes())


def _list_parameters(
    own: Sequence[inspect.Parameter], taken: Mapping[str, tuple[type, Takes]]
) -> Iterator[inspect.Parameter]:
    """Yield the command's parameters: those of the function, with completion of names, and those of all commands."""
    keyword = inspect.Parameter.KEYWORD_ONLY
    yield inspect.Parameter("context_", keyword, annotation=typer.Context)
    for p in own:
        if p.name not in taken:
            yield p.replace(kind=keyword, annotation=complete_parameter(p.name, p.annotation))
            continue
        kind, takes = taken[p.name]
        declared, defaults = get_type_hints(kind, include_extras=True), inspect.signature(kind).parameters
        for name in takes.choose(kind):
            annotation = complete_parameter(name, _change_help(declared[name], takes.helps.get(name)))
            yield inspect.Parameter(name, keyword, default=defaults[name].default, annotation=annotation)
    for name, (annotation, default) in SHARED.items():
        yield inspect.Parameter(name, keyword, default=default, annotation=annotation)


def _change_help(annotation: Any, about: str | None) -> Any:
    """Return an option's annotation with another help text, or unchanged if `about` is None."""
    if about is None:
        return annotation
    base, info = get_args(annotation)
    changed = copy.copy(info)
    changed.help = about
    return Annotated[base, changed]


LONGEST = 60  # characters of an explanation; some shells read the second line of a longer explanation as a name

Offers = Iterator[tuple[str, str]]  # names and their explanations


def complete_parameter(parameter: str, annotation: Any) -> Any:
    """Return the annotation of a command's parameter, with completion if OFFERS has the parameter."""
    if parameter not in OFFERS or get_origin(annotation) is not Annotated:
        return annotation
    base, *extras = get_args(annotation)
    completed = [copy.copy(extra) for extra in extras]
    for info in completed:
        if isinstance(info, ParameterInfo):
            info.autocompletion = _make_completer(OFFERS[parameter])
    return Annotated[(base, *completed)]


def _make_completer(offers: Callable[[typer.Context], Offers]) -> Callable[..., list[tuple[str, str]]]:
    def complete(ctx: typer.Context, incomplete: str) -> list[tuple[str, str]]:
        found = [(name, about) for name, about in offers(ctx) if name.startswith(incomplete)]
        return [(name, textwrap.shorten(about, LONGEST, placeholder=" ...")) for name, about in found]

    return complete


def _offer_components(slot: str, _: typer.Context) -> Offers:
    yield from {c.spec.name: c.spec.summary for c in registry().offers if c.spec.slot == slot}.items()


def _offer_demo_objects(_: typer.Context) -> Offers:
    from tactile_loc.data import DEMO_OBJECTS

    yield from ((demo.name, demo.description) for demo in DEMO_OBJECTS.values())


def _offer_slots(_: typer.Context) -> Offers:
    yield from ((slot, "") for slot in registry().kinds)


def _offer_components_of_slot(context: typer.Context) -> Offers:
    """Offer the components of the slot that the user wrote before the name."""
    slot = context.params.get("slot")
    yield from _offer_components(slot, context) if slot in registry().kinds and context.info_name == "plugins" else ()


OFFERS: Mapping[str, Callable[[typer.Context], Offers]] = {
    "object": _offer_demo_objects,
    "slot": _offer_slots,
    "name": _offer_components_of_slot,
    **{slot: functools.partial(_offer_components, slot) for slot in SLOTS},
}
