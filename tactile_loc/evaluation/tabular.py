"""Shared parts of the tables of evaluations: statistics, Markdown, CSV, and the common keys of a JSON document."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.io.streams.records import read_versions
from tactile_loc.store.files import write_text

Table = list[list[str]]
"""Rows of cells; the first row names the columns."""


@dataclass(frozen=True, eq=False)
class EvaluatedObject:
    """One object evaluated with one encoder. `configuration` has every setting as JSON values."""

    object: str
    symmetry: str
    encoder: str
    grid_poses: int
    evaluation: Any
    configuration: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def summarise(self, *of: Any, normalised: bool = False) -> Statistics:
        """Return the statistics of errors; `of` selects a line and a metric, or a line and a number of contacts.

        The errors are in metres or, if `normalised`, divided by the mean error of a random pose.
        """
        found = self.evaluation
        return Statistics.of(found.normalise_errors(*of) if normalised else found.select_errors(*of))

    def compare_statistics(self, *of: Any) -> dict[str, Statistics]:
        """Return the statistics of errors in "metres" and "normalised"."""
        return {"metres": self.summarise(*of), "normalised": self.summarise(*of, normalised=True)}

    def record_statistics(self, *of: Any) -> dict[str, dict[str, float]]:
        """Return the statistics of errors in "metres" and "normalised" as JSON values."""
        return {unit: asdict(statistics) for unit, statistics in self.compare_statistics(*of).items()}

    def describe(self, **found: Any) -> dict[str, Any]:
        """Return the evaluated object, the results `found`, and every setting, as JSON values."""
        named = {key: getattr(self, key) for key in ("object", "symmetry", "encoder", "grid_poses")}
        return {**named, **found, "configuration": dict(self.configuration)}


@dataclass(frozen=True)
class Statistics:
    """Statistics of a line's errors, all in one unit.

    `std` is the standard deviation of the population. `q25`, `q75` and `p90` are quantiles.
    """

    mean: float
    median: float
    std: float
    q25: float
    q75: float
    p90: float

    @classmethod
    def of(cls, values: NDArray[np.float64]) -> Statistics:
        """Return the statistics of values (T,), in their unit."""
        q25, median, q75, p90 = np.quantile(values, (0.25, 0.5, 0.75, 0.9))
        return cls(float(values.mean()), float(median), float(values.std()), float(q25), float(q75), float(p90))


def format_lengths(s: Statistics) -> list[str]:
    """Return the cells median, mean, std and quartiles, mm."""
    return [*map(format_mm, (s.median, s.mean, s.std)), f"{format_mm(s.q25)} to {format_mm(s.q75)}"]


def list_columns(metres: Statistics, normalised: Statistics) -> dict[str, str]:
    """Return statistics as columns of a CSV file: lengths in mm, and shares of a random pose's mean error."""
    lengths = {f"{k}_mm": f"{1e3 * v:.6g}" for k, v in asdict(metres).items()}
    return lengths | {f"{k}_normalised": f"{v:.6g}" for k, v in asdict(normalised).items()}


def tabulate(runs: Iterable[EvaluatedObject], heads: Iterable[str], cells: Callable[[Any], Iterable[str]]) -> Table:
    """Return a table with a row for each run: its object, its encoder, and its `cells`; `heads` name the cells."""
    return [["object", "encoder", *heads], *([run.object, run.encoder, *cells(run)] for run in runs)]


def bracket_shares(lengths: Table, shares: Table, names: int) -> Table:
    """Join two tables with the same heads and the same first `names` columns; other cells become "length (share)"."""
    rows = zip(lengths[1:], shares[1:], strict=True)
    joined = ([*a[:names], *map("{} ({})".format, a[names:], b[names:])] for a, b in rows)
    return [lengths[0], *joined]


def format_markdown(table: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown."""
    header, *rows = table
    lines = ([cell.replace("|", "\\|") for cell in line] for line in (header, ["---"] * len(header), *rows))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def format_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows as CSV; all rows have the keys of the first row."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def build_document(
    schema_version: int, protocol: Mapping[str, Any], runs: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return a JSON document of runs, with the current time and the library versions."""
    return {
        "schema_version": schema_version,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": read_versions(),
        "protocol": dict(protocol),
        "runs": list(runs),
    }


def write_texts(folder: Path, name: str, **texts: str) -> list[Path]:
    """Write each text to the file `name`.KEYWORD in `folder`, and return the paths. Raises OutputError."""
    return [write_text(folder / f"{name}.{suffix}", text) for suffix, text in texts.items()]


def format_json(document: Mapping[str, Any]) -> str:
    """Return a document as indented JSON text."""
    return json.dumps(document, indent=1) + "\n"
