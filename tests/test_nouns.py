"""The dataclasses of core and store are frozen, and those with arrays have no comparison."""

import dataclasses
import importlib
import inspect
import pkgutil
import typing
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest

from tactile_loc import bases, core, simulate, slots, store

GROWING = {"Edge"}  # part of a frame tree, which grows with each transform


def dataclasses_of(package: ModuleType) -> Iterator[type]:
    for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        module = importlib.import_module(info.name)
        classes = [one for _, one in inspect.getmembers(module, inspect.isclass) if one.__module__ == module.__name__]
        yield from (one for one in classes if dataclasses.is_dataclass(one) and one.__name__ not in GROWING)


@pytest.fixture(scope="module")
def nouns() -> list[type]:
    return [kind for package in (bases, core, simulate, slots, store) for kind in dataclasses_of(package)]


def holds_arrays(noun: type) -> bool:
    """Return whether a field is an array or an optional array."""
    types = [t for hint in typing.get_type_hints(noun).values() for t in (hint, *typing.get_args(hint))]
    return any(typing.get_origin(t) is np.ndarray for t in types)


def test_dataclasses_are_frozen(nouns):
    assert len(nouns) > 50
    assert [noun for noun in nouns if not noun.__dataclass_params__.frozen] == []


def test_dataclasses_with_arrays_compare_by_identity(nouns):
    with_arrays = list(filter(holds_arrays, nouns))
    assert len(with_arrays) > 25
    assert [noun for noun in with_arrays if noun.__eq__ is not object.__eq__] == []
