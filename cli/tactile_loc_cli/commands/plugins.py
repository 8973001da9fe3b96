"""`tactile-loc plugins`: what can fill each slot, with which options, and whether it keeps its contracts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc_cli.console import say, say_table
from tactile_loc_cli.failures import Finding
from tactile_loc_cli.options import set_option

if TYPE_CHECKING:
    from tactile_loc.core.slots.component import Component
    from tactile_loc.core.slots.registry import Registered, Registry
    from tactile_loc.testing.running import CheckResult

BROKEN_CONTRACT = 1

Slot = Annotated[str | None, typer.Argument(metavar="SLOT", help="Only this slot.")]
Name = Annotated[str | None, typer.Argument(metavar="NAME", help="The options of this component.")]
Check = Annotated[
    bool,
    typer.Option("--check", help="Run the contract checks of SLOT NAME instead; exit code 1 if it breaks a contract."),
]
SetOption = Annotated[list[str] | None, set_option("With --check: an option of the component; may be repeated.")]
Properties = Annotated[
    bool,
    typer.Option(
        "--properties", help="With --check: try its properties too; needs pip install 'tactile-loc[testing]'."
    ),
]


def plugins(
    slot: Slot = None, name: Name = None, check: Check = False, option: SetOption = None, properties: Properties = False
) -> dict[str, Any]:
    """List the components of every slot, or the options of one.

    With --check, do to one component what the rest of tactile-loc relies on, and say what is wrong. With --properties
    too, try what must hold whatever is drawn: frames, orders, symmetric copies, image sizes, mirror images.
    """
    from tactile_loc.core.errors import ConfigError
    from tactile_loc.core.slots.registry import registry

    found = registry()
    if check:
        if slot is None or name is None:
            raise ConfigError("--check is of one component; say which, as tactile-loc plugins refiner icp --check")
        return _check(found, slot, name, option or [], properties)
    for given, what in ((option, "-o"), (properties, "--properties")):
        if given:
            raise ConfigError(f"{what} is for --check: give both, or none to list the options and their defaults")
    if slot is not None and name is not None:
        return _show_options(found, slot, name)
    return _show_components(found, slot)


def _show_components(found: Registry, slot: str | None) -> dict[str, Any]:
    from tactile_loc.core.errors import UnknownPluginError, did_you_mean
    from tactile_loc.core.slots.registry import SLOTS

    if slot is not None and slot not in SLOTS:
        raise UnknownPluginError(
            f"there is no slot {slot!r}.{did_you_mean(slot, SLOTS)} The slots are {', '.join(SLOTS)}"
        )
    shown = [c for s in SLOTS for c in found.components if c.spec.slot == s and slot in (None, s)]
    components = [_component(c) for c in shown]
    _say_columns(("slot", "name", "distribution", "summary"), components)
    conflicts = _conflicts(shown)
    failures = [asdict(failure) for failure in found.failures]
    for c in conflicts:
        say(f"conflict: the {c['slot']} {c['name']!r} is offered by {' and '.join(c['distributions'])}")
    for component in components:
        _say_interface(component)
    for f in failures:
        say(f"not loaded: {f['plugin']} of {f['distribution']}: {f['error']}")
    return {"components": components, "conflicts": conflicts, "not_loaded": failures}


def _component(registered: Registered) -> dict[str, Any]:
    spec = registered.spec
    return {
        "slot": spec.slot, "name": spec.name, "distribution": registered.distribution, "summary": spec.summary,
        "interface": spec.interface,
    }  # fmt: skip


def _say_interface(component: dict[str, Any], outdated: str = "") -> None:
    """Name a component that was written for another plugin interface, and the change that it needs, if that is known.

    Of one that is only listed it is not: its class is not imported.
    """
    from tactile_loc.core.slots.interface import INTERFACE_VERSION

    written, named = component["interface"], "the {slot} {name!r} of {distribution}".format(**component)
    if written > INTERFACE_VERSION:
        say(f"interface: {named} needs plugin interface {written}, this tactile-loc has {INTERFACE_VERSION}; "
            "pip install --upgrade tactile-loc")  # fmt: skip
    elif written < INTERFACE_VERSION:
        advice = f"; {outdated}" if outdated else ""
        say(f"interface: {named} was written for plugin interface {written}, this tactile-loc has "
            f"{INTERFACE_VERSION}{advice}")  # fmt: skip


def _conflicts(components: Sequence[Registered]) -> list[dict[str, Any]]:
    counts = Counter((c.spec.slot, c.spec.name) for c in components)
    return [
        {
            "slot": slot,
            "name": name,
            "distributions": [c.distribution for c in components if (c.spec.slot, c.spec.name) == (slot, name)],
        }
        for (slot, name), count in counts.items()
        if count > 1
    ]


def _show_options(found: Registry, slot: str, name: str) -> dict[str, Any]:
    component = _component(found.find(slot, name))
    kind = found.load(slot, name)
    options = [_option(f"{slot}.{key}", field) for key, field in kind.Options.model_fields.items()]
    say(_heading(component))
    _say_interface(component, kind.outdated)
    if options:
        _say_columns(("option", "type", "default", "meaning"), options)
    else:
        say("no options")
    return {**component, "outdated": kind.outdated, "options": options}


def _heading(component: dict[str, Any]) -> str:
    return "{slot} {name} of {distribution}: {summary}".format(**component)


def _option(name: str, field: Any) -> dict[str, str]:
    default = "required" if field.is_required() else _shown(field.get_default(call_default_factory=True))
    about = "; ".join(filter(None, [field.description, _limits(field.metadata)]))
    return {"option": name, "type": _type(field.annotation), "default": default, "meaning": about}


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "none" if value is None else str(value)


def _type(annotation: Any) -> str:
    return annotation.__name__ if isinstance(annotation, type) else str(annotation).replace("typing.", "")


def _limits(metadata: Iterable[Any]) -> str:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    return ", ".join(f"{sign} {getattr(m, key):g}" for m in metadata for key, sign in signs.items() if hasattr(m, key))


def _say_columns(names: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    """Write a table; the last column is folded where the window is too narrow."""
    say_table([names, *([row[name] for name in names] for row in rows)], left=len(names), gap=2, fold=True)


def _check(found: Registry, slot: str, name: str, words: list[str], properties: bool) -> dict[str, Any]:
    """Run the contract checks of a component; raises Finding when it breaks any."""
    from tactile_loc.testing.running import iter_checks

    about = _component(found.find(slot, name))
    component = _make(found, slot, name, words)
    say(_heading(about))
    _say_interface(about, component.outdated)
    checks = []
    for result in iter_checks(component, properties):
        say(_line(result))
        checks.append({**asdict(result), "passed": result.passed})
    failed = sum(not c["passed"] for c in checks)
    say(f"{len(checks) - failed} of {len(checks)} checks passed" + (f", {failed} failed" if failed else ""))
    options = component.options.model_dump(mode="json")
    outcome = {
        **about,
        "outdated": component.outdated,
        "options": options,
        "passed": len(checks) - failed,
        "failed": failed,
        "checks": checks,
    }
    if failed:
        raise Finding(BROKEN_CONTRACT, outcome)
    return outcome


def _make(found: Registry, slot: str, name: str, words: list[str]) -> Component:
    """The component with the options given. Raises ConfigError for others' options, PluginLoadError where it fails."""
    from tactile_loc.core.errors import ConfigError, PluginLoadError, TactileLocError
    from tactile_loc.io.config import parse_overrides

    overrides = parse_overrides(words)
    others = sorted(overrides.keys() - {slot})
    if others:
        raise ConfigError(f"the {slot} {name!r} is checked alone; leave out the options of {', '.join(others)}")
    try:
        component: Component = found.create(slot, name, overrides.get(slot))
    except TactileLocError:
        raise
    except Exception as error:
        raise PluginLoadError(
            f"the {slot} {name!r} cannot be made from its options ({type(error).__name__}: {error})"
        ) from error
    return component


def _line(result: CheckResult) -> str:
    return f"ok      {result.name}" if result.passed else f"FAILED  {result.name}: {result.problem}"
