"""Pictures: the drawing of the places, and the page of a score."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tactile_loc.commands import make_png_url
from tactile_loc.plugin import SensorGeometry, registry

from tactile_loc_test_object.score import MM, Score
from tactile_loc_test_object.scoring import Floats, Surfaces
from tactile_loc_test_object.shape import COLUMNS, PLACES, RADIUS, ROWS, SIDE, TOP, make_object

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from tactile_loc import Page

DRAWN_PX = 900
DIFFERENCE_MM = 0.1  # at the ends of the colours
LABEL = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
ARROW = {"arrowstyle": "->", "lw": 0.8}
LIGHT = (-0.5, 0.6, 0.62)


def draw_places() -> Figure:
    """Return the drawing of the plate from above, with the numbers and the centre lines of its places."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.2, 8.6), layout="constrained")
    ax = figure.subplots()
    half = SIDE / 2
    ax.imshow(_shade_plate(), cmap="gray", vmin=0, vmax=1, extent=(-half, half, -half, half))
    for place in PLACES:
        ax.plot(*place_circle(place.x, place.y), color="#1864ab", lw=0.7)
        label = f"{place.number} {place.name}"
        ax.text(place.x, place.y + RADIUS + 0.9, label, ha="center", va="bottom", fontsize=7.5, bbox=LABEL, zorder=3)
    ax.annotate(
        "raised corner", (half - 3, 1.2 - half), (half - 12, 4 - half), fontsize=7.5, arrowprops=ARROW, bbox=LABEL
    )
    for x in COLUMNS:
        ax.plot((x, x), (-half - 2, half + 2), color="#c92a2a", lw=0.6, ls=(0, (8, 3, 2, 3)))
    for y in ROWS:
        ax.plot((-half - 2, half + 2), (y, y), color="#c92a2a", lw=0.6, ls=(0, (8, 3, 2, 3)))
    ax.set(xlim=(-half - 3, half + 3), ylim=(-half - 3, half + 3), xticks=COLUMNS, yticks=ROWS)
    ax.set_xlabel("x (mm)")
    ax.set_ylabel("y (mm)")
    ax.set_title(
        f"plate {SIDE:g} x {SIDE:g} mm; origin in the middle of its top; all places {TOP:g} mm high\n"
        f"red: centre lines, with a notch at each end; blue: circles of {2 * RADIUS:g} mm that hold the shapes",
        fontsize=9,
    )
    return figure


def place_circle(x: float, y: float) -> tuple[Floats, Floats]:
    """Return the points x and y, mm, of the circle that holds the shape of a place."""
    angles = np.linspace(0, 2 * np.pi, 90)
    return x + RADIUS * np.cos(angles), y + RADIUS * np.sin(angles)


def _shade_plate() -> Floats:
    """Return the brightness (H, W), 0 to 1, of the plate seen from above."""
    pitch_m = SIDE / MM / DRAWN_PX
    half = DRAWN_PX / 2
    camera = SensorGeometry("orthographic", DRAWN_PX, DRAWN_PX, 1 / pitch_m, 1 / pitch_m, half, half, 0.05, 0.05)
    T = np.diag([1.0, -1, -1, 1])
    T[2, 3] = 0.06
    depth = registry().create("renderer", "heightmap", {}).render(make_object().mesh, T[None], camera)[0].astype(float)
    height = 0.06 - np.where(np.isfinite(depth), depth, 0.064)
    dy, dx = np.gradient(height, pitch_m)
    normal = np.stack([-dx, dy, np.ones_like(dx)], -1) / np.sqrt(1 + dx**2 + dy**2)[..., None]
    return np.asarray(np.clip(0.2 + 0.8 * (normal @ np.array(LIGHT)) + 40 * height, 0, 1))


def make_score_page(found: Score, folder: Path) -> Page:
    """Return the page of a score: its numbers, the table of the presses, and pictures of their surfaces."""
    from tactile_loc import Page, Section

    calibration, scale = found.calibration_m, found.height_scale
    numbers = [
        ("score", f"{found.points:.1f}", f"shape {found.shape_points:.1f}, heights {found.height_points:.1f}"),
        ("located", f"{len(found.located)} of {len(found.presses)}", "photos, within 1 mm of where they should be"),
    ]
    if calibration is not None and scale is not None:
        numbers += [
            ("calibration", f"{MM * calibration:.3f} mm", "RMS difference of the surface from the shape (median)"),
            ("heights", f"{100 * scale:.0f} %", "of the true heights"),
        ]
    for name, value, meaning in (
        ("repeatability", found.repeatability_m, "at places pressed again; with the hand's error"),
        ("between places", found.between_places_m, "a hand alone causes about 0.2 mm"),
    ):
        numbers.append((name, "not measured" if value is None else f"{MM * value:.2f} mm", meaning))
    notes = [press.refused for press in found.presses if press.refused]
    header, *rows = found.list_rows()
    shown = [
        (f"{press.photo.path.name}, {press.photo.place.name}: {words}", picture)
        for press in found.presses
        if press.surfaces is not None
        for words, picture in paint_surfaces(press.surfaces)
    ]
    note = (
        "A plane is subtracted from both surfaces. They are compared where the object touches the gel, away from the "
        "border of the contact. Dark is deep. Difference: red is deeper than expected, blue is less deep; the "
        f"strongest colours are {DIFFERENCE_MM:g} mm."
    )
    table = {
        "header": header,
        "rows": rows,
        "left": 3,
        "note": "Shifts are in the photo: x right, y down.",
        "label": "presses",
    }
    sections = [
        Section("summary", "", {"numbers": numbers, "notes": notes}),
        Section("rows", "Presses", table),
        Section("pictures", "Seen, expected, difference", {"images": shown, "note": note}),
    ]
    title = f"test object: {found.points:.1f} of 100 points"
    return Page("tasks", title, f"photos: {folder}", sections, {}, [])


def paint_surfaces(surfaces: Surfaces) -> list[tuple[str, str]]:
    """Return the pictures of the seen and the expected surface and of their difference, each (words, data URL)."""
    from matplotlib import colormaps

    deepest = max(float(surfaces.expected.max()), float(surfaces.seen.max()), 1e-6)
    off = np.where(surfaces.inside, surfaces.find_difference(), 0)
    coloured = colormaps["RdBu_r"](0.5 + 0.5 * np.clip(MM * off / DIFFERENCE_MM, -1, 1))
    coloured[~surfaces.inside] = (0.85, 0.85, 0.85, 1)
    seen, expected = (colormaps["viridis_r"](one / deepest) for one in (surfaces.seen, surfaces.expected))
    words = f"difference {MM * surfaces.error_m:.3f} mm, heights {100 * surfaces.scale:.0f} %"
    return [("seen", _encode(seen)), ("expected", _encode(expected)), (words, _encode(coloured))]


def _encode(picture: Any) -> str:
    from matplotlib.image import imsave

    file, times = BytesIO(), max(1, round(300 / picture.shape[1]))
    imsave(file, np.kron(np.clip(picture, 0, 1), np.ones((times, times, 1))), format="png")
    return make_png_url(file.getvalue())
