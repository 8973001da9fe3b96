"""The comparison of two sweeps, for instance of two versions: which combinations became better, worse, or failed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.sweep.plan import SETTINGS
from tactile_loc.evaluation.sweep.sweep import IDENTITY
from tactile_loc.evaluation.tabular import format_markdown, write_texts
from tactile_loc.slots.registry import SLOTS

if TYPE_CHECKING:
    import pandas as pd

ERROR = "error_mm"
CHANGED = 1.10  # a ratio of medians above this, or its inverse, counts as worse or better
WORSE, BETTER, ONLY_OLD, ONLY_NEW, FAILED = "worse", "better", "only in old", "only in new", "failed"


@dataclass(frozen=True, eq=False)
class Comparison:
    """The compared line of the protocol, a `table`, and the `versions` that differ, by name: (old, new).

    The table has a row for each combination of either sweep. Its first columns are texts that identify the combination;
    a text is empty if a component lacks the option. The other columns are old_mm, new_mm, their ratio (NaN if unknown),
    and the change (empty if small).
    """

    line: str
    table: pd.DataFrame
    versions: Mapping[str, tuple[str, str]]

    def count(self, change: str) -> int:
        """Return the number of combinations with this change."""
        return int((self.table["change"] == change).sum())


def compare(old: Mapping[str, Any], new: Mapping[str, Any], line: str) -> Comparison:
    """Join two records of sweeps from `read_sweep` by combination, and compare the median errors of `line`.

    Two combinations are the same if the object, touches, components, and the options known to both sweeps are the same.
    """
    import pandas as pd

    olds, news = _describe(old, line), _describe(new, line)
    shared = [name for name in olds.columns.intersection(news.columns) if name != ERROR]
    olds, news = _index_by_identity(olds, shared), _index_by_identity(news, shared)
    every = olds.index.append(news.index).unique()
    table = _name_rows(pd.concat([news, olds])).loc[every]
    table = table.assign(old_mm=olds[ERROR].reindex(every), new_mm=news[ERROR].reindex(every))
    table["ratio"] = (table["new_mm"] / table["old_mm"]).where(table["old_mm"] != 0)
    table["change"] = _name_changes(table, every.isin(olds.index), every.isin(news.index))
    return Comparison(line, table.reset_index(drop=True), _find_differing(old["versions"], new["versions"]))


def summarise(comparison: Comparison) -> str:
    """Return the number of combinations with each change, in one sentence."""
    marks = (WORSE, BETTER, FAILED, ONLY_OLD, ONLY_NEW)
    counts = ", ".join(f"{comparison.count(mark)} {mark}" for mark in marks if comparison.count(mark))
    percent = f"{100 * (CHANGED - 1):.0f} %"
    return f"{len(comparison.table)} combinations, {counts or 'none changed'} (by more than {percent})"


def format_texts(comparison: Comparison) -> pd.DataFrame:
    """Return the table with errors in mm and ratios as texts; a text is empty if a value is unknown."""
    errors = {name: comparison.table[name].map(_format_mm) for name in ("old_mm", "new_mm")}
    ratio = comparison.table["ratio"].map(lambda value: "" if np.isnan(value) else f"{value:.3f}")
    return comparison.table.assign(**errors, ratio=ratio)


def write_comparison(out: Path, comparison: Comparison) -> list[Path]:
    """Write compare.md and compare.csv into the folder `out` and return their paths. Raises OutputError."""
    table = format_texts(comparison)
    markdown, csv = "\n".join(_format_markdown(comparison, table)), str(table.to_csv(index=False, lineterminator="\n"))
    return write_texts(out, "compare", md=markdown, csv=csv)


def _format_markdown(comparison: Comparison, table: pd.DataFrame) -> Iterator[str]:
    yield f"# Comparison of two sweeps: {comparison.line}\n"
    yield f"Median error of `{comparison.line}`, mm. {summarise(comparison)}.\n"
    yield format_markdown([list(table.columns), *table.to_numpy().tolist()])
    yield "Versions that differ:\n"
    differing = [[name, *both] for name, both in comparison.versions.items()] or [["none", "", ""]]
    yield format_markdown([["", "old", "new"], *differing])


def _describe(record: Mapping[str, Any], line: str) -> pd.DataFrame:
    """Return a row for each combination: the texts that identify it, and its error in mm.

    The texts are IDENTITY, SETTINGS and the options, which are called "slot.component.option".
    """
    import pandas as pd

    found = []
    for row in record["rows"]:
        settings = row["configuration"]
        identity = {name: row[name] for name in IDENTITY} | {name: settings.get(name) for name in SETTINGS}
        texts = {name: str(value) for name, value in {**identity, **_list_options(settings)}.items()}
        found.append({**texts, ERROR: row.get(f"{line}_median_mm")})
    return pd.DataFrame(found).astype({ERROR: float})


def _list_options(settings: Mapping[str, Any]) -> dict[str, Any]:
    chosen = {slot: settings[slot] for slot in SLOTS}
    return {
        f"{slot}.{one['name']}.{option}": value
        for slot, one in chosen.items()
        for option, value in one["options"].items()
    }


def _index_by_identity(rows: pd.DataFrame, shared: list[str]) -> pd.DataFrame:
    """Index rows by identity: the columns in `shared`, or all columns if rows have equal `shared` columns.

    If several rows have the same identity, the first is kept.
    """
    names = rows.columns.drop(ERROR) if rows.duplicated(shared).any() else shared
    named = rows.set_index(rows[names].fillna("").agg("\n".join, axis=1))
    return named[~named.index.duplicated()]


def _name_rows(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the columns that distinguish rows: the object, and all columns of IDENTITY and options that differ.

    An option is called "slot.option", and is empty if a component lacks it.
    """
    options = [name for name in rows.columns if "." in name]
    varied = [name for name in (*IDENTITY, *options) if name == "object" or rows[name].nunique() > 1]
    known = rows[~rows.index.duplicated()]
    named = known[[]]
    for name in varied:
        slot, _, option = name.partition(".")
        column = f"{slot}.{option.rpartition('.')[2]}" if option else name
        values = known[name].combine_first(named[column]) if column in named else known[name]
        named = named.assign(**{column: values})
    return named.fillna("")


def _name_changes(table: pd.DataFrame, in_old: NDArray[np.bool_], in_new: NDArray[np.bool_]) -> NDArray[np.str_]:
    old_mm, new_mm = table["old_mm"], table["new_mm"]
    conditions = {
        ONLY_NEW: ~in_old, ONLY_OLD: ~in_new, FAILED: old_mm.isna() | new_mm.isna(),
        WORSE: new_mm > CHANGED * old_mm, BETTER: CHANGED * new_mm < old_mm,
    }  # fmt: skip
    return np.select(list(conditions.values()), list(conditions), "")


def _find_differing(old: Mapping[str, str], new: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    both = {name: (old.get(name, "-"), new.get(name, "-")) for name in {**old, **new}}
    return {name: pair for name, pair in both.items() if pair[0] != pair[1]}


def _format_mm(value: float) -> str:
    return "" if np.isnan(value) else format_mm(1e-3 * value)
