"""The job of a benchmark: one method locates all examples of one object from one source."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.benchmark.examples import ExampleDrawer, Examples
from tactile_loc.benchmark.suite import Entry, Suite, create
from tactile_loc.core.errors import TactileLocError
from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.benchmarking import LocatingProblem, Method, ScoredPoses
from tactile_loc.core.slots.registry import registry
from tactile_loc.core.slots.scene import Scene
from tactile_loc.evaluation.metrics import compute_adds, compute_mssd, compute_surface_distances
from tactile_loc.evaluation.protocol import sample_surface
from tactile_loc.evaluation.recall.evaluation import METRICS, RIGHT_M
from tactile_loc.evaluation.recall.summary import measure_diameter
from tactile_loc.locate.results.freedom import explain_as_well
from tactile_loc.store.store import StageStore

LISTED = 10  # most poses of an answer that are measured
COVERED = 0.95  # probability of the poses that should include the true pose
RENDERER = "heightmap"  # draws the poses that are compared with the true pose

Row = dict[str, Any]


@dataclass(frozen=True)
class LocatingJob:
    """One method on one object and one source. `table` is the table of the source's prepared sensor."""

    key: str
    store: Path
    suite: Suite
    source: Entry
    method: Entry
    table: Mapping[str, Any]

    def measure(self, obj: ObjectModel, store: StageStore) -> dict[str, Any]:
        """Return a row for each example and number of touches, and the seconds of preparation."""
        drawer = ExampleDrawer(self.suite, self.source, self.table, obj)
        examples = drawer.load(store)
        method: Method = create("method", self.method)
        folder = store.root / "benchmark-methods"
        problem = LocatingProblem(obj, self.table, drawer.sensor.geometry, folder)
        start_s = time.perf_counter()
        method.prepare(problem)
        prepared_s = time.perf_counter() - start_s
        judge = AnswerJudge(obj, Scene(obj, drawer.sensor.geometry, registry().create("renderer", RENDERER, {})))
        counts = [n for n in sorted(set(self.suite.touches)) if n <= examples.depth_m.shape[1]]
        rows: list[Row] = []
        for number in range(len(examples)):
            touches = examples.make_touches(number, drawer.sensor)
            for n in counts:
                row = _locate(method, problem, touches, n, judge, examples, number)
                rows.append({"example": number, "touches": n, "refused": int(examples.refused[number]), **row})
        return {"rows": rows, "prepared_s": round(prepared_s, 3), "diameter_m": measure_diameter(obj.mesh)}


def _locate(
    method: Method, problem: LocatingProblem, touches: list[Touch], n: int, judge: AnswerJudge, examples: Examples,
    number: int,
) -> Row:  # fmt: skip
    """Locate an example from its first n touches, and measure the answer."""
    if len(touches) < n:
        return {"problem": "the sensor refused nearly all presses"}
    some = [judge.hide_truth(touch) for touch in touches[:n]]
    start_s = time.perf_counter()
    try:
        answer = method.locate(problem, some)
    except TactileLocError as error:
        return {"problem": str(error), "seconds": time.perf_counter() - start_s}
    seconds = time.perf_counter() - start_s
    return {"problem": "", "seconds": seconds, **judge.judge(answer, touches[:n], examples.T_base_object[number])}


@dataclass(frozen=True, eq=False)
class AnswerJudge:
    """Measures the answers of methods for one object."""

    object: ObjectModel
    scene: Scene

    def hide_truth(self, touch: Touch) -> Touch:
        """Return the touch without its true pose."""
        return Touch(
            touch.contact_shape, touch.geometry, touch.name, touch.T_base_sensor,
            T_base_sensor_std_m=touch.T_base_sensor_std_m, T_base_sensor_std_rad=touch.T_base_sensor_std_rad,
        )  # fmt: skip

    def judge(self, answer: ScoredPoses, touches: list[Touch], T_base_object: Poses) -> Row:
        """Return the errors of an answer, mm, and whether the touches determine the pose, as far as the answer shows.

        `covered` tells whether the first poses that hold COVERED of the probability include a right one.
        """
        poses = np.asarray(answer.T_base_object[:LISTED], float)
        errors_m = self._measure_errors(poses, T_base_object)
        surface_m = errors_m[:, METRICS.index("surface")]
        row: Row = {"verdict": answer.verdict, "determined": self._is_determined(poses, surface_m, touches)}
        for k, metric in enumerate(METRICS):
            row |= {f"{metric}_mm": 1e3 * errors_m[0, k], f"listed_{metric}_mm": 1e3 * errors_m[:, k].min()}
        if answer.probabilities is not None:
            p = np.asarray(answer.probabilities[:LISTED], float)
            enough = np.concatenate([[True], np.cumsum(p)[:-1] < COVERED])
            row |= {"probability": float(p[0]), "covered": bool((surface_m[enough] < RIGHT_M).any())}
        listed = {"T_base_object": poses.round(9).tolist(), "scores": np.asarray(answer.scores[:LISTED]).tolist()}
        return {**row, "true_T_base_object": np.asarray(T_base_object).round(9).tolist(), **listed}

    def _measure_errors(self, poses: Poses, T_true: Poses) -> NDArray[np.float64]:
        """Return the METRICS (K, M), metres, of poses (K, 4, 4)."""
        errors = (
            compute_surface_distances(self.object, poses, T_true),
            compute_adds(self.object, self._points_m, poses, T_true),
            compute_mssd(self.object, self.object.mesh.hull_corners_m, poses, T_true),
        )
        return np.stack(errors, axis=1)

    def _is_determined(self, poses: Poses, surface_m: NDArray[np.float64], touches: list[Touch]) -> bool:
        """Return whether none of the poses that are wrong explains the touches as well as the true pose does."""
        wrong = surface_m >= RIGHT_M
        if not wrong.any():
            return True
        ious, true = [], []
        for touch in touches:
            T_sensor_base = np.linalg.inv(np.asarray(touch.T_base_sensor))
            seen = np.concatenate([T_sensor_base @ poses[wrong], np.asarray(touch.T_sensor_object)[None]])
            iou = self.scene.match_touch(touch).imprint_ious(seen, touch)
            ious.append(iou[:-1])
            true.append(iou[-1])
        return not bool(explain_as_well(np.mean(ious, axis=0), float(np.mean(true))).any())

    @cached_property
    def _points_m(self) -> NDArray[np.float64]:
        return sample_surface(self.object)
