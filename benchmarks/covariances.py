#!/usr/bin/env python3
"""Comparison of refined poses' covariances with the poses' errors.

Each example is an object at rest that is pressed from random directions, as in `contacts.py`. Hypotheses start near the
truth, and the hypothesis that explains the touches best is chosen. For each level and number of
touches, the table has the share of examples that end within 3 mm. The other examples converged to another pose. For
examples within 3 mm, it has the median error (root mean square over the surface), the median normalised estimation
error squared (5.35 for true covariances), and the shares of truths in the 50 and 95 % ellipsoids. At the level
"misplaced", sensor poses are wrong by 0.5 mm and 0.5 degrees, and the touches state these errors.
"""

import argparse
import dataclasses

import numpy as np
from asked import load_asked, make_parser, make_source, move_near
from contacts import LEVELS
from scipy.stats import chi2

from tactile_loc import PoseMetric
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.metrics import compute_nees
from tactile_loc.plugin import Candidate, Scene, View, registry
from tactile_loc.plugin.helpers import invert

MILD = dataclasses.replace(NOISE["mild"], press_share=(1.0, 1.0))
CASES = {"mild": {"noise": MILD}, "strong": LEVELS["strong"], "misplaced": LEVELS["misplaced"]}
HYPOTHESES, NEAR_MM = 4, 3.0


def measure_errors(path: str, level: str, touches: int, arguments: argparse.Namespace) -> list[tuple[float, float]]:
    """Return the error, mm, and the normalised estimation error squared of each example of one object."""
    obj = load_asked(path)
    geometry = registry().create("sensor", arguments.sensor, {}).geometry
    scene = Scene(obj, geometry, registry().create("renderer", "heightmap", {}))
    refiner, metric = registry().create("refiner", "joint", {}), PoseMetric(obj)
    source = make_source(obj, geometry, **CASES[level])
    found = []
    for number in range(arguments.examples):
        rng = np.random.default_rng([arguments.seed, number])
        taken, _ = source.draw_example(touches, rng)
        T_base_first, truth = np.asarray(taken[0].T_base_sensor), np.asarray(taken[0].T_sensor_object)
        views = [
            View(
                t, scene.match_touch(t), invert(np.asarray(t.T_base_sensor)) @ T_base_first, source.sensor_std_m,
                source.sensor_std_rad,
            ) for t in taken
        ]  # fmt: skip
        starts = [Candidate(move_near(truth, obj.mesh.centroid_m, rng), 0, 0.0) for _ in range(HYPOTHESES)]
        best = max(refiner.refine_together(views, starts), key=lambda one: one.contact_iou)
        off_mm = 1e3 * metric.symmetric_distance(best.T_sensor_object[None], truth[None])[0]
        known = best.covariance is not None
        nees = compute_nees(metric, best.T_sensor_object, best.covariance, truth) if known else np.inf
        found.append((float(off_mm), nees))
    return found


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__, ["pin", "damping_pin", "head", "hook"])
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--touches", type=int, nargs="+", default=[2, 3, 5])
    parser.add_argument("--examples", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("| level | touches | within 3 mm | error, mm | NEES | in 50 % | in 95 % |\n|---|---|---|---|---|---|---|")
    for level in CASES:
        for touches in arguments.touches:
            found = [measure_errors(path, level, touches, arguments) for path in arguments.objects]
            off_mm, nees = np.concatenate([np.array(one) for one in found]).T
            near_by = off_mm < NEAR_MM
            inside = [float((nees[near_by] < chi2.ppf(share, 6)).mean()) for share in (0.5, 0.95)]
            print(
                f"| {level} | {touches} | {near_by.sum()} of {len(near_by)} | {np.median(off_mm[near_by]):.2f} | "
                f"{np.median(nees[near_by]):.1f} | {inside[0]:.0%} | {inside[1]:.0%} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
