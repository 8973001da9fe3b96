"""Numbers beside the points of a picture, where they cover neither one another nor a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DIGIT, LINE, MARKER = 5.6, 10.0, 7.0  # points: width of a character, height of a label, size of a point's marker
OFFSETS = [(5, 3), (5, -12), (-5, 3), (-5, -12), (0, 8), (0, -17), (5, 13), (-5, 13), (5, -22), (-5, -22), (9, -5)]


@dataclass(frozen=True)
class NumberLabel:
    """One label of the points `members` (indices), which all but coincide, written at `offset_pt` from the first.

    The text begins, ends or is centred there, as the first number of the offset is positive, negative or zero.
    """

    text: str
    members: tuple[int, ...]
    offset_pt: tuple[float, float]

    @property
    def alignment(self) -> str:
        """The horizontal alignment, as matplotlib calls it."""
        return "center" if self.offset_pt[0] == 0 else "left" if self.offset_pt[0] > 0 else "right"


def place_labels(places_pt: NDArray[np.float64], numbers: Sequence[int]) -> list[NumberLabel]:
    """Return labels for points (N, 2), in points of 1/72 inch, with these numbers.

    Points that all but coincide share one. The first of OFFSETS where nothing is covered is taken, if there is one.
    """
    markers = [_box(x, y - MARKER / 2, MARKER, MARKER, 0) for x, y in places_pt]
    taken: list[NDArray[np.float64]] = []
    labels = []
    for members in _coinciding(places_pt):
        text = in_ranges([numbers[i] for i in members])
        x, y = places_pt[members[0]]
        boxes = [_box(x + dx, y + dy, DIGIT * len(text), LINE, dx) for dx, dy in OFFSETS]
        own = set(members)
        others = [*taken, *(box for i, box in enumerate(markers) if i not in own)]
        free = [k for k, box in enumerate(boxes) if not any(_overlap(box, other) for other in others)]
        chosen = free[0] if free else 0
        taken.append(boxes[chosen])
        labels.append(NumberLabel(text, members, OFFSETS[chosen]))
    return labels


def in_ranges(numbers: Sequence[int]) -> str:
    """Write whole numbers in order: 1, 3-5."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    texts = [", ".join(map(str, run)) if len(run) < 3 else f"{run[0]}-{run[-1]}" for run in runs]
    return ", ".join(texts)


def _coinciding(places_pt: NDArray[np.float64]) -> list[tuple[int, ...]]:
    """Points, each with those that are hidden behind it."""
    groups: list[list[int]] = []
    for i, place in enumerate(places_pt):
        near = (group for group in groups if np.abs(places_pt[group[0]] - place).max() < MARKER / 2)
        group = next(near, None)
        if group is None:
            groups.append([i])
        else:
            group.append(i)
    return [tuple(group) for group in groups]


def _box(x: float, y: float, width: float, height: float, side: float) -> NDArray[np.float64]:
    """A box (left, bottom, right, top) right of x, left of it or about it, as `side` is positive, negative or zero."""
    left = x - width * (0.5 if side == 0 else 0.0 if side > 0 else 1.0)
    return np.array([left, y, left + width, y + height])


def _overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return bool((a[:2] < b[2:]).all() and (b[:2] < a[2:]).all())
