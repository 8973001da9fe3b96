"""Two sweeps side by side, for instance of two versions: what became better, worse, or is only in one of them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.formatting import mm
from tactile_loc.core.registry import SLOTS
from tactile_loc.evaluation.tabular import csv_table, markdown_table
from tactile_loc.store.files import write_atomically

PLAIN = ("object", *SLOTS, "noise", "seed", "count")
CHANGED = 1.10  # a ratio of medians beyond which an error counts as worse or better
WORSE, BETTER, ONLY_OLD, ONLY_NEW, FAILED = "worse", "better", "only in old", "only in new", "failed"


@dataclass(frozen=True)
class Pair:
    """A combination in two sweeps: errors in mm, None where there is none, and what changed."""

    names: Mapping[str, str]
    old_mm: float | None
    new_mm: float | None
    mark: str

    @property
    def ratio(self) -> float | None:
        """The new error over the old one; None unless there are both, and the old one is not zero."""
        return self.new_mm / self.old_mm if self.new_mm is not None and self.old_mm else None


@dataclass(frozen=True)
class Comparison:
    """All pairs, the line compared, and the versions that differ, by name: (old, new)."""

    line: str
    pairs: Sequence[Pair]
    versions: Mapping[str, tuple[str, str]]

    def count(self, mark: str) -> int:
        """Return how many pairs have this mark."""
        return sum(pair.mark == mark for pair in self.pairs)


def read_sweep(folder: Path) -> dict[str, Any]:
    """Read a sweep's sweep.json. Raises ConfigError when there is none, or it is none."""
    path = folder / "sweep.json"
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        _ = found["rows"], found["versions"]
    except FileNotFoundError as error:
        raise ConfigError(f"there is no {path}; give the --out folder of a sweep that has ended") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path} cannot be read as a sweep's ({type(error).__name__}); run that sweep again"
        ) from error
    return dict(found)


def compare(old: Mapping[str, Any], new: Mapping[str, Any], line: str) -> Comparison:
    """Join two records of sweeps by combination and compare the medians of `line`.

    Combinations are the same when object, touches, components and all options that both sweeps know are.
    """
    olds, news = _by_identity(old, new), _by_identity(new, old)
    telling = _telling([*old["rows"], *new["rows"]])
    pairs = [_pair(olds.get(name), news.get(name), line, telling) for name in {**olds, **news}]
    names = {**old["versions"], **new["versions"]}
    both = {name: (old["versions"].get(name, "-"), new["versions"].get(name, "-")) for name in names}
    return Comparison(line, pairs, {name: pair for name, pair in both.items() if pair[0] != pair[1]})


def comparison_rows(comparison: Comparison) -> list[dict[str, str]]:
    """Return a row of cells for each pair: names that differ, both errors in mm, the ratio, and the mark."""
    return [
        {
            **pair.names,
            "old_mm": _mm(pair.old_mm), "new_mm": _mm(pair.new_mm),
            "ratio": "" if pair.ratio is None else f"{pair.ratio:.3f}", "change": pair.mark,
        }
        for pair in comparison.pairs
    ]  # fmt: skip


def summary(comparison: Comparison) -> str:
    """Say in one sentence how many combinations changed how."""
    marks = (WORSE, BETTER, FAILED, ONLY_OLD, ONLY_NEW)
    counts = ", ".join(f"{comparison.count(mark)} {mark}" for mark in marks if comparison.count(mark))
    percent = f"{100 * (CHANGED - 1):.0f} %"
    return f"{len(comparison.pairs)} combinations, {counts or 'none changed'} (by more than {percent})"


def write_comparison(out: Path, comparison: Comparison) -> list[Path]:
    """Write compare.md and compare.csv into the folder `out` and return their paths. Raises OutputError."""
    rows = comparison_rows(comparison)
    texts = {"md": "\n".join(_markdown(comparison, rows)), "csv": csv_table(rows)}
    return [_write(out / f"compare.{suffix}", text) for suffix, text in texts.items()]


def _markdown(comparison: Comparison, rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    yield f"# Two sweeps: {comparison.line}\n"
    yield f"Median error of `{comparison.line}`, mm. {summary(comparison)}.\n"
    yield markdown_table(list(rows[0]), (list(row.values()) for row in rows))
    yield "Versions that differ:\n"
    differing = [[name, *both] for name, both in comparison.versions.items()] or [["none", "", ""]]
    yield markdown_table(["", "old", "new"], differing)


def _pair(
    old: Mapping[str, Any] | None, new: Mapping[str, Any] | None, line: str, telling: Sequence[str]
) -> Pair:  # fmt: skip
    column = f"{line}_median_mm"
    old_mm, new_mm = (None if row is None else row.get(column) for row in (old, new))
    names = _names(new or old or {}, telling)
    if old is None or new is None:
        mark = ONLY_NEW if old is None else ONLY_OLD
    elif old_mm is None or new_mm is None:
        mark = FAILED
    else:
        mark = WORSE if new_mm > CHANGED * old_mm else BETTER if CHANGED * new_mm < old_mm else ""
    return Pair(names, old_mm, new_mm, mark)


def _by_identity(record: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Rows by what they are; options that the other sweep's components do not have are left out if nothing is lost."""
    theirs = {name for row in other["rows"] for name in _options(row)}
    short = {_identity(row, theirs): row for row in record["rows"]}
    return short if len(short) == len(record["rows"]) else {_identity(row, None): row for row in record["rows"]}


def _identity(row: Mapping[str, Any], known: set[str] | None) -> str:
    settings = row["configuration"]
    options = {name: value for name, value in _options(row).items() if known is None or name in known}
    plain = [row[name] for name in PLAIN] + [settings.get("shape_px"), settings.get("temperature")]
    return json.dumps([plain, options], sort_keys=True)


def _options(row: Mapping[str, Any]) -> dict[str, Any]:
    """All options of a row's components, by "slot.component.option"."""
    chosen = {slot: row["configuration"][slot] for slot in SLOTS}
    return {
        f"{slot}.{one['name']}.{option}": value
        for slot, one in chosen.items()
        for option, value in one["options"].items()
    }


def _telling(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What tells rows apart: of PLAIN what differs, the object always, and options that differ within a component."""
    values: dict[str, set[str]] = {}
    for row in rows:
        for name, value in {**{name: row[name] for name in PLAIN}, **_options(row)}.items():
            values.setdefault(name, set()).add(json.dumps(value))
    return [name for name, found in values.items() if name == "object" or len(found) > 1]


def _names(row: Mapping[str, Any], telling: Sequence[str]) -> dict[str, str]:
    """The values of what tells rows apart, an option as "slot.option"; empty where a component lacks it."""
    known = {**{name: row[name] for name in PLAIN}, **_options(row)}
    named: dict[str, str] = {}
    for name in telling:
        slot, _, option = name.partition(".")
        column = f"{slot}.{option.rpartition('.')[2]}" if option else name
        named[column] = str(known[name]) if name in known else named.get(column, "")
    return named


def _mm(value: float | None) -> str:
    return "" if value is None else mm(1e-3 * value)


def _write(path: Path, text: str) -> Path:
    return write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
