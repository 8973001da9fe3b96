#!/usr/bin/env python3
"""Keep the results of benchmarks, compare them over time, and write them into the documentation.

`keep NAME [ARGUMENT ...]` runs benchmarks/NAME.py, shows its output, and keeps its tables in
benchmarks/results/VERSION/RUN.json with the machine, the versions, the date and the arguments. A run is named after its
benchmark, or by `--as RUN` where one benchmark has several runs. Without arguments it gets those of the last time. Then
the tables and computed figures of the documentation are renewed, and the sentences to look over are listed.
`bind RUN` says that they were looked over. `--all` repeats every kept run, and runs every other benchmark.
`compare` reports the changes since the version before that has results, and fails where a time grew, or a speed fell,
by more than a tenth. Times are compared as multiples of a yardstick: a fixed piece of work, measured before and after.
`page` writes the documentation's page of results, and all figures that come from results.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from statistics import median
from typing import Any

import figures
from results import NUMBER, RESULTS, ROOT, Kept, Table, latest, tables, versions

BENCHMARKS = ROOT / "benchmarks"
PAGE = ROOT / "docs" / "results.md"
PACKAGES = ("numpy", "scipy", "numba", "torch", "open3d", "trimesh", "faiss-cpu")
WORSE = 0.1  # the share by which a time may grow
CHANGED = 0.1  # the share from which a change is reported
TIME = re.compile(r"(?<!/)\b(m?s|seconds|milliseconds)\b")
RATE = re.compile(r"/s\b")
RATIO = re.compile(r"^x \w")  # a ratio to something else of the same run


@dataclass(frozen=True)
class Change:
    """A figure of a row and column `before` and `now`, times as multiples of the yardstick.

    `wanted` is 1 for a speed, -1 for a time, 0 for anything else.
    """

    where: str
    before: float
    now: float
    wanted: int

    @property
    def ratio(self) -> float:
        """The figure now as a multiple of the one before."""
        return self.now / self.before if self.before else (1.0 if self.now == 0 else math.inf)

    @property
    def is_worse(self) -> bool:
        """Whether it is a time that grew, or a speed that fell, by more than WORSE."""
        return self.wanted * math.log(max(self.ratio, 1e-9)) < -math.log(1 + WORSE)


def compared(before: Kept, now: Kept) -> list[Change]:
    """Return the changes of all figures that both have: same column, same words in the row.

    Times and speeds are left out where a yardstick is unknown.
    """
    earlier = {key: value for table in before.tables for key, value in _figures(table).items()}
    yardsticks = (before.yardstick_ms, now.yardstick_ms)
    changes = []
    for (row, column, place), value in ((key, one) for table in now.tables for key, one in _figures(table).items()):
        power = 1 if RATE.search(column) else -1 if TIME.search(column) else 0  # of the yardstick
        if (row, column, place) in earlier and (all(yardsticks) or not power):
            old, new = ((y or 1.0) ** power for y in yardsticks)
            wanted = 1 if RATIO.search(column) else power
            changes.append(
                Change(f"{now.name}: {row}, {column}", old * earlier[row, column, place], new * value, wanted)
            )
    return changes


def _figures(table: Table) -> dict[tuple[str, str, int], float]:
    """Return the numbers of a table by the words of their row, their column and their place in the cell."""
    found: dict[tuple[str, str, int], float] = {}
    rows = (", ".join(cell for cell in cells if cell and not NUMBER.match(cell)) for cells in table.filled)
    columns = _told_apart(table.columns)
    for row, cells in zip(_told_apart(rows), table.filled, strict=True):
        for column, cell in zip(columns, cells, strict=True):
            numbers = NUMBER.findall(cell) if NUMBER.match(cell) else []
            found |= {(row, column, place): float(number) for place, number in enumerate(numbers)}
    return found


def _told_apart(words: Iterable[str]) -> list[str]:
    """Return the words, with a number from their second time on."""
    seen, found = Counter[str](), []
    for word in words:
        seen[word] += 1
        found.append(f"{word} {seen[word]}" if seen[word] > 1 else word)
    return found


def yardstick_ms() -> float:
    """Return how long a fixed piece of work takes: loops of Python, sorting, products of matrices; median of 9."""
    import numpy as np

    values = np.random.default_rng(0).random((600, 600))
    taken = []
    for _ in range(9):
        start = time.perf_counter()
        sum(number * number for number in range(100_000))
        np.sort(values.ravel())
        values @ values
        taken.append(1e3 * (time.perf_counter() - start))
    return median(taken)


def machine(threads: Mapping[str, str] = os.environ) -> dict[str, Any]:
    """Return the properties of this machine, and the limits of threads among the given variables."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*:\s*(.+)", info.read_text()) if info.exists() else None
    return {
        "processor": model[1] if model else platform.processor() or platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "python": platform.python_version(),
        "system": platform.system(),
        **{name: threads[name] for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS") if name in threads},
    }


def keep(name: str, arguments: list[str], folder: Path = RESULTS, run: str = "") -> Kept:
    """Run a benchmark, show its output, and keep its tables as those of `run`, by default of its name.

    Without arguments it gets those of the last time. Raises SystemExit when it fails, or they are unknown.
    """
    if not (script := BENCHMARKS / f"{name}.py").exists():
        raise SystemExit(f"bench: there is no benchmark {name}; there are {', '.join(names())}")
    before = latest(folder).get(run or name)
    arguments = arguments or (before.arguments if before else [])
    if any(given.startswith(("FILE", "FOLDER")) for given in arguments):
        raise SystemExit(f"bench: {run or name} was measured with files of one's own; name them: {' '.join(arguments)}")
    if before and before.arguments != arguments:
        print(f"bench: other arguments than those that {before.name} was kept with: {' '.join(before.arguments)}")
    first, start = yardstick_ms(), time.perf_counter()
    environment = {**(_threads(before) if before else {}), **os.environ}
    found = tables(_printed(script, arguments, environment))
    if not found:
        raise SystemExit(f"bench: {name} printed no table; nothing is kept")
    known = {(one.metadata["Name"] or "").lower(): one.version for one in metadata.distributions()}
    kept = Kept(
        name, [given.rpartition("/")[2] for given in arguments],
        metadata.version("tactile-loc"), f"{datetime.now(UTC):%Y-%m-%d}", round(time.perf_counter() - start, 1),
        round((first + yardstick_ms()) / 2, 2), machine(environment),
        {package: known[package] for package in PACKAGES if package in known}, found, run or name,
    )  # fmt: skip
    print(f"bench: kept in {kept.write(folder)}")
    return kept


def _threads(kept: Kept) -> dict[str, str]:
    """Return the limits of threads that a run had, as variables of the environment."""
    return {name: kept.machine[name] for name in sorted(kept.machine) if name.isupper()}


def _printed(script: Path, arguments: list[str], environment: dict[str, str]) -> str:
    """Return what a benchmark prints, and show it meanwhile. Raises SystemExit when it fails."""
    words, lines = [sys.executable, str(script), *arguments], []
    environment = {**environment, "COLUMNS": "200"}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment) as process:
        for line in process.stdout or []:
            print(line, end="", flush=True)
            lines.append(line)
    if process.returncode:
        raise SystemExit(f"bench: {script.stem} failed with exit code {process.returncode}; nothing is kept")
    return "".join(lines)


def names() -> list[str]:
    """Return the names of all benchmarks."""
    return sorted(path.stem for path in BENCHMARKS.glob("*.py"))


def compare(folder: Path = RESULTS) -> int:
    """Print the changes between the last two versions that have results; return 1 where a time grew."""
    known = versions(folder)
    if len(known) < 2:
        print(f"bench: only {known[0]} has results; nothing to compare with" if known else "bench: nothing is kept yet")
        return 0
    old, new = known[-2:]
    worse = 0
    for path in sorted((folder / new).glob("*.json")):
        if not (folder / old / path.name).exists():
            print(f"{path.stem}: new since {old}")
            continue
        for change in compared(Kept.read(folder / old / path.name), Kept.read(path)):
            worse += change.is_worse
            if change.is_worse or abs(change.ratio - 1) > CHANGED:
                mark = "WORSE  " if change.is_worse else "       "
                print(f"{mark}{change.where}: {change.before:.4g} -> {change.now:.4g} ({change.ratio:.2f} times)")
    print(f"bench: {old} -> {new}: {worse} times grew, or speeds fell, by more than {WORSE:.0%}")
    return 1 if worse else 0


def page(folder: Path = RESULTS) -> str:
    """Return the documentation's page of results: every run, and the tables of those that `keep` made."""
    parts = [
        "# Results over time\n",
        "This page lists every run of the benchmarks, with its command and date, and the tables of the runs that\n"
        "`scripts/bench.py keep NAME` made. The other tables are on the page in the last column.\n"
        "[Benchmarks](benchmarks.md) explains all tables.\n",
        "A file in `benchmarks/results` keeps each run and version. The yardstick is the time of a fixed piece of\n"
        "work before and after the run. Times of different machines are compared as multiples of it.\n"
        "`make bench-compare` reports the changes since the previous version. It fails if a time grew, or a speed\n"
        "fell, by more than a tenth.\n",
    ]
    runs = latest(folder)
    rows = [
        [name, f"`{command(kept)}`", kept.version, kept.date, str(kept.yardstick_ms or kept.source.partition(",")[0])]
        for name, kept in runs.items()
    ]
    parts.append(Table(["run", "command", "version", "date", "yardstick, ms, or source"], rows).markdown())
    for name, kept in runs.items():
        if kept.yardstick_ms is not None:
            parts.append(
                f"## {name}\n\n`{command(kept)}`\n\n{kept.version}, {kept.date}, {kept.machine['processor']}, "
                f"{kept.machine['cores']} cores; yardstick {kept.yardstick_ms:g} ms.\n"
            )
            parts += [table.markdown() for table in kept.tables]
    return "\n".join(parts)


def command(kept: Kept) -> str:
    """Return how a run is started."""
    is_ours = (BENCHMARKS / f"{kept.benchmark}.py").exists()
    threads = [f"{name}={value}" for name, value in _threads(kept).items()]
    return " ".join(
        [*threads, f"python benchmarks/{kept.benchmark}.py" if is_ours else kept.benchmark, *kept.arguments]
    )


def keep_all() -> int:
    """Repeat every run of a benchmark, and run every benchmark that has none. Return how many failed."""
    runs = {name: kept.benchmark for name, kept in latest().items() if kept.benchmark in names()}
    failed = 0
    for run, name in {**runs, **{name: name for name in names() if name not in runs.values()}}.items():
        try:
            keep(name, [], run=run)
        except SystemExit as error:
            print(error)
            failed += 1
    return failed


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    kept = commands.add_parser("keep", help="run a benchmark and keep its tables")
    kept.add_argument("--as", dest="run", default="", help="the name of the run; by default the benchmark's")
    kept.add_argument("--all", action="store_true", help="all that is kept, and every other benchmark")
    kept.add_argument("name", nargs="?")
    kept.add_argument("arguments", nargs=argparse.REMAINDER)
    commands.add_parser("compare", help="report the changes since the version before")
    commands.add_parser("page", help="write the documentation's page and figures")
    bound = commands.add_parser("bind", help="say that the text about a run was looked over, and is true of it")
    bound.add_argument("name")
    chosen = parser.parse_args()
    failed = 0
    if chosen.command == "compare":
        return compare()
    if chosen.command == "bind":
        figures.bind(chosen.name)
    elif chosen.command == "keep" and chosen.all:
        failed = keep_all()
    elif chosen.command == "keep" and chosen.name:
        benchmark = latest()[chosen.name].benchmark if chosen.name in latest() else chosen.name
        keep(benchmark, chosen.arguments, run=chosen.run or chosen.name)
    elif chosen.command == "keep":
        parser.error(f"name a benchmark, or say --all; there are {', '.join(names())}")
    PAGE.write_text(page(), encoding="utf-8")
    for path in figures.renew():
        print(f"bench: wrote {path}")
    for problem in figures.problems():
        print(f"bench: {problem}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
