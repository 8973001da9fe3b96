"""The registry of plugins, which are found by entry points.

A component's class is imported at its first use, and a command's module when the command runs.
"""

from __future__ import annotations

import importlib
import inspect
import logging
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar, Generic, TypeVar

import pluggy
from pydantic import ValidationError

from tactile_loc.core.runtime.errors import (
    ConfigError,
    MissingLibraryError,
    PluginConflictError,
    PluginLoadError,
    UnknownPluginError,
    advise_choice,
    did_you_mean,
    quote,
)
from tactile_loc.slots.interface import INTERFACE_VERSION, explain_version, require_interface

PROJECT = "tactile_loc"
SLOTS = ("sensor", "renderer", "grid", "encoder", "matcher", "refiner", "fuser")
COMMAND = "command"
KEBAB_CASE = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@dataclass(frozen=True)
class ComponentSpec:
    """One component offered for one slot, or for a kind of component that another package defines.

    `target` is "package.module:Class", imported at first use. `requires` names the pip distribution of a library that
    the component needs and tactile-loc does not. `interface` is the version of the plugin interface for which the
    component was written, by default 1. Write a number here, not INTERFACE_VERSION, because that changes with the
    installed tactile-loc.
    """

    slot: str
    name: str
    target: str
    summary: str
    requires: str = ""
    interface: int = 1


@dataclass(frozen=True)
class CommandSpec:
    """One command of `tactile-loc`, or one group of commands.

    `summary` is the command's line in `tactile-loc --help`. `target` is "package.module:function", or
    "package.module:application" for a group, whose application is a `typer.Typer`. Its module is imported only when the
    command runs. `requires` names the pip distribution of a library that the command needs and its package does not.
    """

    slot: ClassVar[str] = COMMAND
    name: str
    summary: str
    target: str
    requires: str = ""


@dataclass(frozen=True)
class ComponentKind:
    """A kind of component that a package defines beside the slots. Its interface derives from `Component`.

    `name` is the interface's `slot`. `checks` is the module of the contract checks, with the functions
    `checks(capabilities)` and `properties(capabilities)`. `templates` is a package: its folder `templates` contains the
    files that `new-plugin` fills in, `KIND.py.tmpl` and `test_KIND.py.tmpl`. `example` describes the component in
    these files, and `usage` is the command that uses a component: `{name}` stands for its name.
    """

    name: str
    checks: str
    templates: str
    example: str
    usage: str


@hookspec
def tactile_loc_components() -> Iterable[ComponentSpec]:  # type: ignore[empty-body]
    """Return the components that this plugin offers."""


@hookspec
def register_commands() -> Iterable[CommandSpec]:  # type: ignore[empty-body]
    """Return the commands that this plugin adds to `tactile-loc`."""


@hookspec
def register_kinds() -> Iterable[ComponentKind]:  # type: ignore[empty-body]
    """Return the kinds of components that this plugin defines beside the slots."""


logger = logging.getLogger(__name__)

BUILT_IN = "tactile-loc"
ADDED = "this program"  # stands for the distribution of components that a program adds


Spec = TypeVar("Spec", ComponentSpec, CommandSpec)


@dataclass(frozen=True)
class Offer(Generic[Spec]):
    """A component or a command that a distribution offers."""

    spec: Spec
    distribution: str


@dataclass(frozen=True)
class LoadFailure:
    """A plugin that raised an error while it was loaded."""

    plugin: str
    distribution: str
    error: str


class Registry:
    """All components and commands found.

    A plugin that fails to load is kept as a failure and does not affect the others.
    """

    def __init__(self, plugins: Iterable[EntryPoint]) -> None:
        self.components: list[Offer[ComponentSpec]] = []
        self.commands: list[Offer[CommandSpec]] = []
        self.failures: list[LoadFailure] = []
        self.kinds: dict[str, ComponentKind | None] = dict.fromkeys(SLOTS)  # slots have no ComponentKind
        self._classes: dict[ComponentSpec, Any] = {}
        offers: list[tuple[str, str, list[ComponentSpec]]] = []
        for plugin in plugins:
            distribution = _name_distribution(plugin)  # once for each plugin, because this reads a file
            with self._keep_failure(plugin.name, distribution):
                offers.append((plugin.name, distribution, self._load(plugin, distribution)))
        for name, distribution, components in offers:  # a component may be of a kind that a later plugin defines
            with self._keep_failure(name, distribution):
                for component in components:
                    self._require_component_spec(component)
                self.components += [Offer(spec, distribution) for spec in components]

    @contextmanager
    def _keep_failure(self, plugin: str, distribution: str) -> Iterator[None]:
        """Keep an error of the block as the plugin's failure."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - other people's plugins may raise anything
            reason = f"{type(error).__name__}: {error}"
            self.failures.append(LoadFailure(plugin, distribution, reason))

    def _load(self, plugin: EntryPoint, distribution: str) -> list[ComponentSpec]:
        """Import a plugin, add the kinds and commands that it defines, and return the components that it offers."""
        manager = pluggy.PluginManager(PROJECT)
        manager.add_hookspecs(sys.modules[__name__])
        manager.register(plugin.load())
        manager.check_pending()
        components = [spec for offered in manager.hook.tactile_loc_components() for spec in offered]
        commands = [spec for offered in manager.hook.register_commands() for spec in offered]
        kinds = {kind.name: kind for defined in manager.hook.register_kinds() for kind in defined}
        if not components and not commands and not kinds:
            raise TypeError("offers no component and no command: its hooks are missing or return nothing")
        for command in commands:
            _require_command_spec(command)
        self.kinds |= kinds
        self.commands += [Offer(spec, distribution) for spec in commands]
        return components

    def _require_component_spec(self, spec: Any) -> None:
        """Raise TypeError unless this is the spec of a component of a known kind."""
        if not isinstance(spec, ComponentSpec) or spec.slot not in self.kinds or spec.slot == COMMAND:
            raise TypeError(f"offers {spec!r}; the slots are {', '.join(self.kinds)}")
        if not isinstance(spec.interface, int) or spec.interface < 1:
            raise TypeError(f"offers {spec!r}; its interface must be a whole number, 1 or more")

    def add(self, kind: type[Any], name: str, summary: str = "") -> None:
        """Offer a component class under a name, in this process only. This is for notebooks and short scripts.

        The class must follow the current version of the interface. Its slot is that of its base class. A class that was
        added earlier under the same name is replaced. Other processes, and files read by them, do not know the name, so
        publish a component as a package. Raises PluginLoadError unless `kind` is a complete component class, and
        PluginConflictError if a package offers the name.
        """
        slot = getattr(kind, "slot", "")
        try:
            _require_component(kind, slot)
            require_interface(kind, slot)
        except TypeError as error:
            raise PluginLoadError(f"the component {name!r} cannot be added: {error}") from error
        others = [c for c in self.components if (c.spec.slot, c.spec.name, c.distribution) != (slot, name, ADDED)]
        if taken := [c for c in others if (c.spec.slot, c.spec.name) == (slot, name)]:
            raise PluginConflictError(
                f"{taken[0].distribution} offers the {slot} {name!r} already; choose another name"
            )
        target = f"{kind.__module__}:{kind.__qualname__}"
        spec = ComponentSpec(slot, name, target, summary, interface=INTERFACE_VERSION)
        self.components = [*others, Offer(spec, ADDED)]
        self._classes[spec] = kind

    @property
    def offers(self) -> list[Offer[Any]]:
        """All components and commands, in the order found."""
        return [*self.components, *self.commands]

    def names(self, slot: str) -> list[str]:
        """Return the names of a slot's components, or of the commands, in the order found."""
        return list(dict.fromkeys(c.spec.name for c in self.offers if c.spec.slot == slot))

    def find(self, slot: str, name: str) -> Offer[ComponentSpec]:
        """Return the component with this slot and name. Raises UnknownPluginError or PluginConflictError."""
        return self._choose([c for c in self.components if (c.spec.slot, c.spec.name) == (slot, name)], slot, name)

    def find_command(self, name: str) -> Offer[CommandSpec]:
        """Return the command with this name. Raises UnknownPluginError or PluginConflictError."""
        return self._choose([c for c in self.commands if c.spec.name == name], COMMAND, name)

    def _choose(self, found: Sequence[Offer[Spec]], slot: str, name: str) -> Offer[Spec]:
        """Return the only one that was found. Raises UnknownPluginError or PluginConflictError."""
        if not found:
            raise UnknownPluginError(self._describe_unknown(slot, name))
        if len(found) > 1:
            raise PluginConflictError(
                f"two packages offer the {slot} {name!r}: {found[0].distribution} and {found[1].distribution}; "
                "uninstall one, or choose with TACTILE_LOC_PLUGINS"
            )
        return found[0]

    def _describe_unknown(self, slot: str, name: str) -> str:
        if slot not in self.kinds:
            return f"there is no slot {slot!r}; {advise_choice(slot, self.kinds)}"
        broken = "".join(f". The plugin {f.plugin} could not be loaded ({f.error})" for f in self.failures)
        also = ", and no folder or file with that name" if slot == "sensor" else ""
        return f"there is no {slot} {name!r}{also}; {advise_choice(name, self.names(slot))}{broken}".replace("?.", "?")

    def load(self, slot: str, name: str) -> type[Any]:
        """Import and return the class of a component. Raises PluginLoadError, MissingLibraryError or as `find`."""
        found = self.find(slot, name)
        if reason := explain_version(found.spec.interface, found.distribution):
            raise PluginLoadError(f"the {slot} {name!r} of {found.distribution} {reason}")
        if found.spec not in self._classes:
            self._classes[found.spec] = self._import_component(found)
        return self._classes[found.spec]

    def _import_component(self, found: Offer[ComponentSpec]) -> Any:
        slot = found.spec.slot

        def require(kind: Any) -> None:
            _require_component(kind, slot)
            require_interface(kind, slot)

        return _import_target(found, require)

    def load_command(self, found: Offer[CommandSpec]) -> Any:
        """Import and return a command's function or typer application.

        Raises PluginLoadError or MissingLibraryError.
        """
        return _import_target(found, _require_command)

    def create(self, slot: str, name: str, options: Mapping[str, Any] | None = None) -> Any:
        """Return a component with validated options. Raises ConfigError for unknown or invalid options."""
        kind = self.load(slot, name)
        return kind(validate_options(kind.Options, options or {}, f"the {slot} {name!r}"))


def _import_target(found: Offer[Any], require: Callable[[Any], None]) -> Any:
    """Import and return the target of a spec, which `require` checks.

    Raises PluginLoadError or MissingLibraryError.
    """
    what = f"the {found.spec.slot} {found.spec.name!r}"
    module, _, attribute = found.spec.target.partition(":")
    try:
        target = getattr(importlib.import_module(module), attribute)
        require(target)
        logger.debug("T%s is %s of %s.", what[1:], found.spec.target, found.distribution)
        return target
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and not _is_part_of(error.name, module):
            library = shlex.quote(found.spec.requires or error.name or "")
            raise MissingLibraryError(
                f"{what} needs {error.name}, which is not installed: pip install {library}"
            ) from error
        alternative = "component" if isinstance(found.spec, ComponentSpec) else "command"
        raise PluginLoadError(
            f"{what} of {found.distribution} failed on import ({type(error).__name__}: {error}); "
            f"update or uninstall that package, or choose another {alternative}"
        ) from error


def _require_command_spec(spec: Any) -> None:
    """Raise TypeError unless this is the spec of a command."""
    if not isinstance(spec, CommandSpec) or not KEBAB_CASE.fullmatch(spec.name):
        raise TypeError(f"offers {spec!r}; a command needs a CommandSpec, whose name is lower-case words with hyphens")


def _require_command(target: Any) -> None:
    """Raise TypeError unless a command's target is a function or a typer application."""
    if not (inspect.isfunction(target) or hasattr(target, "registered_commands")):
        raise TypeError(f"{target!r} is not a function or a typer application")


def _is_part_of(missing: str | None, module: str) -> bool:
    """Return whether a missing module belongs to the package of `module`, so that no library is missing."""
    package, _, part = (missing or "").partition(".")
    return bool(part) and package == module.partition(".")[0]


def _require_component(kind: Any, slot: str) -> None:
    """Raise TypeError unless `kind` is a complete component class of the slot."""
    from tactile_loc.slots.component import Component

    if not (isinstance(kind, type) and issubclass(kind, Component) and getattr(kind, "slot", None) == slot):
        raise TypeError(f"{kind!r} does not derive from the {slot} interface")
    if inspect.isabstract(kind):
        raise TypeError(f"{kind.__name__} does not implement {', '.join(sorted(kind.__abstractmethods__))}")


def validate_options(
    model: Any, values: Mapping[str, Any], owner: str, name_option: Callable[[str], str] | None = None
) -> Any:
    """Build the pydantic options `model` from `values`.

    Raises ConfigError if an option is unknown or its value is invalid. The message calls an invalid option
    "key of the owner", or `name_option(key)` if that function is given.
    """
    try:
        return model(**values)
    except ValidationError as error:
        problem = error.errors()[0]
        key = ".".join(map(str, problem["loc"])) or "options"
        if problem["type"] == "extra_forbidden":
            fields = model.model_fields
            for table in problem["loc"][:-1]:  # for an option of a table, list that table's options
                fields = getattr(fields[str(table)].annotation, "model_fields", fields)
            allowed = ", ".join(f"{k} ({_name_type(f.annotation)})" for k, f in fields.items()) or "none"
            near = did_you_mean(str(problem["loc"][-1]), fields)
            raise ConfigError(f"{owner} has no option {key!r}.{near} Known: {allowed}") from error
        if problem["type"] == "missing":
            raise ConfigError(f"{owner} needs the option {key!r}; {_advise_setting(owner, key)}") from error
        subject = f"{key} of {owner}" if name_option is None else name_option(key)
        raise ConfigError(f"{subject} cannot be {quote(problem['input'])}; {explain_allowed(problem)}") from error


def _advise_setting(owner: str, key: str) -> str:
    """Return advice on how to set an option of the owner, such as "the sensor 'file'"."""
    slot = owner.removeprefix("the ").partition(" ")[0]
    return f"set it with -o {slot}.{key}=..." if slot in SLOTS else "set it"


_ALLOWED = {
    "greater_than_equal": "give {ge} or more",
    "greater_than": "give more than {gt}",
    "less_than_equal": "give at most {le}",
    "less_than": "give less than {lt}",
    "literal_error": "give {expected}",
    "finite_number": "give a finite number",
    "string_type": "give a text",
}
_KINDS = {"int": "a whole number", "float": "a number", "bool": "true or false"}


def explain_allowed(problem: Mapping[str, Any]) -> str:
    """Return advice for a refused value, such as "give 1 or more".

    `problem` is an item of `ValidationError.errors()`.
    """
    kind, about = problem["type"], problem.get("ctx", {})
    if kind in _ALLOWED:
        return _ALLOWED[kind].format_map({k: f"{v:g}" if isinstance(v, float) else v for k, v in about.items()})
    if kind == "value_error":
        return str(about["error"]).rstrip(".")
    if (wanted := kind.partition("_")[0]) in _KINDS:
        return f"give {_KINDS[wanted]}"
    return str(problem["msg"]).replace("Input should be", "it must be")


def _name_type(annotation: Any) -> str:
    return annotation.__name__ if isinstance(annotation, type) else str(annotation).replace("typing.", "")


@lru_cache(maxsize=1)
def registry() -> Registry:
    """Return the process's registry: what is built in, and all other plugins that TACTILE_LOC_PLUGINS allows.

    TACTILE_LOC_PLUGINS is a comma-separated list of entry-point or distribution names. If it is not set, all plugins
    are allowed. If it is empty, none is allowed.
    """
    found = list(entry_points(group=PROJECT))
    wanted = os.environ.get("TACTILE_LOC_PLUGINS")
    if wanted is not None:
        allowed = {name.strip() for name in wanted.split(",")} | {BUILT_IN}
        found = [e for e in found if e.name in allowed or (e.dist is not None and e.dist.name in allowed)]
    return Registry(sorted(found, key=lambda e: (not _is_built_in(e), e.name)))


def _name_distribution(plugin: EntryPoint) -> str:
    return plugin.dist.name if plugin.dist else plugin.value


def _is_built_in(plugin: EntryPoint) -> bool:
    return _name_distribution(plugin) == BUILT_IN
