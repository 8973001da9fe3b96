#!/usr/bin/env python3
"""The time and the errors of refining ten hypotheses against three touches together.

Each example is an object at rest that three sensors press from random directions, as in `contacts.py`. A hypothesis is
the true pose, rotated by 8 degrees about a random axis through the centroid and moved by about 2 mm along each axis.
The table has the median time over all examples, and the median error (root mean square over the surface, modulo
symmetry) of the hypothesis that explains each example best. For one thread, set
`NUMBA_NUM_THREADS=1 OMP_NUM_THREADS=1`.
"""

import argparse
import time

import numpy as np
from asked import load_asked, make_parser
from contacts import LEVELS

from tactile_loc import PoseMetric, RobotTouches
from tactile_loc.plugin import Candidate, Scene, View, registry
from tactile_loc.plugin.helpers import invert, make_transform, rotation_about

TURNED_DEG, MOVED_MM = 8.0, 2.0
AGAIN = 5  # repetitions of each measurement


def measure(path: str, arguments: argparse.Namespace) -> str:
    """Return one row of the table."""
    obj = load_asked(path)
    geometry = registry().create("sensor", arguments.sensor, {}).geometry
    scene = Scene(obj, geometry, registry().create("renderer", "zbuffer", {}))
    refiner = registry().create("refiner", "joint", {})
    source, metric = RobotTouches(obj, geometry, scene.renderer, **LEVELS[arguments.level]), PoseMetric(obj)
    ms, errors_mm = [], []
    for number in range(arguments.examples):
        rng = np.random.default_rng([arguments.seed, number])
        touches, _ = source.draw_example(arguments.touches, rng)
        T_base_first = np.asarray(touches[0].T_base_sensor)
        views = [View(t, scene.match_touch(t), invert(np.asarray(t.T_base_sensor)) @ T_base_first) for t in touches]
        truth = np.asarray(touches[0].T_sensor_object)
        candidates = [
            Candidate(move_near(truth, obj.mesh.centroid_m, rng), 0, 0.0) for _ in range(arguments.hypotheses)
        ]
        for again in range(AGAIN + (number == 0)):
            start = time.perf_counter()
            refined = refiner.refine_together(views, candidates)
            if again or number:  # after compiling and preparing the mesh
                ms.append(1e3 * (time.perf_counter() - start))
        best = max(refined, key=lambda found: found.contact_iou)
        errors_mm.append(1e3 * metric.symmetric_distance(best.T_sensor_object[None], truth[None])[0])
    return f"| {obj.name} | {len(obj.mesh.faces)} | {np.median(ms):.0f} | {np.median(errors_mm):.3f} |"


def move_near(T: np.ndarray, centroid_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the pose (4, 4), rotated about the centroid and moved."""
    R = rotation_about(rng.normal(size=3), np.radians(TURNED_DEG))
    middle = T[:3, :3] @ centroid_m + T[:3, 3]
    return make_transform(R, middle - R @ middle + 1e-3 * MOVED_MM * rng.normal(size=3)) @ T


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__, ["pin", "head", "hook"])
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--level", default="clean", choices=list(LEVELS))
    parser.add_argument("--touches", type=int, default=3)
    parser.add_argument("--hypotheses", type=int, default=10)
    parser.add_argument("--examples", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("| object | faces | median, ms | error, mm |\n|---|---|---|---|")
    for path in arguments.objects:
        print(measure(path, arguments), flush=True)


if __name__ == "__main__":
    main()
