#!/usr/bin/env python3
"""Errors of locating objects from touches from any direction, by the number of touches.

Each example is an object at rest that is pressed from random directions, by 30 to 90 % of the sensors' deepest press.
Every contact of at least 0.25 % of the sensor counts, also at edges and corners. The touches are drawn by ray casting,
which the localizer does not use. The whole object is searched.

For every number of touches, the table has the share of examples within 0.5 and 1 mm of pose error, the median pose
error, and the share with any hypothesis within these distances. A set of touches is
ambiguous if a pose more than 1 mm away explains all touches as well as the true pose. The table has the share of
ambiguous sets, and the share within 0.5 mm among all other sets. For poses within 1 mm, it has the median normalised
error squared (5.35 for true covariances). The last columns are presses without contact, examples that ended in an
error, and the time.

`--clean`, `--strong` and `--misplaced` choose the errors of the touches; the default is all three. `--fingers` presses
objects between two opposed sensors instead, and reports z. With `--outliers`, one touch of each example is wrong, or
none. A wrong touch has a wrong sensor pose (5 mm, 10 degrees), or is a touch of the next object. The table then counts
how often the wrong touch is named, a right touch is named, or no touch is named although no pose explains all touches.
Meshes are given as FILE[:UNITS] or a demo object's name.
"""

import argparse
import dataclasses
import itertools
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from asked import load_asked, make_parser, make_source, open_asked, write_head
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.geometry.rigid import invert, make_transform, rotation_about
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.noise import NOISE, TouchNoise
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.metrics import compute_nees
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Agreement, Localization
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.store.store import StageStore

WITHIN_MM = (0.5, 1.0)
LEVELS: dict[str, dict[str, Any]] = {
    "clean": {},
    "strong": {"noise": TouchNoise(**{**NOISE["strong"].__dict__, "press_share": (1.0, 1.0)})},
    "misplaced": {"sensor_std_m": 0.5e-3, "sensor_std_rad": np.radians(0.5)},
}
AS_WELL = 0.01  # poses with a smaller difference of the imprint IoU count as equally good
MOVED_MM, MOVED_DEG = 5.0, 10.0
KINDS = ("none", "moved", "other object")
VERDICTS = ("agree", "named", "wrongly named", "no touch named", "failed")


class Located(NamedTuple):
    """Pose errors of a located object, mm: of the chosen pose and of the nearest hypothesis; the chosen pose's along z.

    `nees` is the chosen pose's normalised error squared. `undetermined` is true if a hypothesis more than 1 mm away
    explains the touches as well as the true pose. The default values describe an example that ended in an error.
    """

    chosen_mm: float = np.inf
    nearest_mm: float = np.inf
    z_mm: float = np.inf
    nees: float = np.nan
    undetermined: bool = False


def locate(localizer: Localizer, touches: list[Touch], found: Localization) -> Located:
    """Return the errors of a result, given the touches with their true poses."""
    truth = np.asarray(touches[0].T_sensor_object)
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    metric, chosen = PoseMetric(localizer.object), found.best.refined
    off_mm = 1e3 * measure_pose_errors(localizer.object, poses, truth)
    nees = np.nan
    if chosen.covariance is not None:
        nees = compute_nees(metric, chosen.T_sensor_object, chosen.covariance, truth)
    centre = localizer.object.mesh.centroid_m
    z_mm = 1e3 * abs((poses[0] - truth)[2] @ [*centre, 1.0])
    true = [localizer.scene.match_touch(t).imprint_ious(np.asarray(t.T_sensor_object)[None], t)[0] for t in touches]
    rivals = [h.imprint_iou for h, mm in zip(found.hypotheses, off_mm, strict=True) if mm > 1.0]
    as_well = max(rivals, default=0.0) > np.mean(true) - AS_WELL
    return Located(float(off_mm[0]), float(off_mm.min()), float(z_mm), nees, bool(as_well))


def draw_examples(arguments: argparse.Namespace, touches: RobotTouches) -> Iterator[tuple[list[Touch], int]]:
    """Draw the examples. They are the same for every level, because an example's number is its seed."""
    for number in range(arguments.examples):
        rng = np.random.default_rng([arguments.seed, number])
        if arguments.fingers:
            for press_mm in arguments.press_mm:
                yield touches.draw_grip(rng, press_mm * 1e-3), 0
        else:
            yield touches.draw_example(max(arguments.touches), rng)


def measure(localizer: Localizer, arguments: argparse.Namespace, level: str) -> list[dict[str, Any]]:
    """Return a row for each number of touches of one object and sensor."""
    geometry = localizer.scene.geometry
    source = make_source(localizer.object, geometry, **LEVELS[level])
    counts = [2] if arguments.fingers else sorted(arguments.touches)
    found: dict[int, list[Located]] = {n: [] for n in counts}
    seconds: dict[int, list[float]] = {n: [] for n in counts}
    failed, refused = dict.fromkeys(counts, 0), 0
    for touches, unusable in draw_examples(arguments, source):
        refused += unusable
        for n in counts:
            start = time.perf_counter()
            try:
                said = localize_together([(localizer, touch) for touch in touches[:n]])
                seconds[n].append(time.perf_counter() - start)
                found[n].append(locate(localizer, touches[:n], said))
            except TactileLocError as error:
                failed[n] += 1
                found[n].append(Located())
                print(f"  {n} touches: {error}", flush=True)
                seconds[n].append(time.perf_counter() - start)
    rows = []
    for n in counts:
        chosen, best, z_mm, nees, undetermined = np.array(found[n]).T
        others = chosen[undetermined == 0]
        near = nees[(chosen <= 1.0) & np.isfinite(nees)]
        rows.append({
            "object": localizer.object.name, "sensor": localizer.config.sensor.name, "level": level, "touches": n,
            "examples": len(chosen), "within": {f"{mm:g} mm": float((chosen <= mm).mean()) for mm in WITHIN_MM},
            "among_hypotheses": {f"{mm:g} mm": float((best <= mm).mean()) for mm in WITHIN_MM},
            "median_mm": float(np.median(chosen)), "z_median_mm": float(np.median(z_mm)),
            "undetermined": float(undetermined.mean()),
            "determined": len(others), "right": int((others <= 0.5).sum()),
            "z_worst_mm": float(z_mm.max()), "nees": [float(n) for n in near], "refused": refused, "failed": failed[n],
            "median_s": float(np.median(seconds[n])),
        })  # fmt: skip
    return rows


def move(touch: Touch, rng: np.random.Generator) -> Touch:
    """Return the touch with a wrong sensor pose: shifted, and rotated about the middle of the gel."""
    shift = rng.normal(size=3)
    gel, R = np.array([0.0, 0.0, touch.geometry.standoff_m]), rotation_about(rng.normal(size=3), np.radians(MOVED_DEG))
    off = make_transform(R, gel - R @ gel + 1e-3 * MOVED_MM * shift / np.linalg.norm(shift))
    return dataclasses.replace(touch, T_base_sensor=np.asarray(touch.T_base_sensor) @ off)


def spoil(
    touches: RobotTouches, strangers: RobotTouches, count: int, rng: np.random.Generator
) -> tuple[int, dict[str, list[Touch]]]:
    """Return the number of a touch, and the touches of an example with each of the `KINDS` of errors in this touch."""
    right, _ = touches.draw_example(count, rng)
    wrong = int(rng.integers(count))
    (stranger,), _ = strangers.draw_example(1, rng)
    stranger = dataclasses.replace(stranger, T_base_sensor=right[wrong].T_base_sensor, name=right[wrong].name)
    swapped = {"none": right[wrong], "moved": move(right[wrong], rng), "other object": stranger}
    return wrong, {kind: [*right[:wrong], touch, *right[wrong + 1 :]] for kind, touch in swapped.items()}


def judge(agreement: Agreement, wrong: int | None) -> str:
    """Return the verdict, one of `VERDICTS`, on an example. `wrong` is the number of its wrong touch, or None."""
    if not agreement.contradictory:
        return "agree"
    if not agreement.outliers:
        return "no touch named"
    return "named" if agreement.outliers == (wrong,) else "wrongly named"


def measure_outliers(
    localizer: Localizer, other: ObjectModel, arguments: argparse.Namespace, level: str
) -> list[dict[str, Any]]:
    """Return a row for each number of touches and each kind of error in one touch."""
    ours, theirs = (make_source(obj, localizer.scene.geometry, **LEVELS[level]) for obj in (localizer.object, other))
    rows: dict[tuple[int, str], list[tuple[str, float]]] = {(n, kind): [] for n in arguments.touches for kind in KINDS}
    for n, number in itertools.product(arguments.touches, range(arguments.examples)):
        wrong, example = spoil(ours, theirs, n, np.random.default_rng([arguments.seed, number]))
        right = example["none"][1 if wrong == 0 else 0]
        for kind, touches in example.items():
            try:
                found = localize_together([(localizer, touch) for touch in touches])
            except TactileLocError as error:
                print(f"  {n} touches, {kind}: {error}", flush=True)
                rows[n, kind].append(("failed", np.inf))
                continue
            T_base_object = np.asarray(touches[0].T_base_sensor) @ found.best.T_sensor_object
            T = invert(np.asarray(right.T_base_sensor)) @ T_base_object
            error_m = measure_pose_errors(localizer.object, T[None], np.asarray(right.T_sensor_object))
            said = judge(found.agreement, None if kind == "none" else wrong)
            rows[n, kind].append((said, 1e3 * float(error_m[0])))
    return [
        {
            "object": localizer.object.name, "sensor": localizer.config.sensor.name, "level": level, "touches": n,
            "wrong": kind, "examples": len(found), **{v: sum(said == v for said, _ in found) for v in VERDICTS},
            "within 1 mm": sum(error_mm <= 1 for _, error_mm in found),
            "within 1 mm, no touch named": sum(error_mm <= 1 for said, error_mm in found if said == "no touch named"),
        }
        for (n, kind), found in rows.items()
    ]  # fmt: skip


def main() -> None:
    """Measure, print a table, and write the rows as JSON if requested."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensors", nargs="+", default=["gelslim", "gelsight-mini"])
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 2, 3, 5])
    parser.add_argument("--examples", type=int, default=40)
    parser.add_argument("--spacing-mm", type=float, help="search the grid hopf with this spacing")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--fingers", action="store_true")
    parser.add_argument("--outliers", action="store_true")
    parser.add_argument("--press-mm", nargs="+", type=float, default=[0.5, 1.0, 2.0])
    parser.add_argument("--out", type=Path)
    for level in LEVELS:
        parser.add_argument(f"--{level}", dest="levels", action="append_const", const=level)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if arguments.outliers:
        print(write_head("object", "sensor", "level", "touches", "wrong", *VERDICTS, "within 1 mm", "examples"))
    for mesh, after in zip(arguments.objects, [*arguments.objects[1:], arguments.objects[0]], strict=True):
        for sensor in arguments.sensors:
            with tempfile.TemporaryDirectory() as store:
                localizer = open_asked(
                    mesh, store=StageStore(Path(store)), sensor=sensor,
                    grid={"name": "whole"}
                    if arguments.spacing_mm is None
                    else {"name": "hopf", "spacing_mm": arguments.spacing_mm},
                )  # fmt: skip
                for level in arguments.levels or LEVELS:
                    if arguments.outliers:
                        found = measure_outliers(localizer, load_asked(after), arguments, level)
                    else:
                        found = measure(localizer, arguments, level)
                    for row in found if arguments.outliers else ():
                        print(write_outliers(row), flush=True)
                    rows += found
                    if arguments.out:
                        arguments.out.write_text(json.dumps(rows, indent=1))
    if not arguments.outliers:
        print_tables(rows, arguments.fingers)


def print_tables(rows: list[dict[str, Any]], fingers: bool) -> None:
    """Print, for each sensor and level: the shares by number of touches, then every number of touches in detail."""
    for sensor, level in dict.fromkeys((row["sensor"], row["level"]) for row in rows):
        alike = [row for row in rows if (row["sensor"], row["level"]) == (sensor, level)]
        objects = {name: [row for row in alike if row["object"] == name] for name in {r["object"]: 0 for r in alike}}
        objects[f"all {len(objects)}"] = [pool(n, alike) for n in dict.fromkeys(row["touches"] for row in alike)]
        print(f"\n{sensor}, {level}; in brackets: of the determined\n")
        print(write_head("object", *(str(row["touches"]) for row in objects[alike[0]["object"]])))
        for name, some in objects.items():
            determined = (f"{row['right']} of {row['determined']}" for row in some)
            cells = (f"{row['within']['0.5 mm']:.0%} ({of})" for row, of in zip(some, determined, strict=True))
            print(f"| {name} | {' | '.join(cells)} |")
        heads = [
            "object",
            "touches",
            "within 0.5 mm",
            "1 mm",
            "any within 0.5 mm",
            "undetermined",
            "median, mm",
            "NEES",
        ]
        print("\n" + write_head(*heads, "refused", "failed", "s", *["z median, worst, mm"] * fingers))
        for name, some in objects.items():
            for row in some:
                shares = (*row["within"].values(), row["among_hypotheses"]["0.5 mm"], row["undetermined"])
                cells = [f"{share:.0%}" for share in shares]
                cells += [f"{row['median_mm']:.3f}", f"{np.median(row['nees'] or [np.nan]):.1f}", str(row["refused"])]
                cells += [str(row["failed"]), f"{row['median_s']:.2f}"]
                cells += [f"{row['z_median_mm']:.3f}, {row['z_worst_mm']:.3f}"] * fingers
                print(f"| {name} | {row['touches']} | {' | '.join(cells)} |")


def pool(touches: int, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of all objects for a number of touches: means, sums of counts, and medians of medians."""
    some = [row for row in rows if row["touches"] == touches]
    found: dict[str, Any] = {"touches": touches, "nees": [value for row in some for value in row["nees"]]}
    for key in ("within", "among_hypotheses"):
        found[key] = {mm: np.mean([row[key][mm] for row in some]) for mm in some[0][key]}
    found["undetermined"] = np.mean([row["undetermined"] for row in some])
    found |= {key: sum(row[key] for row in some) for key in ("determined", "right", "refused", "failed")}
    found |= {key: np.median([row[key] for row in some]) for key in ("median_mm", "z_median_mm", "median_s")}
    return found | {"z_worst_mm": max(row["z_worst_mm"] for row in some)}


def write_outliers(row: dict[str, Any]) -> str:
    """Return the table's row of one kind of error."""
    cells = [
        row[key] for key in ("object", "sensor", "level", "touches", "wrong", *VERDICTS, "within 1 mm", "examples")
    ]
    return f"| {' | '.join(map(str, cells))} |"


if __name__ == "__main__":
    main()
