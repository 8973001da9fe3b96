"""What tables and pictures of a sweep are about: names of its choices, errors by choice, effects, the Pareto front."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError, did_you_mean
from tactile_loc.core.registry import SLOTS
from tactile_loc.evaluation.protocol import LINES
from tactile_loc.io.config import SlotConfig
from tactile_loc.sweeps.choices import label, varied_options
from tactile_loc.sweeps.plan import Plan
from tactile_loc.sweeps.sweep import Sweep

DEFAULT_LINE = "chosen"
NAMED = ("encoder", "refiner")  # where no slot varies
LEAST_MM = 1e-6  # a smaller error has no logarithm of its own


@dataclass(frozen=True)
class Cell:
    """One component for each slot on one object: the mean over seeds of its errors, mm, and times, ms.

    None where a combination failed. `choices` are the places of the components among their slots' choices.
    """

    object: str
    noise: str
    choices: tuple[int, ...]
    label: str
    error_mm: float | None
    time_ms: float | None


@dataclass(frozen=True)
class Point:
    """One component for each slot: the geometric means over objects of errors, mm, and times a touch, ms."""

    label: str
    choices: tuple[int, ...]
    error_mm: float
    time_ms: float


def require_line(line: str) -> str:
    """Return `line` if it is one of the protocol's. Raises ConfigError otherwise."""
    if line not in LINES:
        raise ConfigError(f"there is no line {line!r}.{did_you_mean(line, LINES)} Lines: {', '.join(LINES)}")
    return line


def choice_labels(plan: Plan) -> dict[str, list[str]]:
    """Return the name of each choice of each slot, with those of its options that vary."""
    return {slot: [label(one, varied_options(choices)) for one in choices] for slot, choices in plan.slots.items()}


def varying(plan: Plan) -> list[str]:
    """Return the slots that have several choices."""
    return [slot for slot, choices in plan.slots.items() if len(choices) > 1]


def fixed(plan: Plan) -> dict[str, SlotConfig]:
    """Return the slots that have one choice, and what it is."""
    return {slot: choices[0] for slot, choices in plan.slots.items() if len(choices) == 1}


def cells(sweep: Sweep, line: str) -> list[Cell]:
    """Return the cells of a sweep in the plan's order."""
    labels, named = choice_labels(sweep.plan), varying(sweep.plan) or NAMED
    column = f"{line}_median_mm"
    gathered: dict[tuple[str, str, tuple[int, ...]], list[tuple[float, float] | None]] = defaultdict(list)
    for one in sweep.combinations:
        measured = sweep.outcomes[one.key].measured
        pair = None if measured is None else (measured[column], measured["total_ms"])
        gathered[one.object, one.config.touch.noise, one.place[1:-2]].append(pair)
    found = []
    for (name, noise, choices), pairs in gathered.items():
        text = " + ".join(labels[slot][i] for slot, i in zip(SLOTS, choices, strict=True) if slot in named)
        whole = [pair for pair in pairs if pair is not None]
        error, time = (float(v) for v in np.mean(whole, axis=0)) if len(whole) == len(pairs) else (None, None)
        found.append(Cell(name, noise, choices, text, error, time))
    return found


def points(sweep: Sweep, line: str, noise: str) -> list[Point]:
    """Return a point for each combination of components that ended well on all objects, in the plan's order."""
    gathered: dict[tuple[int, ...], list[Cell]] = defaultdict(list)
    for cell in cells(sweep, line):
        if cell.noise == noise:
            gathered[cell.choices].append(cell)
    return [
        Point(found[0].label, choices, _geometric(c.error_mm for c in found), _geometric(c.time_ms for c in found))
        for choices, found in gathered.items()
        if all(cell.error_mm is not None for cell in found)
    ]


def pareto(found: Sequence[Point]) -> list[Point]:
    """Return the points that no other beats in both error and time, by rising time."""
    front: list[Point] = []
    for point in sorted(found, key=lambda p: (p.time_ms, p.error_mm)):
        if not front or point.error_mm < front[-1].error_mm:
            front.append(point)
    return front


def effects(sweep: Sweep, line: str) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return, for each slot that varies and each of its choices, natural logarithms (K,) of error ratios.

    A ratio is that of the error with this choice to the geometric mean over all choices of the slot, all else the same;
    K counts what else there is: objects, noises, and the other slots' choices, where no choice failed.
    """
    labels = choice_labels(sweep.plan)
    return {slot: _effect(sweep, line, SLOTS.index(slot), labels[slot]) for slot in varying(sweep.plan)}


def _effect(sweep: Sweep, line: str, axis: int, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    groups: dict[tuple[object, ...], dict[int, float]] = defaultdict(dict)
    for cell in cells(sweep, line):
        if cell.error_mm is not None:
            others = (cell.object, cell.noise, *cell.choices[:axis], *cell.choices[axis + 1 :])
            groups[others][cell.choices[axis]] = float(np.log(max(cell.error_mm, LEAST_MM)))
    whole = [[group[i] for i in range(len(names))] for group in groups.values() if len(group) == len(names)]
    logs = np.array(whole).reshape(len(whole), len(names))
    return dict(zip(names, (logs - logs.mean(axis=1, keepdims=True)).T, strict=True))


def _geometric(values: Iterator[float | None]) -> float:
    return float(np.exp(np.mean([np.log(max(value or 0.0, LEAST_MM)) for value in values])))
