"""Long evaluations in pieces, each kept as soon as it is done, so that an interrupted one goes on where it stopped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.registry import registry
from tactile_loc.evaluation.sources import SimulatedTouches
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.store import Workspace

Arrays = Sequence[NDArray[Any]]


def save_in_shards(
    work: Workspace, names: Sequence[str], count: int, size: int, make: Callable[[range], Arrays]
) -> None:
    """Save the arrays called `names`, a row for each of `count` numbers, made `size` numbers at once by `make`.

    `make` takes a range of numbers and returns an array of their rows for each name. What an interrupted run has made
    is not made again.
    """
    every = range(count)
    shards = [_shard(work, names, every[start : start + size], make) for start in every[::size]]
    for name, columns in zip(names, zip(*shards, strict=True), strict=True):
        work.save_array(name, np.concatenate(columns))


def _shard(work: Workspace, names: Sequence[str], numbers: range, make: Callable[[range], Arrays]) -> Arrays:
    """The arrays of some numbers: made now, or loaded if an interrupted run got that far."""
    own = [f"{name}-{numbers.start:06d}" for name in names]
    found: Arrays = [array for array in (work.load(name, keep=False) for name in own) if array is not None]
    if len(found) < len(own):
        found = make(numbers)
        for name, array in zip(own, found, strict=True):
            work.save_array(name, array, keep=False)
    return found


def describe_located(localizer: Localizer, touches: SimulatedTouches, count: int) -> dict[str, Any]:
    """Return what decides the posteriors of `count` simulated touches, and those fused with them, as JSON values."""
    matcher = registry().create("matcher", localizer.config.matcher.name, localizer.config.matcher.options)
    return {
        **localizer.describe_scores(), "temperature_scaling": asdict(localizer.temperature_scaling),
        "matcher": matcher.describe(),
        "fuser": localizer.fuser.describe(), **touches.describe(localizer), "count": count,
    }  # fmt: skip
