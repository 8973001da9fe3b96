"""What the shell offers when Tab is pressed: names of components, demo objects, slots. Nothing heavy is loaded."""

from __future__ import annotations

import copy
import textwrap
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.models import ParameterInfo

from tactile_loc.core.registry import SLOTS

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
        from tactile_loc.core.registry import registry

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
