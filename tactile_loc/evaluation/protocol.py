"""The paper's protocol for one touch, on simulated touches: how far estimates are off, beside what the grid allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.poses import Poses
from tactile_loc.evaluation.judge import LINES, METRICS, STAGES, Judge
from tactile_loc.evaluation.oracle import oracle_poses
from tactile_loc.evaluation.shards import describe_located, save_in_shards
from tactile_loc.evaluation.sources import SimulatedTouches
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import Artifact, Workspace

PROTOCOL_VERSION = 2  # raised when the same localizer would get other numbers
SHARD = 25  # touches localised, saved and resumed at once
ARRAYS = ("errors_m", "T_sensor_object", "seconds", "beliefs")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How far off T simulated touches were localised.

    `errors_m` (T, L, M) in metres of every line of LINES by every metric of METRICS; `T_sensor_object` (T, L, 4, 4) the
    pose that a line ended with, metres; `seconds` (T, S) of every stage of STAGES, refining one pose; `beliefs` (T, B)
    what BELIEF says of each posterior, metres and nats.
    """

    errors_m: NDArray[np.float64]
    T_sensor_object: Poses
    seconds: NDArray[np.float64]
    beliefs: NDArray[np.float64]

    def errors(self, line: str, metric: str = "add") -> NDArray[np.float64]:
        """Return the errors (T,) of a line, metres."""
        return self.errors_m[:, LINES.index(line), METRICS.index(metric)]

    def scale_m(self, metric: str = "add") -> float:
        """Return the mean error of a random pose of the grid, metres, by which the paper normalises."""
        return float(self.errors("random", metric).mean())

    def normalised(self, line: str, metric: str = "add") -> NDArray[np.float64]:
        """Return the errors (T,) of a line as shares of the mean error of a random pose (unitless)."""
        return self.errors(line, metric) / self.scale_m(metric)

    def poses(self, line: str) -> Poses:
        """Return the poses (T, 4, 4) that a line ended with, metres."""
        return self.T_sensor_object[:, LINES.index(line)]

    def stage_seconds(self, stage: str) -> NDArray[np.float64]:
        """Return how long a stage took (T,), seconds."""
        return self.seconds[:, STAGES.index(stage)]


def evaluate(localizer: Localizer, count: int, touches: SimulatedTouches) -> Evaluation:
    """Localise the first `count` of simulated touches and measure all LINES.

    The result is kept in the localizer's store; what an interrupted evaluation has finished, by shards of SHARD
    touches, is not done again, and the errors are those of an uninterrupted one. All encoders are asked about the same
    touches, beside the same random poses. Raises TactileLocError.
    """

    def run(work: Workspace) -> None:
        judge = Judge(localizer)
        save_in_shards(work, ARRAYS, count, SHARD, lambda numbers: _localise(judge, numbers, touches))

    return _read(localizer.store.build(evaluation_key(localizer, count, touches), run))


def evaluation_key(localizer: Localizer, count: int, touches: SimulatedTouches) -> StageKey:
    """Return the key under which an evaluation is stored: everything that decides its errors."""
    refiner = {"refiner": localizer.refiner.describe()}
    return StageKey("evaluation", PROTOCOL_VERSION, {**describe_located(localizer, touches, count), **refiner})


def _localise(judge: Judge, numbers: Sequence[int], source: SimulatedTouches) -> list[NDArray[Any]]:
    """The ARRAYS of some touches."""
    localizer = judge.localizer
    touches = [source.touch(localizer, number) for number in numbers]
    for touch in touches:
        localizer.matcher(touch.press_depth_m)  # what is built once is no part of a touch's time
    localizer.most_probable_pose(touches[0])  # nor is loading libraries
    oracle = oracle_poses(localizer, touches)
    rows = []
    what = f"{localizer.object.name} ({localizer.config.encoder.name})"
    task = f"locating {what}, touches {numbers[0] + 1} to {numbers[-1] + 1}"
    with localizer.progress.task(task, len(touches)) as advance:
        for number, touch, index in zip(numbers, touches, oracle, strict=True):
            rows.append(judge.judge(touch, int(index), np.random.default_rng(source.random(number, 1))))
            advance(1)
    return [np.stack(column) for column in zip(*rows, strict=True)]


def _read(artifact: Artifact) -> Evaluation:
    return Evaluation(*(artifact.array(name, mmap=False) for name in ARRAYS))
