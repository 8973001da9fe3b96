#!/usr/bin/env python3
"""The error of a sensor's mount on the flange, by the number of touches and their noise.

Each example has a part at rest at a random pose, a mount with an offset of a few centimetres and any rotation, and
random contacts of the part, which give the flange poses. Contacts are drawn by ray casting, which the localizer does
not use. For every level of noise and number of touches, the table has the number of refused mounts. For all other
mounts, it has the median and the 90 % quantile of the errors of the sensor frame's origin and rotation. It also has the
share of truths in the 95 % ellipsoid, the share of excluded touches, and the median time. Models are built beforehand.
With `--outlier`, the flange's pose of one touch in each example is wrong by 5 mm and 10 degrees. Then the table also
has the share of examples that exclude this touch.
"""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from asked import make_parser
from scipy.stats import chi2

from tactile_loc import FlangeTouches, Localizer, StageStore, TactileLocError, calibrate_hand_eye
from tactile_loc.core.geometry.lie import compute_pose_errors
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.plugin import Scene, registry
from tactile_loc.plugin.helpers import draw_rotations, invert, make_transform, rotation_about
from tactile_loc.simulate.touch_simulation import simulate_touches

MOUNT_STD_M, BASE_STD_M = 0.05, 0.3
MOVED_MM, MOVED_DEG = 5.0, 10.0


class Example(NamedTuple):
    """The outcome of one example.

    `nees` is e^T C^-1 e of the error e and its covariance C. `left_out` is the number of excluded touches, and
    `outlier_left_out` states whether the last touch, which `--outlier` makes wrong, is one of them.
    """

    error_mm: float
    error_deg: float
    nees: float
    left_out: int
    outlier_left_out: bool
    seconds: float


def draw_pose(std_m: float, rng: np.random.Generator) -> np.ndarray:
    """Return a pose (4, 4) with a random rotation."""
    return make_transform(draw_rotations(1, rng)[0], std_m * rng.normal(size=3))


def simulate(
    localizer: Localizer, count: int, level: str, rng: np.random.Generator
) -> tuple[FlangeTouches, np.ndarray]:
    """Return touches of a part at rest, and the true mount."""
    scene = Scene(localizer.object, localizer.scene.geometry, registry().create("renderer", "zbuffer", {}))
    touches = simulate_touches(localizer.sampler, scene, count, rng, None, NOISE[level])
    T_flange_sensor, T_base_object = draw_pose(MOUNT_STD_M, rng), draw_pose(BASE_STD_M, rng)
    T_sensor_object = np.stack([touch.T_sensor_object for touch in touches])
    T_base_flange = T_base_object @ invert(T_sensor_object) @ invert(T_flange_sensor)
    return FlangeTouches(tuple(touches), T_base_flange), T_flange_sensor


def add_outlier(given: FlangeTouches, rng: np.random.Generator) -> FlangeTouches:
    """Return the same touches with a wrong last flange pose."""
    T = given.T_base_flange.copy()
    shift = rng.normal(size=3)
    R = rotation_about(rng.normal(size=3), np.radians(MOVED_DEG))
    T[-1] = T[-1] @ make_transform(R, 1e-3 * MOVED_MM * shift / np.linalg.norm(shift))
    return FlangeTouches(given.touches, T)


def measure_example(localizer: Localizer, count: int, level: str, seed: int, outlier: bool) -> Example | str:
    """Find one mount and return its errors, or the reason why the mount was refused."""
    rng = np.random.default_rng([seed, count])
    given, truth = simulate(localizer, count, level, rng)
    given = add_outlier(given, rng) if outlier else given
    start = time.perf_counter()
    try:
        found = calibrate_hand_eye(localizer, given)
    except TactileLocError as error:
        return str(error)
    seconds = time.perf_counter() - start
    e = compute_pose_errors(truth, found.mount.T_flange_sensor)
    return Example(
        1e3 * float(np.linalg.norm(e[:3])), float(np.degrees(np.linalg.norm(e[3:]))),
        float(e @ np.linalg.solve(found.fit.covariance, e)), int((~found.kept).sum()), not found.kept[-1], seconds,
    )  # fmt: skip


def write_row(level: str, count: int, found: list[Example | str], outlier: bool) -> str:
    """Return one row of the table."""
    good = [one for one in found if isinstance(one, Example)]
    start = f"| {level} | {count} | {len(found) - len(good)} of {len(found)} |"
    if not good:
        return start + " - |" * (5 + outlier)
    mm, deg, nees, left_out, named, seconds = np.array(good, float).T
    inside = float((nees < chi2.ppf(0.95, 6)).mean())
    last = f" {named.mean():.0%} |" if outlier else ""
    return (
        f"{start} {np.median(mm):.2f} ({np.quantile(mm, 0.9):.2f}) | "
        f"{np.median(deg):.2f} ({np.quantile(deg, 0.9):.2f}) | "
        f"{inside:.0%} | {left_out.sum() / (count * len(good)):.0%} | {np.median(seconds):.1f} |{last}"
    )


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__, ["pin", "head", "hook"])
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--touches", type=int, nargs="+", default=[6, 10, 15])
    parser.add_argument("--levels", nargs="+", default=["none", "mild", "strong"], choices=list(NOISE))
    parser.add_argument("--examples", type=int, default=5, help="examples of each object")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--outlier", action="store_true")
    parser.add_argument("--store", type=Path)
    arguments = parser.parse_args()
    store = StageStore(arguments.store)
    localizers = [Localizer.create(name, sensor=arguments.sensor, store=store) for name in arguments.objects]
    for localizer in localizers:
        localizer.localize(localizer.simulate(1)[0])  # builds the model and compiles
    print(
        "| noise | touches | refused | error, mm (90 %) | error, degrees (90 %) | in 95 % | left out | time, s |"
        + (" outlier left out |" if arguments.outlier else "")
    )
    print("|---|---|---|---|---|---|---|---|" + "---|" * arguments.outlier)
    for level in arguments.levels:
        for count in arguments.touches:
            found = [
                measure_example(localizer, count, level, arguments.seed + k, arguments.outlier)
                for localizer in localizers
                for k in range(arguments.examples)
            ]
            print(write_row(level, count, found, arguments.outlier), flush=True)


if __name__ == "__main__":
    main()
