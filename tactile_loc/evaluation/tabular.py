"""What all tables of evaluations share: statistics, Markdown, CSV, and the head of a JSON document."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.io.records import read_versions
from tactile_loc.store.files import write_atomically

Rows = Sequence[Sequence[str]]


@dataclass(frozen=True, eq=False)
class EvaluatedObject:
    """One object evaluated with one encoder. `configuration` holds every setting as JSON values."""

    object: str
    symmetry: str
    encoder: str
    grid_poses: int
    evaluation: Any
    configuration: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def record(self, **found: Any) -> dict[str, Any]:
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


def columns(metres: Statistics, normalised: Statistics) -> dict[str, str]:
    """Return statistics as columns of a CSV file: lengths in mm, and shares of a random pose's mean error."""
    lengths = {f"{k}_mm": f"{1e3 * v:.6g}" for k, v in asdict(metres).items()}
    return lengths | {f"{k}_normalised": f"{v:.6g}" for k, v in asdict(normalised).items()}


def bracketed(lengths: Rows, shares: Rows, names: int) -> list[list[str]]:
    """Join two tables with the same first `names` columns: "mm (normalised)" in the others."""
    pairs = zip(lengths, shares, strict=True)
    return [
        [*a[:names], *(f"{x} ({y})" for x, y in zip(a[names:], b[names:], strict=True))] for a, b in pairs
    ]  # fmt: skip


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def csv_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows, all with the first one's keys, as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def document(schema_version: int, protocol: Mapping[str, Any], runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a JSON document of runs, with when and with what they were made."""
    return {
        "schema_version": schema_version,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": read_versions(),
        "protocol": dict(protocol),
        "runs": list(runs),
    }


def write_all(folder: Path, name: str, record: Mapping[str, Any], csv_text: str, markdown: str) -> list[Path]:
    """Write NAME.json, NAME.csv and NAME.md and return their paths. Raises OutputError."""
    texts = {"json": json.dumps(record, indent=1) + "\n", "csv": csv_text, "md": markdown}
    return [write_atomically(folder / f"{name}.{suffix}", _writer(text)) for suffix, text in texts.items()]


def _writer(text: str) -> Any:
    return lambda path: path.write_text(text, encoding="utf-8")
