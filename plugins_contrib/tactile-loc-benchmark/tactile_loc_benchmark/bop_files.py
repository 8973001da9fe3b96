"""The files of a benchmark in the formats of BOP: the located poses as CSV, and the true poses as scene_gt.json.

A scene holds the examples of one source and one object, and an image is one example. There is one file of results for
each method and number of touches. Poses are in the base frame, which stands for BOP's camera frame. Lengths are in
millimetres, also those of the model to which the poses belong.
"""

import csv
import io
import json
import re
from collections.abc import Hashable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tactile_loc.commands import write_atomically, write_json

from tactile_loc_benchmark.job import Row

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
FOLDER, SPLIT = "bop", "test"
UNKNOWN_TIME = -1


def write_bop(folder: Path, rows: Sequence[Row], dataset: str = "benchmark") -> Path:
    """Write the folder `bop` with the results of each method and number of touches, the true poses, and the ids.

    Returns the path of this folder. Raises OutputError.
    """
    root = folder / FOLDER
    objects, scenes = _number(row["object"] for row in rows), _number(map(_name_scene, rows))
    ordered = sorted(rows, key=lambda row: scenes[_name_scene(row)])
    about = []
    for (source, name), scene_id in scenes.items():
        some = [row for row in ordered if _name_scene(row) == (source, name)]
        path = root / SPLIT / f"{scene_id:06d}" / "scene_gt.json"
        _write_text(path, json.dumps(make_truth(some, objects[name])))
        about.append({"scene_id": scene_id, "obj_id": objects[name], "object": name, "source": source})
    kinds = list(dict.fromkeys((row["method"], row["touches"]) for row in ordered))
    results = []
    for (method, touches), name in zip(kinds, _name_results(kinds), strict=True):
        some = [row for row in ordered if (row["method"], row["touches"]) == (method, touches)]
        lines = [line for row in some for line in list_lines(row, scenes[_name_scene(row)], objects[row["object"]])]
        file = f"{name}_{dataset}-{SPLIT}.csv"
        _write_text(root / file, _format_csv(lines))
        results.append({"file": file, "method": method, "touches": touches})
    write_json(root / "ids.json", {"objects": objects, "scenes": about, "results": results})
    return root


def list_lines(row: Row, scene_id: int, obj_id: int) -> Iterator[tuple[Any, ...]]:
    """Yield the COLUMNS of every listed pose of an example. An example without a pose has none."""
    time = f"{row['seconds']:.6f}" if np.isfinite(row.get("seconds", np.nan)) else UNKNOWN_TIME
    for T, score in zip(row.get("T_base_object", ()), row.get("scores", ()), strict=True):
        R, t_mm = (" ".join(f"{number:.9g}" for number in part) for part in _convert_pose(T))
        yield scene_id, row["example"], obj_id, f"{score:.6g}", R, t_mm, time


def make_truth(rows: Sequence[Row], obj_id: int) -> dict[str, list[dict[str, Any]]]:
    """Return the true poses of a scene's examples as the values of BOP's scene_gt.json; unknown ones are left out."""
    known = {row["example"]: row["true_T_base_object"] for row in rows if "true_T_base_object" in row}
    truth = {}
    for im_id in sorted(known):
        R, t_mm = _convert_pose(known[im_id])
        truth[str(im_id)] = [{"cam_R_m2c": R, "cam_t_m2c": t_mm, "obj_id": obj_id}]
    return truth


def _name_scene(row: Row) -> tuple[str, str]:
    return row["source"], row["object"]


def _number(names: Iterable[Hashable]) -> dict[Any, int]:
    """Return the number of each name, from 1, in the order in which the names first occur."""
    return {name: number for number, name in enumerate(dict.fromkeys(names), start=1)}


def _convert_pose(T: Any) -> tuple[list[float], list[float]]:
    """Return the rotation (9,), row by row, and the translation (3,), mm, of a pose (4, 4), metres."""
    pose = np.asarray(T)
    return pose[:3, :3].ravel().tolist(), (1e3 * pose[:3, 3]).tolist()


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _format_csv(lines: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([COLUMNS, *lines])
    return text.getvalue()


def _name_results(kinds: Sequence[tuple[str, int]]) -> Iterator[str]:
    """Yield a distinct name for each method and number of touches; BOP allows neither spaces nor underscores."""
    methods = list(dict.fromkeys(method for method, _ in kinds))
    plain = {method: re.sub(r"[^A-Za-z0-9]+", "-", method).strip("-") for method in methods}
    alike = {method for method in methods if list(plain.values()).count(plain[method]) > 1 or not plain[method]}
    for method, touches in kinds:
        number = f"-{methods.index(method) + 1}" if method in alike else ""
        yield f"{plain[method]}{number}-{touches}-touches"
