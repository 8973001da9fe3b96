#!/usr/bin/env python3
"""Keep the results of benchmarks, compare them over time, and write them into the documentation.

`keep NAME [ARGUMENT ...]` runs benchmarks/NAME.py and keeps its tables in benchmarks/results/VERSION/RUN.json, with the
machine, the versions, the date and the arguments. A run has the name of its benchmark, or the name given with `--as
RUN`. Without arguments, the run repeats the arguments of the last time. Then the tables and computed figures of the
documentation are renewed, and the sentences to check are listed. `bind RUN` confirms these sentences. `keep --all`
repeats every kept run, and runs every other benchmark. `compare` prints the ratio of every figure to its value before:
in the previous version or, if only one version has the run, in the previous committed measurement. It fails if a time
grew, or a speed fell, by more than a tenth. Times are compared as multiples of a yardstick: the time of a fixed piece
of work before and after a run. `page` writes benchmarks/results/README.md, and all figures of the documentation that
come from results.
"""

import argparse
import math
import os
import platform
import re
import shlex
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
from results import NUMBER, RESULTS, ROOT, Kept, Table, find_tables, list_versions, read_before, read_latest

BENCHMARKS = ROOT / "benchmarks"
SHARED = ("asked", "determined", "mistake_cases", "planted")  # modules that benchmarks share
PAGE = RESULTS / "README.md"
PACKAGES = ("numpy", "scipy", "numba", "torch", "open3d", "trimesh", "faiss-cpu")
WORSE = 0.1  # share by which a time may grow
CHANGED = 0.1  # share by which a figure may change without a mark
TIME = re.compile(r"(?<!/)\b(m?s|seconds|milliseconds)\b")
RATE = re.compile(r"/s\b")
RATIO = re.compile(r"^x \w")  # ratio to another row of the same run


@dataclass(frozen=True)
class Change:
    """A figure `before` and `now`. Times and speeds are relative to the yardstick.

    `wanted` is 1 if the figure should grow (a speed), -1 if it should fall (a time), and otherwise 0.
    """

    where: str
    before: float
    now: float
    wanted: int

    @property
    def ratio(self) -> float:
        """The present figure, divided by the previous figure."""
        return self.now / self.before if self.before else (1.0 if self.now == 0 else math.inf)

    @property
    def is_worse(self) -> bool:
        """Whether a time grew, or a speed fell, by more than `WORSE`."""
        return self.wanted * math.log(max(self.ratio, 1e-9)) < -math.log(1 + WORSE)


def find_changes(before: Kept, now: Kept) -> list[Change]:
    """Return the changes of all figures that both runs have in the same column, and in a row with the same words.

    Times and speeds are left out if a yardstick is unknown.
    """
    earlier = {key: value for table in before.tables for key, value in _read_figures(table).items()}
    yardsticks = (before.yardstick_ms, now.yardstick_ms)
    changes = []
    for key, value in (item for table in now.tables for item in _read_figures(table).items()):
        row, column, _ = key
        power = 1 if RATE.search(column) else -1 if TIME.search(column) else 0  # exponent of the yardstick
        if key in earlier and (all(yardsticks) or not power):
            old, new = ((y or 1.0) ** power for y in yardsticks)
            wanted = 1 if RATIO.search(column) else power
            changes.append(Change(f"{now.name}: {row}, {column}", old * earlier[key], new * value, wanted))
    return changes


def _read_figures(table: Table) -> dict[tuple[str, str, int], float]:
    """Return the numbers of a table. A number's key is the words of its row, its column, and its index in the cell."""
    found: dict[tuple[str, str, int], float] = {}
    rows = (", ".join(cell for cell in cells if cell and not NUMBER.match(cell)) for cells in table.filled)
    columns = _number_repeats(table.columns)
    for row, cells in zip(_number_repeats(rows), table.filled, strict=True):
        for column, cell in zip(columns, cells, strict=True):
            numbers = NUMBER.findall(cell) if NUMBER.match(cell) else []
            found |= {(row, column, place): float(number) for place, number in enumerate(numbers)}
    return found


def _number_repeats(words: Iterable[str]) -> list[str]:
    """Return the words. Each repetition of a word gets a number."""
    seen, found = Counter[str](), []
    for word in words:
        seen[word] += 1
        found.append(f"{word} {seen[word]}" if seen[word] > 1 else word)
    return found


def measure_yardstick_ms() -> float:
    """Return the median of 9 times, in ms, of a fixed piece of work: Python loops, sorting, products of matrices."""
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


def describe_machine(threads: Mapping[str, str] = os.environ) -> dict[str, Any]:
    """Return the properties of this machine, and the limits of threads in the environment variables `threads`."""
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
    """Run a benchmark, show its output, and keep its tables. The default name of the `run` is the benchmark's name.

    Without arguments, the arguments of the last time are repeated. Raises SystemExit if the benchmark fails, or the
    last arguments name files of a user.
    """
    if not (script := BENCHMARKS / f"{name}.py").exists():
        raise SystemExit(f"bench: there is no benchmark {name}; there are {', '.join(list_benchmarks())}")
    before = read_latest(folder).get(run or name)
    arguments = arguments or (before.arguments if before else [])
    if any(given.startswith(("FILE", "FOLDER")) for given in arguments):
        raise SystemExit(f"bench: {run or name} was measured with your own files; name them: {' '.join(arguments)}")
    if before and before.arguments != arguments:
        print(f"bench: the arguments differ from those of the last {before.name}: {' '.join(before.arguments)}")
    first, start = measure_yardstick_ms(), time.perf_counter()
    environment = {**(_read_threads(before) if before else {}), **os.environ}
    found = find_tables(_run_benchmark(script, arguments, environment))
    if not found:
        raise SystemExit(f"bench: {name} printed no table; nothing is kept")
    known = {(one.metadata["Name"] or "").lower(): one.version for one in metadata.distributions()}
    kept = Kept(
        name, [given.rpartition("/")[2] for given in arguments],
        metadata.version("tactile-loc"), f"{datetime.now(UTC):%Y-%m-%d}", round(time.perf_counter() - start, 1),
        round((first + measure_yardstick_ms()) / 2, 2), describe_machine(environment),
        {package: known[package] for package in PACKAGES if package in known}, found, run or name,
    )  # fmt: skip
    print(f"bench: kept in {kept.write(folder)}")
    return kept


def _read_threads(kept: Kept) -> dict[str, str]:
    """Return the limits of threads of a run, as environment variables."""
    return {name: kept.machine[name] for name in sorted(kept.machine) if name.isupper()}


def _run_benchmark(script: Path, arguments: list[str], environment: dict[str, str]) -> str:
    """Run a benchmark, and show and return its output. Raises SystemExit if it fails."""
    words, lines = [sys.executable, str(script), *arguments], []
    environment = {**environment, "COLUMNS": "200"}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment) as process:
        for line in process.stdout or []:
            print(line, end="", flush=True)
            lines.append(line)
    if process.returncode:
        raise SystemExit(f"bench: {script.stem} failed with exit code {process.returncode}; nothing is kept")
    return "".join(lines)


def list_benchmarks() -> list[str]:
    """Return the names of all benchmarks."""
    return sorted(path.stem for path in BENCHMARKS.glob("*.py") if path.stem not in SHARED)


def compare(folder: Path = RESULTS) -> int:
    """Print the ratio of every figure of the newest version to its value before. Return 1 if a figure is worse."""
    known = list_versions(folder)
    if not known:
        print("bench: nothing is kept yet")
        return 0
    worse = compared = 0
    for path in sorted((folder / known[-1]).glob("*.json")):
        now = Kept.read(path)
        if (before := read_before(now, folder)) is None:
            print(f"{now.name}: measured once, {now.measurement}")
            continue
        changes = find_changes(before, now)
        print(f"{now.name}: {len(changes)} figures, {before.measurement} -> {now.measurement}")
        for change in changes:
            print(_format_change(change))
        worse, compared = worse + sum(change.is_worse for change in changes), compared + len(changes)
    print(f"bench: {compared} figures of {known[-1]} are compared; {worse} are worse by more than {WORSE:.0%}")
    return 1 if worse else 0


def _format_change(change: Change) -> str:
    mark = "WORSE" if change.is_worse else "other" if abs(change.ratio - 1) > CHANGED else ""
    return f"{mark:5}  {change.where}: {change.before:.4g} -> {change.now:.4g} ({change.ratio:.2f} times)"


def format_page(folder: Path = RESULTS) -> str:
    """Return the text of benchmarks/results/README.md: all runs with their tables."""
    parts = [
        "# Results over time\n",
        "The first table lists every run of the benchmarks, with its command and date. All tables follow below.\n"
        "[Benchmarks](../../docs/benchmarks.md) explains them. Where the last column names a page, the tables were\n"
        "copied from this page.\n",
        "This folder contains a file for each run and version. The yardstick is the time that a fixed piece\n"
        "of work takes, measured before and after the run. To compare machines, times are divided by the yardstick.\n"
        "`make bench-compare` prints the ratio of every figure to its value in the previous version. A run that only\n"
        "one version has is compared with its previous committed measurement. The command fails if a time has grown,\n"
        "or a speed has fallen, by more than a tenth.\n",
    ]
    runs = read_latest(folder)
    rows = []
    for name, kept in runs.items():
        source = kept.source.partition(",")[0]
        rows.append([name, f"`{format_command(kept)}`", kept.version, kept.date, str(kept.yardstick_ms or source)])
    parts.append(Table(["run", "command", "version", "date", "yardstick, ms, or source"], rows).markdown())
    for name, kept in runs.items():
        if kept.tables:
            machine = f", {kept.machine['processor']}, {kept.machine['cores']} cores" if kept.yardstick_ms else ""
            parts.append(f"## {name}\n\n`{format_command(kept)}`\n\n{kept.version}, {kept.date}{machine}.\n")
            parts += [table.markdown() for table in kept.tables]
    return "\n".join(parts)


def format_command(kept: Kept) -> str:
    """Return the command of a run."""
    is_ours = (BENCHMARKS / f"{kept.benchmark}.py").exists()
    threads = [f"{name}={value}" for name, value in _read_threads(kept).items()]
    program = f"python benchmarks/{kept.benchmark}.py" if is_ours else kept.benchmark
    return " ".join([*threads, program, shlex.join(kept.arguments)]).strip()


def keep_all() -> int:
    """Repeat every kept run, and run every other benchmark. Return the number of failures."""
    known, failed = list_benchmarks(), 0
    runs = {name: kept.benchmark for name, kept in read_latest().items() if kept.benchmark in known}
    for run, name in [*runs.items(), *((name, name) for name in known if name not in runs.values())]:
        try:
            keep(name, [], run=run)
        except SystemExit as error:
            print(error)
            failed += 1
    return failed


def main() -> int:
    """Run the chosen command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    kept = commands.add_parser("keep", help="run a benchmark and keep its tables")
    kept.add_argument("--as", dest="run", default="", help="name of the run; by default the benchmark's")
    kept.add_argument("--all", action="store_true", help="every kept run, and every other benchmark")
    kept.add_argument("name", nargs="?")
    kept.add_argument("arguments", nargs=argparse.REMAINDER)
    commands.add_parser("compare", help="print the ratio of every figure to its value before")
    commands.add_parser("page", help="write the page of all results, and the documentation's figures")
    bound = commands.add_parser("bind", help="confirm the sentences of the documentation about a run")
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
        benchmark = read_latest()[chosen.name].benchmark if chosen.name in read_latest() else chosen.name
        keep(benchmark, chosen.arguments, run=chosen.run or chosen.name)
    elif chosen.command == "keep":
        parser.error(f"name a benchmark, or add --all; there are {', '.join(list_benchmarks())}")
    PAGE.write_text(format_page(), encoding="utf-8")
    for path in figures.renew_pages():
        print(f"bench: wrote {path}")
    for problem in figures.find_problems():
        print(f"bench: {problem}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
