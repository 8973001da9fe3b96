#!/usr/bin/env python3
"""How well objects are located from pressed touches out of any direction, by the number of touches.

Each example is an object at rest that sensors press from random directions, by 30 to 90 % of their deepest press; every
contact of at least 0.25 % of the sensor counts, edges and corners too. The touches are drawn by ray casting, which the
localizer does not use. All rotations are searched. For every number of touches: the share of examples within 0.5 and
1 mm (root mean square over the surface, symmetry regarded), the median, how often any hypothesis was that near (the
search found it, the choice did not), presses that showed no touch, examples that ended in an error, and the time.

`--clean`, `--strong` and `--misplaced` choose what the touches suffer from; by default all three. `--fingers` presses
objects between two opposed sensors instead, and reports z. Meshes are given as FILE[:UNITS] or a demo object's name.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.errors import TactileLocError
from tactile_loc.core.noise import NOISE, TouchNoise
from tactile_loc.core.poses import PoseMetric
from tactile_loc.core.registry import registry
from tactile_loc.core.sensing import Touch
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.io.meshes import load_object
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.store.store import StageStore

WITHIN_MM = (0.5, 1.0)
LEVELS: dict[str, dict[str, Any]] = {
    "clean": {},
    "strong": {"noise": TouchNoise(**{**NOISE["strong"].__dict__, "press_share": (1.0, 1.0)})},
    "misplaced": {"sensor_std_m": 0.5e-3, "sensor_std_rad": np.radians(0.5)},
}


def errors_mm(localizer: Localizer, touches: list[Touch]) -> tuple[float, float, float]:
    """The chosen pose's error, the least of all hypotheses', and the chosen one's along the sensor's z, all in mm."""
    found = localize_together([(localizer, touch) for touch in touches])
    truth = np.asarray(touches[0].T_sensor_object)
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    errors = 1e3 * PoseMetric(localizer.object).symmetric_distance(poses, np.broadcast_to(truth, poses.shape))
    centre = localizer.object.mesh.centroid_m
    z_mm = 1e3 * abs((poses[0] - truth)[2] @ [*centre, 1.0])
    return float(errors[0]), float(errors.min()), float(z_mm)


def examples(arguments: argparse.Namespace, touches: RobotTouches) -> Iterator[tuple[list[Touch], int]]:
    """The same examples for every level: their randomness is their number's."""
    for number in range(arguments.examples):
        rng = np.random.default_rng([arguments.seed, number])
        if arguments.fingers:
            for press_mm in arguments.press_mm:
                yield touches.opposed(rng, press_mm * 1e-3), 0
        else:
            yield touches.example(max(arguments.touches), rng)


def measure(localizer: Localizer, arguments: argparse.Namespace, level: str) -> list[dict[str, Any]]:
    """Return a row for each number of touches of one object and sensor."""
    geometry = localizer.scene.geometry
    raycast = registry().create("renderer", "raycast", {})
    source = RobotTouches(localizer.object, geometry, raycast, **LEVELS[level])
    counts = [2] if arguments.fingers else sorted(arguments.touches)
    found: dict[int, list[tuple[float, float, float]]] = {n: [] for n in counts}
    seconds: dict[int, list[float]] = {n: [] for n in counts}
    failed, refused = dict.fromkeys(counts, 0), 0
    for touches, unusable in examples(arguments, source):
        refused += unusable
        for n in counts:
            start = time.perf_counter()
            try:
                found[n].append(errors_mm(localizer, touches[:n]))
            except TactileLocError as error:
                failed[n] += 1
                found[n].append((np.inf, np.inf, np.inf))
                print(f"  {n} touches: {error}", flush=True)
            seconds[n].append(time.perf_counter() - start)
    rows = []
    for n in counts:
        chosen, best, z_mm = np.array(found[n]).T
        rows.append({
            "object": localizer.object.name, "sensor": localizer.config.sensor.name, "level": level, "touches": n,
            "examples": len(chosen), "within": {f"{mm:g} mm": float((chosen < mm).mean()) for mm in WITHIN_MM},
            "among_hypotheses": {f"{mm:g} mm": float((best < mm).mean()) for mm in WITHIN_MM},
            "median_mm": float(np.median(chosen)), "z_median_mm": float(np.median(z_mm)),
            "z_worst_mm": float(z_mm.max()), "refused": refused, "failed": failed[n],
            "median_s": float(np.median(seconds[n])), "poses": localizer.model.size,
        })  # fmt: skip
    return rows


def main() -> None:
    """Measure, print a table, and write the rows as JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", default=list(DEMO_OBJECTS))
    parser.add_argument("--sensors", nargs="+", default=["gelslim", "gelsight-mini"])
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 2, 3, 5])
    parser.add_argument("--examples", type=int, default=40)
    parser.add_argument("--spacing-mm", type=float, default=6.0)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--together", default="joint", choices=["joint", "each"])
    parser.add_argument("--fingers", action="store_true")
    parser.add_argument("--press-mm", nargs="+", type=float, default=[0.5, 1.0, 2.0])
    parser.add_argument("--out", type=Path)
    for level in LEVELS:
        parser.add_argument(f"--{level}", dest="levels", action="append_const", const=level)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    head = f"{'object':14s} {'sensor':14s} {'level':10s} touches  <0.5 mm  <1 mm  median  any<0.5  refused failed   s"
    print(head + ("   z median, worst" if arguments.fingers else ""), flush=True)
    for mesh in arguments.meshes:
        path, _, units = mesh.partition(":")
        obj = load_object(path, units or "auto")
        for sensor in arguments.sensors:
            with tempfile.TemporaryDirectory() as store:
                localizer = Localizer.create(
                    path, units=units or "auto", store=StageStore(Path(store)), sensor=sensor,
                    together=arguments.together,
                    grid={"name": "hopf", "spacing_mm": arguments.spacing_mm, "min_contact_percent": 0.25},
                )  # fmt: skip
                for level in arguments.levels or LEVELS:
                    for row in measure(localizer, arguments, level):
                        rows.append(row)
                        near, far = row["within"].values()
                        print(
                            f"{obj.name:14s} {sensor:14s} {level:10s} {row['touches']:7d} {near:8.0%} {far:6.0%} "
                            f"{row['median_mm']:7.3f} {row['among_hypotheses']['0.5 mm']:8.0%} {row['refused']:8d} "
                            f"{row['failed']:6d} {row['median_s']:.2f}"
                            + (f"   {row['z_median_mm']:.3f}, {row['z_worst_mm']:.3f}" if arguments.fingers else ""),
                            flush=True,
                        )
                        if arguments.out:
                            arguments.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
