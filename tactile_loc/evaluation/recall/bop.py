"""Export of located examples in the formats of the BOP benchmark: results as CSV, and true poses as scene_gt.json.

A scene holds the examples of one object under one condition. An image is one example. There is one file of results for
each method and number of touches. Poses are in one frame for each example, which stands for BOP's camera frame: that of
the first touch's sensor, or the base frame. Lengths are in millimetres, also those of the model to which the poses
belong.
"""

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Poses
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.store.files import write_json, write_text

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
FOLDER, SPLIT = "bop", "test"
UNKNOWN_TIME = -1
OURS = "tactile-loc"


class Answer(NamedTuple):
    """The listed poses (K, 4, 4), metres, of one example, with their scores (K,); no poses if nothing was found."""

    poses: Poses | Sequence[Any]
    scores: Floats | Sequence[float]
    seconds: float


@dataclass(frozen=True, eq=False)
class BopScene:
    """E examples of an object: the true poses `T_true` (E, 4, 4), metres, NaN if unknown, and the answers.

    `answers` maps a method and a number of touches to an answer for each example: the listed poses (K, 4, 4), metres,
    their scores (K,), and the seconds, NaN if unknown. An answer without a pose has no poses and no scores. `about`
    describes the scene.
    """

    object: str
    about: Mapping[str, Any]
    T_true: Poses
    answers: Mapping[tuple[str, int], Sequence[Answer]]


def make_scenes(table: ExampleTable) -> list[BopScene]:
    """Return a scene for each run of an evaluation; poses are in the frame of the first touch's sensor."""
    scenes = []
    for (name, encoder, noise, seed), run in table.group("object", "encoder", "noise", "seed").items():
        truths = np.full((1 + run["example"].max(), 4, 4), np.nan)
        truths[run["example"]] = run["T_true"]
        answers = {(OURS, n): list(_list_answers(some, len(truths))) for (n,), some in run.group("touches").items()}
        about = {"encoder": encoder, "noise": noise, "seed": None if seed < 0 else seed}
        scenes.append(BopScene(name, about, truths, answers))
    return scenes


def _list_answers(table: ExampleTable, count: int) -> Iterator[Answer]:
    """Yield the answers of `count` examples; an example that is not in the table has none."""
    rows = {example: row for row, example in enumerate(table["example"].tolist())}
    for example in range(count):
        row = rows.get(example)
        scores = np.zeros(0) if row is None else table["probabilities"][row]
        listed = np.isfinite(scores)
        poses = () if row is None else table["T_sensor_object"][row][listed]
        yield Answer(poses, scores[listed], np.nan if row is None else float(table["seconds"][row]))


def number_objects(scenes: Sequence[BopScene]) -> dict[str, int]:
    """Return each object's obj_id, from 1, in the order of the scenes."""
    return {name: number for number, name in enumerate(dict.fromkeys(scene.object for scene in scenes), start=1)}


def format_results(scenes: Sequence[BopScene], method: str, touches: int) -> str:
    """Return every listed pose of all examples as BOP's CSV; `touches` is the number of touches.

    An example without a pose has no row.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    of_object = number_objects(scenes)
    for scene_id, scene in enumerate(scenes, start=1):
        for im_id, (poses, scores, seconds) in enumerate(scene.answers.get((method, touches), ())):
            time = f"{seconds:.6f}" if np.isfinite(seconds) else UNKNOWN_TIME
            for T, score in zip(poses, scores, strict=True):
                pose = map(_join, _convert_pose(np.asarray(T)))
                writer.writerow((scene_id, im_id, of_object[scene.object], f"{score:.6g}", *pose, time))
    return text.getvalue()


def _convert_pose(T: Floats) -> tuple[list[float], list[float]]:
    """Return the rotation (9,), row by row, and the translation (3,), mm, of a pose (4, 4), metres."""
    return T[:3, :3].ravel().tolist(), (1e3 * T[:3, 3]).tolist()


def _join(numbers: Sequence[float]) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


def make_truth(scene: BopScene, obj_id: int) -> dict[str, list[dict[str, Any]]]:
    """Return the true poses of a scene's examples as the values of BOP's scene_gt.json; unknown ones are left out."""
    truth = {}
    for im_id, T in enumerate(scene.T_true):
        if np.isfinite(T).all():
            R, t_mm = _convert_pose(T)
            truth[str(im_id)] = [{"cam_R_m2c": R, "cam_t_m2c": t_mm, "obj_id": obj_id}]
    return truth


def write_bop(folder: Path, scenes: Sequence[BopScene], dataset: str = "evaluation") -> list[Path]:
    """Write the folder `bop` with the results of each method and number of touches, the true poses, and the ids.

    Returns the paths of the ids and of the results. Raises OutputError.
    """
    root, of_object = folder / FOLDER, number_objects(scenes)
    about = []
    for scene_id, scene in enumerate(scenes, start=1):
        obj_id = of_object[scene.object]
        path = root / SPLIT / f"{scene_id:06d}" / "scene_gt.json"
        write_text(path, json.dumps(make_truth(scene, obj_id)))
        about.append({"scene_id": scene_id, "obj_id": obj_id, "object": scene.object, **scene.about})
    kinds = list(dict.fromkeys(kind for scene in scenes for kind in scene.answers))
    files = [f"{name}_{dataset}-{SPLIT}.csv" for name in _name_results(kinds)]
    results = [{"file": file, "method": kind[0], "touches": kind[1]} for file, kind in zip(files, kinds, strict=True)]
    ids = write_json(root / "ids.json", {"objects": of_object, "scenes": about, "results": results})
    texts = (format_results(scenes, *kind) for kind in kinds)
    return [ids, *(write_text(root / file, text) for file, text in zip(files, texts, strict=True))]


def _name_results(kinds: Sequence[tuple[str, int]]) -> Iterator[str]:
    """Yield a distinct name for each method and number of touches; BOP allows neither spaces nor underscores."""
    methods = list(dict.fromkeys(method for method, _ in kinds))
    plain = {method: re.sub(r"[^A-Za-z0-9]+", "-", method).strip("-") for method in methods}
    alike = {method for method in methods if list(plain.values()).count(plain[method]) > 1 or not plain[method]}
    for method, touches in kinds:
        number = f"-{methods.index(method) + 1}" if method in alike else ""
        yield f"{plain[method]}{number}-{touches}-touches"
