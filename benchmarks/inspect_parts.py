#!/usr/bin/env python3
"""Differences that `tactile-loc inspect` finds on clean parts and on parts with a planted difference.

Each part is touched three times at a random place, with tilts and shifts. A burr and a dent are caps 1.6 mm wide. A
closed hole is 2 mm wide: the model has it, the part does not. A shifted boss is 2.4 mm wide and 0.5 mm high. A worn
edge has a flat 4 mm long. The size is the height, depth or shift, or the depth of the flat below the edge. Touches are
drawn by ray casting, which the inspection does not use. Given poses have errors of 0.1 mm and 0.2 degrees along each
axis.

The first table has the share of parts with a reported difference within 3 mm of the planted one, and the clean parts
with any reported difference. The second one compares the reported heights with the true ones. The third one has the
pose errors that the differences cause, with clean readings: the largest displacement of a surface point (median, 90 %)
by a fit that starts at the true pose. The last one checks the height x that clean inspections state: a burr or a dent
of this height is planted at a random touched place, and the same sensor poses touch again. The limits were chosen on
other parts. An interrupted run continues with the next part.

Taxim draws the images. They are read by a random law of the gel, as the localizer may choose any. For them, a further
table has the differences at places that enough touches show. A difference is overlooked if the verdict is "as the
model" within less than its size.
"""

import contextlib
import functools
import hashlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from asked import ROOT, load_asked, make_parser, name_asked, write_head
from planted import KINDS, Spot, alter
from tactile_loc_benchmark.sources.taxim_images import TaximImages
from tactile_loc_inspect import comparison, inspection

from tactile_loc import ObjectModel, RobotTouches, Touch, make_noise
from tactile_loc.core.runtime.errors import TactileLocError, TouchError
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.evaluation.jobs import JobOutcome, QueuedJob, do_job, resume_jobs
from tactile_loc.evaluation.summary import compute_wilson_range
from tactile_loc.plugin import Scene, View, registry
from tactile_loc.plugin.helpers import exponential, invert

SIZES_MM = (0.1, 0.2, 0.3, 0.5)
SENSORS = {"images": "gelsight-mini", "GelSight images": "gelsight"}  # whose images Taxim draws
READINGS = {**dict.fromkeys(("clean", "noisy", "elastic"), SIZES_MM), **dict.fromkeys(SENSORS, (0.2, 0.5, 1.0))}
MESHES = ROOT.parent / "shared" / "data" / "meshes" / "automate"
NAMES = (
    "00187_socket 00486_plug 00731_socket 00296_plug 00514_socket 00652_plug 00103_plug 00016_socket 01053_plug "
    "00014_plug 00345_plug 00437_plug"
)
TOUCHES, DRAWS, SEED, NEAR_M, GEL, VERSION = 3, 60, 5, 3e-3, Gel(4e-3), 5  # increase VERSION if results change
STATED, FACTORS = 4, (0.7, 1.0, 1.3)  # clean inspections of each part whose stated height is checked, and its shares
SHOWN_M = 5e-4  # a touch shows a planted difference if it shows a place this near to its middle
TILT_RAD, ASIDE_M, PRESS, POSE_STD = 0.05, 6e-4, (0.4, 0.8), np.array([3.5e-3] * 3 + [1e-4] * 3)


class Presser:
    """Presses a sensor on parts, drawn by ray casting, and reads the touches."""

    def __init__(self, reading: str, folder: Path) -> None:
        make = SENSORS.get(reading)
        self.images = make and TaximImages(TaximImages.Options(sensor=make))
        self.noise = make_noise("mild" if reading == "noisy" else "none")
        place = folder / str(make) / "sensor"
        if self.images and not (place / "sensor.toml").exists():
            self.images.prepare_sensor(place.parent)
        name, options = ("calibrated", {"path": str(place)}) if self.images else ("gelsight-mini", {})
        self.sensor = registry().create("sensor", name, options)
        self.renderer = registry().create("renderer", "raycast", {})
        self.geometry = replace(self.sensor.geometry, gel=GEL) if reading == "elastic" else self.sensor.geometry

    def press(self, obj: ObjectModel, spot: Spot, rng: np.random.Generator) -> Touch | None:
        """Return a touch of a part at a spot; None if the sensor does not touch it there."""
        drawn = replace(self.geometry, gel=Gel()) if self.images else self.geometry
        source = RobotTouches(obj, drawn, self.renderer, noise=self.noise)
        z, x = -spot.normal, np.cross(spot.normal, rng.normal(size=3))
        x /= np.linalg.norm(x)
        T = np.eye(4)
        T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
        T = exponential(np.r_[TILT_RAD * rng.normal(size=3), 0, 0, 0], np.zeros(3)) @ T
        aside = T[:3, :2] @ rng.normal(size=2) * ASIDE_M
        T[:3, 3] = spot.point_m + aside - T[:3, 2] * (drawn.standoff_m + 3e-3)
        touch = source.approach(T, drawn.max_depth_m * rng.uniform(*PRESS), "touch", rng)
        if touch is None or (invert(np.asarray(touch.T_base_sensor)) @ [*spot.point_m, 1])[2] > drawn.surface_m - 1e-4:
            return None
        if not self.images:
            return touch
        with contextlib.suppress(TactileLocError):
            scene, T = Scene(obj, touch.geometry, self.renderer), np.asarray(touch.T_sensor_object)
            image = self.images.press(scene, T, rng)
            shape = self.sensor.contact_shape(image)
            return Touch(shape, self.geometry, T_sensor_object=T, image=image)
        return None


open_presser = functools.cache(Presser)


def inspect(
    presser: Presser, part: ObjectModel, known: ObjectModel, spot: Spot, seed: Sequence[int]
) -> tuple[inspection.Inspection, list[View]]:
    """Press a part at a spot, and inspect it with the model `known`. Raises TouchError without touches."""
    pressed = (presser.press(part, spot, np.random.default_rng([*seed, number])) for number in range(DRAWS))
    touches = list(itertools.islice((one for one in pressed if one is not None), TOUCHES))
    if len(touches) < TOUCHES:
        raise TouchError("the place cannot be touched")
    mine, rng = registry().create("renderer", "heightmap", {}), np.random.default_rng(seed)
    law = rng.integers(3) if presser.images else 0  # the localizer may take any law of the gel
    touches = [(one, *one.read_otherwise())[min(law, len(one.contact_shape.otherwise))] for one in touches]
    views = [View(one, Scene(known, one.geometry, mine)) for one in touches]
    errors = exponential(POSE_STD * rng.normal(size=(TOUCHES, 6)), presser.geometry.gel_middle_m)
    return inspection.inspect_part(views, list(errors @ list_true(views))), views


def list_true(views: Sequence[View]) -> np.ndarray:
    """Return the true poses (N, 4, 4), metres, in the frame of each touch's sensor."""
    return np.stack([np.asarray(view.touch.T_sensor_object) for view in views])


def describe(found: inspection.Inspection, point_m: np.ndarray) -> dict[str, Any]:
    """Return what an inspection found, and what it found near a point (3,), metres."""
    shifts = () if found.shift is None else (found.shift,)
    near, moved = (
        [one for one in some if np.linalg.norm(one.point_m - point_m) < NEAR_M] for some in (found.differences, shifts)
    )
    height = [abs(near[0].height_m), near[0].std_m] if near and not near[0].at_least else None
    places = np.linalg.norm(found.map.points_m - point_m, axis=1) < SHOWN_M
    shown = bool((found.map.touches[places] >= found.limits.touches).any())
    row = {
        "found": len(found.differences) + len(shifts),
        "near": len(near) + len(moved),
        "detectable_m": min(found.detectable_m, 1.0),
    }
    row |= {"shown": shown, "said": found.verdict}
    return {**row, "height": height, "moved_m": {}}


def measure_moved(views: Sequence[View], known: ObjectModel) -> dict[str, float]:
    """Return the largest displacement, metres, by both fits of the pose that start at the true poses."""
    true = list_true(views)
    fits = {"plain": [comparison.fit_plain_pose(view, T) for view, T in zip(views, true, strict=True)]}
    fits["robust"] = [one.T for one in comparison.compare_touches(views, list(true))]
    return {
        name: max(map(functools.partial(inspection.measure_motion, known), true, some)) for name, some in fits.items()
    }


def check_stated(
    presser: Presser, obj: ObjectModel, spot: Spot, seed: Sequence[int], clean: inspection.Inspection
) -> Iterator[dict[str, Any]]:
    """Inspect parts with a burr or a dent at a random place that a clean inspection touched, as high as it stated."""
    found, rng = clean.map, np.random.default_rng(seed)
    weights = found.areas_m2 * np.isfinite(inspection.state_heights(found, clean.limits))
    place = rng.choice(len(weights), p=weights / weights.sum())
    normal = found.normals[place] / np.linalg.norm(found.normals[place])
    along = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    where = Spot(found.points_m[place], normal, along / np.linalg.norm(along))
    for kind, factor in itertools.product(KINDS[:2], FACTORS):
        with contextlib.suppress(TactileLocError):  # a mesh that is not closed takes no burr
            part, known = alter(obj, kind, 1e3 * factor * clean.detectable_m, where)
            again, _ = inspect(presser, part, known, spot, seed)
            yield {"kind": f"stated {kind}", "size_mm": factor, **describe(again, where.point_m)}


@dataclass(frozen=True)
class PartJob:
    """Cases of one part with one kind of reading: clean presses or, if their number is 0, each difference once.

    The first STATED clean presses are repeated with differences as high as stated.
    """

    key: str
    store: Path
    reading: str
    clean: int

    def measure(self, obj: ObjectModel, _: Any) -> dict[str, Any]:
        """Return a row for each case."""
        presser = open_presser(self.reading, self.store)
        cases = [("clean", 0.0, n) for n in range(self.clean)]
        kinds = KINDS[:3] if self.reading in SENSORS else KINDS
        cases = cases or [(*one, 100 + n) for n, one in enumerate(itertools.product(kinds, READINGS[self.reading]))]
        return {"rows": [row for case in cases for row in self.measure_case(presser, obj, *case)]}

    def measure_case(
        self, presser: Presser, obj: ObjectModel, kind: str, size: float, number: int
    ) -> list[dict[str, Any]]:
        """Return the rows of a case, at the first random spot that can be touched; none if there is none."""
        for tried in range(DRAWS):
            seed = [SEED, number, tried, int.from_bytes(obj.name.encode()[:4])]
            spot = Spot.draw(obj, rng := np.random.default_rng(seed), kind == "worn edge")
            with contextlib.suppress(TouchError):
                if presser.press(obj, spot, rng) is not None:
                    part, known = alter(obj, kind, size, spot) if size else (obj, obj)
                    found, views = inspect(presser, part, known, spot, seed)
                    row = {"kind": kind, "size_mm": size, **describe(found, spot.point_m)}
                    if size and self.reading == "clean":
                        row["moved_m"] = measure_moved(views, known)
                    stated = not size and number < STATED and found.verdict == "as the model"
                    return [row, *(check_stated(presser, obj, spot, seed, found) if stated else ())]
        return []


class Here:
    """Runs jobs in this process."""

    def run_jobs(self, jobs: Sequence[Any], subjects: Mapping[str, Any]) -> Iterator[JobOutcome]:
        """Yield the outcome of each job."""
        yield from (do_job(job, subjects[job.key]) for job in jobs)


def write_share(found: Sequence[bool]) -> str:
    """Return the share of the differences found, and its 95 % confidence interval."""
    if not found:
        return ""
    low, high = compute_wilson_range(sum(found), len(found))
    return f"{100 * np.mean(found):.0f} % ({100 * low:.0f} to {100 * high:.0f}) of {len(found)}"


def write_outcome(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the share found, and how many were not found though they are higher than stated."""
    overlooked = [row for row in rows if row["said"] == "as the model" and row["detectable_m"] < 1e-3 * row["size_mm"]]
    found = [row["near"] > 0 for row in rows]
    return f"{100 * np.mean(found):.0f} % of {len(rows)}, {len(overlooked)} overlooked" if rows else ""


def report_overlooked(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the shares of the differences that are found, where enough touches show their place."""
    sizes = sorted({row["size_mm"] for row in rows if row["kind"] in KINDS})
    print("\n" + write_head("difference at a place that enough touches show", *(f"{size} mm" for size in sizes)))
    for kind in KINDS:
        each = [
            [row for row in rows if (row["kind"], row["size_mm"]) == (kind, size) and row["shown"]] for size in sizes
        ]
        if any(each):
            print(f"| {kind} | {' | '.join(map(write_outcome, each))} |")


def report(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the tables."""
    sizes = sorted({row["size_mm"] for row in rows if row["kind"] in KINDS})
    heads = [f"{size} mm" for size in sizes]
    print(write_head("reading", "difference", *heads, "inspections"))
    for reading, of in itertools.groupby(rows, lambda row: row["reading"]):
        by_kind = {
            kind: [row for row in some if row["kind"] == kind] for some in [list(of)] for kind in ("clean", *KINDS)
        }
        if reading in SENSORS:
            by_kind = {kind: some for kind, some in by_kind.items() if kind not in KINDS[3:]}
        for kind, some in by_kind.items():
            if not some:
                continue
            each = [[row["near"] > 0 for row in some if row["size_mm"] == size] for size in sizes]
            cells = [f"{100 * np.mean(one):.0f} %" if one else "" for one in each]
            if kind == "clean":
                size_mm = 1e3 * np.median([row["detectable_m"] for row in some])
                kind = f"none; stated: within {size_mm:.2f} mm (median)"
                cells = [f"{sum(row['found'] > 0 for row in some)} false alarms", *[""] * (len(sizes) - 1)]
            print(f"| {reading} | {kind} | {' | '.join(cells)} | {len(some)} |")
    print("\n" + write_head("stated height, burrs and dents", *heads))
    known = [row for row in rows if row["kind"] in KINDS[:2] and row["height"]]
    each = [(1e-3 * size, [row["height"] for row in known if row["size_mm"] == size]) for size in sizes]
    ratios = (f"{np.median([height for height, _ in some] or [0]) / size:.2f}" for size, some in each)
    within = (np.mean([abs(height - size) < 2 * std for height, std in some] or [0]) for size, some in each)
    print(f"| of the true height (median) | {' | '.join(ratios)} |")
    print(f"| true height within +- | {' | '.join(f'{100 * share:.0f} %' for share in within)} |")
    if any(row["reading"] in SENSORS for row in rows):
        report_overlooked(rows)
    print("\n" + write_head("pose", *heads))
    for name, words in (("plain", "least squares"), ("robust", "of the inspection")):
        each = [[1e3 * row["moved_m"][name] for row in rows if row["moved_m"] and row["size_mm"] == s] for s in sizes]
        cells = [f"{np.median(one):.2f}, {np.quantile(one, 0.9):.2f}" if one else "" for one in each]
        print(f"| {words} | {' | '.join(cells)} |")
    if not any(row["kind"].startswith("stated") for row in rows):
        return
    print("\n" + write_head("reading", "difference", *(f"{factor} x" for factor in FACTORS)))
    for reading, kind in itertools.product(dict.fromkeys(row["reading"] for row in rows), KINDS[:2]):
        some = [row for row in rows if (row["reading"], row["kind"]) == (reading, f"stated {kind}")]
        each = [[row["near"] > 0 for row in some if row["size_mm"] == factor] for factor in FACTORS]
        print(f"| {reading} | {kind} | {' | '.join(map(write_share, each))} |")


def main() -> None:
    """Measure, and print both tables."""
    parser = make_parser(__doc__, [f"{MESHES / name}.obj:m" for name in NAMES.split()])
    parser.add_argument("--readings", nargs="+", choices=READINGS, default=list(READINGS))
    parser.add_argument("--clean", type=int, default=17, help="clean inspections of each part")
    parser.add_argument("--planted", type=int, default=12, help="parts with planted differences")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "inspect-parts", help="folder of the finished jobs")
    asked = parser.parse_args()
    queue = []
    kinds = [(asked.clean, name) for name in asked.objects] + [(0, name) for name in asked.objects[: asked.planted]]
    for reading, (clean, name) in itertools.product(asked.readings, kinds):
        key = hashlib.sha256(repr((VERSION, name_asked(name), reading, clean)).encode()).hexdigest()[:32]
        job = PartJob(key, asked.out, reading, clean)
        queue.append(QueuedJob(job, load_asked(name), f"{reading}, {name_asked(name)}", {"reading": reading}))
    outcomes, _ = resume_jobs("inspecting parts", queue, asked.out, Here())
    found = [(one.about["reading"], outcomes[one.job.key]) for one in queue]
    report([{"reading": reading, **row} for reading, one in found if one.measured for row in one.measured["rows"]])
    print("\n".join(one.error for _, one in found if one.error))


if __name__ == "__main__":
    main()
