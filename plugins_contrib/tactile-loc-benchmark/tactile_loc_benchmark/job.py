"""The job of a benchmark: one method locates all examples of one object from one source."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from tactile_loc import PoseJudge, StageStore, hash_code
from tactile_loc.plugin import ConfigError, ObjectModel, Poses, Scene, TactileLocError, Touch, registry
from tactile_loc.plugin.helpers import invert

from tactile_loc_benchmark.examples import ExampleDrawer
from tactile_loc_benchmark.interfaces import AnswerError, LocatingProblem, Method, RecordedSource, ScoredPoses
from tactile_loc_benchmark.suite import OWN, Suite, SuiteEntry, create, hash_shortly

LISTED = 10  # most poses of an answer that are measured
METRICS = ("mssd", "add", "shape")  # the columns of `PoseJudge.measure_errors`
RIGHT_M = 1e-3  # poses with pose errors up to this are right
AS_WELL = 0.02  # a pose explains the touches as well as the true one if its imprint IoU is lower by at most this
COVERED = 0.95  # probability of the poses that should include the true pose
RENDERER = "heightmap"  # draws the poses that are compared with the true pose

# packages of tactile-loc, and modules of this package, that decide rows
LOCATING = ("core", "slots", "bases", "simulate", "io", "sensors", "plugins", "locate", "evaluation")
DRAWING = ("examples", "interfaces", "job")

Row = dict[str, Any]


@dataclass(frozen=True)
class LocatingJob:
    """One method on one object and one source.

    `table` is the table of the source's prepared sensor, and `code` is the result of `describe_code`.
    """

    key: str
    store: Path
    suite: Suite
    source: SuiteEntry
    method: SuiteEntry
    table: Mapping[str, Any]
    code: Mapping[str, str]

    def measure(self, obj: ObjectModel, store: StageStore) -> dict[str, Any]:
        """Return a row for each example and number of touches, and the seconds of preparation.

        Raises ConfigError if this process has other code than the one that made the job.
        """
        if describe_code(self.source, self.method) != self.code:
            raise ConfigError(
                "the worker's tactile-loc or plugins differ from those of the process that started the benchmark; "
                "install the same versions there, and start the benchmark again"
            )
        drawer = ExampleDrawer(self.suite, self.source, self.table, obj)
        examples = drawer.load(store)
        problem = LocatingProblem(obj, self.table, drawer.sensor.geometry, store.root)
        judge = AnswerJudge(obj, Scene(obj, problem.geometry, registry().create("renderer", RENDERER, {})))
        method: Method = create("method", self.method)
        start_s = time.perf_counter()
        method.prepare(problem)
        prepared_s = time.perf_counter() - start_s
        recorded = isinstance(drawer.source, RecordedSource)
        counts = [1] if recorded else sorted(set(self.suite.touches))  # recorded touches are located alone
        rows: list[Row] = []
        for number in range(len(examples)):
            touches, T_base_object = examples.make_touches(number, drawer.sensor), examples.T_base_object[number]
            for n in counts:
                about = {"example": number, "touches": n, "refused": int(examples.refused[number])}
                rows.append({**about, **_locate(method, problem, touches, n, judge, T_base_object)})
        return {"rows": rows, "prepared_s": round(prepared_s, 3), "diameter_m": judge.poses.diameter_m}


def describe_code(source: SuiteEntry, method: SuiteEntry) -> dict[str, str]:
    """Return hashes of the code that decides the rows of a source and a method. Raises TactileLocError."""
    return {
        "touch-source": hash_shortly(create("touch-source", source).describe()),
        "method": hash_shortly(create("method", method).describe()),
        **{name: hash_code(f"tactile_loc.{name}") for name in LOCATING},
        **{name: hash_code(f"{OWN}.{name}") for name in DRAWING},
    }


def _locate(
    method: Method, problem: LocatingProblem, touches: list[Touch], n: int, judge: AnswerJudge, T_base_object: Poses
) -> Row:
    """Locate an example from its first n touches, and measure the answer. Raises AnswerError if it is none."""
    if len(touches) < n:
        return {"problem": "the sensor refused nearly all presses"}
    shown = [dataclasses.replace(touch, T_sensor_object=None) for touch in touches[:n]]  # methods never see the truth
    start_s = time.perf_counter()
    try:
        answer = method.locate(problem, shown)
    except AnswerError:
        raise
    except TactileLocError as error:
        return {"problem": str(error), "seconds": time.perf_counter() - start_s}
    seconds = time.perf_counter() - start_s
    if not isinstance(answer, ScoredPoses):
        raise AnswerError(f"a method returned {type(answer).__name__}; return ScoredPoses")
    return {"problem": "", "seconds": seconds, **judge.judge(answer, touches[:n], T_base_object)}


@dataclass(frozen=True, eq=False)
class AnswerJudge:
    """Measures the answers of methods for one object."""

    object: ObjectModel
    scene: Scene

    def judge(self, answer: ScoredPoses, touches: list[Touch], T_base_object: Poses) -> Row:
        """Return the errors of an answer, mm, and whether the touches determine the pose, as far as the answer shows.

        `covered` tells whether the first poses that hold COVERED of the probability include a right one.
        """
        poses = answer.T_base_object[:LISTED]
        errors_m = self.poses.measure_errors(poses, T_base_object)
        right = errors_m[:, METRICS.index("mssd")] <= RIGHT_M
        row: Row = {"verdict": answer.verdict, "determined": self._is_determined(poses[~right], touches)}
        for k, metric in enumerate(METRICS):
            first_mm, listed_mm = 1e3 * float(errors_m[0, k]), 1e3 * float(errors_m[:, k].min())
            row |= {f"{metric}_mm": first_mm, f"listed_{metric}_mm": listed_mm}
        if answer.probabilities is not None:
            p = answer.probabilities[:LISTED]
            enough = np.concatenate([[True], np.cumsum(p)[:-1] < COVERED])
            row |= {"probability": float(p[0]), "covered": bool(right[enough].any())}
        listed = {"T_base_object": poses.round(9).tolist(), "scores": answer.scores[:LISTED].tolist()}
        return {**row, "true_T_base_object": np.asarray(T_base_object).round(9).tolist(), **listed}

    def _is_determined(self, wrong: Poses, touches: list[Touch]) -> bool:
        """Return whether none of the `wrong` poses (W, 4, 4) explains the touches as well as the true pose does."""
        if not len(wrong):
            return True
        ious, true = [], []
        for touch in touches:
            T_sensor_base = invert(np.asarray(touch.T_base_sensor))
            seen = np.concatenate([T_sensor_base @ wrong, np.asarray(touch.T_sensor_object)[None]])
            iou = self.scene.match_touch(touch).imprint_ious(seen, touch)
            ious.append(iou[:-1])
            true.append(iou[-1])
        return not bool((np.mean(ious, axis=0) >= np.mean(true) - AS_WELL).any())

    @cached_property
    def poses(self) -> PoseJudge:
        """What measures the poses."""
        return PoseJudge(self.object)
