"""Export of located examples in the formats of the BOP benchmark: results as CSV, and true poses as scene_gt.json.

A scene is one run: an object, an encoder, a noise and a seed. An image is one example. There is one file of results for
each number of touches. Poses are in the frame of the first touch's sensor, which is BOP's camera frame. Lengths are in
millimetres, also those of the model to which the poses belong.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.evaluation.recall.summary import RecallRun
from tactile_loc.store.files import write_atomically, write_json

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
FOLDER, SPLIT = "bop", "test"
UNKNOWN_TIME = -1


def number_objects(runs: Sequence[RecallRun]) -> dict[str, int]:
    """Return each object's obj_id, from 1, in the order of the runs."""
    return {name: number for number, name in enumerate(dict.fromkeys(run.object for run in runs), start=1)}


def format_results(runs: Sequence[RecallRun], touches: int) -> str:
    """Return every listed pose of all examples as BOP's CSV; `touches` is the number of touches.

    An example without a pose has no row.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    of_object = number_objects(runs)
    for scene_id, run in enumerate(runs, start=1):
        writer.writerows(_list_rows(run, touches, scene_id, of_object[run.object]))
    return text.getvalue()


def _list_rows(run: RecallRun, touches: int, scene_id: int, obj_id: int) -> Iterator[tuple[Any, ...]]:
    found = run.evaluation
    column = found.together.index(touches)
    for im_id in range(len(found)):
        seconds = found.seconds[im_id, column]
        time = f"{seconds:.6f}" if np.isfinite(seconds) else UNKNOWN_TIME
        scores, poses = found.probabilities[im_id, column], found.T_sensor_object[im_id, column]
        for score, T in zip(scores, poses, strict=True):
            if np.isfinite(score):
                yield scene_id, im_id, obj_id, f"{score:.6g}", *map(_join, _convert_pose(T)), time


def _convert_pose(T: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return the rotation (9,), row by row, and the translation (3,), mm, of a pose (4, 4), metres."""
    return T[:3, :3].ravel().tolist(), (1e3 * T[:3, 3]).tolist()


def _join(numbers: Sequence[float]) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


def make_truth(run: RecallRun, obj_id: int) -> dict[str, list[dict[str, Any]]]:
    """Return the true poses of a run's examples as the values of BOP's scene_gt.json.

    An example whose first touch cannot be read is left out.
    """
    truth = {}
    for im_id, T in enumerate(run.evaluation.T_true):
        if np.isfinite(T).all():
            R, t_mm = _convert_pose(T)
            truth[str(im_id)] = [{"cam_R_m2c": R, "cam_t_m2c": t_mm, "obj_id": obj_id}]
    return truth


def write_bop(folder: Path, runs: Sequence[RecallRun]) -> list[Path]:
    """Write the folder `bop` with the results for each number of touches, the true poses, and the ids' meaning.

    Returns the paths of the results and of the ids. Raises OutputError.
    """
    root, of_object = folder / FOLDER, number_objects(runs)
    scenes = []
    for scene_id, run in enumerate(runs, start=1):
        obj_id = of_object[run.object]
        path = root / SPLIT / f"{scene_id:06d}" / "scene_gt.json"
        write_atomically(path, partial(Path.write_text, data=json.dumps(make_truth(run, obj_id)), encoding="utf-8"))
        about = {key: getattr(run, key) for key in ("object", "encoder", "noise", "seed")}
        scenes.append({"scene_id": scene_id, "obj_id": obj_id, **about})
    ids = write_json(root / "ids.json", {"objects": of_object, "scenes": scenes})
    return [
        ids,
        *(
            write_atomically(
                root / f"tactile-loc-{n}-touches_evaluation-{SPLIT}.csv",
                partial(Path.write_text, data=format_results(runs, n), encoding="utf-8"),
            )
            for n in runs[0].evaluation.together
        ),
    ]
