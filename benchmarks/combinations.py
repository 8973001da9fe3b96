#!/usr/bin/env python3
"""Test that components of all slots work together: each combination locates a touch, or is refused.

One face of a small chamfered box is pressed on a GelSight Mini, without noise. A touch of this face determines the pose
up to the box's symmetry. Each combination of renderer, grid, encoder, matcher, refiner and fuser locates the box. The
fuser `product` fuses one touch and two touches. The fuser `kinematic` fuses only two, because it learns nothing from
one touch. Touches are drawn by another renderer than the tested one. The error is the symmetric surface distance (RMS)
of the nearest of the ten listed poses, whatever its probability. An error above the refiner's limit counts as a
failure. The limits are 0.3 mm, 0.6 mm for kiss-icp, and 2 mm for none (the finest grid's spacing).
A refused combination must be refused with a reason before anything is built.

`--out` keeps a row for each combination, and only missing combinations are measured. `--renderers`, `--grids`, ...
choose a subset. The encoder `outline` comes with `pip install -e plugins_contrib/tactile-loc-outline`.
"""

import argparse
import itertools
import json
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tactile_loc.core.geometry.rigid import Poses, invert, make_transform, rotation_about
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.errors import ConfigError, TactileLocError
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.slots.registry import registry
from tactile_loc.store.store import StageStore

Combination = dict[str, str]  # a component's name by slot
Row = dict[str, Any]

OPTIONS: dict[str, tuple[str, ...]] = {
    "renderer": ("heightmap", "raycast", "zbuffer", "pyrender"),
    "grid": ("whole", "face", "hopf"),
    "encoder": ("pixel", "outline", "moco"),
    "matcher": ("dense", "faiss"),
    "refiner": ("joint", "icp", "filterreg", "kiss-icp", "render", "none"),
    "fuser": ("product", "kinematic"),
}
SMALL: dict[tuple[str, str], dict[str, Any]] = {  # options for a small combination
    ("grid", "whole"): {"directions": 400, "turns": 40},
    ("grid", "face"): {"face": "+z", "spacing_mm": 2.0},
    ("grid", "hopf"): {"spacing_mm": 2.5, "level": 1, "min_contact_percent": 10.0},
    ("encoder", "moco"): {"epochs": 2, "queries": 256, "batch": 32, "channels": 4, "noise": "none"},
}
SETTINGS: dict[str, Any] = {
    "sensor": {"name": "gelsight-mini", "image_size_px": [80, 60]}, "shape_px": 32, "temperature": 0.02, "top": 10,
    "search": {
        "candidates": 2, "candidates_together": 2, "registered": 2, "moved_together": 2, "registered_together": 2,
        "registered_widely": 2, "iterations": 2,
    },
    "hypotheses": {"listed": 10, "drawn": 10, "refined_together": 5},
}  # fmt: skip
LIMIT_MM = {"joint": 0.3, "icp": 0.3, "filterreg": 0.3, "kiss-icp": 0.6, "render": 0.3, "none": 2.0}
SIDES_M, CHAMFER_M = (0.010, 0.007, 0.005), 0.0012
PRESS_M = 0.0008
PLACES = ((0.0011, -0.0007, 0.35), (-0.0020, 0.0012, -0.5))  # the box's middle over the gel: x, y, metres; yaw, rad


def chamfered_box() -> ObjectModel:
    """Return a box with chamfered edges and a half-turn symmetry about each axis."""
    half = np.array(SIDES_M) / 2
    corners = [half - CHAMFER_M * (np.arange(3) != axis) for axis in range(3)]
    signs = np.array(list(itertools.product((-1, 1), repeat=3)))
    points = np.concatenate([signs * corner for corner in corners])
    faces = np.array(ConvexHull(points).simplices, np.int64)
    a, b, c = points[faces].transpose(1, 0, 2)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward, ::-1]
    mesh = TriangleMesh(points, faces)
    return ObjectModel("chamfered box", mesh, SymmetryGroup.parse("z2*x2", mesh.centroid_m))


def combinations(options: Mapping[str, Iterable[str]] = OPTIONS) -> Iterator[Combination]:
    """Yield all combinations, in an order in which consecutive combinations share built stages."""
    for names in itertools.product(*options.values()):
        yield dict(zip(options, names, strict=True))


def configure(combination: Combination) -> RunConfig:
    """Return the small configuration of a combination."""
    chosen = {slot: {"name": name, **SMALL.get((slot, name), {})} for slot, name in combination.items()}
    return RunConfig.from_dict({**SETTINGS, **chosen}, "the combination")


def touches(obj: ObjectModel, localizer: Localizer, renderer: str) -> list[Touch]:
    """Return the clean touches of the box's face, drawn by another renderer. The base frame is the object's frame."""
    other = registry().create("renderer", "zbuffer" if renderer == "raycast" else "raycast", {})
    deepest = localizer.scene.geometry
    scene = Scene(obj, deepest.press(PRESS_M, deepest.max_depth_m), other)
    return [_touch(scene, k, *place) for k, place in enumerate(PLACES)]


def _touch(scene: Scene, number: int, x_m: float, y_m: float, yaw_rad: float) -> Touch:
    facing = rotation_about([0, 0, 1], yaw_rad) @ rotation_about([1, 0, 0], np.pi)  # the face +z faces the sensor
    T: Poses = scene.bring_to_contact(make_transform(facing, [x_m, y_m, 0.0])[None])[0][0]
    shape = ContactShape(scene.render_contact_depths(T[None])[0], PRESS_M)
    return Touch(shape, scene.geometry, f"touch-{number}", T_base_sensor=invert(T), T_sensor_object=T)


def make_localizer(combination: Combination, obj: ObjectModel, store: StageStore) -> Localizer:
    """Return a combination's localizer. Raises ConfigError if the combination is refused."""
    return Localizer(configure(combination), obj, store)


def try_combination(combination: Combination, obj: ObjectModel, store: StageStore) -> Row:
    """Locate the touches with a combination. Return its row: errors, mm, by number of touches, or why it failed."""
    before = len(store.built)
    row: Row = {**combination, "refused": "", "failed": ""}
    try:
        localizer = make_localizer(combination, obj, store)
    except ConfigError as error:
        built = "" if len(store.built) == before else "refused after something was built"
        return {**row, "refused": str(error), "failed": built}
    start = time.perf_counter()
    try:
        row["errors_mm"] = locate(localizer, touches(obj, localizer, combination["renderer"]))
    except TactileLocError as error:
        return {**row, "failed": f"{type(error).__name__}: {error}"}
    row["seconds"] = round(time.perf_counter() - start, 2)
    worst, limit = max(row["errors_mm"].values()), LIMIT_MM[combination["refiner"]]
    return row if worst <= limit else {**row, "failed": f"{worst:.2f} mm off, more than {limit:g} mm"}


def locate(localizer: Localizer, pressed: list[Touch]) -> dict[str, float]:
    """Return the errors, mm, with all touches and, if the fuser uses contact shapes, with one touch."""
    alone = [] if localizer.fuser.capabilities.contact_only else pressed[:1]
    groups = {str(len(some)): some for some in (alone, pressed) if some}
    return {count: error_mm(localizer, some) for count, some in groups.items()}


def error_mm(localizer: Localizer, pressed: list[Touch]) -> float:
    """Return the symmetric surface distance, mm, of the nearest listed hypothesis from the true pose."""
    found = localize_together([(localizer, touch) for touch in pressed])
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    true: NDArray[np.float64] = np.broadcast_to(np.asarray(pressed[0].T_sensor_object), poses.shape)
    return float(1e3 * PoseMetric(localizer.object).symmetric_distance(poses, true).min())


def key_of(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of a row's combination, in the order of the slots."""
    return tuple(row[slot] for slot in OPTIONS)


def print_table(rows: list[Row], options: Mapping[str, Iterable[str]]) -> None:
    """Print a row for each grid, encoder and matcher. A refiner's column has the worst error of these rows, mm."""
    refiners = list(options["refiner"])
    print("| grid | encoder | matcher | " + " | ".join(refiners) + " | combinations | refused | failed |")
    print("|---" * (len(refiners) + 6) + "|")
    for names in itertools.product(options["grid"], options["encoder"], options["matcher"]):
        some = [row for row in rows if (row["grid"], row["encoder"], row["matcher"]) == names]
        worst = [_worst([row for row in some if row["refiner"] == refiner]) for refiner in refiners]
        counts = [len(some), *(sum(bool(row[what]) for row in some) for what in ("refused", "failed"))]
        print(f"| {' | '.join([*names, *worst, *map(str, counts)])} |")


def _worst(rows: list[Row]) -> str:
    errors = [max(row["errors_mm"].values()) for row in rows if row.get("errors_mm")]
    return f"{max(errors):.3f}" if errors else "-"


def main() -> None:
    """Measure the missing combinations, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for slot, names in OPTIONS.items():
        parser.add_argument(f"--{slot}s", nargs="+", default=list(names), choices=names)
    parser.add_argument("--out", type=Path, help="file of rows, one JSON object per line")
    parser.add_argument("--store", type=Path, help="store of grids, encoders and banks")
    arguments = parser.parse_args()
    options = {slot: getattr(arguments, f"{slot}s") for slot in OPTIONS}
    obj = chamfered_box()
    with tempfile.TemporaryDirectory() as folder:
        store = StageStore(arguments.store or Path(folder))
        rows = list(_measure(options, obj, store, arguments.out))
    print_table(rows, options)
    for row in rows:
        if row["failed"]:
            print(f"{', '.join(key_of(row))}: {row['failed']}")
    for reason in dict.fromkeys(row["refused"] for row in rows if row["refused"]):
        print(f"refused: {reason}")


def _measure(
    options: Mapping[str, Iterable[str]], obj: ObjectModel, store: StageStore, out: Path | None
) -> Iterator[Row]:
    """Yield the row of each combination. A row that is not in the file is measured now, and added to the file."""
    lines = out.read_text(encoding="utf-8").splitlines() if out is not None and out.exists() else []
    known = {key_of(row): row for row in map(json.loads, lines)}
    for combination in combinations(options):
        row = known.get(key_of(combination))
        if row is None:
            row = try_combination(combination, obj, store)
            if out is not None:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
        yield row


if __name__ == "__main__":
    main()
