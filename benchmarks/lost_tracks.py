#!/usr/bin/env python3
"""How soon a track's verdict says that the pose no longer explains the touches, and how often it is wrong.

Each track follows an object for `BEFORE` frames, starts near the truth, and is then given `AFTER` frames of one kind:

- *the same*: the slide goes on;
- *another object*: the sensor touches another object at the same place;
- *far away*: the sensor touches another object a third of a metre away;
- *jumped*: the object lies elsewhere, unreported.

Slides, noise and errors of sensor poses are those of `sequences.py`. The first frame counts as 1. *Left "certain"* is
the number of the first frame whose verdict is not "certain": the median and the worst track. *Wrong, in time* counts
tracks that left "certain" within three frames, of all tracks whose first pose was wrong all the time. *Certain and
wrong* is the share of all frames from the third on whose verdict is "certain" and whose first pose is more than 3 mm
off (any pose, for another object). *Certain and right* is the share of all frames from the third on whose verdict is
"certain" and whose first pose is at most 3 mm off.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from asked import make_parser
from sequences import FOUND_M, make_sliding, start_tracker, track
from tactile_loc_benchmark.sliding_touches import Frame
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localizer, PoseMetric, StageStore, TrackedPose, Verdict
from tactile_loc.plugin.helpers import invert, make_translation

BEFORE, AFTER, SOON = 12, 30, 3
FAR_M = 0.33
SAME, OTHER, FAR, JUMPED = KINDS = ("the same", "another object", "far away", "jumped")


def draw_frames(kind: str, localizer: Localizer, other: Localizer, rng: np.random.Generator) -> list[Frame]:
    """Return the frames of one track."""
    count = BEFORE + AFTER
    if kind in (SAME, JUMPED):
        return make_sliding(localizer).draw_example(count, rng, BEFORE if kind == JUMPED else None)
    own = make_sliding(localizer).draw_example(BEFORE, rng)
    return [*own, *_continue(own[-1], make_sliding(other).draw_example(AFTER, rng), FAR_M if kind == FAR else 0.0)]


def _continue(last: Frame, frames: Sequence[Frame], away_m: float) -> list[Frame]:
    """Return frames that follow the last one, with the sensor's first pose `away_m` metres from its last pose."""
    T_base_new = last.T_base_sensor @ make_translation([away_m, 0.0, 0.0]) @ invert(frames[0].T_base_sensor)
    moved = []
    for frame in frames:
        T = T_base_new @ frame.T_base_sensor
        touch = None if frame.touch is None else replace(frame.touch, T_base_sensor=T)
        moved.append(replace(frame, time_s=last.time_s + 0.01 + frame.time_s, touch=touch, T_base_sensor=T))
    return moved


def rate(kind: str, metric: PoseMetric, found: Sequence[TrackedPose], frames: Sequence[Frame]) -> np.ndarray:
    """Return, for each frame after the change (N, 2), whether the verdict is certain, and whether the pose is right."""
    certain = np.array([one.verdict is Verdict.CERTAIN for one in found])
    if kind in (OTHER, FAR):
        return np.stack([certain, np.zeros(len(certain), bool)], axis=1)
    poses = np.array([one.T_sensor_object for one in found])
    truth = np.array([frame.T_sensor_object for frame in frames])
    return np.stack([certain, metric.symmetric_distance(poses, truth) < FOUND_M], axis=1)


def measure(localizer: Localizer, others: Sequence[Localizer], kind: str, tracks: int, seed: int) -> np.ndarray:
    """Return the ratings (tracks, AFTER, 2) of an object's tracks."""
    metric, ratings = PoseMetric(localizer.object), []
    for number in range(tracks):
        rng = np.random.default_rng([seed, KINDS.index(kind), number])
        frames = draw_frames(kind, localizer, others[number % len(others)], rng)
        found, _ = track(start_tracker(localizer, frames, rng), frames)
        ratings.append(rate(kind, metric, found[BEFORE:], frames[BEFORE:]))
    return np.array(ratings)


def write_row(name: str, kind: str, ratings: np.ndarray) -> str:
    """Return one row of the table."""
    certain, right = ratings[..., 0], ratings[..., 1]
    left = np.where(certain.all(axis=1), certain.shape[1] + 1, 1 + (~certain).argmax(axis=1))
    wrong = ~right.any(axis=1)
    late = slice(SOON - 1, None)
    return (
        f"| {name} | {kind} | {len(ratings)} | {np.median(left):.0f} ({left.max()}) | "
        f"{(left[wrong] <= SOON).sum()} of {wrong.sum()} | {(certain & ~right)[:, late].mean():.1%} | "
        f"{(certain & right)[:, late].mean():.1%} |"
    )


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--tracks", type=int, default=5, help="tracks of each object and kind")
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=KINDS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--store", type=Path)
    arguments = parser.parse_args()
    store = StageStore(arguments.store)
    localizers = [Localizer.create(name, sensor=arguments.sensor, store=store) for name in arguments.objects]
    print('| object | then | tracks | left "certain" | wrong, in time | certain and wrong | certain and right |\n'
          "|---|---|---|---|---|---|---|", flush=True)  # fmt: skip
    total: dict[str, list[np.ndarray]] = {kind: [] for kind in arguments.kinds}
    for localizer in localizers:
        others = [other for other in localizers if other is not localizer]
        for kind in arguments.kinds:
            ratings = measure(localizer, others, kind, arguments.tracks, arguments.seed)
            total[kind].append(ratings)
            print(write_row(localizer.object.name, kind, ratings), flush=True)
    for kind, ratings in total.items():
        print(write_row("all", kind, np.concatenate(ratings)), flush=True)


if __name__ == "__main__":
    main()
