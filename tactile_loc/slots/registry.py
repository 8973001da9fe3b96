"""The registry of plugins, which are found by entry points.

An entry point of the group `tactile_loc` names a module with hooks. One of the group `tactile_loc.SLOT` names a
component's class itself.
A component's class is imported at its first use, and a command's module when the command runs.
"""

import importlib
import inspect
import logging
import os
import re
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from importlib.metadata import EntryPoint
from typing import Any, ClassVar

import pluggy

from tactile_loc.core.runtime.errors import (
    MissingLibraryError,
    PluginConflictError,
    PluginLoadError,
    UnknownPluginError,
    advise_choice,
)
from tactile_loc.slots.code import find_plugins
from tactile_loc.slots.interface import INTERFACE_VERSION, explain_version, require_interface
from tactile_loc.slots.options import validate_options

PROJECT = "tactile_loc"
SLOTS = ("sensor", "renderer", "grid", "encoder", "matcher", "refiner", "fuser")
COMMAND = "command"
CLASS_INTERFACE = 2  # the version of the interface of classes that entry points name
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


@dataclass(frozen=True)
class Offer:
    """A component or a command that a distribution offers: its ComponentSpec or CommandSpec."""

    spec: Any
    distribution: str


@dataclass(frozen=True)
class LoadFailure:
    """A plugin that raised an error while it was loaded."""

    plugin: str
    distribution: str
    error: str


class Registry:
    """All components and commands found: `offers`, in the order found.

    A plugin that fails to load is kept as a failure and does not affect the others. `kinds` are the slots, and the
    kinds of components that packages define.
    """

    def __init__(self, plugins: Iterable[EntryPoint]) -> None:
        self.offers: list[Offer] = []
        self.failures: list[LoadFailure] = []
        self.kinds: dict[str, ComponentKind | None] = dict.fromkeys(SLOTS)  # slots have no ComponentKind
        self._classes: dict[ComponentSpec, Any] = {}
        offered: list[tuple[str, str, list[Any]]] = []
        for plugin in plugins:
            distribution = _name_distribution(plugin)  # once for each plugin, because this reads a file
            with self._keep_failure(plugin.name, distribution):
                offered.append((plugin.name, distribution, self._load_plugin(plugin)))
        for name, distribution, specs in offered:  # a component may be of a kind that a later plugin defines
            with self._keep_failure(name, distribution):
                for spec in specs:
                    self._require_spec(spec)
                self.offers += [Offer(spec, distribution) for spec in specs]

    @property
    def components(self) -> list[Offer]:
        """The components, in the order found."""
        return [offer for offer in self.offers if offer.spec.slot != COMMAND]

    @property
    def commands(self) -> list[Offer]:
        """The commands, in the order found."""
        return [offer for offer in self.offers if offer.spec.slot == COMMAND]

    @contextmanager
    def _keep_failure(self, plugin: str, distribution: str) -> Iterator[None]:
        """Keep an error of the block as the plugin's failure."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - other people's plugins may raise anything
            reason = f"{type(error).__name__}: {error}"
            self.failures.append(LoadFailure(plugin, distribution, reason))

    def _load_plugin(self, plugin: EntryPoint) -> list[Any]:
        """Return the specs that a plugin offers. Import a module with hooks, and add the kinds that it defines."""
        if plugin.group != PROJECT:
            about: Any = plugin.dist.metadata if plugin.dist else {}
            summary = about["Summary"] if "Summary" in about else ""  # noqa: SIM401 - metadata has no get()
            slot = plugin.group.removeprefix(f"{PROJECT}.").replace("_", "-")  # a group has no hyphens
            return [ComponentSpec(slot, plugin.name, plugin.value, summary, interface=CLASS_INTERFACE)]
        manager = pluggy.PluginManager(PROJECT)
        manager.add_hookspecs(sys.modules[__name__])
        manager.register(plugin.load())
        manager.check_pending()
        hooks = (manager.hook.tactile_loc_components, manager.hook.register_commands)
        specs = [spec for hook in hooks for several in hook() for spec in several]
        kinds = {kind.name: kind for defined in manager.hook.register_kinds() for kind in defined}
        if not specs and not kinds:
            raise TypeError("offers no component and no command: its hooks are missing or return nothing")
        self.kinds |= kinds
        return specs

    def _require_spec(self, spec: Any) -> None:
        """Raise TypeError unless this is the spec of a command, or of a component of a known kind."""
        if isinstance(spec, CommandSpec):
            if not KEBAB_CASE.fullmatch(spec.name):
                raise TypeError(f"offers {spec!r}; the name of a command is lower-case words with hyphens")
        elif not isinstance(spec, ComponentSpec) or spec.slot not in self.kinds or spec.slot == COMMAND:
            raise TypeError(f"offers {spec!r}; the slots are {', '.join(self.kinds)}")
        elif not isinstance(spec.interface, int) or spec.interface < 1:
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
        except TypeError as error:
            raise PluginLoadError(f"the component {name!r} cannot be added: {error}") from error
        target = f"{kind.__module__}:{kind.__qualname__}"
        spec = ComponentSpec(slot, name, target, summary, interface=INTERFACE_VERSION)
        for taken in self._list_named(slot, name):
            if taken.distribution != ADDED:
                raise PluginConflictError(
                    f"{taken.distribution} offers the {slot} {name!r} already; choose another name"
                )
            self.offers.remove(taken)
        self.offers.append(Offer(spec, ADDED))
        self._classes[spec] = kind

    def names(self, slot: str) -> list[str]:
        """Return the names of a slot's components, or of the commands, in the order found."""
        return list(dict.fromkeys(offer.spec.name for offer in self.offers if offer.spec.slot == slot))

    def find(self, slot: str, name: str) -> Offer:
        """Return the component, or the command, with this name. Raises UnknownPluginError or PluginConflictError."""
        found = self._list_named(slot, name)
        if not found:
            raise UnknownPluginError(self._describe_unknown(slot, name))
        if len(found) > 1:
            raise PluginConflictError(
                f"two packages offer the {slot} {name!r}: {found[0].distribution} and {found[1].distribution}; "
                "uninstall one, or choose with TACTILE_LOC_PLUGINS"
            )
        return found[0]

    def _list_named(self, slot: str, name: str) -> list[Offer]:
        return [offer for offer in self.offers if (offer.spec.slot, offer.spec.name) == (slot, name)]

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
            self._classes[found.spec] = import_target(found)
        kind: type[Any] = self._classes[found.spec]
        return kind

    def create(self, slot: str, name: str, options: Mapping[str, Any] | None = None) -> Any:
        """Return a component with validated options. Raises ConfigError for unknown or invalid options."""
        kind = self.load(slot, name)
        return kind(validate_options(kind.Options, options or {}, f"the {slot} {name!r}"))


def explain_missing(offer: Offer) -> str:
    """Return which library a component or a command lacks and how to install it, or "". Nothing is imported.

    Only the libraries of `requires` are looked up.
    """
    spec = offer.spec
    lacking = [name for name in _list_requirements(spec.requires) if not _is_installed(name)] if spec.requires else []
    if not lacking:
        return ""
    line = f"pip install {shlex.quote(spec.requires)}"
    return f"the {spec.slot} {spec.name!r} needs {' and '.join(lacking)}, which is not installed: {line}"


def _list_requirements(text: str) -> list[str]:
    """Return the distributions that words for `pip install` name: with extras, those that the extras add."""
    from packaging.requirements import Requirement

    found = re.fullmatch(r"(?:\S*/)?([\w.-]+)(?:\[([\w,-]+)\])?.*", text)  # a path in a clone may stand before the name
    if found is None:
        return []
    name, extras = found[1], (found[2] or "").split(",")
    if extras == [""] or not _is_installed(name):
        return [name]
    added = [Requirement(line) for line in metadata.requires(name) or []]
    chosen = [one for one in added if one.marker and any(one.marker.evaluate({"extra": extra}) for extra in extras)]
    return list(dict.fromkeys(part for one in chosen for part in _list_requirements(str(one).partition(";")[0])))


def _is_installed(distribution: str) -> bool:
    """Return whether a distribution is installed, in any of its builds, such as faiss-cpu and faiss-gpu."""
    stem = distribution.removesuffix("-cpu")
    for name in (stem, f"{stem}-cpu", f"{stem}-gpu"):
        with suppress(metadata.PackageNotFoundError):
            metadata.version(name)
            return True
    return False


def import_target(found: Offer) -> Any:
    """Import and return the class of a component, or the function or typer application of a command.

    Raises PluginLoadError or MissingLibraryError.
    """
    what = f"{found.spec.slot} {found.spec.name!r}"
    module, _, attribute = found.spec.target.partition(":")
    try:
        target = getattr(importlib.import_module(module), attribute)
        if found.spec.slot != COMMAND:
            _require_component(target, found.spec.slot)
        elif not (inspect.isfunction(target) or hasattr(target, "registered_commands")):
            raise TypeError(f"{target!r} is not a function or a typer application")
        logger.debug("The %s is %s of %s.", what, found.spec.target, found.distribution)
        return target
    except Exception as error:
        missing = error.name or "" if isinstance(error, ModuleNotFoundError) else ""
        if missing and not missing.startswith(f"{module.partition('.')[0]}."):  # the package itself is complete
            library = shlex.quote(found.spec.requires or missing)
            raise MissingLibraryError(
                f"the {what} needs {missing}, which is not installed: pip install {library}"
            ) from error
        alternative = "component" if isinstance(found.spec, ComponentSpec) else "command"
        raise PluginLoadError(
            f"the {what} of {found.distribution} failed on import ({type(error).__name__}: {error}); "
            f"update or uninstall that package, or choose another {alternative}"
        ) from error


def _require_component(kind: Any, slot: str) -> None:
    """Raise TypeError unless `kind` is a complete component class of the slot, for this version of the interface."""
    from tactile_loc.slots.component import Component

    if not (isinstance(kind, type) and issubclass(kind, Component) and getattr(kind, "slot", None) == slot):
        raise TypeError(f"{kind!r} does not derive from the {slot} interface")
    if inspect.isabstract(kind):
        raise TypeError(f"{kind.__name__} does not implement {', '.join(sorted(kind.__abstractmethods__))}")
    require_interface(kind, slot)


@lru_cache(maxsize=1)
def registry() -> Registry:
    """Return the process's registry: what is built in, and all other plugins that TACTILE_LOC_PLUGINS allows.

    TACTILE_LOC_PLUGINS is a comma-separated list of entry-point or distribution names. If it is not set, all plugins
    are allowed. If it is empty, none is allowed.
    """
    found = find_plugins()
    wanted = os.environ.get("TACTILE_LOC_PLUGINS")
    if wanted is not None:
        allowed = {name.strip() for name in wanted.split(",")} | {BUILT_IN}
        found = [e for e in found if e.name in allowed or (e.dist is not None and e.dist.name in allowed)]
    return Registry(sorted(found, key=lambda e: (not _is_built_in(e), e.name)))


def _name_distribution(plugin: EntryPoint) -> str:
    return plugin.dist.name if plugin.dist else plugin.value


def _is_built_in(plugin: EntryPoint) -> bool:
    return _name_distribution(plugin) == BUILT_IN
