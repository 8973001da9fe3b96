#!/usr/bin/env python3
"""Results of benchmarks that can be compared over time.

`keep NAME [ARGUMENT ...]` runs benchmarks/NAME.py, shows what it prints, and keeps its tables in
benchmarks/results/VERSION/NAME.json with the machine, the versions, the date and the arguments; `--all` runs every
benchmark as it is. Times of different machines, and of a busy one, are compared as multiples of a yardstick: a fixed
piece of work, measured before and after. `compare` tells what changed since the latest earlier version that has
results, and fails where a time grew or a speed fell by more than a tenth; `page` writes the documentation's page of
what is kept, and its figure.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import re
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
BENCHMARKS, RESULTS = ROOT / "benchmarks", ROOT / "benchmarks" / "results"
PAGE, FIGURE = ROOT / "docs" / "results.md", ROOT / "docs" / "images" / "results.png"
PACKAGES = ("numpy", "scipy", "numba", "torch", "open3d", "trimesh", "faiss-cpu")
WORSE = 0.1  # of a time, by which it may grow
CHANGED = 0.1  # of a figure, from which on a change is told
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
TIME = re.compile(r"(?<!/)\b(m?s|seconds|milliseconds)\b")
RATE = re.compile(r"/s\b")
RATIO = re.compile(r"^x \w")  # how many times as fast as something else of the same run


@dataclass(frozen=True)
class Table:
    """A printed table: the names of its columns, and its rows of cells."""

    columns: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Kept:
    """What a benchmark printed, where and when; `yardstick_ms` is the median time of the fixed piece of work."""

    benchmark: str
    arguments: list[str]
    version: str
    date: str
    seconds: float
    yardstick_ms: float
    machine: dict[str, Any]
    packages: dict[str, str]
    tables: list[Table]

    @classmethod
    def read(cls, path: Path) -> Kept:
        """Read one that was kept."""
        values = json.loads(path.read_text())
        return cls(**{**values, "tables": [Table(**table) for table in values["tables"]]})

    def write(self, folder: Path) -> Path:
        """Write it into the folder of its version; return the file."""
        path = folder / self.version / f"{self.benchmark}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(asdict(self), indent=1) + "\n")
        return path


@dataclass(frozen=True)
class Change:
    """A figure of a row and column that was `before` and is `now`: times as multiples of the yardstick.

    `wanted` is 1 for a speed, which should be large, -1 for a time, 0 for what is neither.
    """

    where: str
    before: float
    now: float
    wanted: int

    @property
    def ratio(self) -> float:
        """How many times as large it is."""
        return self.now / self.before if self.before else (1.0 if self.now == 0 else math.inf)

    @property
    def is_worse(self) -> bool:
        """Whether it is a time that grew, or a speed that fell, by more than WORSE."""
        return self.wanted * math.log(max(self.ratio, 1e-9)) < -math.log(1 + WORSE)


def tables(text: str) -> list[Table]:
    """Return the Markdown tables of what a benchmark printed; a row without a first cell has that of the row above."""
    found: list[Table] = []
    before = ""
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")] if line.strip().startswith("|") else []
        is_rule = bool(cells) and all(re.fullmatch(r":?-+:?", cell) for cell in cells)
        if cells and is_rule and before:
            found.append(Table(before, []))
        elif cells and found and before and len(cells) == len(found[-1].columns):
            if not cells[0] and found[-1].rows:
                cells[0] = found[-1].rows[-1][0]
            found[-1].rows.append(cells)
        before = cells
    return found


def compared(before: Kept, now: Kept) -> list[Change]:
    """Return every figure that both have: of tables with the same columns, and rows with the same words."""
    earlier = {key: value for table in before.tables for key, value in _figures(table).items()}
    changes = []
    for table in now.tables:
        for (row, column, place), value in _figures(table).items():
            if (row, column, place) in earlier:
                power = 1 if RATE.search(column) else -1 if TIME.search(column) else 0  # of the yardstick
                old, new = earlier[row, column, place] * before.yardstick_ms**power, value * now.yardstick_ms**power
                where = f"{now.benchmark}: {row}, {column}"
                changes.append(Change(where, old, new, 1 if RATIO.search(column) else power))
    return changes


def _figures(table: Table) -> dict[tuple[str, str, int], float]:
    """The numbers of a table by the words of their row (and how many had the same before), column and place in it."""
    found: dict[tuple[str, str, int], float] = {}
    alike: Counter[str] = Counter()
    for cells in table.rows:
        words = ", ".join(cell for cell in cells if cell and not NUMBER.match(cell))
        row = f"{words} {alike[words] + 1}" if alike[words] else words
        alike[words] += 1
        for column, cell in zip(table.columns, cells, strict=True):
            if NUMBER.match(cell):
                for place, number in enumerate(NUMBER.findall(cell)):
                    found[row, column, place] = float(number)
    return found


def yardstick_ms() -> float:
    """Return how long a fixed piece of work takes: loops of Python, sorting, and products of matrices; median of 9."""
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


def machine() -> dict[str, Any]:
    """Say what this runs on."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists() and (found := re.search(r"model name\s*:\s*(.+)", info.read_text())):
        name = found[1]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    threads = {name: os.environ[name] for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS") if name in os.environ}
    return {
        "processor": name,
        "cores": cores,
        "python": platform.python_version(),
        "system": platform.system(),
        **threads,
    }


def keep(name: str, arguments: list[str], folder: Path = RESULTS) -> Kept:
    """Run a benchmark, show what it prints, and keep its tables. Raises SystemExit when it fails."""
    script = BENCHMARKS / f"{name}.py"
    if not script.exists():
        raise SystemExit(f"bench: there is no benchmark {name}; there are {', '.join(names())}")
    first, start = yardstick_ms(), time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, str(script), *arguments], stdout=subprocess.PIPE, text=True, cwd=ROOT,
        env={**os.environ, "COLUMNS": "200"},
    )  # fmt: skip
    lines = []
    for line in process.stdout or []:
        print(line, end="", flush=True)
        lines.append(line)
    if process.wait():
        raise SystemExit(f"bench: {name} failed with exit code {process.returncode}; nothing is kept")
    found = tables("".join(lines))
    if not found:
        raise SystemExit(f"bench: {name} printed no table; nothing is kept")
    packages = {}
    for package in PACKAGES:
        try:
            packages[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    kept = Kept(
        name, [Path(given).name if Path(given).exists() else given for given in arguments],
        metadata.version("tactile-loc"), f"{datetime.now(UTC):%Y-%m-%d}", round(time.perf_counter() - start, 1),
        round((first + yardstick_ms()) / 2, 2), machine(), packages, found,
    )  # fmt: skip
    print(f"bench: kept in {kept.write(folder)}")
    return kept


def names() -> list[str]:
    """Return the names of all benchmarks."""
    return sorted(path.stem for path in BENCHMARKS.glob("*.py"))


def versions(folder: Path = RESULTS) -> list[str]:
    """Return the versions that have results, the oldest first."""
    found = [path.name for path in folder.glob("*") if path.is_dir()]
    return sorted(found, key=lambda name: [int(part) for part in re.findall(r"\d+", name)])


def compare(folder: Path = RESULTS) -> int:
    """Tell what changed from the last version but one that has results to the last; return 1 where a time grew."""
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
            if change.is_worse or abs(change.ratio - 1) > CHANGED:
                worse += change.is_worse
                mark = "WORSE  " if change.is_worse else "       "
                print(f"{mark}{change.where}: {change.before:.4g} -> {change.now:.4g} ({change.ratio:.2f} times)")
    print(f"bench: {old} -> {new}: {worse} times grew, or speeds fell, by more than {WORSE:.0%}")
    return 1 if worse else 0


def page(folder: Path = RESULTS) -> str:
    """Return the page of what is kept of the newest version, in Markdown."""
    known = versions(folder)
    parts = [
        "# Results over time\n",
        "What the benchmarks printed, kept by `scripts/bench.py keep NAME`, a file a benchmark and version in\n"
        "`benchmarks/results`. Times of different machines are compared as multiples of a yardstick, a fixed piece of\n"
        "work that is measured before and after; `make bench-compare` tells what changed since the version before,\n"
        "and fails where a time grew, or a speed fell, by more than a tenth.\n",
    ]
    if len(known) > 1:
        parts.append("![Times by version, as multiples of the first version's](images/results.png)\n")
    for path in sorted((folder / known[-1]).glob("*.json")) if known else []:
        kept = Kept.read(path)
        threads = ", ".join(f"{name}={kept.machine[name]}" for name in sorted(kept.machine) if name.isupper())
        parts.append(
            f"## {kept.benchmark}\n\n`python benchmarks/{' '.join([f'{kept.benchmark}.py', *kept.arguments])}`\n\n"
            f"{kept.version}, {kept.date}, {kept.machine['processor']}, {kept.machine['cores']} cores"
            f"{f' ({threads})' if threads else ''}; yardstick {kept.yardstick_ms:g} ms.\n"
        )
        for table in kept.tables:
            rows = [table.columns, ["---"] * len(table.columns), *table.rows]
            parts.append("\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n")
    return "\n".join(parts)


def draw(path: Path, folder: Path = RESULTS) -> bool:
    """Draw every benchmark's times by version, as multiples of the first's; whether there are versions to compare."""
    known = versions(folder)
    if len(known) < 2:
        return False
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for name in sorted({file.stem for file in folder.glob("*/*.json")}):
        having = [version for version in known if (folder / version / f"{name}.json").exists()]
        first = Kept.read(folder / having[0] / f"{name}.json")
        means = []
        for version in having:
            changes = compared(first, Kept.read(folder / version / f"{name}.json"))
            logs = [math.log(c.ratio) for c in changes if c.wanted == -1 and c.before > 0 and c.now > 0]
            means.append(math.exp(sum(logs) / len(logs)) if logs else math.nan)
        if not all(map(math.isnan, means)):
            axes.plot([known.index(version) for version in having], means, marker="o", label=name)
    axes.set_xticks(range(len(known)), known)
    axes.set(xlabel="version", ylabel="time, multiple of the first version's", yscale="log")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)
    return True


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    kept = commands.add_parser("keep", help="run a benchmark and keep what it prints")
    kept.add_argument("name", nargs="?")
    kept.add_argument("arguments", nargs=argparse.REMAINDER)
    kept.add_argument("--all", action="store_true", help="every benchmark, without arguments")
    commands.add_parser("compare", help="tell what changed since the version before")
    commands.add_parser("page", help="write the documentation's page and figure")
    chosen = parser.parse_args()
    if chosen.command == "compare":
        return compare()
    if chosen.command == "page":
        PAGE.write_text(page())
        draw(FIGURE)
        return 0
    if not (chosen.all or chosen.name):
        parser.error(f"name a benchmark, or say --all; there are {', '.join(names())}")
    for name in names() if chosen.all else [chosen.name]:
        keep(name, [] if chosen.all else chosen.arguments)
    return 0


if __name__ == "__main__":
    sys.exit(main())
