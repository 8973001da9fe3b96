#!/usr/bin/env python3
"""Errors of tracking an object while a sensor slides and rotates over it, and the recovery after a jump.

Sequences are those of `tactile_loc_benchmark.sliding_touches`. The sensor touches from any direction, and touches are
drawn by ray casting, with 100 frames a second. The noise is mild, and stays on the gel for a quarter of a second. The
errors of the sensor's poses are 0.1 mm and 0.1 degrees. Three methods get the same frames. The tracker starts with an
error of 1 mm and 1 degree. Localisation locates each tenth frame alone. ICP registers each frame's surface to that of
the frame before; it starts at the truth, and uses the sensor's motion as a prediction.

Errors are those of the object's centroid and rotation, modulo symmetry: the median and the 95 % quantile over all
frames, and the error at the end. Times are the median and the 99th percentile (wall clock) over the frames in which the
tracker did not search. *In 95 %* is the share of truths in the tracker's 95 % ellipsoid. In a jump, the object suddenly
lies elsewhere without a change of the sensor's pose. In a slip, it slides by 4 mm along the gel and rotates by 15
degrees. The object is found again if the error is below 3 mm (root mean square over the surface), or 1.5 mm for a slip.
The table counts this at once for one frame alone, and later for the tracker's first mode and for any of its modes.
`OMP_NUM_THREADS=1` keeps libraries from waiting for each other.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from asked import make_parser, make_source
from scipy.stats import chi2
from tactile_loc_benchmark.sliding_touches import Frame, SlidingTouches, Slip
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localizer, ObjectModel, PoseMetric, StageStore, Touch, TrackedPose, Tracker
from tactile_loc.core.geometry.lie import move
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.metrics import compute_nees
from tactile_loc.plugin import Poses, registry
from tactile_loc.plugin.helpers import Cloud, invert, make_contact_cloud, rotation_angle

SENSOR_STD_M, SENSOR_STD_RAD = 1e-4, np.radians(0.1)
START_STD = np.array([1e-3] * 3 + [np.radians(1.0)] * 3) / np.sqrt(3)
ALONE_EVERY = 10  # one of this many frames is localised alone
FOUND_M = 3e-3
SLIP, SLIP_FOUND_M = Slip(4e-3, np.radians(15.0)), 1.5e-3
BEFORE, SOON, LATE = 12, 3, 100  # frames before and after a jump
CLOUD_POINTS = 1000


class Followed(NamedTuple):
    """Poses (N, 4, 4) of N frames, and the seconds for each frame (N,)."""

    T_sensor_object: np.ndarray
    seconds: np.ndarray


def make_sliding(localizer: Localizer) -> SlidingTouches:
    """Return sequences of the localizer's object, drawn by another renderer than the localizer's."""
    errors = {"noise": NOISE["mild"], "sensor_std_m": SENSOR_STD_M, "sensor_std_rad": SENSOR_STD_RAD}
    return SlidingTouches(make_source(localizer.object, localizer.sensor.geometry, **errors))


def start_tracker(localizer: Localizer, frames: Sequence[Frame], rng: np.random.Generator) -> Tracker:
    """Return a tracker that starts near the truth."""
    tracker = Tracker(localizer)
    truth = frames[0].T_base_sensor @ frames[0].T_sensor_object
    tracker.start(move(truth, START_STD * rng.normal(size=6)), np.diag(START_STD**2))
    return tracker


def track(tracker: Tracker, frames: Sequence[Frame]) -> tuple[list[TrackedPose], np.ndarray]:
    """Return the tracked poses and the seconds for each frame."""
    found, seconds = [], []
    for frame in frames:
        start = time.perf_counter()
        found.append(tracker.update(frame.time_s, frame.touch, frame.T_base_sensor))
        seconds.append(time.perf_counter() - start)
    return found, np.array(seconds)


def time_each(find: Callable[[Touch], np.ndarray], touches: Sequence[Touch]) -> Followed:
    """Return the pose and the seconds for each touch."""
    poses, seconds = [], []
    for touch in touches:
        start = time.perf_counter()
        poses.append(find(touch))
        seconds.append(time.perf_counter() - start)
    return Followed(np.array(poses), np.array(seconds))


def chain_icp(frames: Sequence[Frame]) -> Followed:
    """Return poses from ICP between each frame and the frame before, starting at the first frame's true pose."""
    icp = registry().create("refiner", "icp", {})
    poses, seconds, before = [frames[0].T_sensor_object], [0.0], None
    for last, frame in zip((frames[0], *frames), frames, strict=False):
        start = time.perf_counter()
        T_frame_last = invert(frame.T_base_sensor) @ last.T_base_sensor
        cloud = None if frame.touch is None else make_cloud(frame.touch)
        if before is not None and cloud is not None:
            guess = T_frame_last.copy()
            points_mm = before.points_mm @ guess[:3, :3].T + 1e3 * guess[:3, 3]
            found = icp.register(Cloud(points_mm, before.normals @ guess[:3, :3].T, before.spacing_mm), cloud).T_mm
            if found is not None:
                T = found.copy()
                T[:3, 3] *= 1e-3
                T_frame_last = T @ T_frame_last
        if frame is not frames[0]:
            poses.append(T_frame_last @ poses[-1])
            seconds.append(time.perf_counter() - start)
        before = cloud
    return Followed(np.array(poses), np.array(seconds))


def make_cloud(touch: Touch) -> Cloud:
    """Return a touch's surface and walls as a cloud of points, in mm."""
    geometry, shape = touch.thin(200)
    points_m, normals = make_contact_cloud(shape, geometry)
    every = max(1, round(len(points_m) / CLOUD_POINTS))
    return Cloud(1e3 * points_m[::every], normals[::every], 1e3 * geometry.pixel_pitch_m)


def measure_pose_differences(obj: ObjectModel, T_estimates: Poses, T_true: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of the centroid (K,), metres, and the rotation (K,), radians, of estimates (K, 4, 4).

    Of all poses equivalent to the true pose, the nearest (by root mean square surface distance) counts.
    """
    nearest = PoseMetric(obj).nearest_equivalents(T_true, T_estimates)
    centroids_m = (nearest - T_estimates)[:, :3] @ [*obj.mesh.centroid_m, 1.0]
    turned = rotation_angle(nearest[:, :3, :3] @ np.swapaxes(T_estimates[:, :3, :3], 1, 2))
    return np.linalg.norm(centroids_m, axis=-1), turned


def write_row(
    localizer: Localizer, name: str, followed: Followed, truth: np.ndarray, local: np.ndarray, last: str
) -> str:
    """Return one row of the table of slides."""
    shift_m, turn_rad = measure_pose_differences(localizer.object, followed.T_sensor_object, truth)
    mm, degrees = 1e3 * shift_m, np.degrees(turn_rad)
    ms = 1e3 * followed.seconds[local]
    return (
        f"| {localizer.object.name} | {name} | {np.median(mm):.2f} ({np.quantile(mm, 0.95):.2f}) | "
        f"{np.median(degrees):.2f} ({np.quantile(degrees, 0.95):.2f}) | {mm[-1]:.2f}, {degrees[-1]:.1f} | "
        f"{np.median(ms):.0f} ({np.quantile(ms, 0.99):.0f}) | {last} |"
    )


def measure_slides(localizer: Localizer, count: int, seed: int) -> list[str]:
    """Return the rows of one sequence."""
    rng = np.random.default_rng([seed, 0])
    frames = make_sliding(localizer).draw_example(count, rng)
    truth = np.array([frame.T_sensor_object for frame in frames])
    found, seconds = track(start_tracker(localizer, frames, rng), frames)
    local, metric = np.array([not one.searched for one in found]), PoseMetric(localizer.object)
    inside = np.mean([
        compute_nees(metric, one.T_sensor_object, one.covariance, T) < chi2.ppf(0.95, 6)
        for one, T in zip(found, truth, strict=True)
    ])  # fmt: skip
    poses = np.array([one.T_sensor_object for one in found])
    some = [k for k in range(0, count, ALONE_EVERY) if frames[k].touch is not None]
    alone = time_each(lambda touch: localizer.localize(touch).best.T_sensor_object, [frames[k].touch for k in some])
    chain, every = chain_icp(frames), np.ones(count, bool)
    return [
        write_row(localizer, "tracker", Followed(poses, seconds), truth, local, f"{inside:.0%} | {(~local).sum()}"),
        write_row(localizer, "each alone", alone, truth[some], every[: len(some)], "- | -"),
        write_row(localizer, "ICP", chain, truth, every, "- | -"),
    ]


class Found(NamedTuple):
    """The numbers of found poses after jumps, and the seconds of a search.

    `alone` counts poses found at once from one frame alone. The other counts are for the tracker's first mode or any
    mode, `SOON` or `LATE` frames after the jump.
    """

    alone: int
    soon: int
    soon_any: int
    late: int
    late_any: int
    seconds: float


def measure_jumps(localizer: Localizer, examples: int, seed: int, slip: Slip | None) -> Found:
    """Return how often the object is found again after jumps or slips."""
    near_m = SLIP_FOUND_M if slip else FOUND_M
    metric, searching, counts = PoseMetric(localizer.object), [], np.zeros(5, int)
    for number in range(examples):
        rng = np.random.default_rng([seed, 1, number])
        frames = make_sliding(localizer).draw_example(BEFORE + LATE + 1, rng, BEFORE, slip)
        found, seconds = track(start_tracker(localizer, frames, rng), frames)
        searching += [s for one, s in zip(found, seconds, strict=True) if one.searched]
        alone = localizer.localize(frames[BEFORE].touch).best.T_sensor_object
        near = [is_near(metric, alone[None], frames[BEFORE], near_m)[0]]
        for after in (SOON, LATE):
            modes = is_near(metric, found[BEFORE + after].T_sensor_object_modes, frames[BEFORE + after], near_m)
            near += [modes[0], modes.any()]
        counts += near
    return Found(*counts.tolist(), float(np.median(searching)) if searching else np.nan)


def is_near(metric: PoseMetric, poses: np.ndarray, frame: Frame, near_m: float) -> np.ndarray:
    """Return a mask (K,) of the poses (K, 4, 4) that are within `near_m` metres of the true pose."""
    return metric.symmetric_distance(poses, np.stack([frame.T_sensor_object] * len(poses))) < near_m


def main() -> None:
    """Print the tables."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--jumps", type=int, default=5, help="jumps of each object")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--store", type=Path)
    arguments = parser.parse_args()
    store = StageStore(arguments.store)
    localizers = [Localizer.create(name, sensor=arguments.sensor, store=store) for name in arguments.objects]
    print("| object | | error, mm (95 %) | error, degrees (95 %) | at the end, mm, degrees | time, ms (99 %) | in "
          "95 % | searches |\n|---|---|---|---|---|---|---|---|")  # fmt: skip
    for localizer in localizers:
        touch = localizer.simulate(1)[0]
        localizer.localize(touch)  # builds the model
        track(Tracker(localizer), [Frame(0.0, touch, np.eye(4), np.eye(4))] * 2)  # compiles
        print("\n".join(measure_slides(localizer, arguments.frames, arguments.seed)), flush=True)
    for slip in (None, SLIP):
        print(
            f"\n| object | {'slips' if slip else 'jumps'} | one frame alone | {SOON} frames later | any mode | "
            f"{LATE} frames later | any mode | search, ms |\n|---|---|---|---|---|---|---|---|"
        )
        for localizer in localizers:
            *counts, seconds = measure_jumps(localizer, arguments.jumps, arguments.seed, slip)
            print(f"| {localizer.object.name} | {arguments.jumps} | {' | '.join(map(str, counts))} | "
                  f"{1e3 * seconds:.0f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
