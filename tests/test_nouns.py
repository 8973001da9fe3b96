"""What the dataclasses of core and store have in common: nobody changes them, and arrays are not compared."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
import typing
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest

from tactile_loc import core, store

GROWING = {"Edge"}  # of a tree of frames: it is filled as transforms come


def dataclasses_of(package: ModuleType) -> Iterator[type]:
    for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        module = importlib.import_module(info.name)
        classes = [one for _, one in inspect.getmembers(module, inspect.isclass) if one.__module__ == module.__name__]
        yield from (one for one in classes if dataclasses.is_dataclass(one) and one.__name__ not in GROWING)


NOUNS = [*dataclasses_of(core), *dataclasses_of(store)]


def holds_arrays(noun: type) -> bool:
    """Whether a field is an array, or None instead."""
    types = [t for hint in typing.get_type_hints(noun).values() for t in (hint, *typing.get_args(hint))]
    return any(typing.get_origin(t) is np.ndarray for t in types)


@pytest.mark.parametrize("noun", NOUNS, ids=lambda noun: noun.__name__)
def test_nobody_changes_them(noun):
    assert noun.__dataclass_params__.frozen


@pytest.mark.parametrize("noun", list(filter(holds_arrays, NOUNS)), ids=lambda noun: noun.__name__)
def test_arrays_are_not_compared(noun):
    assert noun.__eq__ is object.__eq__
