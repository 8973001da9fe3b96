#!/usr/bin/env python3
"""Draw the moving picture of the README: a finger touches an object three times, and its possible poses become one.

Touches and results are those of the program. Writes docs/images/touches.gif and touches-dark.gif.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from tactile_loc import Localization, Localizer, localize_together, paint_shape
from tactile_loc.plugin.helpers import make_transform, make_translation, map_in_threads, rotation_about
from tactile_loc.view.drawn_scene import DrawnSensor, move_triangles
from tactile_loc.view.one_versus_several import find_font
from tactile_loc.view.palette import DARK, LIGHT, Palette
from tactile_loc.view.pose_panel import Canvas, fit_bounds
from tactile_loc.view.raytracing import Viewpoint, blend

IMAGES = Path(__file__).parent / "images"
OBJECT, SENSOR, SEED = "hook", "gelsight-mini", 13  # with this seed, all fingers are visible from the viewpoint
WIDTH, HEIGHT = 960, 540  # pixels
HEAD, FOOT, COLUMN, SIDE = 76, 40, 170, 118  # pixels of the heading, the legend, the contact shapes, and one of these
VIEW = Viewpoint(azimuth_deg=30.0, elevation_deg=20.0)
T_SCENE_BASE = make_transform(rotation_about([0.0, 0.0, 1.0], np.pi), np.zeros(3))  # turns the scene to the viewer
AWAY_M, MOVES, FADES = 0.03, 9, 5  # way of the finger, and numbers of pictures of its way and of a change
MOVE_MS, HOLD_MS, LAST_MS = 60, 1500, 3500
MOST_GHOSTS, GHOST, EARLIER = 10, 0.32, 0.25  # drawn poses, and opacities of a pose and of an earlier finger
COLOURS, NEAR = 240, 24  # of the picture; sum of differences, 0 to 255, of colours that become the paper

Array = NDArray[np.float64]
Layer = NDArray[np.float32]  # (H, W, 4): colours, 0 to 1, multiplied by opacity, and opacity


@dataclass(frozen=True, eq=False)
class Film:
    """Draws the pictures in one palette. `stages` are the results after one touch, two touches, and so on."""

    stages: Sequence[Localization]
    palette: Palette

    @cached_property
    def sensors(self) -> list[DrawnSensor]:
        """The sensor at each touch."""
        return [DrawnSensor.of(touch, T_SCENE_BASE @ touch.T_base_sensor) for touch in self.stages[-1].touches]

    @cached_property
    def truth_m(self) -> Array:
        """The triangles (F, 3, 3) of the object at its true pose, metres."""
        T = self.sensors[0].T_scene_sensor @ self.stages[0].touch.T_sensor_object
        return move_triangles(self.stages[0].object.mesh.triangles_m, T)

    @cached_property
    def canvas(self) -> Canvas:
        """The part of the scene that is drawn: the object at all poses, and the sensors on their whole way."""
        shown = [*self.sensors, *(move_away(one, AWAY_M) for one in self.sensors)]
        solids = [self.truth_m, *(part for one in shown for part in (one.gel_m, one.body_m))]
        solids += [move_triangles(self.stages[0].object.mesh.triangles_m, T) for T in list_poses(self.stages[0])]
        left, right, bottom, top = fit_bounds(VIEW, [1e3 * part for part in solids], 0.02, 0.02)
        width, height = WIDTH - COLUMN, HEIGHT - HEAD - FOOT
        room = max((right - left) / width, (top - bottom) / height)
        x, y = 0.5 * (left + right), 0.5 * (bottom + top)
        half_x, half_y = 0.5 * room * width, 0.5 * room * height
        size_mm = 1e3 * float(np.ptp(self.truth_m.reshape(-1, 3), axis=0).max())
        return Canvas(VIEW, (x - half_x, x + half_x, y - half_y, y + half_y), max(width, height), 0.04 * size_mm)

    @cached_property
    def outline(self) -> Layer:
        """The edges of the object at its true pose."""
        return self.canvas.draw_edges(1e3 * self.truth_m, self.palette.truth, 3)

    def draw_solids(self, poses: Sequence[Array], sensors: Sequence[DrawnSensor]) -> Layer:
        """Return the object at some poses T_scene_object (4, 4), metres, and some sensors."""
        best, gel, housing = map(Palette.rgb, (self.palette.best, self.palette.gel, self.palette.housing))
        mesh = self.stages[0].object.mesh
        solids = [(move_triangles(mesh.triangles_m, T), best) for T in poses]
        for one in sensors:
            solids += [(one.gel_m, gel), (one.housing_m, housing), (one.body_m, housing)]
        if not solids:
            return np.zeros_like(self.outline)
        return self.canvas.draw_solids([1e3 * part for part, _ in solids], [colour for _, colour in solids])[1]

    def draw_scene(self, found: Localization | None, touches: int, away_m: float) -> Layer:
        """Return the poses of a result, and the finger of the last of some touches, `away_m` metres before its place.

        A single pose is solid, and several are seen through. Earlier fingers are faint.
        """
        moved = [move_away(one, away_m) for one in self.sensors[touches - 1 : touches] if touches]
        poses = [] if found is None else list_poses(found)
        image = self.draw_solids([], moved)
        for ghost in map_in_threads(lambda T: self.draw_solids([T], moved), poses[::-1]):
            image = blend(image, ghost, 1.0 if len(poses) == 1 else GHOST)
        image = blend(image, self.draw_solids([], self.sensors[: max(touches - 1, 0)]), EARLIER)
        return blend(image, self.outline, 0.9)

    def draw(self) -> Iterator[tuple[Image.Image, int]]:
        """Yield each picture, and the milliseconds for which it is shown."""
        yield self.finish(self.draw_scene(None, 0, 0.0), None, 0), HOLD_MS
        before: Localization | None = None
        for number, found in enumerate(self.stages, 1):
            for step in range(1, MOVES + 1):
                scene = self.draw_scene(before, number, AWAY_M * (1 - step / MOVES) ** 2)
                yield self.finish(scene, before, number - 1 if step < MOVES else number), MOVE_MS
            old, new = scene, self.draw_scene(found, number, 0.0)
            for step in range(1, FADES + 1):
                share = np.float32(step / FADES)
                last = LAST_MS if number == len(self.stages) else HOLD_MS
                scene = (1 - share) * old + share * new
                yield self.finish(scene, found, number), last if step == FADES else MOVE_MS
            before = found

    def finish(self, scene: Layer, found: Localization | None, touches: int) -> Image.Image:
        """Return a scene as a picture with the verdict on `found`, the contact shapes of `touches`, and a legend."""
        palette, small, legend, line = self.palette, find_font(15), find_font(19), HEIGHT - 22
        flat = scene[..., :3] + (1 - scene[..., 3:]) * Palette.rgb(palette.paper)
        page = Image.new("RGB", (WIDTH, HEIGHT), palette.paper)
        page.paste(Image.fromarray((255 * flat.clip(0, 1)).astype(np.uint8)), (0, HEAD))
        pen = ImageDraw.Draw(page)
        pen.line((26, line, 50, line), palette.truth, 4)
        pen.text((58, line), "true pose, unknown to the program", palette.soft, legend, anchor="lm")
        if found is not None:
            pen.rectangle((450, line - 7, 474, line + 7), palette.best, palette.ink)
            pen.text((482, line), "poses that explain the touches", palette.soft, legend, anchor="lm")
        bold, left = find_font(22, "Bold"), 26.0
        if found is not None:
            verdict = str(found.verdict)
            right = left + pen.textlength(verdict, bold) + 32
            pen.rounded_rectangle((left, 18, right, 58), 8, palette.find_verdict(verdict))
            pen.text((left + 16, 38), verdict, "#ffffff", bold, anchor="lm")
            left = right + 18
        pen.text((left, 38), describe(found), palette.ink, find_font(20), anchor="lm")
        for number, touch in enumerate(self.stages[-1].touches[:touches]):
            x, y = WIDTH - COLUMN + 26, HEAD + 8 + (SIDE + 30) * number
            page.paste(Image.fromarray(paint_shape(touch.contact_shape, touch.geometry)).resize((SIDE, SIDE)), (x, y))
            pen.rectangle((x, y, x + SIDE, y + SIDE), outline=palette.soft)
            pen.text((x + SIDE / 2, y + SIDE + 13), f"touch {number + 1}", palette.soft, small, anchor="mm")
        return page


def move_away(sensor: DrawnSensor, away_m: float) -> DrawnSensor:
    """Return a sensor some metres before its place."""
    T = sensor.T_scene_sensor @ make_translation([0, 0, -away_m])
    return DrawnSensor(sensor.geometry, T, sensor.touch)


def list_poses(found: Localization) -> list[Array]:
    """Return the poses T_scene_object (4, 4), metres, that explain the touches equally well, the best first."""
    return [T_SCENE_BASE @ one.T_base_object for one in found.equal_explanations[:MOST_GHOSTS]]


def describe(found: Localization | None) -> str:
    """Return what the touches show, in words."""
    if found is None:
        return f"Where is the {OBJECT}? A finger touches it three times."
    count, touches = len(found.equal_explanations), len(found.touches)
    least = "at least " if count == len(found.hypotheses) else ""
    text = f"{touches} touch{'' if touches == 1 else 'es'}: {least}{count} pose"
    if count > 1:
        return f"{text}s fit"
    errors_m = found.measure_errors_m(found.object)
    assert errors_m is not None
    return f"{text} fits, within {np.ceil(1e5 * errors_m[0]) / 100:.2f} mm of the true pose"


def save(path: Path, film: Film) -> Path:
    """Write the pictures as a GIF whose colours are those of the last picture and the first."""
    frames, times_ms = zip(*film.draw(), strict=True)
    both = Image.new("RGB", (WIDTH, 2 * HEIGHT))
    both.paste(frames[-1], (0, 0))
    both.paste(frames[len(frames) // 2], (0, HEIGHT))
    shared = both.quantize(COLOURS)
    entries = np.array(shared.getpalette(), int).reshape(-1, 3)
    paper = 255 * Palette.rgb(film.palette.paper)
    entries[np.abs(entries - paper).sum(axis=1) < NEAR] = paper  # the mean of similar colours would tint the paper
    shared.putpalette(entries.ravel().tolist())
    first, *others = (one.quantize(palette=shared, dither=Image.Dither.NONE) for one in frames)
    first.save(path, save_all=True, append_images=others, duration=list(times_ms), loop=0, optimize=True)
    return path


def main() -> None:
    """Locate the object after each touch, and draw the film in both palettes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=IMAGES)
    out = parser.parse_args().out
    localizer = Localizer.create(OBJECT, sensor=SENSOR)
    observations = [(localizer, touch) for touch in localizer.simulate_together(3, SEED)]
    stages = [localize_together(observations[:count]) for count in (1, 2, 3)]
    for name, palette in (("touches.gif", LIGHT), ("touches-dark.gif", DARK)):
        print(save(out / name, Film(stages, palette)))


if __name__ == "__main__":
    main()
