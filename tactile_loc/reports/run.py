"""The report of a run: the object's pose from one touch, or from several together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import format_pose
from tactile_loc.core.runtime.formatting import format_millimetres, format_percent
from tactile_loc.io.toml import format_toml
from tactile_loc.locate.result.doubts import list_doubts
from tactile_loc.locate.result.result_arrays import NAME, ResultArrays, TouchArrays, read_arrays
from tactile_loc.locate.result.result_json import HypothesisRecord, ResultRecord, TouchRecord, read_record
from tactile_loc.locate.result.verdict import Verdict, explain_verdict, name_verdict
from tactile_loc.reports import pictures, scene
from tactile_loc.reports.distribution import SurfaceDistribution, count_yaws, map_sides, spread_over_surface
from tactile_loc.reports.page import Page, Section

ALL = 0.999999  # a sum of probabilities above this value is one, except for rounding
COLUMNS = ("rank", "prob. (%)", "imprint IoU (%)", "x (mm)", "y (mm)", "z (mm)", "rotation (°)", "about axis")
SPACING_MM = 4.0  # spacing assumed for a grid without this option
SPREAD = 0.5  # standard deviation that fills the gaps between grid poses, as a share of the spacing
LEAST_SPREAD_MM = 0.5
BEFORE = ("model",)  # stages before the localisation


def make_run_page(path: Path) -> Page:
    """Return the page of a result from its result.json. Raises ResultError if the result's files cannot be used."""
    record = read_record(path)
    return make_result_page(record, read_arrays(path.with_name(NAME), record))


def make_result_page(record: ResultRecord, arrays: ResultArrays) -> Page:
    """Return the page of a result."""
    data = collect_data(record, arrays)
    truth = record.touch.T_sensor_object is not None
    header = [*COLUMNS, *([] if record.errors is None else ["error (mm)"])]
    notes, seconds = [*record.object.notes, *list_doubts(record)], record.seconds.get("model")
    sections = [
        Section("summary", "", {"numbers": list(_list_numbers(record)), "notes": notes}),
        Section("candidates", "Candidates", {"header": header, "rows": _list_rows(record), "truth": truth}),
        Section("contact", "Contact shapes", _describe_contact(record, arrays)),
        Section("distribution", "Distribution", _describe_distribution(record, arrays, data)),
        Section("times", "Times", {"built": "" if seconds is None else f"{seconds:.3g}"}),
        Section("made", "Settings", _describe_settings(record)),
    ]
    verdict = "" if record.verdict is None else f"{record.verdict}: "
    title = f"{verdict}{record.object.name} on {record.sensor_name}"
    return Page("run", title, _write_about(record), sections, data, ["solids.js", "run.js"])


def collect_data(record: ResultRecord, arrays: ResultArrays) -> dict[str, Any]:
    """Return the values for the scripts of a run's page; lengths in mm, angles in degrees, times in ms."""
    poses = np.array([h.T_sensor_object for h in record.hypotheses], float)
    T_true = record.touch.T_sensor_object
    truth = None if T_true is None else np.array(T_true, float)
    surface = find_surface(record, arrays)
    return {
        "candidates": [_describe_candidate(h, T) for h, T in zip(record.hypotheses, poses, strict=True)],
        **scene.build_sensor_scene(arrays, poses, truth),
        "surface": scene.build_surface_scene(surface, poses, truth, arrays.touches[0].geometry),
        **_sum_rotations(arrays),
        "times": [[stage, 1e3 * s] for stage, s in record.seconds.items() if stage not in BEFORE],
    }


def find_surface(record: ResultRecord, arrays: ResultArrays) -> SurfaceDistribution:
    """Return the probability, over the surface, of where the sensor of the first touch is."""
    spacing_mm = record.configuration.get("grid", {}).get("options", {}).get("spacing_mm")
    spread_mm = max(SPREAD * float(spacing_mm if isinstance(spacing_mm, (int, float)) else SPACING_MM), LEAST_SPREAD_MM)
    geometry = arrays.touches[0].geometry
    return spread_over_surface(arrays.mesh, arrays.T_sensor_object, arrays.weights, geometry, 1e-3 * spread_mm)


def _describe_candidate(h: HypothesisRecord, T: NDArray[np.float64]) -> dict[str, Any]:
    return {
        "rank": h.rank, "probability": h.probability, "imprint_iou": h.imprint_iou, "T": scene.list_rows_mm(T),
        "error_mm": None if h.error_m is None else 1e3 * h.error_m,
    }  # fmt: skip


def _sum_rotations(arrays: ResultArrays) -> dict[str, Any]:
    R, weights = arrays.T_sensor_object[:, :3, :3], arrays.weights
    yaw, side = count_yaws(R, weights), map_sides(R, weights)
    return {
        "yaw": {"deg": yaw.yaw_deg.round(3).tolist(), "percent": (100 * yaw.mass).tolist(), "width": yaw.width_deg},
        "side": {
            "kind": side.kind, "normal": side.normal.tolist(), "x": side.x.tolist(), "y": side.y.tolist(),
            "percent": (100 * side.mass).tolist(),
        },
    }  # fmt: skip


def _write_about(record: ResultRecord) -> str:
    touch = record.touch
    what = f"touch {touch.name}" if touch.path is not None else f"simulated touch, noise {touch.noise}"
    if record.other_touches:
        what = f"{1 + len(record.other_touches)} touches together, the first: {touch.name}"
    pressed = f"press depth {1e3 * touch.press_depth_m:.2f} mm"
    return f"{what}, {pressed}; {record.searched}; {record.created}"


def _list_numbers(record: ResultRecord) -> Iterator[tuple[str, str, str]]:
    best = record.hypotheses[0]
    x, y, z, angle_deg, axis = format_pose(np.array(best.T_sensor_object))
    rotated = f"of the object in the sensor's frame, rotated {angle_deg}° about {axis}"
    yield "best pose: x, y, z", f"{x}, {y}, {z} mm", rotated
    if best.T_base_object is not None:
        x, y, z, angle_deg, axis = format_pose(np.array(best.T_base_object))
        yield "in the base frame", f"{x}, {y}, {z} mm", f"x, y, z, rotated {angle_deg}° about {axis}"
    if record.verdict is not None:
        meaning = "; ".join(filter(None, (explain_verdict(record.verdict), record.says_within)))
        yield "verdict", name_verdict(record.verdict), meaning
    if record.verdict is Verdict.AMBIGUOUS and str(record.freedom or ""):
        yield "open", "", str(record.freedom)
    if record.next_step:
        yield "next step", "", record.next_step
    yield "normalised entropy", f"{record.normalised_entropy:.2f}", "0: one pose is certain, 1: nothing is known"
    if (found := record.pose_set) is not None:
        yield found.title, found.size, found.meaning
    explains = "how well the best pose explains the touch, in depth and outline"
    yield "imprint IoU", f"{100 * best.imprint_iou:.0f} %", explains
    probability = format_percent(best.probability)
    yield "probability", probability, f"of the best candidate; sum over {best.grid_poses} grid poses"
    if (errors := record.errors) is not None:
        closest = f"RMS surface distance; of the nearest grid pose: {format_millimetres(errors.closest_in_grid_m)}"
        yield "error", format_millimetres(errors.best_m), closest


def _list_rows(record: ResultRecord) -> list[list[str]]:
    return [
        [
            str(h.rank), f"{100 * h.probability:.1f}", f"{100 * h.imprint_iou:.0f}",
            *format_pose(np.array(h.T_sensor_object)), *([] if h.error_m is None else [f"{1e3 * h.error_m:.2f}"]),
        ]
        for h in record.hypotheses
    ]  # fmt: skip


def _describe_contact(record: ResultRecord, arrays: ResultArrays) -> dict[str, Any]:
    """Return the touches, each candidate's contact shapes, and the differences between touches and candidates."""
    records = [record.touch, *record.other_touches]
    ious = record.hypotheses[0].imprint_ious or [record.hypotheses[0].imprint_iou]
    press_mm = 1e3 * max(touch.shape.press_depth_m for touch in arrays.touches)
    apart = f"{pictures.MOST_APART * press_mm:.2f}"
    words = (f"\N{MINUS SIGN}{apart} or less", "pressed in less … more than the touch (mm)", f"+{apart} or more")
    return {
        "touches": [_describe_touch(*one) for one in zip(records, ious, arrays.touches, strict=True)],
        "depths": (
            pictures.write_gradient(pictures.DEPTHS),
            ("0", "depth from full penetration (mm)", f"{press_mm:.2f}"),
        ),
        "differences": (pictures.write_gradient(pictures.DIFFERENCES), words),
        "cards": [(h.rank, _write_card(h), _draw_made(i, arrays.touches)) for i, h in enumerate(record.hypotheses)],
    }


def _describe_touch(record: TouchRecord, imprint_iou: float, touch: TouchArrays) -> dict[str, Any]:
    best = record.best_imprint_iou
    return {
        "name": record.name,
        "explained": "" if best is None else f"{100 * imprint_iou:.0f} % (another pose: {100 * best:.0f} %)",
        "outlier": record.outlier,
        "frame": pictures.Frame.of(touch.geometry),
        "outline": pictures.trace_outline(touch.shape, touch.geometry),
        "picture": pictures.draw_shape(touch.shape, touch.geometry),
        "photo": None if touch.image is None else pictures.encode_photo(touch.image),
    }


def _write_card(h: HypothesisRecord) -> str:
    error = "" if h.error_m is None else f", error {format_millimetres(h.error_m)}"
    return f"{format_percent(h.probability)}, IoU {100 * h.imprint_iou:.0f} %{error}"


def _draw_made(number: int, touches: Sequence[TouchArrays]) -> list[tuple[str, str]]:
    """Draw, for each touch, the contact shape that candidate `number` predicts, and its difference from the touch."""
    made = [(touch.make_shape(number), touch) for touch in touches]
    return [
        (pictures.draw_shape(shape, t.geometry), pictures.draw_difference(shape, t.shape, t.geometry))
        for shape, t in made
    ]


def _describe_distribution(record: ResultRecord, arrays: ResultArrays, data: dict[str, Any]) -> dict[str, Any]:
    held = f"these have {100 * arrays.mass:.3g} % of the probability"
    return {
        "kept": len(arrays.log_p),
        "searched": record.grid_poses,
        "others": "the others have no probability" if arrays.mass > ALL else held,
        "spread_mm": data["surface"]["spread_mm"],
        "side": _write_side(data["side"]),
        "one_side": data["side"]["kind"] == "one",
    }


def _write_side(side: dict[str, Any]) -> str:
    """Describe the sides of the object that can face the sensor."""
    normal = "({:z.2f}, {:z.2f}, {:z.2f})".format(*side["normal"])
    if side["kind"] == "one":
        return (
            f"In all poses of the grid, the same side of the object faces the sensor: {normal} in the object's frame."
        )
    if side["kind"] == "lean":
        return f"Around the side {normal} in the object's frame:"
    return f"Any side can face the sensor; the most probable is {normal} in the object's frame."


def _describe_settings(record: ResultRecord) -> dict[str, Any]:
    obj = record.object
    size = " x ".join(f"{1e3 * v:.1f}" for v in obj.size_m)
    components = [(slot, record.configuration.get(slot, {}).get("name", ""), package)
                  for slot, package in record.distributions.items()]  # fmt: skip
    return {
        "object": f"{obj.name}: {size} mm, {obj.triangles} triangles, symmetry {obj.symmetry}, read from {obj.source}.",
        "components": components,
        "configuration": format_toml(record.configuration),
        "versions": list(record.versions.items()),
    }
