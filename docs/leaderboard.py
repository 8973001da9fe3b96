#!/usr/bin/env python3
"""The leaderboard (benchmarks/results/leaderboard/README.md), and the tables of components in docs/benchmark.md.

The leaderboard shows all files of its folder. Run this program to renew both pages.
"""

import re
import sys
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

from tactile_loc_benchmark.files import HEAD, TABLE_NOTE, format_within, list_cells
from tactile_loc_benchmark.job import Row
from tactile_loc_benchmark.leaderboard import read_standings
from tactile_loc_benchmark.summary import WITHIN_M

from tactile_loc.evaluation.text_tables import format_markdown
from tactile_loc.slots.registry import registry

DOCS = Path(__file__).parent
RESULTS = DOCS.parent / "benchmarks" / "results" / "leaderboard"
PAGE, GUIDE = RESULTS / "README.md", DOCS / "benchmark.md"
OURS, OFFERING = "tactile-loc", "tactile-loc-benchmark"
NEAR = WITHIN_M.index(1e-3)
INTRODUCTION = f"""\
# Leaderboard

This page compares methods that locate objects from touch. `tactile-loc benchmark` measured all figures
([how, and how to add your method](../../../docs/benchmark.md)). `python docs/leaderboard.py` writes this page from the
files in this folder.

{textwrap.fill(f"{TABLE_NOTE} The best value of each column is bold, for each number of touches.", 120)}

"""
SHARED = 3  # the first cells of HEAD are the source, the number of touches and the method
Key = tuple[str, str, str]  # suite, protocol, source


# For each column of HEAD from the fourth on: a value of a group, and 1 if the largest is the best, -1 if the smallest.
MERITS: tuple[tuple[str, int | None, int] | None, ...] = (
    *(("within", k, 1) for k in range(len(WITHIN_M))),
    ("listed_within", NEAR, 1),
    ("median_m", None, -1),
    ("determined_within_1_mm", None, 1),
    ("median_determined_m", None, -1),
    ("auc", None, 1),
    ("average_recall_mssd", None, 1),
    ("shape_within_1_mm", None, 1),
    ("calibration_error", None, -1),
    None,
    None,
    ("median_s", None, -1),
)


def read_all(folder: Path = RESULTS) -> list[Row]:
    """Return the newest standing of each suite, protocol, source, method and number of touches."""
    found = [standing for path in sorted(folder.glob("*.json")) for standing in read_standings(path)]
    found.sort(key=lambda standing: standing["date"])
    newest = {(*_find_key(one), one["method"], one["touches"]): one for one in found}
    return list(newest.values())


def format_page(standings: Sequence[Row]) -> str:
    """Return the text of the leaderboard."""
    tables: dict[Key, list[Row]] = {}
    for standing in standings:
        tables.setdefault(_find_key(standing), []).append(standing)
    parts = [INTRODUCTION, "## Where tactile-loc loses\n\n", _format_losses(tables.values())]
    previous = ""
    for (suite, protocol, source), some in sorted(tables.items(), key=lambda item: item[0][0]):
        if suite != previous:
            parts.append(f"\n## Suite {suite}\n\n{some[0]['summary']}.\n")
        previous = suite
        versions = _join(some[-1]["source_libraries"]) or "no library"
        about = f"Licence: {some[0]['licence'] or 'not stated'}. Versions: {versions}. Protocol: `{protocol}`."
        parts.append(f"\n### {suite}: {source}\n\n{about}\n\n{format_markdown(_tabulate(some))}")
    parts.append(f"\n## Methods\n\n{format_markdown(_tabulate_methods(standings))}")
    return "".join(parts)


def _find_key(standing: Row) -> Key:
    return standing["suite"], standing["protocol"], standing["source"]


def _tabulate(standings: Sequence[Row]) -> list[list[str]]:
    """Return a row for each number of touches and method, with the best values bold."""
    ordered = sorted(standings, key=lambda one: (one["touches"], -one["within"][NEAR]))
    rows = [[HEAD[1], HEAD[2], "examples", *HEAD[SHARED:], "date"]]
    for one in ordered:
        rivals = [other for other in ordered if other["touches"] == one["touches"]]
        cells = list(list_cells(one))
        values = [
            f"**{cell}**" if len(rivals) > 1 and _is_best(one, rivals, merit) else cell
            for cell, merit in zip(cells[SHARED:], MERITS, strict=True)
        ]
        rows.append([*cells[1:SHARED], str(one["examples"]), *values, one["date"]])
    return rows


def _is_best(group: Row, rivals: Sequence[Row], merit: tuple[str, int | None, int] | None) -> bool:
    if merit is None:
        return False
    name, number, sign = merit
    own, *others = (one[name] if number is None else one[name][number] for one in (group, *rivals))
    return own is not None and all(other is None or sign * other <= sign * own for other in others)


def _format_losses(tables: Collection[Sequence[Row]]) -> str:
    """Return a table of all methods that are better than the default tactile-loc within 1 mm."""
    if all(one["component"] == OURS for some in tables for one in some):
        return "The results contain no other method yet.\n"
    rows = [list(_compare(one, ours)) for some in tables for one, ours in _find_losses(some)]
    if not rows:
        return "No method has a larger share within 1 mm than tactile-loc with its default settings.\n"
    head = ["suite", "source", "touches", "method", "within 1 mm", "tactile-loc", "intervals"]
    return format_markdown([head, *rows])


def _find_losses(standings: Sequence[Row]) -> Iterator[tuple[Row, Row]]:
    """Yield each better method of one table, with tactile-loc's result for the same number of touches."""
    ours = {one["touches"]: one for one in standings if one["component"] == OURS and not one["options"]}
    for one in standings:
        mine = ours.get(one["touches"])
        if mine is not None and one["component"] != OURS and one["within"][NEAR] > mine["within"][NEAR]:
            yield one, mine


def _compare(one: Row, ours: Row) -> Iterator[str]:
    yield from (one["suite"], one["source"], str(one["touches"]), one["method"])
    yield from (format_within(group, NEAR) for group in (one, ours))
    apart = one["within_range"][NEAR][0] > ours["within_range"][NEAR][1]
    yield "do not overlap" if apart else "overlap"


def _tabulate_methods(standings: Sequence[Row]) -> list[list[str]]:
    rows = {
        one["method"]: [one["method"], f"`{one['component']}`", one["paper"] or "-", _join(one["libraries"])]
        for one in standings
    }
    return [["method", "component", "follows", "versions"], *rows.values()]


def _join(versions: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in versions.items())


def tabulate_components(kind: str) -> str:
    """Return a table of the built-in sources or methods with the command that installs their libraries."""
    rows = [["name", "description", "needs"]]
    for found in registry().components:
        if found.distribution == OFFERING and found.spec.slot == kind:
            needs = f"`pip install '{found.spec.requires}'`" if found.spec.requires else "-"
            rows.append([f"`{found.spec.name}`", found.spec.summary, needs])
    return format_markdown(rows)


def fill_guide(text: str) -> str:
    """Return the text of docs/benchmark.md with its tables of sources and methods renewed."""
    for kind in ("touch-source", "method"):
        place = re.compile(rf"(?<=<!-- {kind} -->\n).*?(?=<!-- /{kind} -->)", re.DOTALL)
        if not place.search(text):
            sys.exit(f"{GUIDE} has no place for the table of each {kind}")
        table = tabulate_components(kind)
        text = place.sub(lambda _, table=table: table, text)  # type: ignore[misc]
    return text


def main() -> None:
    """Write both pages."""
    PAGE.write_text(format_page(read_all()), encoding="utf-8")
    GUIDE.write_text(fill_guide(GUIDE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
