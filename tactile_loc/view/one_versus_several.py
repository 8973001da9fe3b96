"""Picture of the reason to touch again: the poses that explain one touch, beside the pose that explains all touches.

Pillow draws it, because to import matplotlib takes longer than to locate an object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from tactile_loc.core.geometry.rigid import Float32, Floats
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.formatting import format_millimetres
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.shape_pictures import paint_shape
from tactile_loc.locate.result.localization import Localization
from tactile_loc.store.files import write_atomically
from tactile_loc.view.drawn_scene import (
    GEL,
    HOUSING,
    STEEL,
    TRUTH,
    DrawnScene,
    DrawnSensor,
    find_extent_m,
    move_triangles,
    trace_outlines_m,
)
from tactile_loc.view.palette import LIGHT, Palette
from tactile_loc.view.pose_panel import TRUTH_OPACITY, Canvas, choose_view, fit_bounds
from tactile_loc.view.raytracing import blend, unmultiply

MOST_GHOSTS, MOST_SHAPES = 6, 4  # largest numbers of drawn poses of the first touch, and of drawn contact shapes
GHOST, SEEN_THROUGH = 0.45, 0.5  # opacity of the first touch's poses, and of other sensors
EDGE_STEP = 0.04  # depth step that counts as an edge, in sizes of the object
LABEL = 0.55  # place of a sensor's label: 0 for the gel's middle, 1 for its corner
MARGIN = 0.05  # free space around the drawn solids, in sizes of the picture
# pixels
WIDTH, HEIGHT = 780, 884  # of a side of the picture
SCENE_TOP, SCENE_WIDTH, SCENE_HEIGHT = 354, 748, 482  # of the solids
PIXELS = 480  # along the longer side of the rendered solids
SHAPE, SHAPE_TOP, GAP = 145, 168, 19  # longer side of a contact shape, its place, and the space between two
SIGN, BETWEEN = 58, 36  # width of a sign of the legend with its space, and the space between two entries
OVERSIZE = 3  # scale at which outlines of contact are drawn
TITLE, HEAD, TEXT, SMALL, SMALLEST = 27, 25, 21, 19, 6  # sizes of texts
BOLD = "Bold"


def draw_one_versus_several(
    alone: Localization, together: Localization, title: str, palette: Palette = LIGHT
) -> Image.Image:
    """Draw the first touch and the poses that explain it, beside all touches and the first pose that explains them.

    `alone` is the result of the first touch of `together`. Lines show the true pose if it is known.
    """
    page = Image.new("RGB", (2 * WIDTH, HEIGHT), palette.paper)
    ghosts = [h.T_sensor_object for h in alone.equal_explanations[:MOST_GHOSTS]]
    view = _SharedView.of(DrawnScene.of(together), ghosts)
    left, right = (_Side(page, start, palette) for start in (0, WIDTH))
    left.draw(alone, "the first touch alone", "poses that explain the touch")
    left.put_scene(view.draw_ghosts(ghosts), [])
    right.draw(together, f"{len(together.touches)} touches together", "first pose")
    right.put_scene(view.draw_touched(), view.place_labels())
    left.write((WIDTH, 34), title, TITLE, style=BOLD, most=2 * WIDTH)
    return page


def save_picture(path: Path, picture: Image.Image) -> Path:
    """Write a picture atomically, and return the path. Raises OutputError if the file cannot be written."""
    return write_atomically(path, lambda temporary: picture.save(temporary, compress_level=2))


def describe_side(found: Localization, of: str) -> tuple[str, str]:
    """Return the two lines above a side of the picture: the verdict, and what the touches show."""
    errors_m = found.measure_errors_m(found.object)
    off = "" if errors_m is None else f"; first pose: {format_millimetres(errors_m[0])} off"
    return f"{of}: {found.verdict}", f"{found.count_explanations()}{off}"


def name_touch(number: int) -> str:
    """Return the label of a touch, which counts from 0."""
    return f"touch {number + 1}"


@cache
def find_font(size: int, style: str = "") -> ImageFont.FreeTypeFont:
    """Return the font that matplotlib ships, without importing matplotlib unless its files lie elsewhere."""
    name = Path("fonts", "ttf", f"DejaVuSans{'-' if style else ''}{style}.ttf")
    spec = find_spec("matplotlib")
    path = Path(str(spec and spec.origin)).parent / "mpl-data" / name
    if not path.is_file():
        from matplotlib import get_data_path

        path = get_data_path() / name
    return ImageFont.truetype(str(path), size, layout_engine=ImageFont.Layout.BASIC)


@dataclass(frozen=True)
class _Side:
    """A half of a picture, which starts at the pixel column `left`. Places are pixels from its upper left corner."""

    page: Image.Image
    left: int
    palette: Palette

    def write(self, at: Any, text: str, size: int, style: str = "", most: float = WIDTH, **look: Any) -> None:
        """Write a line around a place (x, y). It is smaller if it is wider than `most` pixels less a margin."""
        while size > SMALLEST and (wide := find_font(size, style).getlength(text)) > most - 2 * GAP:
            size = max(SMALLEST, min(size - 1, int(size * (most - 2 * GAP) / wide)))
        look = {"fill": self.palette.ink, "anchor": "mm"} | look
        ImageDraw.Draw(self.page).text((self.left + at[0], at[1]), text, font=find_font(size, style), **look)

    def draw(self, found: Localization, of: str, blue: str) -> None:
        """Write what the touches show, draw their contact shapes, and explain the colours."""
        head, text = describe_side(found, of)
        self.write((WIDTH / 2, 96), head, HEAD, BOLD)
        self.write((WIDTH / 2, 130), text, TEXT, fill=self.palette.soft)
        shown = found.touches[:MOST_SHAPES]
        x = (WIDTH - SHAPE * len(shown) - GAP * (len(shown) - 1)) // 2
        for number, touch in enumerate(shown):
            self._put_shape(x, touch)
            self.write((x + SHAPE / 2, SHAPE_TOP + SHAPE + 14), name_touch(number), SMALL)
            x += SHAPE + GAP
        self._draw_legend(blue, found.touch.T_sensor_object is not None)

    def _put_shape(self, x: int, touch: Touch) -> None:
        """Draw a contact shape as the sensor sees it, x right and y down, with the outline of the contact."""
        left, right, bottom, top = find_extent_m(touch.geometry)
        scale = SHAPE / max(right - left, bottom - top)
        width, height = round(scale * (right - left)), round(scale * (bottom - top))
        picture = Image.fromarray(paint_shape(touch.contact_shape, touch.geometry))
        picture = picture.resize((OVERSIZE * width, OVERSIZE * height), Image.Resampling.BILINEAR)
        pen = ImageDraw.Draw(picture)
        for line_m in trace_outlines_m(touch.contact_shape, touch.geometry):
            places = (line_m[:, :2] - [left, top]) * OVERSIZE * scale
            pen.line([tuple(place) for place in places], self.palette.contact, 2 * OVERSIZE, joint="curve")
        at = self.left + x + (SHAPE - width) // 2, SHAPE_TOP + (SHAPE - height) // 2
        self.page.paste(picture.resize((width, height), Image.Resampling.BOX), at)
        frame = at[0] - 1, at[1] - 1, at[0] + width, at[1] + height
        ImageDraw.Draw(self.page).rectangle(frame, outline=self.palette.ink, width=2)

    def put_scene(self, image: Float32, labels: Sequence[Floats]) -> None:
        """Draw a picture (H, W, 4) of solids as large as fits below the contact shapes, and name its sensors.

        `labels` are the places (2,) of the names: see `_SharedView.place_labels`.
        """
        small = Image.fromarray((255 * unmultiply(image) + 0.5).astype(np.uint8))
        scale = min(SCENE_WIDTH / small.width, SCENE_HEIGHT / small.height)
        large = small.resize((round(scale * small.width), round(scale * small.height)), Image.Resampling.BICUBIC)
        x, y = (WIDTH - large.width) // 2, SCENE_TOP + (SCENE_HEIGHT - large.height) // 2
        self.page.paste(large, (self.left + x, y), large)
        for number, (right, down) in enumerate(labels):
            at = x + right * large.width, y + down * large.height
            self.write(at, name_touch(number), TEXT, stroke_width=3, stroke_fill=self.palette.paper)

    def _draw_legend(self, blue: str, knows_truth: bool) -> None:
        """Explain the blue solids and, if they are drawn, the lines of the true pose."""
        font, pen, y = find_font(TEXT), ImageDraw.Draw(self.page), HEIGHT - 36
        words = [blue, "true pose"][: 1 + knows_truth]
        x = self.left + 0.5 * (WIDTH - sum(SIGN + font.getlength(word) for word in words) - BETWEEN * knows_truth)
        for word, colour, half in zip(words, (self.palette.best, self.palette.truth), (7, 1), strict=False):
            pen.rectangle((x, y - half, x + SIGN - 16, y + half), colour, self.palette.ink if half > 1 else None)
            pen.text((x + SIGN, y), word, self.palette.ink, font, anchor="lm")
            x += SIGN + font.getlength(word) + BETWEEN


@dataclass(frozen=True, eq=False)
class _SharedView:
    """A scene from one viewpoint, for both sides of the picture."""

    scene: DrawnScene
    canvas: Canvas

    @classmethod
    def of(cls, scene: DrawnScene, ghosts: Sequence[Floats]) -> _SharedView:
        """Choose a viewpoint that shows the object, also at the poses `ghosts` (4, 4), metres, and all sensors."""
        view = choose_view(scene.mesh, scene.poses[0])
        posed = [move_triangles(scene.mesh.triangles_m, T) for T in ghosts]
        sensors = [part for sensor in scene.sensors for part in (sensor.gel_m, sensor.housing_m)]
        bounds = fit_bounds(view, [1e3 * part for part in (scene.object_m, *posed, *sensors)], MARGIN, MARGIN)
        size_mm = 1e3 * float(np.ptp(scene.mesh.triangles_m.reshape(-1, 3), axis=0).max())
        return cls(scene, Canvas(view, bounds, PIXELS, EDGE_STEP * size_mm))

    @cached_property
    def truth(self) -> Float32 | None:
        """A picture of the object's edges at the true pose, if it is known."""
        return None if self.scene.truth_m is None else self.canvas.draw_edges(1e3 * self.scene.truth_m, TRUTH)

    def draw_ghosts(self, T_sensor_object: Sequence[Floats]) -> Float32:
        """Return a picture of the first sensor and the object at each pose (4, 4), metres, seen through."""
        first = self.scene.sensors[:1]
        image = self._draw([], first)
        for ghost in map_in_threads(lambda T: self._draw([T], first), T_sensor_object[::-1]):
            image = blend(image, ghost, GHOST)
        return self._mark_truth(image)

    def draw_touched(self) -> Float32:
        """Return a picture of the object at the first pose, on the first sensor; others are seen through."""
        best, sensors = [self.scene.poses[0]], self.scene.sensors
        return self._mark_truth(blend(self._draw(best, sensors[:1]), self._draw(best, sensors), SEEN_THROUGH))

    def place_labels(self) -> list[Floats]:
        """Return a place (2,) for the label of each sensor, from 0 to 1, right and down in the picture.

        It is near the corner of the gel that is farthest from the object and other sensors.
        """
        left, right, bottom, top = self.canvas.bounds
        solids = [self.scene.object_m, *(sensor.gel_m for sensor in self.scene.sensors)]
        flat = [self.canvas.view.project(1e3 * triangles_m).reshape(-1, 2) for triangles_m in solids]
        middles, places = np.stack([points.mean(axis=0) for points in flat]), []
        for number, corners in enumerate(flat[1:]):
            others = np.delete(middles, number + 1, axis=0)
            free_mm = np.linalg.norm(corners[:, None] - others, axis=-1).min(axis=1)
            at = LABEL * corners[free_mm.argmax()] + (1 - LABEL) * middles[number + 1]
            places.append((at - [left, top]) / [right - left, bottom - top])
        return places

    def _draw(self, T_sensor_object: Sequence[Floats], sensors: Sequence[DrawnSensor]) -> Float32:
        surfaces = [move_triangles(self.scene.mesh.triangles_m, T) for T in T_sensor_object]
        colours = [STEEL] * len(surfaces) + [GEL, HOUSING] * len(sensors)
        surfaces += [part for sensor in sensors for part in (sensor.gel_m, sensor.housing_m)]
        return self.canvas.draw_solids([1e3 * surface for surface in surfaces], colours)[1]

    def _mark_truth(self, image: Float32) -> Float32:
        return image if self.truth is None else blend(image, self.truth, TRUTH_OPACITY)
