"""The table of located examples that evaluations, sweeps and benchmarks share: a row for each example."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.errors import ConfigError

CONSTANT = ("object", "symmetry", "encoder", "noise", "seed", "diameter_m", "grid_poses")  # columns of a run
MOST_FUSED = 20  # touches of an example
LABELS = ("object", "encoder", "noise", "seed", "example", "touches")


@dataclass(frozen=True, eq=False)
class ExampleTable:
    """E examples, each located from its first touches. A column is an array (E, ...), and its name ends with its unit.

    The LABELS name the object, the encoder or method, the noise or kind of the touches, the seed (-1 without a seed),
    the number of the example, and the number of touches. The column "LINE METRIC_m" has the errors of a pose, metres,
    infinite without a pose. LINE says which pose: the `first` pose of an answer, the nearest `listed` pose, or a line
    of a protocol. Usual further columns are `probability` (0 to 1), `verdict`, `problem` (why there is no pose),
    `determined`, `seconds`, `diameter_m` of the object, and `refused`, the number of presses that made no touch.
    """

    columns: Mapping[str, NDArray[Any]]

    @classmethod
    def make(cls, columns: Mapping[str, NDArray[Any]], **others: Any) -> ExampleTable:
        """Make a table from columns; each of the `others` is a column, or one value for all examples."""
        count = len(next(iter(columns.values())))
        labels = {name: np.broadcast_to(value, count) for name, value in others.items()}
        return cls({**labels, **columns, **labels})

    @classmethod
    def read(cls, columns: Mapping[str, Sequence[Any]]) -> ExampleTable:
        """Make a table from lists of JSON values. None is an infinite length, another number that is NaN, or ""."""
        return cls({name: _make_column(name, values) for name, values in columns.items()})

    @classmethod
    def of_rows(cls, rows: Sequence[Mapping[str, Any]]) -> ExampleTable:
        """Make a table from rows of JSON values; a row may lack columns, which are then as None in `read`."""
        names = dict.fromkeys(name for row in rows for name in row)
        return cls.read({name: [row.get(name) for row in rows] for name in names})

    @classmethod
    def join(cls, tables: Iterable[ExampleTable]) -> ExampleTable:
        """Return the examples of several tables with the same columns."""
        parts = list(tables)
        return cls({name: np.concatenate([part[name] for part in parts]) for name in parts[0].columns})

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return self.columns[name]

    def select(self, rows: NDArray[Any] | Sequence[int]) -> ExampleTable:
        """Return some examples: those of a mask (E,), or of indices."""
        return ExampleTable({name: values[rows] for name, values in self.columns.items()})

    def group(self, *names: str) -> dict[tuple[Any, ...], ExampleTable]:
        """Return the examples with equal values in the columns `names`, by these values, in the order of the rows."""
        found: dict[tuple[Any, ...], list[int]] = {}
        for row, key in enumerate(zip(*(self[name].tolist() for name in names), strict=True)):
            found.setdefault(key, []).append(row)
        return {key: self.select(rows) for key, rows in found.items()}

    def errors_m(self, line: str = "first", metric: str = "mssd") -> Floats:
        """Return the errors (E,) of the poses of a line, metres; "mssd" is the pose error."""
        return self[f"{line} {metric}_m"]

    def count_refused(self) -> int:
        """Return the number of presses that made no touch. An example counts once, whatever its numbers of touches."""
        return sum(int(some["refused"][0]) for some in self.group(*LABELS[:-1]).values())

    def describe(self) -> dict[str, list[Any]]:
        """Return the columns with one value for each example as lists of JSON values; see `read`."""
        return {name: _list_values(values) for name, values in self.columns.items() if values.ndim == 1}


@dataclass(frozen=True, eq=False)
class EvaluatedRun:
    """The located examples of one object with one encoder, noise and seed, and every setting as JSON values."""

    table: ExampleTable
    configuration: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def describe(self) -> dict[str, Any]:
        """Return what is the same for all examples, the number of refused presses, and every setting."""
        same = {name: self.table[name][0].item() for name in CONSTANT if name in self.table.columns}
        if same.get("seed", 0) < 0:
            same["seed"] = None
        return {**same, "refused": self.table.count_refused(), "configuration": dict(self.configuration)}


def join_runs(runs: Sequence[EvaluatedRun]) -> ExampleTable:
    """Return the examples of all runs."""
    return ExampleTable.join(run.table for run in runs)


def sort_numbers(given: Sequence[int], what: str) -> tuple[int, ...]:
    """Return numbers of touches in ascending order. Raises ConfigError unless all are from 1 to MOST_FUSED."""
    numbers = tuple(sorted(set(given)))
    if not numbers or not 1 <= numbers[0] <= numbers[-1] <= MOST_FUSED:
        raise ConfigError(f"the numbers of {what} cannot be {list(given)}; give numbers from 1 to {MOST_FUSED}")
    return numbers


def name_errors(errors_m: Floats, lines: Sequence[str], metrics: Sequence[str]) -> dict[str, Any]:
    """Return errors (E, L, M), metres, as columns."""
    return {f"{line} {metric}_m": errors_m[:, i, k] for i, line in enumerate(lines) for k, metric in enumerate(metrics)}


def _make_column(name: str, values: Sequence[Any]) -> NDArray[Any]:
    texts = any(isinstance(value, str) for value in values)
    missing = "" if texts else np.inf if name.endswith("_m") else np.nan
    return np.array([missing if value is None else value for value in values])


def _list_values(values: NDArray[Any]) -> list[Any]:
    if values.dtype.kind != "f":
        return list(values.tolist())
    return [value if np.isfinite(value) else None for value in values.tolist()]
