"""The report of a run: the object's pose from one touch, or from several together."""

from collections.abc import Iterator
from datetime import datetime
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Poses, format_pose
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.formatting import format_millimetres, format_percent
from tactile_loc.core.sensing.scene import View
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.io.toml import format_toml
from tactile_loc.locate.result.doubts import list_doubts
from tactile_loc.locate.result.hypothesis import Hypothesis
from tactile_loc.locate.result.localization import Localization
from tactile_loc.reports import pictures, scene
from tactile_loc.reports.distribution import SurfaceDistribution, count_yaws, map_sides, spread_over_surface
from tactile_loc.reports.page import Page, Section
from tactile_loc.view.drawn_scene import DrawnScene
from tactile_loc.view.palette import Palette

ALL = 0.999999  # a sum of probabilities above this value is one, except for rounding
COLUMNS = ("rank", "prob. (%)", "imprint IoU (%)", "x (mm)", "y (mm)", "z (mm)", "rotation (°)", "about axis")
SPACING_MM = 4.0  # spacing assumed for a grid without this option
SPREAD = 0.5  # standard deviation that fills the gaps between grid poses, as a share of the spacing
LEAST_SPREAD_MM = 0.5
LEAST_PERCENT = 0.05  # smaller shares would be shown as 0.0
BEFORE = ("model",)  # stages before the localisation
VERDICT = "verdict"


def make_run_page(path: Path) -> Page:
    """Return the page of a result from its result.json. Raises ResultError if the result's files cannot be used."""
    return make_result_page(Localization.load(path))


def make_result_page(found: Localization) -> Page:
    """Return the page of a result as its files keep it: see `Localization.reduce`.

    Raises ResultError if its configuration is unknown.
    """
    data = collect_data(found)
    header = [*COLUMNS, *([] if found.assessment.errors is None else ["error (mm)"])]
    notes, seconds = [*found.object.notes, *list_doubts(found)], found.seconds.get("model")
    about = {"truth": found.touch.T_sensor_object is not None, "search": found.describe_search()}
    colours = {VERDICT: Palette.find_verdict(found.verdict)}
    sections = [
        Section("summary", "", {"numbers": list(_list_numbers(found)), "notes": notes, "colours": colours}),
        Section("candidates", "Candidates", {"header": header, "rows": _list_rows(found), **about}),
        Section("contact", "Contact shapes", _describe_contact(found)),
        Section("distribution", "Distribution", _describe_distribution(found, data)),
        Section("times", "Times", {"built": "" if seconds is None else f"{seconds:.3g}"}),
        Section("made", "Settings", _describe_settings(found)),
    ]
    title = f"{found.verdict}: {found.object.name} on {found.made_with.sensor_name}"
    return Page("run", title, _write_about(found), sections, data, ["solids.js", "run.js"])


def collect_data(found: Localization) -> dict[str, Any]:
    """Return the values for the scripts of a run's page; lengths in mm, angles in degrees, times in ms."""
    poses, truth = np.array([h.T_sensor_object for h in found.hypotheses]), found.touch.T_sensor_object
    R, weights = found.posterior.grid.T_sensor_object[:, :3, :3], compute_weights(found.posterior)
    return {
        "candidates": _describe_candidates(found),
        **scene.build_sensor_scene(DrawnScene.of(found)),
        "surface": scene.build_surface_scene(find_surface(found), poses, truth, found.touch.geometry),
        "yaw": count_yaws(R, weights),
        "side": map_sides(R, weights),
        "times": [[stage, 1e3 * s] for stage, s in found.seconds.items() if stage not in BEFORE],
    }


def compute_weights(posterior: PosePosterior) -> Floats:
    """Return the probabilities (N,) of a posterior's poses, scaled to sum to one."""
    p = posterior.probabilities
    return np.asarray(p / p.sum())


def find_surface(found: Localization) -> SurfaceDistribution:
    """Return the probability, over the surface, of where the sensor of the first touch is."""
    spacing_mm = found.made_with.configuration["grid"]["options"].get("spacing_mm")
    spread_mm = max(SPREAD * float(spacing_mm if isinstance(spacing_mm, (int, float)) else SPACING_MM), LEAST_SPREAD_MM)
    poses, weights = found.posterior.grid.T_sensor_object, compute_weights(found.posterior)
    return spread_over_surface(found.object.mesh, poses, weights, found.touch.geometry, 1e-3 * spread_mm)


def _describe_candidates(found: Localization) -> list[dict[str, Any]]:
    return [
        {
            "rank": rank,
            "probability": h.probability,
            "imprint_iou": h.imprint_iou,
            "T": scene.list_rows_mm(h.T_sensor_object),
            "error_mm": None if error_m is None else 1e3 * error_m,
        }
        for rank, (h, error_m) in enumerate(_pair_errors(found), 1)
    ]


def _pair_errors(found: Localization) -> Iterator[tuple[Hypothesis, float | None]]:
    """Yield the hypotheses, each with its pose error, metres, or None."""
    errors = found.assessment.errors
    yield from zip_longest(found.hypotheses, () if errors is None else errors.of_hypotheses_m)


def _write_about(found: Localization) -> str:
    touch, source = found.touch, found.made_with.configuration["touch"]
    what = f"touch {touch.name}" if source["path"] is not None else f"simulated touch, noise {source['noise']}"
    if found.others:
        what = f"{len(found.touches)} touches together"
    depths_mm = sorted({f"{1e3 * one.press_depth_m:.2f}" for one in found.touches}, key=float)
    pressed = f"press depth {' to '.join(dict.fromkeys((depths_mm[0], depths_mm[-1])))} mm"
    return f"{what}, {pressed}; {datetime.fromisoformat(found.made_with.created):%d %B %Y, %H:%M %Z}"


def _list_numbers(found: Localization) -> Iterator[tuple[str, str, str]]:
    best = found.best
    meaning = "; ".join(filter(None, (found.explain(), found.describe_within())))
    yield VERDICT, found.verdict.value, meaning
    if found.assessment.next_step:
        yield "next step", "", found.assessment.next_step
    if (errors := found.assessment.errors) is not None:
        closest = f"largest displacement; of the nearest grid pose: {format_millimetres(errors.closest_in_grid_m)}"
        yield "pose error", format_millimetres(errors.best_m), closest
    x, y, z, angle_deg, axis = format_pose(best.T_sensor_object)
    frame = "in the frame of touch 1's sensor" if found.others else "in the sensor's frame"
    yield f"pose {frame}", f"{x}, {y}, {z} mm", f"x, y, z, rotated {angle_deg}° about {axis}"
    if best.T_base_object is not None:
        x, y, z, angle_deg, axis = format_pose(best.T_base_object)
        yield "pose in the base frame", f"{x}, {y}, {z} mm", f"x, y, z, rotated {angle_deg}° about {axis}"
    if (listed := found.pose_set) is not None:
        yield listed.title, listed.size, listed.meaning
    explains = f"how well the pose explains the {'touches' if found.others else 'touch'}, in depth and outline"
    yield "imprint IoU", f"{100 * best.imprint_iou:.0f} %", explains


def _list_rows(found: Localization) -> list[list[str]]:
    return [
        [
            str(rank),
            f"{100 * h.probability:.1f}" if 100 * h.probability >= LEAST_PERCENT else f"< {2 * LEAST_PERCENT:g}",
            f"{100 * h.imprint_iou:.0f}",
            *format_pose(h.T_sensor_object),
            *([] if error_m is None else [f"{1e3 * error_m:.2f}"]),
        ]
        for rank, (h, error_m) in enumerate(_pair_errors(found), 1)
    ]


def _describe_contact(found: Localization) -> dict[str, Any]:
    """Return the touches, each candidate's contact shapes, and the differences between touches and candidates."""
    press_mm = 1e3 * max(touch.press_depth_m for touch in found.touches)
    apart = f"{pictures.MOST_APART * press_mm:.2f}"
    words = (f"\N{MINUS SIGN}{apart} or less", "pressed in less … more than the touch (mm)", f"+{apart} or more")
    poses = np.array([h.T_sensor_object for h in found.hypotheses])
    drawn = [_draw_made(view, poses) for view in found.make_views()]  # for each touch, one for each candidate
    cards = []
    for k, (h, error_m) in enumerate(_pair_errors(found)):
        error = "" if error_m is None else f", error {format_millimetres(error_m)}"
        text = f"{format_percent(h.probability)}, IoU {100 * h.imprint_iou:.0f} %{error}"
        cards.append((k + 1, text, [of_touch[k] for of_touch in drawn]))
    return {
        "touches": [_describe_touch(found, number) for number in range(len(found.touches))],
        "depths": (
            pictures.write_gradient(pictures.DEPTHS),
            ("0", "depth from full penetration (mm)", f"{press_mm:.2f}"),
        ),
        "differences": (pictures.write_gradient(pictures.DIFFERENCES), words),
        "cards": cards,
    }


def _describe_touch(found: Localization, number: int) -> dict[str, Any]:
    touch, best = found.touches[number], found.agreement.best_ious
    imprint_iou = (found.best.imprint_ious or (found.best.imprint_iou,))[number]
    outlier = number in found.agreement.outliers
    return {
        "name": f"touch {number + 1}, {touch.name}" if found.others else touch.name,
        "explained": f"{100 * imprint_iou:.0f} %" if found.others else "",
        "other": f"{100 * best[number]:.0f} %" if outlier and best else "",
        "outlier": outlier,
        "frame": pictures.ImageBorders.of(touch.geometry),
        "outline": pictures.trace_outline(touch.contact_shape, touch.geometry),
        "picture": pictures.draw_shape(touch.contact_shape, touch.geometry),
        "photo": None if touch.image is None else pictures.encode_photo(touch.image),
    }


def _draw_made(view: View, T_first_object: Poses) -> list[tuple[str, str]]:
    """Draw the contact shapes that poses (K, 4, 4), metres, predict for a touch, and their differences from it."""
    touch, geometry = view.touch, view.touch.geometry
    made_m = view.scene.render_what_touch_shows(view.T_sensor_first @ T_first_object, touch)
    shapes = [ContactShape(depth_m, touch.press_depth_m) for depth_m in made_m]
    return [
        (pictures.draw_shape(shape, geometry), pictures.draw_difference(shape, touch.contact_shape, geometry))
        for shape in shapes
    ]


def _describe_distribution(found: Localization, data: dict[str, Any]) -> dict[str, Any]:
    mass = found.assessment.kept_probability
    return {
        "kept": len(found.posterior.grid),
        "searched": found.assessment.grid_poses,
        "entropy": f"{found.normalised_entropy:.2f}",
        "others": "the others have no probability"
        if mass > ALL
        else f"these have {100 * mass:.3g} % of the probability",
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


def _describe_settings(found: Localization) -> dict[str, Any]:
    obj, made = found.object, found.made_with
    size = " x ".join(f"{1e3 * v:.1f}" for v in obj.mesh.extents_m)
    triangles, slots = len(obj.mesh.faces), made.distributions.items()
    return {
        "object": f"{obj.name}: {size} mm, {triangles} triangles, symmetry {obj.symmetry}, read from {obj.source}.",
        "components": [(slot, made.configuration.get(slot, {}).get("name", ""), package) for slot, package in slots],
        "configuration": format_toml(made.configuration),
        "versions": list(made.versions.items()),
    }
