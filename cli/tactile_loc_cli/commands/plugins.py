"""`tactile-loc plugins`, which lists and checks what packages offer, and `tactile-loc objects`, the demo objects."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.slots.registry import COMMAND
from tactile_loc_cli.console import say, say_table
from tactile_loc_cli.failures import Finding
from tactile_loc_cli.options import declare, require_slot, set_option

if TYPE_CHECKING:
    from tactile_loc.slots.component import Component
    from tactile_loc.slots.registry import Offer, Registry

BROKEN_CONTRACT = 1

Slot = Annotated[str | None, typer.Argument(metavar="SLOT", help="Only this slot.")]
Name = Annotated[str | None, typer.Argument(metavar="NAME", help="List the options of this component.")]
Check = Annotated[
    bool, declare("--check", "Run the contract checks of SLOT NAME; exit code 1 if it breaks a contract.")
]
SetOption = Annotated[list[str] | None, set_option("With --check: set an option of the component; may be repeated.")]
Properties = Annotated[bool, declare("--properties", "With --check: also run property tests.")]


def objects() -> dict[str, Any]:
    """List the demo objects."""
    from tactile_loc.data import DEMO_OBJECTS

    rows = [
        {"object": demo.name, "symmetry": demo.symmetry, "description": demo.description, "path": str(demo.path)}
        for demo in DEMO_OBJECTS.values()
    ]
    _say_columns(("object", "symmetry", "description"), rows)
    return {"objects": [{"name": row.pop("object"), **row} for row in rows]}


def plugins(
    slot: Slot = None, name: Name = None, check: Check = False, option: SetOption = None, properties: Properties = False
) -> dict[str, Any]:
    """List components and their options, or check one.

    Without SLOT and NAME, the components of every slot and all commands are listed; with both, the options of one
    component. The slot of commands is `command`.

    --check runs the contract checks of one component or command and reports each failure. --properties also tests
    general properties on random inputs: frames, orders, symmetric copies, image sizes, mirror images.
    """
    from tactile_loc.core.runtime.errors import ConfigError
    from tactile_loc.slots.registry import registry

    found = registry()
    if check:
        if slot is None or name is None:
            raise ConfigError("--check needs SLOT and NAME, as in tactile-loc plugins refiner icp --check")
        return _check(found, slot, name, option or [], properties)
    for given, flag in ((option, "-o"), (properties, "--properties")):
        if given:
            raise ConfigError(f"{flag} needs --check; add it, or leave out {flag} to list the options")
    if slot is not None and name is not None:
        return _show_options(found, slot, name)
    return _show_components(found, slot)


def _show_components(found: Registry, slot: str | None) -> dict[str, Any]:
    from tactile_loc.slots.registry import explain_missing

    if slot is not None:
        require_slot(slot)
    shown = [c for s in found.kinds for c in found.offers if c.spec.slot == s and slot in (None, s)]
    rows = [_describe(c) for c in shown]
    _say_columns(("slot", "name", "distribution", "summary"), rows)
    conflicts = _find_conflicts(shown)
    failures = [asdict(failure) for failure in found.failures]
    for c in conflicts:
        say(f"conflict: {' and '.join(c['distributions'])} both offer a {c['slot']} {c['name']!r}")
    components = [row for row in rows if row["slot"] != COMMAND]
    for component in components:
        _say_interface(component)
    for f in failures:
        say(f"not loaded: {f['plugin']} of {f['distribution']}: {f['error']}")
    missing = [{"slot": c.spec.slot, "name": c.spec.name, "reason": explain_missing(c)} for c in shown]
    missing = [row for row in missing if row["reason"]]
    for row in missing:
        say(f"not installed: {row['reason']}")
    commands = [row for row in rows if row["slot"] == COMMAND]
    found_out = {"conflicts": conflicts, "not_loaded": failures, "not_installed": missing}
    return {"components": components, "commands": commands, **found_out}


def _describe(offer: Offer) -> dict[str, Any]:
    """Return what a spec states about a component or a command."""
    spec = offer.spec
    about = {"slot": spec.slot, "name": spec.name, "distribution": offer.distribution, "summary": spec.summary}
    return about if spec.slot == COMMAND else {**about, "interface": spec.interface}


def _say_interface(component: dict[str, Any]) -> None:
    """Report a component that was written for another version of the plugin interface."""
    from tactile_loc.slots.interface import explain_version

    if reason := explain_version(component["interface"], component["distribution"]):
        say("interface: the {slot} {name!r} of {distribution} {reason}".format(reason=reason, **component))


def _find_conflicts(components: Sequence[Offer]) -> list[dict[str, Any]]:
    distributions: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for c in components:
        distributions[c.spec.slot, c.spec.name].append(c.distribution)
    return [
        {"slot": slot, "name": name, "distributions": several}
        for (slot, name), several in distributions.items()
        if len(several) > 1
    ]


def _show_options(found: Registry, slot: str, name: str) -> dict[str, Any]:
    if slot == COMMAND:
        command = _describe(found.find(COMMAND, name))
        say(_format_heading(command))
        say(f"for its options, see tactile-loc {name} -h")
        return command
    component = _describe(found.find(slot, name))
    kind = found.load(slot, name)
    options = [_describe_option(f"{slot}.{key}", field) for key, field in kind.Options.model_fields.items()]
    say(_format_heading(component))
    if options:
        _say_columns(("option", "type", "default", "meaning"), options)
    else:
        say("no options")
    return {**component, "options": options}


def _format_heading(component: dict[str, Any]) -> str:
    return "{slot} {name} of {distribution}: {summary}".format(**component)


def _describe_option(name: str, field: Any) -> dict[str, str]:
    default = "required" if field.is_required() else _format_value(field.get_default(call_default_factory=True))
    about = "; ".join(filter(None, [field.description, _format_limits(field.metadata)]))
    return {"option": name, "type": _name_type(field.annotation), "default": default, "meaning": about}


def _format_value(value: Any) -> str:
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def _name_type(annotation: Any) -> str:
    return annotation.__name__ if isinstance(annotation, type) else str(annotation).replace("typing.", "")


def _format_limits(metadata: Iterable[Any]) -> str:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    return ", ".join(f"{sign} {getattr(m, key):g}" for m in metadata for key, sign in signs.items() if hasattr(m, key))


def _say_columns(names: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    """Write a table whose last column is folded if the window is too narrow."""
    say_table([names, *([row[name] for name in names] for row in rows)], left=len(names), gap=2, fold=True)


def _check(found: Registry, slot: str, name: str, words: list[str], properties: bool) -> dict[str, Any]:
    """Run the contract checks of a component or a command. Raises Finding if a check fails."""
    from tactile_loc.testing.running import iter_checks

    offer = found.find(slot, name)
    about = _describe(offer)
    checked = offer.spec if slot == COMMAND else _make(found, slot, name, words)
    say(_format_heading(about))
    checks = []
    for result in iter_checks(checked, properties):
        say(f"ok      {result.name}" if result.passed else f"FAILED  {result.name}: {result.problem}")
        checks.append({**asdict(result), "passed": result.passed})
    failed = sum(not c["passed"] for c in checks)
    passed = len(checks) - failed
    say(f"{passed} of {len(checks)} checks passed" + (f", {failed} failed" if failed else ""))
    options = {} if slot == COMMAND else {"options": checked.options.model_dump(mode="json")}
    outcome = {**about, **options, "passed": passed, "failed": failed, "checks": checks}
    if failed:
        raise Finding(BROKEN_CONTRACT, outcome)
    return outcome


def _make(found: Registry, slot: str, name: str, words: list[str]) -> Component:
    """Make the component with these options.

    Raises ConfigError for options of another slot, and PluginLoadError if the component's class raises an error.
    """
    from tactile_loc.core.runtime.errors import ConfigError, PluginLoadError, TactileLocError
    from tactile_loc.io.config import parse_overrides

    overrides = parse_overrides(words)
    others = sorted(overrides.keys() - {slot})
    if others:
        raise ConfigError(f"--check tests only the {slot} {name!r}; leave out the options of {', '.join(others)}")
    try:
        component: Component = found.create(slot, name, overrides.get(slot))
    except TactileLocError:
        raise
    except Exception as error:
        raise PluginLoadError(
            f"the {slot} {name!r} cannot be made from its options ({type(error).__name__}: {error}); correct them"
        ) from error
    return component
