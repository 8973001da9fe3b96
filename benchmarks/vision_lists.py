#!/usr/bin/env python3
"""How often one touch ranks the right pose of a vision system's list first.

A list has ten poses: the true one, and nine that are turned about a principal axis of the part by 180, by 90, or by a
random angle. Each pose has an error, and a score that prefers the true pose slightly. One touch of the GelSight Mini,
drawn by another renderer, is then located with the list as a prior. A pose of the list is right if it differs by its
error alone from a pose that equals the true one within 1 mm (pose error). The same lists are also ranked without their
right poses. Parts are given as FILE[:UNITS]; the default is the demo objects.
"""

import argparse

import numpy as np
from asked import make_parser, make_source, name_asked, open_asked, write_head
from numpy.typing import NDArray
from tactile_loc_benchmark.suite import read_split

from tactile_loc import GaussianPrior, HypothesesPrior, Localizer, PoseJudge, Touch, Verdict
from tactile_loc.plugin.helpers import exponential

LISTED = 10
STD_M, STD_RAD = 2e-3, np.radians(3)  # errors of vision along and about each axis
SCORE_STD, LIKELIER = 0.5, 0.5  # of the logs of scores; how much the true pose's exceeds the others'
RIGHT_M = 1e-3
SURE = 0.95

Array = NDArray[np.float64]


def draw_list(localizer: Localizer, T: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return poses (LISTED, 4, 4), metres, the logs of their scores, and which are right, if T (4, 4) is true."""
    mesh = localizer.object.mesh
    axes = np.linalg.eigh(np.cov((mesh.vertices_m - mesh.centroid_m).T))[1].T
    angles = np.concatenate([[0.0], np.repeat([np.pi, np.pi / 2], 3), rng.uniform(-np.pi, np.pi, 3)])
    poses, confusions = [], []
    for k, angle in enumerate(angles):
        confused = T @ exponential(np.concatenate([angle * axes[k % 3], np.zeros(3)]), mesh.centroid_m)
        seen_m = confused[:3, :3] @ mesh.centroid_m + confused[:3, 3]
        error = exponential(np.concatenate([STD_RAD * rng.normal(size=3), STD_M * rng.normal(size=3)]), seen_m)
        poses.append(error @ confused)
        confusions.append(confused)
    logs = SCORE_STD * rng.normal(size=LISTED)
    logs[0] += LIKELIER
    errors_m = PoseJudge(localizer.object).measure_errors(np.array(confusions), T)[:, 0]
    return np.array(poses), logs, errors_m < RIGHT_M


def locate(localizer: Localizer, touch: Touch, poses: Array, logs: Array) -> tuple[Array, Verdict, bool]:
    """Return the probabilities (K,) of listed poses after a touch, the verdict, and whether the first pose is right."""
    std = STD_M * np.sqrt(3), STD_RAD * np.sqrt(3)
    listed = tuple(GaussianPrior(T, *std, localizer.object.symmetry) for T in poses)
    prior = HypothesesPrior(listed, np.exp(logs) / np.exp(logs).sum())
    found = localizer.localize(touch, prior)
    T, p = np.array([h.T_sensor_object for h in found.hypotheses]), np.array([h.probability for h in found.hypotheses])
    errors_m = PoseJudge(localizer.object).measure_errors(T[:1], touch.T_sensor_object)
    return prior.rank(T, p), found.verdict, bool(errors_m[0, 0] < RIGHT_M)


def measure(localizer: Localizer, arguments: argparse.Namespace) -> list[str]:
    """Return the part's cells of the table."""
    source = make_source(localizer.object, localizer.scene.geometry)
    before, after, stated, certain, absent = [], [], [], [], []
    for k in range(arguments.lists):
        rng = np.random.default_rng([arguments.seed, k])
        touch = source.draw_example(1, rng)[0][0]
        poses, logs, right = draw_list(localizer, touch.T_sensor_object, rng)
        ranked, verdict, found = locate(localizer, touch, poses, logs)
        before.append(right[logs.argmax()])
        after.append(right[ranked.argmax()])
        stated.append(ranked.max())
        certain += [found] if verdict is Verdict.CERTAIN else []
        if not right.all():
            _, verdict, found = locate(localizer, touch, poses[~right], logs[~right])
            absent += [found] if verdict is Verdict.CERTAIN else []
    sure = np.array(after)[np.array(stated) >= SURE]
    shares = (f"{100 * np.mean(one):.0f} %" for one in (before, after))
    counts = (f"{np.sum(some):.0f} of {len(some)}" for some in (sure, certain, absent))
    return [*shares, *counts]


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--lists", type=int, default=20, help="lists of each part")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    names = ("first before", "first after", "right at 95 %", "right if certain", "right if certain, pose not listed")
    print(write_head("part", *names))
    for asked in arguments.objects:
        cells = measure(open_asked(asked, sensor=arguments.sensor), arguments)
        print(f"| {name_asked(asked)} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
