"""What all tables of evaluations share: statistics, Markdown, CSV, and the head of a JSON document."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.io.streams.records import read_versions
from tactile_loc.store.files import write_atomically

Table = list[list[str]]
"""Rows of cells; the first row names the columns."""


@dataclass(frozen=True, eq=False)
class EvaluatedObject:
    """One object evaluated with one encoder. `configuration` holds every setting as JSON values."""

    object: str
    symmetry: str
    encoder: str
    grid_poses: int
    evaluation: Any
    configuration: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def summarise(self, *of: Any, normalised: bool = False) -> Statistics:
        """Return the statistics of the evaluation's errors `of` a line and a metric, or a number of contacts.

        In metres, or as shares of the mean random error if `normalised`.
        """
        found = self.evaluation
        return Statistics.of(found.normalise_errors(*of) if normalised else found.select_errors(*of))

    def compare_statistics(self, *of: Any) -> dict[str, Statistics]:
        """Return the statistics of errors both ways: in "metres", and "normalised"."""
        return {"metres": self.summarise(*of), "normalised": self.summarise(*of, normalised=True)}

    def describe(self, **found: Any) -> dict[str, Any]:
        """Return what was evaluated, what was found, and every setting, as JSON values."""
        named = {key: getattr(self, key) for key in ("object", "symmetry", "encoder", "grid_poses")}
        return {**named, **found, "configuration": dict(self.configuration)}


@dataclass(frozen=True)
class Statistics:
    """Of the errors of a line's touches, all in one unit: `std` is of the population, `q25`, `q75`, `p90` quantiles."""

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


def list_columns(metres: Statistics, normalised: Statistics) -> dict[str, str]:
    """Return statistics as columns of a CSV file: lengths in mm, and shares of a random pose's mean error."""
    lengths = {f"{k}_mm": f"{1e3 * v:.6g}" for k, v in asdict(metres).items()}
    return lengths | {f"{k}_normalised": f"{v:.6g}" for k, v in asdict(normalised).items()}


def tabulate(
    runs: Iterable[EvaluatedObject], heads: Iterable[str], cells: Callable[[Any], Iterable[str]]
) -> Table:  # fmt: skip
    """Return a row for each run: its object, its encoder, and the run's `cells`, one under each of `heads`."""
    return [["object", "encoder", *heads], *([run.object, run.encoder, *cells(run)] for run in runs)]


def bracket_shares(lengths: Table, shares: Table, names: int) -> Table:
    """Join two tables with the same heads and the same first `names` columns: "mm (normalised)" in the others."""
    rows = zip(lengths[1:], shares[1:], strict=True)
    joined = ([*a[:names], *map("{} ({})".format, a[names:], b[names:])] for a, b in rows)
    return [lengths[0], *joined]


def format_markdown(table: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown."""
    header, *rows = table
    return "\n".join("| " + " | ".join(line) + " |" for line in (header, ["---"] * len(header), *rows)) + "\n"


def format_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows, all with the first one's keys, as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def build_document(
    schema_version: int, protocol: Mapping[str, Any], runs: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:  # fmt: skip
    """Return a JSON document of runs, with when and with what they were made."""
    return {
        "schema_version": schema_version,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": read_versions(),
        "protocol": dict(protocol),
        "runs": list(runs),
    }


def write_texts(folder: Path, name: str, **texts: str) -> list[Path]:
    """Write each text to a file NAME.SUFFIX of its keyword and return their paths. Raises OutputError."""
    return [
        write_atomically(folder / f"{name}.{suffix}", partial(Path.write_text, data=text, encoding="utf-8"))
        for suffix, text in texts.items()
    ]


def format_json(document: Mapping[str, Any]) -> str:
    """Return a document as it is written."""
    return json.dumps(document, indent=1) + "\n"
