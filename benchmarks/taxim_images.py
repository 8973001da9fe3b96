#!/usr/bin/env python3
"""Locates parts on the gel of Taxim, a tactile simulator that was written by others.

Taxim draws the gel's surface and its image, with the colours of its GelSight and a flat gel. Its gel is no elastic
layer: it follows the object where the object reaches deeper than 40 % of the press, and is smoothed with Gaussian
pyramids elsewhere. The sensor is calibrated as by `tactile-loc calibrate` on images of a pressed ball, without labels.
Parts are pressed from any direction, by 30 to 90 % of the deepest press, and drawn by ray casting.

The first table has the errors of the found circles and of the read surfaces. The second has the press depths that are
read for sharp tips by contact mechanics, from Taxim's gel surfaces and from its images. The last table has the located
touches. Touches are read from exact shapes, from Taxim's gel surfaces and from its images, and located with a gel that
is rigid or the calibrated elastic layer. `first` and `listed` are the shares of examples in which the first pose, or
any listed pose, is within 1 mm (root mean square over the surface, modulo symmetry). An example that ends in an error
counts as not located.

Meshes are given as FILE[:UNITS] or a demo object's name.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_parser, make_source, name_asked, open_asked
from numpy.typing import NDArray
from tactile_loc_benchmark.sources.calibrating import calibrate_sensor
from tactile_loc_benchmark.sources.taxim_images import TaximGel
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.errors import TactileLocError, TouchError
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.io.images import write_image
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.sensors.calibration.folder import Calibration, read_calibration
from tactile_loc.sensors.calibration.labelling import label_presses
from tactile_loc.sensors.calibration.press_table import TABLE
from tactile_loc.sensors.reading.reading import (
    extrapolate_press_m,
    find_contact_shape,
    find_gel_surface,
    measure_press_m,
    recover_indentation,
)
from tactile_loc.sensors.reading.surface import differentiate
from tactile_loc.slots.registry import registry
from tactile_loc.store.store import StageStore

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Image = NDArray[np.uint8]

MM = 1e3
BALL_MM, PRESSES = 3.0, 50
DEPTHS_MM = (0.3, 0.9)  # of the ball
INSIDE = 0.2  # the ball's centre keeps this share of the image's sides from the border
SPARE = 2  # touches of an example in excess of the largest number, because readings may be refused
COUNTS = (1, 3, 5)
NEAR_M = 1e-3
TIPS = ("cone, 45°", "cone, 30°", "corner of a cube", "ridge, 90°", "ridge, 60°", "ball, 3 mm")
TIP_MM = (0.3, 0.6, 0.9)
TIP_PLACES = 4
COVERED = 2.0  # errors of a press that its uncertainty covers, standard deviations
NEARLY = 0.05  # share of a press that is no error


def press(sensor: TaximGel, depth_m: Float32, press_m: float) -> tuple[Float32, Image]:
    """Return the indentation (H, W), metres, and the image (H, W, 3), given the contact depths in a rigid gel."""
    return sensor.find_surface_m(depth_m, press_m), sensor.draw_image(depth_m, press_m)


def find_distances_mm(geometry: SensorGeometry, x_mm: float, y_mm: float) -> tuple[Float64, Float64]:
    """Return the offsets along x and y (H, W), mm, of the pixels from a point of the gel, mm from the upper left."""
    pitch_mm = MM * geometry.pixel_pitch_m
    x = (np.arange(geometry.width_px) + 0.5) * pitch_mm - x_mm
    y = (np.arange(geometry.height_px) + 0.5) * pitch_mm - y_mm
    across, down = np.meshgrid(x, y)
    return across, down


def shape_tip(name: str, across_mm: Float64, down_mm: Float64, turn_rad: float) -> Float64:
    """Return the heights (H, W), mm, of a tip over its deepest point. Angles of tips are between sides and the gel."""
    x = np.cos(turn_rad) * across_mm + np.sin(turn_rad) * down_mm
    y = np.cos(turn_rad) * down_mm - np.sin(turn_rad) * across_mm
    radius = np.hypot(x, y)
    if name.startswith("ball"):
        return np.where(radius < BALL_MM, BALL_MM - np.sqrt(np.maximum(BALL_MM**2 - radius**2, 0)), BALL_MM)
    if name.startswith("corner"):  # three planes, whose normals have angles of acos(1 / sqrt(3)) with the gel's
        ways = [np.cos(a) * x + np.sin(a) * y for a in 2 * np.pi / 3 * np.arange(3)]
        return np.sqrt(2) * np.max(ways, axis=0)
    angle_deg = float(name.split(",")[1].strip(" °"))
    if name.startswith("cone"):
        return np.tan(np.radians(angle_deg)) * radius
    steep = np.tan(np.radians(90 - angle_deg / 2))  # of a ridge with this angle between its two sides
    return np.maximum(steep * np.abs(y), 10 * (np.abs(x) - 2.5))


def write_presses(sensor: TaximGel, folder: Path, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """Write images of a pressed ball and of the untouched gel, and return the balls' x, y and depth, mm."""
    geometry, balls = sensor.geometry, []
    sides_mm = MM * geometry.pixel_pitch_m * np.array([geometry.width_px, geometry.height_px])
    folder.mkdir(parents=True)
    for number in range(PRESSES + 1):
        x_mm, y_mm = sides_mm * (INSIDE + (1 - 2 * INSIDE) * rng.random(2))
        press_mm = rng.uniform(*DEPTHS_MM) if number else 0.0
        height_mm = shape_tip("ball", *find_distances_mm(geometry, x_mm, y_mm), 0.0)
        image = sensor.draw_image((height_mm / MM).astype(np.float32), press_mm / MM)
        write_image(folder / f"image-{number:03d}.png", image)
        if number:
            balls.append((x_mm, y_mm, press_mm))
    return balls


def calibrate(presses: Path, out: Path, camera: SensorGeometry) -> Calibration:
    """Calibrate on a folder of images, as `tactile-loc calibrate` without a table, and return the sensor."""
    label_presses(presses, None, BALL_MM, MM * camera.pixel_pitch_m)
    return read_calibration(calibrate_sensor(presses, camera, out))


def report_calibration(
    known: Calibration, sensor: TaximGel, presses: Path, balls: list[tuple[float, float, float]]
) -> Iterator[str]:
    """Yield the rows of the first table."""
    pitch_mm = MM * sensor.geometry.pixel_pitch_m
    off_px, radii, errors_mm, steepest = [], [], [], []
    with (presses / TABLE).open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "ball"]
    for row in rows:
        x_mm, y_mm, press_mm = balls[int(row["image"][6:9]) - 1]
        x_px, y_px = float(row["center_x_px"]), float(row["center_y_px"])
        off_px.append(np.hypot(x_px - x_mm / pitch_mm, y_px - y_mm / pitch_mm))
        radii.append(float(row["radius_px"]) * pitch_mm / np.sqrt(2 * BALL_MM * press_mm - press_mm**2))
        height_mm = shape_tip("ball", *find_distances_mm(sensor.geometry, x_mm, y_mm), 0.0)
        surface_m, image = press(sensor, (height_mm / MM).astype(np.float32), press_mm / MM)
        true_m, read_m = reduce_surface(surface_m, known.geometry), known.read_indentation(image)
        errors_mm.append(MM * np.sqrt(np.mean((read_m - true_m)[true_m > 0.1 * press_mm / MM] ** 2)))
        steepest.append(measure_press_m(read_m, known.geometry) / measure_press_m(true_m, known.geometry))
    gel = known.record.get("gel", {})
    yield f"| images with a found ball, of {len(balls)} | {len(rows)} |"
    yield f"| centres of circles off by, px (median, 90 %) | {np.median(off_px):.1f}, {np.quantile(off_px, 0.9):.1f} |"
    yield f"| radius of circles / radius of penetration (median) | {np.median(radii):.2f} |"
    yield f"| read surface off within the imprint, mm (median) | {np.median(errors_mm):.3f} |"
    yield f"| read / true press of the surface (median) | {np.median(steepest):.2f} |"
    yield f"| effective thickness, mm | {MM * gel.get('thickness_m', np.nan):.1f} |"
    yield f"| coating, mm | {MM * gel.get('coating_m', np.nan):.2f} |"


def reduce_surface(surface_m: Float32, geometry: SensorGeometry) -> Float32:
    """Return a surface (H, W), metres, at a smaller size, by averaging over the area of each new pixel."""
    rows, columns = (old // new for old, new in zip(surface_m.shape, geometry.shape, strict=True))
    height, width = geometry.shape
    return surface_m.reshape(height, rows, width, columns).mean(axis=(1, 3)).astype(np.float32)


def report_tips(known: Calibration, sensor: TaximGel, rng: np.random.Generator) -> Iterator[str]:
    """Yield the rows of the second table: shares of the true press that are read, and that their uncertainty covers."""
    geometry = sensor.geometry
    sides_mm = MM * geometry.pixel_pitch_m * np.array([geometry.width_px, geometry.height_px])
    for name in TIPS:
        exact, read = ([], []), ([], [])  # shares of the press, and whether the uncertainty covers their error
        for press_mm in TIP_MM:
            for _ in range(TIP_PLACES):
                x_mm, y_mm = sides_mm * rng.uniform(0.3, 0.7, 2)
                height_mm = shape_tip(name, *find_distances_mm(geometry, x_mm, y_mm), rng.uniform(0, 2 * np.pi))
                surface_m, image = press(sensor, (height_mm / MM).astype(np.float32), press_mm / MM)
                seen_m = reduce_surface(surface_m, known.geometry)
                slopes = differentiate(seen_m, known.geometry)
                found = recover_indentation(seen_m, slopes, known.geometry), known.read_indentation(image)
                for (shares, covered), indentation_m in zip((exact, read), found, strict=True):
                    press_m, std_m = extrapolate_press_m(indentation_m, known.geometry)
                    shares.append(MM * press_m / press_mm)
                    covered.append(abs(MM * press_m - press_mm) < max(COVERED * MM * std_m, NEARLY * press_mm))
        cells = (
            f"{np.median(v):.2f} | {np.min(v):.2f} to {np.max(v):.2f} | {100 * np.mean(c):.0f} %"
            for v, c in (exact, read)
        )
        yield f"| {name} | {' | '.join(cells)} |"


@dataclasses.dataclass(frozen=True, eq=False)
class Pressed:
    """One press: its touch on a rigid gel, and Taxim's gel surface (H, W), metres, and image (H, W, 3)."""

    touch: Touch
    surface_m: Float32
    image: Image


def draw_presses(source: RobotTouches, sensor: TaximGel, count: int, rng: np.random.Generator) -> list[Pressed]:
    """Draw presses of an object from any direction."""
    found = []
    for touch in source.draw_example(count, rng)[0]:
        scene = Scene(source.object, sensor.geometry.press(touch.indentation_m), source.renderer)
        depth_m = scene.render_contact_depths(np.asarray(touch.T_sensor_object)[None])[0]
        found.append(Pressed(touch, *press(sensor, depth_m, touch.indentation_m)))
    return found


def read_shape(one: Pressed, what: str, localizer: Localizer, known: Calibration) -> ContactShape:
    """Return the contact shape that a localizer's sensor reads from a press. Raises TouchError if it reads none."""
    geometry = localizer.scene.geometry
    if what == "exact shape":
        return one.touch.contact_shape
    if what == "image":
        return localizer.sensor.contact_shape(one.image)
    surface_m = reduce_surface(one.surface_m, geometry)
    if not geometry.gel.is_elastic:
        return find_contact_shape(surface_m, geometry, known.noise_m)
    recovered_m = recover_indentation(surface_m, differentiate(surface_m, geometry), geometry)
    return find_gel_surface(recovered_m, geometry, known.noise_m)


@dataclasses.dataclass
class Tally:
    """Results of one case: refused and all readings, and for each number of touches, errors in mm and times in ms."""

    refused: int = 0
    readings: int = 0
    first_mm: dict[int, list[float]] = dataclasses.field(default_factory=lambda: {n: [] for n in COUNTS})
    listed_mm: dict[int, list[float]] = dataclasses.field(default_factory=lambda: {n: [] for n in COUNTS})
    times_ms: dict[int, list[float]] = dataclasses.field(default_factory=lambda: {n: [] for n in COUNTS})

    def add(self, other: Tally) -> None:
        """Add the results of another case."""
        self.refused += other.refused
        self.readings += other.readings
        for name in ("first_mm", "listed_mm", "times_ms"):
            for count in COUNTS:
                getattr(self, name)[count] += getattr(other, name)[count]

    def write_row(self, *names: str) -> str:
        """Return a row of the table."""
        cells = []
        for n in COUNTS:
            first, listed = (np.array(values[n]) < MM * NEAR_M for values in (self.first_mm, self.listed_mm))
            cells += [f"{first.mean():.0%}".replace("%", " %"), f"{listed.mean():.0%}".replace("%", " %")]
        times = np.median(self.times_ms[3]) if self.times_ms[3] else np.nan
        return f"| {' | '.join(names)} | {' | '.join(cells)} | {self.refused} of {self.readings} | {times:.0f} |"


def measure(localizer: Localizer, examples: list[list[Pressed]], what: str, known: Calibration) -> Tally:
    """Locate examples with the first touches that the sensor does not refuse."""
    tally, metric = Tally(), PoseMetric(localizer.object)
    for presses in examples:
        touches: list[Touch] = []
        for one in presses:
            if len(touches) == max(COUNTS):
                break
            tally.readings += 1
            try:
                shape = read_shape(one, what, localizer, known)
                touches.append(dataclasses.replace(one.touch, contact_shape=shape, geometry=localizer.scene.geometry))
            except TouchError:
                tally.refused += 1
        for count in COUNTS:
            first, listed, took_ms = locate(localizer, touches[:count], metric)
            tally.first_mm[count].append(first)
            tally.listed_mm[count].append(listed)
            tally.times_ms[count].append(took_ms)
    return tally


def locate(localizer: Localizer, touches: list[Touch], metric: PoseMetric) -> tuple[float, float, float]:
    """Return the errors of the first and the best listed pose, mm, and the time, ms. Errors are inf without a pose."""
    start = time.perf_counter()
    try:
        found = localize_together([(localizer, touch) for touch in touches])
    except TactileLocError:
        return np.inf, np.inf, 1e3 * (time.perf_counter() - start)
    took_ms = 1e3 * (time.perf_counter() - start)
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    truth = np.asarray(touches[0].T_sensor_object)
    errors_mm = MM * metric.symmetric_distance(poses, np.broadcast_to(truth, poses.shape))
    return float(errors_mm[0]), float(errors_mm.min()), took_ms


CASES = (
    ("exact shape", "rigid"), ("gel surface", "rigid"), ("gel surface", "layer"),
    ("image", "rigid"), ("image", "layer"),
)  # fmt: skip


def locate_objects(
    names: list[str], known: Calibration, sensor: TaximGel, arguments: argparse.Namespace, say: Callable[[str], None]
) -> None:
    """Locate objects in all cases, and report the rows of the last table."""
    sensors: dict[str, dict[str, Any]] = {"rigid": {"gel": "rigid"}, "layer": {}}
    store = StageStore(arguments.store)
    total = {case: Tally() for case in CASES}
    for name in names:
        localizers = {
            gel: open_asked(
                name, store=store,
                sensor={"name": "calibrated", "path": str(known.folder), **options},
            )
            for gel, options in sensors.items()
        }  # fmt: skip
        source = make_source(localizers["rigid"].object, localizers["rigid"].scene.geometry)
        examples = [
            draw_presses(source, sensor, max(COUNTS) + SPARE, np.random.default_rng([arguments.seed, number]))
            for number in range(arguments.examples)
        ]
        for case in CASES:
            what, gel = case
            tally = measure(localizers[gel], examples, what, known)
            total[case].add(tally)
            say(tally.write_row(name_asked(name), what, gel))
    for (what, gel), tally in total.items():
        say(tally.write_row("all", what, gel))


def main() -> None:
    """Measure, and print three tables."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--examples", type=int, default=12)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--store", type=Path, help="folder of stored builds")
    parser.add_argument("--keep", type=Path, help="new folder for the images of presses and the calibrated sensor")
    arguments = parser.parse_args()
    mini = registry().create("sensor", "gelsight-mini", {}).native
    sensor = TaximGel("gelsight", mini)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        balls = write_presses(sensor, folder / "presses", np.random.default_rng([arguments.seed, 0, 0]))
        known = calibrate(folder / "presses", folder / "sensor", mini)
        print("| calibration | |\n|---|---|")
        print("\n".join(report_calibration(known, sensor, folder / "presses", balls)), flush=True)
        print("\n| tip | gel surface | range | covered | image | range | covered |\n|---|---|---|---|---|---|---|")
        print("\n".join(report_tips(known, sensor, np.random.default_rng([arguments.seed, 1, 0]))), flush=True)
        heads = " | ".join(f"{n}: first | listed" for n in COUNTS)
        print(f"\n| object | touches from | gel | {heads} | refused | three, ms |")
        print("|---|---|---|" + "---|" * (2 * len(COUNTS) + 2))
        locate_objects(arguments.objects, known, sensor, arguments, lambda row: print(row, flush=True))


if __name__ == "__main__":
    main()
