#!/usr/bin/env python3
"""A sweep on local processes and on a Dask cluster of this machine, with and without killing a worker.

The plan has two renderers, three encoders, four refiners and three demo objects. The grid is coarse, and pixels and
touches are few, because the benchmark tests the sweep, not the results. `--small` uses two encoders, two refiners, one
renderer and one object. The benchmark counts rows, failures and builds of each stage, and compares all tables. It
prints these numbers, and writes them to `--out`/counts.json. The exit code is 1 if anything is lost, differs or was
built twice.
"""

import argparse
import json
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from tactile_loc import Plan, StageStore, write_sweep
from tactile_loc.evaluation.jobs import Workers
from tactile_loc.evaluation.sweep.combination import combine
from tactile_loc.evaluation.sweep.sweep import MOMENTARY, Sweep, run_sweep
from tactile_loc.evaluation.workers import DaskWorkers, LocalWorkers

SENSOR = 'camera = "orthographic"\nimage_size_px = [80, 80]\nmax_depth_mm = 2.0\nmm_per_px = 0.35\n'
MOCO = {"name": "moco", "epochs": 1, "queries": 32, "batch": 32, "channels": 4}
FACTORS = {
    "object": ["pin", "head", "damping_pin"],
    "renderer": ["zbuffer", "pyrender"],
    "encoder": [MOCO, {"name": "pixel", "cells": 12}, {"name": "pixel", "cells": 20}],
    "refiner": ["filterreg", "kiss-icp", "render", "none"],
}
SMALL = {"object": 1, "renderer": 1, "encoder": 2, "refiner": 2}
QUIET = {"dashboard_address": "127.0.0.1:0", "scheduler_kwargs": {"dashboard": False}}
WAYS = ("local", "local-killed", "dask", "dask-killed")
KILL_AFTER = 0.25  # share of the rows


def make_plan(arguments: argparse.Namespace) -> Plan:
    """Return the plan of 3 x 2 x 3 x 4 combinations, or of 1 x 1 x 2 x 2."""
    sensor = arguments.out / "sensor.toml"
    sensor.write_text(SENSOR)
    return Plan.from_values({
        **{name: values[: SMALL[name]] if arguments.small else values for name, values in FACTORS.items()},
        "sensor": str(sensor), "count": arguments.count,
        "option": {"grid": {"spacing_mm": arguments.spacing_mm}}, "shape_px": 32, "temperature": 0.01,
    })  # fmt: skip


@contextmanager
def kill_at_random(rows: Path, after: int, victims: Callable[[], list[int]]) -> Iterator[list[int]]:
    """Kill a process of `victims` when the folder `rows` has `after` rows. Yield a list for the killed process."""
    killed: list[int] = []
    over = threading.Event()

    def wait() -> None:
        while not over.wait(0.02):
            if len(list(rows.glob("*.json"))) >= after and (pids := victims()):
                os.kill(pids[0], signal.SIGKILL)
                killed.append(pids[0])
                return

    thread = threading.Thread(target=wait)
    thread.start()
    try:
        yield killed
    finally:
        over.set()
        thread.join()


def list_local_workers() -> list[int]:
    """Return the process identifiers of this process's local workers."""
    children = psutil.Process().children()
    return [child.pid for child in children if any("multiprocessing.spawn" in word for word in child.cmdline())]


def measure(name: str, arguments: argparse.Namespace, workers: Workers, victims: Callable[[], list[int]] | None) -> Any:
    """Run the sweep with a new folder and store, and return its table and its counts."""
    out, store = arguments.out / name, arguments.out / f"store-{name}"
    plan = make_plan(arguments)
    after = int(KILL_AFTER * len(combine(plan)[0]))
    start_s = time.perf_counter()
    with kill_at_random(out / "rows", after, victims or list) as killed:
        swept = run_sweep(plan, out, store, workers)
    seconds = time.perf_counter() - start_s
    write_sweep(out, swept, "chosen")
    return drop_momentary(swept), {
        "name": name,
        "seconds": round(seconds, 1),
        "killed": len(killed),
        **count_rows(swept, store),
    }


def count_rows(swept: Sweep, store: Path) -> dict[str, Any]:
    """Return the numbers of rows and failures, and the numbers of builds of stages."""
    built = Counter(name for row in swept.rows for name in json.loads(row["built"]))
    stored = {f"{entry.stage} {entry.digest}" for entry in StageStore(store).entries()}
    return {
        "rows": len(swept.rows), "failed": swept.failed, "built": swept.built,
        "most_builds_of_one": max(built.values()),
        "stored_but_in_no_row": len(stored - set(built)), "in_a_row_but_not_stored": len(set(built) - stored),
    }  # fmt: skip


def drop_momentary(swept: Sweep) -> list[dict[str, Any]]:
    """Return the table without columns that depend on the machine or the time."""
    return [{name: value for name, value in row.items() if name not in MOMENTARY} for row in swept.rows]


@contextmanager
def make_workers(way: str, arguments: argparse.Namespace) -> Iterator[tuple[Workers, Callable[[], list[int]]]]:
    """Yield workers for one of the `WAYS`, and a function that finds the workers' processes."""
    from distributed import LocalCluster

    if way.startswith("local"):
        yield LocalWorkers(arguments.workers, 1, arguments.out / "workers.log"), list_local_workers
        return
    with LocalCluster(n_workers=arguments.workers, processes=True, threads_per_worker=1, **QUIET) as cluster:
        yield DaskWorkers(cluster.scheduler_address), lambda: [nanny.pid for nanny in cluster.workers.values()]


def run_all(arguments: argparse.Namespace) -> Iterator[tuple[list[dict[str, Any]], dict[str, Any]]]:
    """Run the sweep in all requested ways."""
    for way in arguments.ways:
        with make_workers(way, arguments) as (workers, victims):
            yield measure(way, arguments, workers, victims if way.endswith("-killed") else None)


def is_whole(found: dict[str, Any], table: list[dict[str, Any]], first: list[dict[str, Any]]) -> bool:
    """Return whether nothing was lost, built twice, or different."""
    lost = found["failed"] + found["stored_but_in_no_row"] + found["in_a_row_but_not_stored"]
    return not lost and found["most_builds_of_one"] == 1 and table == first


def main() -> int:
    """Run, print and write the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/sweep"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--count", type=int, default=2, help="touches of each combination")
    parser.add_argument("--spacing-mm", type=float, default=8.0)
    parser.add_argument("--small", action="store_true", help="two encoders, two refiners, one renderer and one object")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS, help="ways to run; by default all")
    arguments = parser.parse_args()
    arguments.out = arguments.out.absolute()
    arguments.out.mkdir(parents=True, exist_ok=True)
    found, first = [], None
    for table, count in run_all(arguments):
        first = table if first is None else first
        found.append({**count, "same_table": table == first, "whole": is_whole(count, table, first)})
        print(json.dumps(found[-1]), flush=True)
    (arguments.out / "counts.json").write_text(json.dumps(found, indent=1) + "\n")
    return 0 if all(one["whole"] for one in found) else 1


if __name__ == "__main__":
    sys.exit(main())
