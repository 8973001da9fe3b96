#!/usr/bin/env python3
"""The time from the start of a process to its first result, and the size of stored objects.

Each row of the first table is a process that runs `--runs` times, with medians of its time and of its processor time.
The first `tactile-loc run`, with an empty store and nothing compiled, runs once. Further first runs of each object have
compiled code, and an empty store each. The second table has the size of each object in the store, and the time to build
its places and to open them. All folders are temporary.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median

from asked import open_asked, split_asked

from tactile_loc import DEMO_OBJECTS, Localizer, StageStore, write_touch
from tactile_loc.locate.sources.stored_places import build_places
from tactile_loc.plugin import Progress

LOCATE = "import sys\nfrom tactile_loc import Localizer\nlocalizer = Localizer.create(sys.argv[1])\n"
LOCATE += "localizer.localize(localizer.read_touch(sys.argv[2]))\n"
CLI = "from tactile_loc_cli.main import main\nmain()\n"
OPENED = 5  # times that the places of an object are opened


def main() -> None:
    """Measure, and print two tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("objects", nargs="*", default=list(DEMO_OBJECTS), help="demo objects or meshes, FILE[:UNITS]")
    parser.add_argument("--runs", type=int, default=11, help="runs of each process")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("| process | median, s | processor time, s | runs |\n|---|---|---|---|")
        for row in time_processes(folder, arguments.objects, arguments.runs):
            print(row, flush=True)
        print("\n| object | places | in the store, MB | build places, s | open places, ms |\n|---|---|---|---|---|")
        for path in arguments.objects:
            print(measure_object(path, folder / "objects" / Path(path).stem), flush=True)


def time_processes(folder: Path, objects: Sequence[str], runs: int) -> Iterator[str]:
    """Yield the rows of the first table."""
    caches = {"XDG_CACHE_HOME": str(folder / "cache"), "NUMBA_CACHE_DIR": str(folder / "compiled")}
    # bytecode is kept, as after an installation
    caches |= {"PYTHONPYCACHEPREFIX": str(folder / "bytecode"), "PYTHONDONTWRITEBYTECODE": ""}
    environment = {**os.environ, **caches, "TACTILE_LOC_STORE": str(folder / "store")}
    run = [sys.executable, "-c", CLI, "run", "--out", str(folder / "out")]
    yield format_times("first `tactile-loc run`", [time_process(run, environment)])
    for asked in objects:
        path, units = split_asked(asked)
        words = [*run, "--object", path, "--units", units, "--store"]
        times = [time_process([*words, str(folder / f"{Path(path).stem}-{k}")], environment) for k in range(runs)]
        yield format_times(f"first `tactile-loc run` of the {Path(path).stem}, compiled", times)
    yield format_times("`tactile-loc run` again", [time_process(run, environment) for _ in range(runs)])
    simulating = Localizer.create("hook", store=folder / "store")
    touch = write_touch(folder / "touch.npz", simulating.simulate(seed=3)[0])
    locate = [sys.executable, "-c", LOCATE, "hook", str(touch)]
    time_process(locate, environment)
    yield format_times("first pose of the stored hook", [time_process(locate, environment) for _ in range(runs)])
    library = [sys.executable, "-c", "import tactile_loc"]
    yield format_times("`import tactile_loc`", [time_process(library, environment) for _ in range(runs)])


def time_process(words: list[str], environment: Mapping[str, str]) -> tuple[float, float]:
    """Run a process and return its time and its processor time, seconds. Raises SystemExit if it fails."""
    start = time.perf_counter()
    process = subprocess.Popen(words, env=dict(environment), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    with process.stderr or open(os.devnull, "rb") as errors:
        said = errors.read()
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"startup: {' '.join(words)} failed: {said.decode()}")
    return seconds, usage.ru_utime + usage.ru_stime


def format_times(what: str, times: list[tuple[float, float]]) -> str:
    """Return a row of the first table from the times and processor times of its runs."""
    whole, processor = (median(column) for column in zip(*times, strict=True))
    return f"| {what} | {whole:.2f} | {processor:.2f} | {len(times)} |"


def measure_object(path: str, folder: Path) -> str:
    """Return the row of an object in the second table. Its store is a new folder."""
    localizer = open_asked(path, store=folder)
    start = time.perf_counter()
    places, _ = build_places(localizer.sampler, localizer.scene, localizer.store, Progress())
    build_s = time.perf_counter() - start
    opened_ms = []
    for _ in range(OPENED):
        store, start = StageStore(folder), time.perf_counter()  # a new store verifies all checksums
        build_places(localizer.sampler, localizer.scene, store, Progress())
        opened_ms.append(1e3 * (time.perf_counter() - start))
    size = sum(entry.nbytes for entry in localizer.store.entries())
    return f"| {localizer.object.name} | {len(places)} | {1e-6 * size:.1f} | {build_s:.1f} | {median(opened_ms):.0f} |"


if __name__ == "__main__":
    main()
