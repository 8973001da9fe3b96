#!/usr/bin/env python3
"""Errors and times of locating real objects from one clean touch, with the default components.

For each mesh, one face has a grid of about `--poses` poses, and `--touches` touches have random poses between the grid
poses. Errors are ADD over 10 000 surface points, modulo symmetry, in mm and divided by a random pose's mean error.
Meshes are given as FILE[:UNITS]; the default is all demo objects. Times are medians on this machine, in one run.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from asked import load_asked, make_parser
from tactile_loc_benchmark.suite import read_split

from tactile_loc import ExampleTable, Localizer, ObjectModel, RunConfig, StageStore
from tactile_loc.evaluation.protocol import STAGES, evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.summary import find_scale_m, summarise_lines

LINES = ("closest", "random", "best-1", "best-10", "reg-1", "chosen")


def choose_spacing(obj: ObjectModel, base: dict, poses: int) -> float:  # type: ignore[type-arg]
    """Return the grid spacing, mm, that gives about `poses` poses, because spacing^3 sets their number."""
    spacing_mm = 4.0
    for _ in range(2):
        config = RunConfig.from_dict({**base, "grid": {"name": "face", "spacing_mm": spacing_mm}})
        with tempfile.TemporaryDirectory() as store:
            spacing_mm *= (len(Localizer(config, obj, StageStore(Path(store))).model.grid) / poses) ** (1 / 3)
    return round(spacing_mm, 2)


def measure(obj: ObjectModel, arguments: argparse.Namespace) -> dict[str, object]:
    """Build one object's model in an empty store, locate its touches, and return a row of the table."""
    base = {"sensor": arguments.sensor, "refiner": arguments.refiner}
    spacing_mm = choose_spacing(obj, base, arguments.poses)
    config = RunConfig.from_dict({**base, "grid": {"name": "face", "spacing_mm": spacing_mm}})
    with tempfile.TemporaryDirectory() as store:
        localizer = Localizer(config, obj, StageStore(Path(store)))
        start = time.perf_counter()
        localizer.listed.matcher(localizer.scene.geometry.max_depth_m)
        build_s = time.perf_counter() - start
        result = evaluate(localizer, arguments.touches, SimulatedTouches(seed=arguments.seed))
        poses = len(localizer.model.grid)
    return {
        "object": obj.name, "symmetry": str(obj.symmetry), "poses": poses, "spacing_mm": spacing_mm, "build_s": build_s,
        "random_mm": find_scale_m(result) * 1e3, **summarise_errors(result, LINES),
    }  # fmt: skip


def summarise_errors(table: ExampleTable, lines: Sequence[str]) -> dict[str, Any]:
    """Return the medians and means of the errors by line, mm and normalised, and the stages' median times, ms."""
    rows = summarise_lines(table, lines)
    return {
        "median_mm": {row["line"]: row["median_m"] * 1e3 for row in rows},
        "mean_mm": {row["line"]: row["mean_m"] * 1e3 for row in rows},
        "median_normalised": {row["line"]: row["median_normalised"] for row in rows},
        "median_ms": {k: float(np.median(table[f"{k}_s"])) * 1e3 for k in STAGES},
    }


def report(row: dict) -> str:  # type: ignore[type-arg]
    """Return the lines of the table for one object."""
    head = f"{row['object']:<26}{row['poses']:>7} poses {row['spacing_mm']:>5.2f} mm, built in {row['build_s']:.1f} s, "
    times = ", ".join(f"{k} {v:.1f}" for k, v in row["median_ms"].items())
    lines = [f"{head}symmetry {row['symmetry']}; ms: {times}"]
    for name in LINES:
        median, mean, share = (row[k][name] for k in ("median_mm", "mean_mm", "median_normalised"))
        ratio = median / row["median_mm"]["closest"]
        lines.append(
            f"    {name:<8} median {median:7.2f} mm ({share:.3f})   mean {mean:7.2f} mm   {ratio:5.2f} x closest"
        )
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--poses", type=int, default=10_000, help="approximate poses of a grid")
    parser.add_argument("--touches", type=int, default=200)
    parser.add_argument("--sensor", default="gelslim")
    parser.add_argument("--refiner", default="joint")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="also write the rows here")
    arguments = parser.parse_args()
    rows = []
    for mesh in arguments.objects:
        rows.append(measure(load_asked(mesh), arguments))
        print(report(rows[-1]), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
