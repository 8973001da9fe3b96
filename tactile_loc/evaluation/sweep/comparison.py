"""The comparison of two sweeps, for instance of two versions: which combinations became better, worse, or failed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.sweep.plan import SETTINGS
from tactile_loc.evaluation.sweep.sweep import IDENTITY
from tactile_loc.evaluation.text_tables import Row, format_csv, format_document, tabulate
from tactile_loc.slots.registry import SLOTS
from tactile_loc.store.files import write_text

Key = tuple[str, ...]

ERROR = "error_mm"
CHANGED = 1.10  # a ratio of medians above this, or its inverse, counts as worse or better
WORSE, BETTER, ONLY_OLD, ONLY_NEW, FAILED = "worse", "better", "only in old", "only in new", "failed"


@dataclass(frozen=True, eq=False)
class SweepComparison:
    """The compared line of the protocol, a row for each combination of either sweep, and the `versions` that differ.

    A row has texts that identify the combination; a text is empty if a component lacks the option. Its other values are
    old_mm, new_mm and their ratio, None if unknown, and the change, empty if it is small. `versions` has the old and
    the new version by name.
    """

    line: str
    rows: Sequence[Row]
    versions: Mapping[str, tuple[str, str]]

    def count(self, change: str) -> int:
        """Return the number of combinations with this change."""
        return sum(row["change"] == change for row in self.rows)


def compare(old: Mapping[str, Any], new: Mapping[str, Any], line: str) -> SweepComparison:
    """Join two records of sweeps from `read_sweep` by combination, and compare the median errors of `line`.

    Two combinations are the same if the object, touches, components, and the options known to both sweeps are the same.
    """
    described = [_describe(record, line) for record in (old, new)]
    known_old, known_new = ({name: None for row in rows for name in row if name != ERROR} for rows in described)
    shared = [name for name in known_old if name in known_new]
    olds, news = (_index_by_identity(rows, shared) for rows in described)
    names = _name_rows({**olds, **news}, [*news.values(), *olds.values()])
    rows = []
    for key in {**olds, **news}:
        old_mm, new_mm = (found.get(key, {}).get(ERROR) for found in (olds, news))
        ratio = None if old_mm is None or new_mm is None or old_mm == 0 else new_mm / old_mm
        change = ONLY_NEW if key not in olds else ONLY_OLD if key not in news else _name_change(old_mm, new_mm)
        rows.append({**names[key], "old_mm": old_mm, "new_mm": new_mm, "ratio": ratio, "change": change})
    before, after = old["versions"], new["versions"]
    differing = [name for name in {**before, **after} if before.get(name) != after.get(name)]
    versions = {name: (before.get(name, "-"), after.get(name, "-")) for name in differing}
    return SweepComparison(line, rows, versions)


def summarise(comparison: SweepComparison) -> str:
    """Return the number of combinations with each change, in one sentence."""
    marks = (WORSE, BETTER, FAILED, ONLY_OLD, ONLY_NEW)
    counts = ", ".join(f"{comparison.count(mark)} {mark}" for mark in marks if comparison.count(mark))
    percent = f"{100 * (CHANGED - 1):.0f} %"
    return f"{len(comparison.rows)} combinations, {counts or 'none changed'} (by more than {percent})"


def format_texts(comparison: SweepComparison) -> list[dict[str, str]]:
    """Return the rows with errors in mm and ratios as texts; a text is empty if a value is unknown."""
    return [
        {
            **row,
            **{name: "" if row[name] is None else format_mm(1e-3 * row[name]) for name in ("old_mm", "new_mm")},
            "ratio": "" if row["ratio"] is None else f"{row['ratio']:.3f}",
        }
        for row in comparison.rows
    ]


def write_comparison(out: Path, comparison: SweepComparison) -> list[Path]:
    """Write compare.md and compare.csv into the folder `out` and return their paths. Raises OutputError."""
    rows = format_texts(comparison)
    versions = [[name, *both] for name, both in comparison.versions.items()] or [["none", "", ""]]
    parts = [
        f"Median error of `{comparison.line}`, mm. {summarise(comparison)}.",
        tabulate(rows),
        "Versions that differ:",
        [["", "old", "new"], *versions],
    ]
    texts = {"md": format_document(f"Comparison of two sweeps: {comparison.line}", parts), "csv": format_csv(rows)}
    return [write_text(out / f"compare.{suffix}", text) for suffix, text in texts.items()]


def _describe(record: Mapping[str, Any], line: str) -> list[Row]:
    """Return a row for each combination: the texts that identify it, and its error in mm.

    The texts are IDENTITY, SETTINGS and the options, which are called "slot.component.option".
    """
    found = []
    for row in record["rows"]:
        settings = row["configuration"]
        known = {name: row[name] for name in IDENTITY} | {name: settings.get(name) for name in SETTINGS}
        for slot in SLOTS:
            chosen = settings[slot]
            known |= {f"{slot}.{chosen['name']}.{option}": value for option, value in chosen["options"].items()}
        error_mm = row.get(f"{line}_median_mm")
        texts = {name: str(value) for name, value in known.items()}
        found.append({**texts, ERROR: None if error_mm is None or error_mm != error_mm else float(error_mm)})
    return found


def _index_by_identity(rows: Sequence[Row], shared: Sequence[str]) -> dict[Key, Row]:
    """Return rows by identity: the texts `shared`, or all texts if rows have equal `shared` texts.

    If several rows have the same identity, the first is kept.
    """
    every = dict.fromkeys(name for row in rows for name in row if name != ERROR)
    found: dict[Key, Row] = {}
    for names in (shared, every):
        found = {tuple(row.get(name, "") for name in names): row for row in reversed(rows)}
        if len(found) == len(rows):
            break
    return dict(reversed(found.items()))


def _name_rows(rows: Mapping[Key, Row], every: Sequence[Row]) -> dict[Key, dict[str, str]]:
    """Return the texts that distinguish rows: the object, and all of IDENTITY and the options that differ in `every`.

    An option is called "slot.option", and is empty if a component lacks it.
    """
    options = dict.fromkeys(name for row in every for name in row if "." in name)
    varied = [
        name
        for name in (*IDENTITY, *options)
        if name == "object" or len({row[name] for row in every if name in row}) > 1
    ]
    named: dict[Key, dict[str, str]] = {key: {} for key in rows}
    for key, row in rows.items():
        for name in varied:
            slot, _, option = name.partition(".")
            column = f"{slot}.{option.rpartition('.')[2]}" if option else name
            named[key][column] = row.get(name, named[key].get(column, ""))
    return named


def _name_change(old_mm: float | None, new_mm: float | None) -> str:
    if old_mm is None or new_mm is None:
        return FAILED
    return WORSE if new_mm > CHANGED * old_mm else BETTER if CHANGED * new_mm < old_mm else ""
