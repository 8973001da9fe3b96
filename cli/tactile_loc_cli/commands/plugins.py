"""`tactile-loc plugins`: what can fill each slot, and with which options."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc_cli.console import output, say

if TYPE_CHECKING:
    from tactile_loc.core.registry import Registered, Registry


def plugins(
    slot: Annotated[str | None, typer.Argument(metavar="SLOT", help="Only this slot.")] = None,
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="The options of this component.")] = None,
) -> None:
    """List the components of every slot, or the options of one."""
    from tactile_loc.core.registry import registry

    found = registry()
    if slot is not None and name is not None:
        _show_options(found, slot, name)
        return
    _show_components(found, slot)
    for failure in found.failures:
        say(f"not loaded: {failure.plugin} of {failure.distribution}: {failure.error}")


def _show_components(found: Registry, slot: str | None) -> None:
    from rich.markup import escape
    from rich.table import Table

    from tactile_loc.core.errors import UnknownPluginError, did_you_mean
    from tactile_loc.core.hookspecs import SLOTS

    if slot is not None and slot not in SLOTS:
        raise UnknownPluginError(
            f"there is no slot {slot!r};{did_you_mean(slot, SLOTS)} the slots are {', '.join(SLOTS)}"
        )
    table = Table(box=None)
    for column in ("slot", "name", "distribution"):
        table.add_column(column, no_wrap=True)
    table.add_column("summary", overflow="fold")
    shown = [c for s in SLOTS for c in found.components if c.spec.slot == s and slot in (None, s)]
    for component in shown:
        spec = component.spec
        table.add_row(*map(escape, (spec.slot, spec.name, component.distribution, spec.summary)))
    output().print(table)
    for line in _conflicts(shown):
        say(line)


def _conflicts(components: Iterable[Registered]) -> list[str]:
    components = list(components)
    counts = Counter((c.spec.slot, c.spec.name) for c in components)
    return [
        f"conflict: the {slot} {name!r} is offered by "
        + " and ".join(c.distribution for c in components if (c.spec.slot, c.spec.name) == (slot, name))
        for (slot, name), count in counts.items()
        if count > 1
    ]


def _show_options(found: Registry, slot: str, name: str) -> None:
    from rich.markup import escape
    from rich.table import Table

    registered = found.find(slot, name)
    options = found.load(slot, name).Options
    say(f"{slot} {name} of {registered.distribution}: {registered.spec.summary}")
    if not options.model_fields:
        say("no options")
        return
    table = Table(box=None)
    for column in ("option", "type", "default"):
        table.add_column(column, no_wrap=True)
    table.add_column("meaning", overflow="fold")
    for key, field in options.model_fields.items():
        default = "required" if field.is_required() else _shown(field.get_default(call_default_factory=True))
        about = "; ".join(filter(None, [field.description, _limits(field.metadata)]))
        table.add_row(*map(escape, (f"{slot}.{key}", _type(field.annotation), default, about)))
    output().print(table)


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "none" if value is None else str(value)


def _type(annotation: Any) -> str:
    return annotation.__name__ if isinstance(annotation, type) else str(annotation).replace("typing.", "")


def _limits(metadata: Iterable[Any]) -> str:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    return ", ".join(f"{sign} {getattr(m, key):g}" for m in metadata for key, sign in signs.items() if hasattr(m, key))
