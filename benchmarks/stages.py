#!/usr/bin/env python3
"""How long each stage of locating takes: by object, number of touches, and number of threads.

Touches of the whole object come from any direction, and are drawn by ray casting. Each number of threads has a process
of its own. Before the timed examples, two other examples are located, so that everything is loaded and built. The table
has medians in ms of all examples: matching, coarse registration, refinement, the choice of hypotheses, and the whole
call; and the 95 % quantile of the whole call. A first pose is right if its pose error is at most 1 mm,
*listed* is the share with such a pose among the listed ones, and *shape* is the share with a shape distance of at most
1 mm.

*misplaced* examples have one sensor pose that is 5 mm and 10 degrees off. So no pose explains all of their touches.

With `--before FOLDER`, processes with the older `tactile_loc` in that folder locate the same touches, in turn with the
present one. With `--processor`, all times are processor times, which other programs hardly change.

Meshes are given as FILE[:UNITS] or a demo object's name.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
from asked import make_parser, make_source, name_asked, open_asked, write_head

from tactile_loc import Localizer, StageStore, TactileLocError, Touch, localize_together
from tactile_loc.core.poses.pose_errors import RIGHT_M, measure_pose_errors
from tactile_loc.core.poses.tolerance import measure_shape_distances
from tactile_loc.plugin.helpers import make_transform, rotation_about

MS = 1e3
KINDS = ("clean", "misplaced")
SHARES = ("right", "listed", "shape")
STAGES = ("match", "register", "refine", "choose")
LOADING = 2  # examples located before the timed ones
OFF_M, OFF_RAD = 5e-3, np.radians(10.0)  # error of a misplaced sensor
Row = dict[str, float | int | str]


def misplace(touches: list[Touch]) -> list[Touch]:
    """Return touches of which the last has a wrong sensor pose."""
    wrong = make_transform(rotation_about([0.0, 0.0, 1.0], OFF_RAD), np.array([OFF_M, 0.0, 0.0]))
    last = dataclasses.replace(touches[-1], T_base_sensor=np.asarray(touches[-1].T_base_sensor) @ wrong)
    return [*touches[:-1], last]


def measure(mesh: str, arguments: argparse.Namespace, store: StageStore) -> Iterator[Row]:
    """Yield a row for each number of touches of one object, in this process's threads."""
    localizer = open_asked(mesh, sensor=arguments.sensor, store=store)
    source = make_source(localizer.object, localizer.scene.geometry)
    examples = [
        source.draw_example(max(arguments.touches), np.random.default_rng([arguments.seed, number]))[0]
        for number in range(arguments.examples + LOADING)
    ]
    for count in arguments.touches:
        for kind in KINDS if count > 1 and not arguments.clean else KINDS[:1]:
            rows = [time_example(localizer, misplace(ts[:count]) if kind == "misplaced" else ts[:count])
                    for ts in examples][LOADING:]  # fmt: skip
            middle = {name: float(np.median([row[name] for row in rows])) for name in (*STAGES, "all")}
            last = float(np.quantile([row["all"] for row in rows], 0.95))
            shares = {name: float(np.mean([row[name] for row in rows])) for name in SHARES}
            yield {"object": name_asked(mesh), "touches": count, "kind": kind, **middle, "last": last, **shares}


def time_example(localizer: Localizer, touches: list[Touch]) -> dict[str, float]:
    """Return the ms of each stage and of the whole call, and whether SHARES of the poses are within 1 mm."""
    start = time.perf_counter()
    try:
        found = localize_together([(localizer, touch) for touch in touches])
    except TactileLocError:
        spent = {"all": MS * (time.perf_counter() - start)}
        return dict.fromkeys(STAGES, np.nan) | spent | dict.fromkeys(SHARES, False)
    spent = {"all": MS * (time.perf_counter() - start)}
    poses, truth = np.stack([one.T_sensor_object for one in found.hypotheses]), np.asarray(touches[0].T_sensor_object)
    right = measure_pose_errors(localizer.object, poses, truth) <= RIGHT_M
    shape = bool(measure_shape_distances(localizer.object.mesh, poses[:1], truth)[0] <= RIGHT_M)
    shares = dict(zip(SHARES, (bool(right[0]), bool(right.any()), shape), strict=True))
    return {name: MS * found.seconds.get(name, 0.0) for name in STAGES} | spent | shares


def main() -> None:
    """Measure, and print a table."""
    parser = make_parser(__doc__, ["pin", "hook"])
    parser.add_argument("--sensor", default="gelslim")
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 3, 5])
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--examples", type=int, default=30)
    parser.add_argument("--seed", type=int, default=35)
    parser.add_argument("--clean", action="store_true", help="no misplaced examples")
    parser.add_argument("--before", type=Path, help="folder of an older tactile_loc")
    parser.add_argument("--processor", action="store_true", help="measure processor times")
    for hidden in ("--only", "--store"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.only:  # this is a process with its own number of threads
        if arguments.processor:
            time.perf_counter = time.process_time  # also for the times that a result states
        for row in measure(arguments.only, arguments, StageStore(arguments.store)):
            print(json.dumps(row), flush=True)
        return
    timed = [f"{name}, ms" for name in (*STAGES, "all", "95 %")]
    codes = {"now": None, "before": arguments.before} if arguments.before else {"": None}
    print(write_head("object", "touches", "kind", *(["code"] if arguments.before else []), "threads", *timed, *SHARES))
    with tempfile.TemporaryDirectory() as folder:
        for threads, mesh, (label, older) in product(arguments.threads, arguments.objects, codes.items()):
            environment = os.environ | {"NUMBA_NUM_THREADS": str(threads), "OMP_NUM_THREADS": "1"}
            environment |= {} if older is None else {"PYTHONPATH": str(older.absolute())}
            command = [sys.executable, *sys.argv, "--only", mesh, "--store", str(Path(folder) / label)]
            process = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
            for row in map(json.loads, process.stdout.splitlines()):
                about = [row["object"], row["touches"], row["kind"], *filter(None, [label]), threads]
                times = [f"{row[name]:.1f}" for name in (*STAGES, "all", "last")]
                shares = [f"{row[name]:.0%}" for name in SHARES]
                print(f"| {' | '.join(map(str, [*about, *times, *shares]))} |", flush=True)


if __name__ == "__main__":
    main()
