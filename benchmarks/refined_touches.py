#!/usr/bin/env python3
"""Pose errors and times of refiners with one touch and with several, from the same candidates.

Each example is an object at rest that sensors press from random directions, drawn by ray casting, as in `contacts.py`.
A candidate is the true pose, rotated by 8 degrees about a random axis through the centroid and moved by about 2 mm
along each axis. Each refiner refines ten candidates. The error is that of the refined pose which explains the touches
best: the largest displacement of a surface point, modulo symmetry. One touch often leaves a motion open. Rows named
"candidate" are the candidates themselves. Refiners are drawn by the default renderer. Each refiner first refines two
candidates of the first example, so that its library is loaded.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from asked import load_asked, make_parser, make_source, move_near, write_head
from contacts import LEVELS
from numpy.typing import NDArray

from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.core.sensing.scene import Scene, View, compare_where_seen, view_touch
from tactile_loc.locate.hypotheses import find_seen_poses
from tactile_loc.plugin import Candidate, RefinedPose, Refiner, registry
from tactile_loc.plugin.helpers import Cloud, CloudRefiner, Registration

CANDIDATE, GICP = "candidate", "gicp"
REFINERS = ("none", "joint", "icp", "filterreg", "kiss-icp", "render", GICP)
CLOSE_MM = 0.1
Measured = dict[
    tuple[int, str], list[tuple[str, float, float]]
]  # by touches and refiner: object, error in mm, time in s


class Gicp(CloudRefiner):
    """Registers with small_gicp's GICP with its defaults: 0.25 mm voxels, pairs up to 1 mm, 20 iterations."""

    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return a Registration with the library's result, or with None if the result is not finite."""
        import small_gicp

        T_mm = np.array(small_gicp.align(target.points_mm, source.points_mm).T_target_source)
        return Registration(T_mm if np.isfinite(T_mm).all() else None)


def make_refiner(name: str) -> Refiner:
    """Return a refiner with its default options; `gicp` is that of the library small_gicp."""
    return Gicp() if name == GICP else registry().create("refiner", name, {})


def measure(path: str, arguments: argparse.Namespace, measured: Measured) -> None:
    """Add the errors and times of all refiners on an object."""
    obj = load_asked(path)
    geometry = registry().create("sensor", arguments.sensor, {}).geometry
    scene = Scene(obj, geometry, registry().create("renderer", "heightmap", {}))
    source = make_source(obj, geometry, **LEVELS[arguments.level])
    refiners = {name: make_refiner(name) for name in arguments.refiners.split(",")}
    for number in range(arguments.examples):
        rng = np.random.default_rng([arguments.seed, number])
        touches, _ = source.draw_example(max(arguments.touches), rng)
        truth = np.asarray(touches[0].T_sensor_object)
        starts = [move_near(truth, obj.mesh.centroid_m, rng) for _ in range(arguments.candidates)]
        candidates = [Candidate(T, 0, 0.0) for T in starts]
        for count in arguments.touches:
            views = [view_touch(touches[0], touch, scene.match_touch(touch)) for touch in touches[:count]]
            for name, refiner in refiners.items():
                if number == 0:
                    refiner.refine_together(views, candidates[:2])
                start = time.perf_counter()
                refined = refiner.refine_together(views, candidates)
                seconds = time.perf_counter() - start
                T = choose(views, refined)
                error_mm = 1e3 * float(measure_pose_errors(obj, T[None], truth)[0])
                label = CANDIDATE if name == "none" else name
                measured[count, label].append((obj.name, error_mm, seconds))


def choose(views: Sequence[View], refined: Sequence[RefinedPose]) -> NDArray[np.float64]:
    """Return the refined pose (4, 4), metres, that explains the touches best, as a localisation does."""
    T = np.stack([pose.T_sensor_object for pose in refined])
    ious = compare_where_seen(views, T, find_seen_poses(views, refined) if len(views) > 1 else None)[0]
    return np.asarray(T[ious.mean(axis=1).argmax()])


def report(measured: Measured) -> str:
    """Return the table: a row for each number of touches and refiner."""
    names = list(dict.fromkeys(name for rows in measured.values() for name, _, _ in rows))
    head = ["touches", "refiner", *(f"{name}, mm" for name in names), "all, mm", "90th percentile, mm"]
    lines = [write_head(*head, f"within {CLOSE_MM} mm", "median ms")]
    for (count, label), rows in sorted(measured.items(), key=lambda item: item[0][0]):
        errors, seconds = np.array([row[1] for row in rows]), np.array([row[2] for row in rows])
        of = [np.median([error for name, error, _ in rows if name == wanted]) for wanted in names]
        cells = [*of, np.median(errors), np.percentile(errors, 90)]
        close, ms = 100 * np.mean(errors <= CLOSE_MM), 1e3 * np.median(seconds)
        shown = " | ".join(f"{cell:.3f}" for cell in cells)
        lines.append(f"| {count} | {label} | {shown} | {close:.0f} % | {ms:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Measure all objects, and print the table."""
    parser = make_parser(__doc__, ["pin", "head", "hook", "elbow_pipe"])
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--level", default="clean", choices=list(LEVELS))
    parser.add_argument("--touches", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--refiners", default=",".join(REFINERS), help="names, separated by commas")
    parser.add_argument("--candidates", type=int, default=10)
    parser.add_argument("--examples", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    measured: Measured = defaultdict(list)
    for path in arguments.objects:
        measure(path, arguments, measured)
    print(report(measured))


if __name__ == "__main__":
    main()
