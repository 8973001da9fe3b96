#!/usr/bin/env python3
"""How often the sets of `--coverage` contain the true pose, and how large they are, for touches outside the model.

Objects are pressed from any direction, by 30 to 90 % of the sensor's deepest press. They are drawn by ray casting, and
the gel's surface is computed by ContactMechanics, neither of which the localizer uses. In the second case, the surface
also has noise to which nothing was fitted (`UnseenNoise` of outside.py).

A set contains the true pose if one of its poses is within 1 mm of it (root mean square over the surface, modulo
symmetry), or if it contains "elsewhere" and no pose found is. For each object, number of touches and case, the table
has the share of sets that contain the true pose, the share with "elsewhere", and the median and 90th percentile of the
number of poses. The last rows have the same for all objects, and for the quarter of all examples with the greatest
entropy. The time of the fit is wall-clock time, and processor time of all threads. An example that ends in an error is
left out. Meshes are given as FILE[:UNITS] or a demo object's name.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_parser, make_source, open_asked
from elastic_gel import SIZES_PX, press_elastic, view_as
from outside import UnseenNoise

from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.evaluation.robot_touches import RobotTouches, measure_noisily
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.locate.probability.conformal import LISTED
from tactile_loc.locate.result.localization import Localization
from tactile_loc.store.store import StageStore

SENSOR = "gelsight-mini"
GEL = Gel(4e-3, 0.48)
CASES: dict[str, TouchNoise | None] = {"clean": None, "unseen noise": UnseenNoise()}
UNCERTAIN = 0.25  # share of the examples with the greatest entropy
Row = dict[str, Any]


def add_noise(touch: Touch, noise: TouchNoise, rng: np.random.Generator) -> Touch:
    """Return a touch with noise."""
    depth_m, press_m = measure_noisily(
        noise, touch.contact_shape.depth_m[None], touch.press_depth_m, touch.geometry, rng
    )
    return dataclasses.replace(touch, contact_shape=ContactShape(depth_m, press_m))


def measure(localizer: Localizer, touches: list[Touch], coverage: float) -> Row:
    """Locate touches with a coverage, and return what the table needs."""
    found = localize_together([(localizer, touch) for touch in touches], coverage=coverage)
    pose_set = found.pose_set
    assert pose_set is not None
    held = right = is_right(localizer, found, pose_set.radius_m)
    if pose_set.elsewhere and not right:
        everything = localize_together([(localizer, touch) for touch in touches], top=LISTED)
        held = not is_right(localizer, everything, pose_set.radius_m)
    return {
        "held": held, "elsewhere": pose_set.elsewhere, "poses": pose_set.poses, "right": right,
        "missed": pose_set.missed,
        "entropy": found.posterior.entropy, "level": pose_set.level,
    }  # fmt: skip


def is_right(localizer: Localizer, found: Localization, radius_m: float) -> bool:
    """Return whether any listed pose is within `radius_m` metres of the true pose."""
    errors_m = found.measure_errors_m(localizer.object)
    return errors_m is not None and bool((errors_m <= radius_m).any())


def measure_object(localizer: Localizer, source: RobotTouches, arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield a row for each example, number of touches and case of one object."""
    gel = localizer.scene.geometry.gel
    for count in arguments.touches:
        for number in range(arguments.examples):
            rng = np.random.default_rng([arguments.seed, count, number])
            drawn = [view_as(press_elastic(t, source, GEL), gel) for t in source.draw_example(count, rng)[0]]
            for case, noise in CASES.items():
                try:
                    touches = drawn if noise is None else [add_noise(touch, noise, rng) for touch in drawn]
                    row = measure(localizer, touches, arguments.coverage)
                except TactileLocError:
                    continue
                yield {"object": localizer.object.name, "touches": count, "case": case, **row}


def fit(localizer: Localizer) -> str:
    """Fit the probabilities, then the sets; return the time of the sets in words."""
    _ = localizer.probabilities.temperature_scaling, localizer.probabilities.fused_scaling
    wall_s, busy_s = time.perf_counter(), time.process_time()
    examples = len(localizer.conformal_sets.scores)
    wall_s, busy_s = time.perf_counter() - wall_s, time.process_time() - busy_s
    return f"{localizer.object.name}: sets fitted to {examples} examples in {wall_s:.0f} s, {busy_s:.0f} s of processor"


def write_row(name: str, touches: object, case: str, rows: list[Row]) -> str:
    """Return a row of the table."""
    held, elsewhere, poses = (np.array([row[key] for row in rows], float) for key in ("held", "elsewhere", "poses"))
    return (
        f"| {name} | {touches} | {case} | {len(rows)} | {held.mean():.0%} | {elsewhere.mean():.0%} | "
        f"{np.median(poses):.0f} | {np.quantile(poses, 0.9):.0f} |"
    )


def summarise(rows: list[Row]) -> Iterator[str]:
    """Yield the rows of all objects, and that of the examples with the greatest entropy."""
    for touches, case in dict.fromkeys((row["touches"], row["case"]) for row in rows):
        alike = [row for row in rows if (row["touches"], row["case"]) == (touches, case)]
        yield write_row("all", touches, case, alike)
    yield write_row("all", "all", "all", rows)
    border = np.quantile([row["entropy"] for row in rows], 1 - UNCERTAIN)
    yield write_row("all", "all", "greatest entropy", [row for row in rows if row["entropy"] >= border])


def main() -> None:
    """Measure, print a table, and write the examples as JSON if requested."""
    parser = make_parser(__doc__, ["damping_pin"])
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 3])
    parser.add_argument("--examples", type=int, default=20)
    parser.add_argument("--coverage", type=float, default=0.95)
    parser.add_argument("--seed", type=int, default=101)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    sensor = {"name": SENSOR, "image_size_px": SIZES_PX[SENSOR]}
    layer = {**sensor, "gel": "layer", "gel_thickness_mm": 1e3 * (GEL.thickness_m or 0), "poisson": GEL.poisson}
    rows: list[Row] = []
    fits: list[str] = []
    print(
        "| object | touches | case | examples | contains the pose | with elsewhere | poses, median | poses, 90 % |\n"
        "|---|---|---|---|---|---|---|---|"
    )
    for mesh in arguments.objects:
        with tempfile.TemporaryDirectory() as folder:
            rigid, elastic = (
                open_asked(mesh, store=StageStore(Path(folder)), sensor=chosen)
                for chosen in ({**sensor, "gel": "rigid"}, layer)
            )
            source = make_source(rigid.object, rigid.scene.geometry)
            fits.append(fit(elastic))
            mine: list[Row] = []
            for row in measure_object(elastic, source, arguments):
                mine.append(row)
                if arguments.out:
                    arguments.out.write_text(json.dumps(rows + mine, indent=1))
            rows += mine
        for touches, case in dict.fromkeys((row["touches"], row["case"]) for row in mine):
            alike = [row for row in mine if (row["touches"], row["case"]) == (touches, case)]
            print(write_row(elastic.object.name, touches, case, alike), flush=True)
    for line in (*summarise(rows), "", *fits):
        print(line)


if __name__ == "__main__":
    main()
