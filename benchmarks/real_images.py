#!/usr/bin/env python3
"""Errors of slopes, depths and poses from real images of gels, with calibrations on presses of a ball only.

`--data` is a folder with the public sets gelslim_balls, gelsight_mini_balls, gelsight_balls_160x120, fots_balls and
gelslim_shapes. The last set has other shapes on the first sensor. Slope errors are means over held-out presses of
several splits. The shapes are read with a calibration on four fifths of the balls (split 0). Times are medians on this
machine.

The press depths of the shapes are given in their file names. They are also measured in presses of the small sphere,
whose radius is known. `circle` is the height of the sphere's cap over the visible circle, plus the depth of the gel at
this circle. `surface` is the depth of the top of the sphere that fits the middle of the surface best.
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_data_parser, write_head
from numpy.typing import NDArray

from tactile_loc import EstimatorRecipe, Localizer, SensorGeometry, StageStore, convert_presses
from tactile_loc.io.images import load_image
from tactile_loc.sensors.calibration.outcome import CalibrationOutcome, calibrate
from tactile_loc.sensors.calibration.presses import PressFolder, choose_size_px, read_presses
from tactile_loc.sensors.reading.circles import Circle, compare_colours, find_imprint, find_rim
from tactile_loc.sensors.reading.reading import Health, measure_health, measure_press_m

# folder or file, ball radius and pixel size in mm, image size
SETS = {
    "gelslim": ("gelslim_balls", 2.92, 0.059259, (320, 320)),
    "GelSight Mini": ("gelsight_mini_balls", 9.47 / 2, 0.0634, (320, 240)),
    "160 x 120": ("gelsight_balls_160x120/dataPack_small.npz", 2.0, 0.1245, (160, 120)),
    "FOTS": ("fots_balls", 4.7 / 2, 1 / 19.58, (240, 320)),
}
PRESSES_MM = ("0.25", "0.5", "0.75", "1.0")
SMALL_SPHERE_MM = 2.92
TIP_Z_M = 20e-3
BORDER_MM = 0.3  # excluded border of the tip, where the gel does not follow the tip's shape
AROUND_MM = (0.5, 1.0)  # range of distances from the tip in which the gel around the tip has gentle slopes
DARK, WHITE = 12, 245  # counts between which a colour is not saturated
GRID_MM = 1.6  # gives a bank of about 13 000 poses with 1600 cells; half the spacing would take 16 GB


def read(name: str, data: Path, folder: Path) -> PressFolder:
    """Convert a public set into a folder of presses, and read it."""
    source, ball_radius_mm, mm_per_px, (width, height) = SETS[name]
    convert_presses(data / source, folder, ball_radius_mm, mm_per_px)
    scale = 1e3 / mm_per_px
    geometry = SensorGeometry(
        "orthographic", width, height, scale, scale, width / 2, height / 2, standoff_m=0.01, max_depth_m=1.5e-3
    )
    return read_presses(folder, geometry, median_background=name == "FOTS")


def reduce(presses: PressFolder, name: str, folder: Path) -> PressFolder:
    """Return a set's presses at the size that `tactile-loc calibrate` uses."""
    size_px = choose_size_px(presses.camera)
    return read_presses(folder, presses.camera, median_background=name == "FOTS", size_px=size_px)


def list_health_rows(calibrations: dict[str, CalibrationOutcome], sets: dict[str, PressFolder]) -> list[str]:
    """Return table rows of the least and largest health of each set's images with each calibration.

    For the calibration's own set, only held-out presses count. For the other sets, all presses count. Each cell has the
    health without and with the set's own image of the untouched gel.
    """
    rows = []
    for name, calibrated in calibrations.items():
        cells = []
        for other, presses in sets.items():
            held_out = calibrated.held_out if other == name else range(len(presses))
            plain = [_figure(calibrated, presses, k, calibrated.estimator.background) for k in held_out]
            zeroed = [_figure(calibrated, presses, k, presses.background) for k in held_out]
            cells += [f"{min(plain):.1f} to {max(plain):.1f}, {min(zeroed):.1f} to {max(zeroed):.1f}"]
        rows.append(f"| {name} | {' | '.join(cells)} |")
    return rows


def _figure(calibrated: CalibrationOutcome, presses: PressFolder, number: int, untouched: NDArray[np.uint8]) -> float:
    """Return the health of an image, resized to the calibration's size, as a multiple of the worst training press."""
    estimator = calibrated.estimator
    image, zero = (_resize(i, estimator.geometry.shape) for i in (presses.images[number], untouched))
    estimator.untouched, kept = zero, estimator.untouched
    found: Health = measure_health(image, zero, estimator.read(image)[1], estimator.geometry)
    estimator.untouched = kept
    return found.compare(Health.of_record(calibrated.record["health"]))


def _resize(image: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    from PIL import Image

    return np.asarray(Image.fromarray(image).resize(shape[::-1], Image.Resampling.BOX))


def measure_slopes(presses: PressFolder, splits: int) -> tuple[CalibrationOutcome, dict[str, float]]:
    """Calibrate on several splits. Return the first calibration and the mean errors."""
    done = [calibrate(presses, EstimatorRecipe(seed=seed)) for seed in range(splits)]
    means = [calibrated.mean_errors for calibrated in done]
    image = presses.images[0]
    seconds = [_time(lambda: done[0].estimator.read(image)) for _ in range(9)]
    mean = {key: float(np.mean([m[key] for m in means])) for key in means[0]}
    return done[0], {**mean, "ms": 1e3 * float(np.median(seconds))}


@dataclass(frozen=True)
class SpherePress:
    """A press of the small sphere, measured in its image: the visible circle, and depths in mm.

    `cap_mm` is the height of the sphere above the circle, and `rim_mm` is the depth of the gel at the circle. `top_mm`
    is the depth of the top of the best fitting sphere, and `rms_mm` is this sphere's RMS distance from the surface in
    the circle.
    """

    circle: Circle
    radius_mm: float
    cap_mm: float
    rim_mm: float
    top_mm: float
    rms_mm: float

    @classmethod
    def of(cls, calibrated: CalibrationOutcome, image: NDArray[np.uint8]) -> SpherePress:
        """Measure a press in its image (H, W, 3)."""
        estimator = calibrated.estimator
        change = compare_colours(image, estimator.background)
        imprint = find_imprint(change)
        circle = find_rim(change, imprint.circle)
        pitch_mm = 1e3 * estimator.geometry.pixel_pitch_m
        away_mm, radius_mm = pitch_mm * circle.measure_distance_px(image.shape[:2]), pitch_mm * circle.radius_px
        below_mm = SMALL_SPHERE_MM - np.sqrt(SMALL_SPHERE_MM**2 - np.minimum(away_mm, radius_mm) ** 2)
        surface_mm = 1e3 * estimator.read(image)[0]
        tops_mm = surface_mm + below_mm  # top of the sphere, according to each pixel in contact
        top_mm = float(tops_mm[away_mm < radius_mm / 2].mean())
        rim_mm = float(surface_mm[np.abs(away_mm - radius_mm) < pitch_mm].mean())
        return cls(
            circle, radius_mm, below_mm.max(), rim_mm, top_mm, _measure_rms((tops_mm - top_mm)[away_mm < radius_mm])
        )

    def write_row(self, stated: str) -> str:
        """Return a row of the table of presses."""
        by_circle = f"{self.cap_mm:.3f} + {self.rim_mm:.3f} = {self.cap_mm + self.rim_mm:.3f}"
        return f"| {stated} | {self.radius_mm:.2f} | {by_circle} | {self.top_mm:.3f} | {self.rms_mm:.3f} |"


def measure_growth(calibrated: CalibrationOutcome, shapes: Path) -> list[float]:
    """Return the strength of the colours around the prism's tip at each press, as multiples of the strength at 0.5 mm.

    A flat face touches the same area at any press. Therefore the heights around the tip are proportional to the press
    depth, and so are the colours of small slopes, without any calibration. Only pixels that are never saturated, at a
    distance in `AROUND_MM` from the tip, count.
    """
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    images = [_read_image(shapes / f"prism_{press}_real.png") for press in PRESSES_MM]
    pose, geometry = _write_pose(json.loads((shapes / "poses.json").read_text()), "0.5"), calibrated.estimator.geometry
    tip = _find_tip(pose, shapes / "prism.stl", geometry.shape, 0.0)
    away_mm = distance_transform_edt(~tip) * 1e3 * geometry.pixel_pitch_m
    looked_at = (away_mm > AROUND_MM[0]) & (away_mm < AROUND_MM[1])
    for image in images:
        looked_at &= ((image > DARK) & (image < WHITE)).all(axis=2)
    untouched = calibrated.estimator.background.astype(float)
    changes = [gaussian_filter(image - untouched, (2, 2, 0))[looked_at] for image in images]
    usual = changes[PRESSES_MM.index("0.5")]
    return [float((change * usual).sum() / (usual**2).sum()) for change in changes]


def measure_depths(calibrated: CalibrationOutcome, shapes: Path, spheres: dict[str, SpherePress]) -> list[str]:
    """Return rows of the table of depths of the prism's tip, compared with the given depths and the sphere's depths."""
    poses = json.loads((shapes / "poses.json").read_text())
    rows = []
    for press, times in zip(PRESSES_MM, measure_growth(calibrated, shapes), strict=True):
        indentation = calibrated.estimator.read(_read_image(shapes / f"prism_{press}_real.png"))[0]
        tip = _find_tip(_write_pose(poses, press), shapes / "prism.stl", indentation.shape)
        tip_mm, press_mm = (
            1e3 * indentation[tip].mean(),
            1e3 * measure_press_m(indentation, calibrated.estimator.geometry),
        )
        stated, seen = (100 * (tip_mm / true_mm - 1) for true_mm in (float(press), spheres[press].top_mm))
        rows.append(f"| {press} | {tip_mm:.3f} | {stated:+.0f} % | {seen:+.0f} % | {press_mm:.3f} | {times:.2f} |")
    return rows


def locate(sensor: Path, shapes: Path, store: Path) -> list[str]:
    """Locate the prism in its images with the default components. Return rows of the table of poses."""
    localizer = Localizer.create(
        shapes / "prism.stl", units="mm", symmetry="none", sensor={"name": "calibrated", "path": str(sensor)},
        grid={"name": "face", "face": "+z", "spacing_mm": GRID_MM}, encoder={"name": "pixel", "cells": 40},
        store=StageStore(store),
    )  # fmt: skip
    poses = json.loads((shapes / "poses.json").read_text())
    rows = []
    for press in PRESSES_MM:
        touch = localizer.read_touch(shapes / f"prism_{press}_real.png")
        localization = localizer.localize(touch)
        turns = [
            _measure_off(h.T_sensor_object, _write_pose(poses, press), touch.geometry) for h in localization.hypotheses
        ]
        x_mm, y_mm, yaw_deg = turns[0]
        apart = min((abs(abs(t[2] - turns[0][2]) - 180) for t in turns[1:]), default=np.inf)
        both = "yes" if apart < 5 else "no"
        half_turn_deg = (yaw_deg + 90) % 180 - 90
        seen_mm = 1e3 * touch.contact_shape.indentation_m
        rows.append(
            f"| {press} | {x_mm:+.2f} | {y_mm:+.2f} | {half_turn_deg:+.2f} | {seen_mm:.3f} | {both} | {len(turns)} |"
        )
    return rows


def _measure_off(T: NDArray[np.float64], pose: dict[str, Any], geometry: SensorGeometry) -> tuple[float, float, float]:
    """Return the error of a pose of the prism: x and y of the tip in mm, and yaw in degrees."""
    tip_m = T @ np.array([0.0, 0.0, TIP_Z_M, 1.0])
    u, v = (value + 0.5 for value in pose["origin_px"])  # the set counts from the first pixel's centre
    sx, sy = geometry.scale_at_surface
    x_m, y_m = (u - geometry.cx) / sx, (v - geometry.cy) / sy
    yaw_deg = float(np.degrees(np.arctan2(T[1, 0], T[0, 0]))) - pose["theta_deg"]
    return 1e3 * float(tip_m[0] - x_m), 1e3 * float(tip_m[1] - y_m), yaw_deg


def _write_pose(poses: dict[str, Any], press: str) -> dict[str, Any]:
    """Return the pose at a press. The lightest press has no pose of its own; the object was at the pose of 0.5 mm."""
    return poses.get(f"prism_{press}") or poses["prism_0.5"]


def _find_tip(
    pose: dict[str, Any], mesh: Path, shape: tuple[int, int], border_mm: float = BORDER_MM
) -> NDArray[np.bool_]:
    """Return the pixels (H, W) that the prism's tip covers, without its border."""
    import trimesh

    tip = trimesh.load(mesh)
    corners = tip.vertices[tip.vertices[:, 2] > 1e3 * TIP_Z_M - 0.1][:, :2]  # type: ignore[attr-defined]
    low, high = corners.min(axis=0) + border_mm, corners.max(axis=0) - border_mm
    v, u = np.mgrid[: shape[0], : shape[1]]
    x, y = ((a - origin) * pose["mm_per_px"] for a, origin in zip((u, v), pose["origin_px"], strict=True))
    c, s = np.cos(np.radians(pose["theta_deg"])), np.sin(np.radians(pose["theta_deg"]))
    along, across = c * x + s * y, s * x - c * y
    return (along > low[0]) & (along < high[0]) & (across > low[1]) & (across < high[1])


def _read_image(path: Path) -> NDArray[np.uint8]:
    return load_image(path, "RGB")[1]


def _measure_rms(values: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _time(work: Any) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = make_data_parser(__doc__)
    parser.add_argument("--splits", type=int, default=3)
    parser.add_argument("--calibrations", action="store_true", help="stop before reading and locating other shapes")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        small, calibrations = {}, {}
        print(write_head("set", "presses", "surface angle", "shape in the contact", "untouched gel", "image to depth"))
        for number, name in enumerate(SETS):
            presses = read(name, arguments.data, work / str(number))
            first, mean = measure_slopes(presses, arguments.splits)
            print(
                f"| {name} | {len(presses)} | {mean['slope_deg']:.2f}° | {1e6 * mean['shape_m']:.0f} um | "
                f"{1e6 * mean['untouched_m']:.0f} um | {mean['ms']:.0f} ms |",
                flush=True,
            )
            small[name] = reduce(presses, name, work / str(number))
            calibrations[name], less = measure_slopes(small[name], arguments.splits)
            size = "{} x {}".format(*choose_size_px(presses.camera))
            print(
                f"| {name}, reduced to {size} | | {less['slope_deg']:.2f}° | {1e6 * less['shape_m']:.0f} um | "
                f"{1e6 * less['untouched_m']:.0f} um | {less['ms']:.0f} ms |",
                flush=True,
            )
            if name == "gelslim":
                sensor = first
                first.write(work / "sensor")
        print()
        print(write_head("health by the calibration of", *small))
        print("\n".join(list_health_rows(calibrations, small)))
        if arguments.calibrations:
            return
        shapes = arguments.data / "gelslim_shapes"
        images = {press: _read_image(shapes / f"sphere_{press}_real.png") for press in PRESSES_MM}
        spheres = {press: SpherePress.of(sensor, image) for press, image in images.items()}
        print()
        print(
            write_head(
                "stated, mm", "circle's radius, mm", "circle: cap + gel", "surface: top", "RMS in the circle, mm"
            )
        )
        print("\n".join(sphere.write_row(press) for press, sphere in spheres.items()))
        print()
        print(
            write_head(
                "stated, mm", "prism's tip, mm", "less stated", "less sphere's", "press, mm", "colours around it"
            )
        )
        print("\n".join(measure_depths(sensor, shapes, spheres)))
        print()
        print(
            write_head(
                "stated, mm", "x off, mm", "y off, mm", "yaw off, °", "press, mm", "both half turns", "hypotheses"
            )
        )
        print("\n".join(locate(work / "sensor", shapes, work / "store")))


if __name__ == "__main__":
    main()
