"""Contract checks for the components of every slot. They test the options and `describe`.

CHECKS is the list of all checks. The modules of the slots add theirs when they are imported.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.slots.component import Capabilities, Component
from tactile_loc.slots.registry import registry

PROPERTY = "property"  # the tag of checks on drawn cases
CHECKS: list[Check] = []
SHARED: list[Any] = []  # the caches of `share`

Made = TypeVar("Made", bound=Callable[..., Any])
Cause = str | Callable[[], str]  # the end of a message, or a function that finds it when a check fails


@dataclass(frozen=True)
class Check:
    """A check of the components of a `slot`, or of all slots if it is empty. `run` raises ContractError.

    A check applies if its `tags` hold. A tag is a capability that the component must declare, or "not " and one that it
    must not declare. The tag PROPERTY marks checks on drawn cases.
    """

    name: str
    slot: str
    tags: tuple[str, ...]
    run: Callable[[Any], None]

    def __call__(self, component: Any) -> None:
        """Raise ContractError if the component breaks the contract."""
        try:
            self.run(component)
        finally:
            for cached in SHARED:  # the component may have changed what it was given
                cached.cache_clear()

    @property
    def demands(self) -> str:
        """What the check demands, in one sentence."""
        return (self.run.__doc__ or "").strip().partition("\n")[0]

    @property
    def is_property(self) -> bool:
        """True if the check draws its cases."""
        return PROPERTY in self.tags

    def applies_to(self, component: Component) -> bool:
        """Return whether the check is for this component, with its declared capabilities."""
        if not self.slot:
            return True
        declared = component.capabilities
        if self.slot != component.slot or not isinstance(declared, Capabilities):
            return False
        tags = (tag.rpartition(" ") for tag in self.tags if tag != PROPERTY)
        return all(getattr(declared, capability) is not bool(negated) for negated, _, capability in tags)


def check(slot: str = "", *tags: str) -> Callable[[Callable[[Any], None]], Check]:
    """Return a decorator that makes a function of one component a Check, and adds it to CHECKS."""

    def add(run: Callable[[Any], None]) -> Check:
        CHECKS.append(Check(run.__name__, slot, tags, run))
        return CHECKS[-1]

    return add


class ContractError(AssertionError):
    """A component broke a contract. The message states the contract and how it was broken."""


def share(make: Made) -> Made:
    """Return the function with a cache that lasts until the end of a check."""
    SHARED.append(lru_cache(maxsize=8)(make))
    return SHARED[-1]  # type: ignore[no-any-return]


def require(holds: object, sentence: str, cause: Cause = "") -> None:
    """Raise ContractError with `sentence` and its likely `cause` as its message unless the condition `holds`."""
    if not holds:
        raise ContractError(f"{sentence}{cause if isinstance(cause, str) else cause()}")


def name_cause(mistakes: Mapping[str, Any], explains: Callable[[Any], object] = bool, often: str = "") -> str:
    """Return the end of a message that names the first mistake whose result `explains` the component's answer.

    A result is what a right component with this mistake would give; by default, it says itself whether it explains the
    answer. If none does, the end names causes that are frequent.
    """
    for mistake, result in mistakes.items():
        with np.errstate(all="ignore"):
            if explains(result):
                return f"; likely cause: {mistake}"
    return f"; often, {often}" if often else ""


def require_equal(first: ArrayLike, again: ArrayLike, sentence: str) -> None:
    """Raise ContractError unless two answers to the same question are exactly equal. NaN equals NaN."""
    a, b = np.asarray(first), np.asarray(again)
    same = np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    require(same, f"{sentence}; otherwise declare deterministic=False")


def require_array(value: Any, shape: tuple[int, ...], dtype: type, what: str) -> None:
    """Raise ContractError unless `value` is an array of this shape and type; `what` names it in the message."""
    require(isinstance(value, np.ndarray), f"{what} must be a numpy array, not {type(value).__name__}")
    require(value.shape == shape, f"{what} must have shape {shape}, not {value.shape}")
    require(value.dtype == dtype, f"{what} must be {np.dtype(dtype)}, not {value.dtype}")


def require_close(value: ArrayLike, truth: ArrayLike, tolerance: float, sentence: str, cause: Cause = "") -> None:
    """Raise ContractError unless two arrays agree to an absolute tolerance, in the arrays' own unit."""
    a, b = np.asarray(value, float), np.asarray(truth, float)
    require(a.shape == b.shape, f"{sentence} (shapes {a.shape} and {b.shape})", cause)
    finite = np.isfinite(a)
    require(finite.all(), f"{sentence}, but {100 * (~finite).mean():.2g} % of the values are not finite", cause)
    largest = float(np.abs(a - b).max(initial=0.0))
    require(largest <= tolerance, f"{sentence} (largest difference {largest:.3g}, allowed {tolerance:.3g})", cause)


class Untouched:
    """Keeps copies of arrays, to find out later whether the arrays were changed."""

    def __init__(self, **arrays: Any) -> None:
        self._arrays = arrays
        self._copies = {name: np.array(array, copy=True) for name, array in arrays.items()}

    def require(self) -> None:
        """Raise ContractError if an array has changed."""
        for name, array in self._arrays.items():
            same = np.array_equal(array, self._copies[name], equal_nan=array.dtype.kind == "f")
            require(same, f"inputs must not be written to, but {name} was; work on a copy")


@check()
def check_declaration(component: Component) -> None:
    """The slot is known, and capabilities are declared."""
    known = registry().kinds
    require(component.slot in known, f"slot must be one of {', '.join(known)}, not {component.slot!r}")
    declared = component.capabilities
    require(isinstance(declared, Capabilities), f"capabilities must be a Capabilities, not {declared!r}")
    options = component.options
    require(isinstance(options, type(component).Options), f"options must be an instance of Options, not {options!r}")


@check()
def check_options_are_strict(component: Component) -> None:
    """Options derive from ComponentOptions, are frozen and refuse unknown names."""
    options = component.options
    require(isinstance(options, ComponentOptions), "Options must derive from ComponentOptions")
    require(options.model_config.get("frozen"), "Options must be frozen: settings do not change during a run")
    refuses = options.model_config.get("extra") == "forbid"
    require(refuses, 'Options must have extra="forbid": a misspelt option must be an error')


@check()
def check_options_are_described(component: Component) -> None:
    """Every option has a description, which is its help text."""
    for name, field in type(component.options).model_fields.items():
        require(field.description, f"every option needs Field(description=...) with its unit; {name} has none")


@check()
def check_describe_is_json(component: Component) -> None:
    """`describe` returns the same JSON values every time, and these can be written and read without a change."""
    described = component.describe()
    try:
        text = json.dumps(described, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        require(False, f"describe() must return JSON values, since it is part of the store's keys: {error}")
    require(json.loads(text) == described, "describe() must not change in JSON: use lists and text keys")
    own = Component.describe(component)
    kept = all(described.get(name) == own[name] for name in ("class", "code"))
    require(kept, "describe() must keep the class and the hash of its code: begin with super().describe()")
    twin = type(component)(component.options).describe()
    require(twin == described, "describe() must be the same for a second component with the same options")


@check()
def check_describe_names_every_option(component: Component) -> None:
    """Another value of an option gives another description; otherwise the store would return outdated results."""
    for name, changed in _change_options(component.options):
        try:
            other = type(component)(changed).describe()
        except TactileLocError:
            continue
        require(
            other != component.describe(),
            f"describe() must change with every option, but {name} = {getattr(changed, name)!r} changes nothing; mark "
            'an option that cannot change any result with Field(json_schema_extra={"neutral": True})',
        )


def _change_options(options: Any) -> Iterator[tuple[str, Any]]:
    """Yield the name, and options with another value of it, for each option that is a number, a switch or a choice."""
    for name, field in type(options).model_fields.items():
        if name in options.neutral():
            continue
        for value in _list_other_values(field, getattr(options, name)):
            try:
                changed = type(options).model_validate({**options.model_dump(), name: value})
            except ValidationError:
                continue
            yield name, changed
            break


def _list_other_values(field: FieldInfo, value: Any) -> list[Any]:
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, str):  # a choice; free text, such as a path, has no other known value
        return [choice for choice in get_args(field.annotation) if isinstance(choice, str) and choice != value]
    if isinstance(value, int):
        return [value + 1, value - 1]
    if isinstance(value, float):
        return [value + 0.1, 0.9 * value if value else 0.01]
    return [1, 0.5] if value is None else []
