#!/usr/bin/env python3
"""Real images of gels: how well slopes, depths and a pose come out of them, learned from presses of a ball alone.

`--data` is a folder with the public sets gelslim_balls, gelsight_mini_balls, gelsight_balls_160x120 and fots_balls, and
gelslim_shapes: other shapes on the first sensor. Slope errors are means over presses that were held out, of several
splits. The shapes are read with a calibration on four fifths of the balls (split 0). Times are medians on this machine.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.calibration.calibrate import Calibrated, calibrate
from tactile_loc.calibration.folder import write_calibration
from tactile_loc.calibration.health import Health, health
from tactile_loc.calibration.presses import PressFolder, convert, read_presses, reading_size_px
from tactile_loc.core.sensing import SensorGeometry
from tactile_loc.io.images import load_image
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.store import StageStore

# folder or file, format, ball radius and pixel in mm, image size
SETS = {
    "gelslim": ("gelslim_balls", "circles", 2.92, 0.059259, (320, 320)),
    "GelSight Mini": ("gelsight_mini_balls", "gs_sdk", 9.47 / 2, 0.0634, (320, 240)),
    "160 x 120": ("gelsight_balls_160x120/dataPack_small.npz", "taxim", 2.0, 0.1245, (160, 120)),
    "FOTS": ("fots_balls", "fots", 4.7 / 2, 1 / 19.58, (240, 320)),
}
PRESSES_MM = ("0.25", "0.5", "0.75", "1.0")
SMALL_SPHERE_MM, SPHERE_AT_PX = 2.92, (208.5, 166.5)
TIP_Z_M = 20e-3
BORDER_MM = 0.3  # of the tip, where the gel does not follow


def read(name: str, data: Path, folder: Path) -> PressFolder:
    """Convert a public set into a folder of presses and read it."""
    source, format, ball_radius_mm, mm_per_px, (width, height) = SETS[name]
    convert(data / source, folder, format, ball_radius_mm, mm_per_px)
    scale = 1e3 / mm_per_px
    geometry = SensorGeometry(
        "orthographic", width, height, scale, scale, width / 2, height / 2, standoff_m=0.01, max_depth_m=1.5e-3
    )
    return read_presses(folder, geometry, median_background=name == "FOTS")


def reduced(presses: PressFolder, name: str, folder: Path) -> PressFolder:
    """Return a set's presses as small as `tactile-loc calibrate` reads them."""
    size_px = reading_size_px(presses.camera)
    return read_presses(folder, presses.camera, median_background=name == "FOTS", size_px=size_px)


def health_rows(calibrations: dict[str, Calibrated], sets: dict[str, PressFolder]) -> list[str]:
    """Return rows of how far off each calibration finds each set's images, resized: figures from least to most.

    Of its own set the presses that were held out; of the others all, as they are and with their own untouched gel.
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


def _figure(calibrated: Calibrated, presses: PressFolder, number: int, untouched: NDArray[np.uint8]) -> float:
    """The health of an image, resized to the calibration's, as a multiple of the worst that it learned from."""
    estimator = calibrated.estimator
    image, zero = (_resized(i, estimator.geometry.shape) for i in (presses.images[number], untouched))
    estimator.untouched, kept = zero, estimator.untouched
    found: Health = health(image, zero, estimator.read(image)[1], estimator.geometry)
    estimator.untouched = kept
    return found.figure(calibrated.usual)


def _resized(image: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    from PIL import Image

    return np.asarray(Image.fromarray(image).resize(shape[::-1], Image.Resampling.BOX))


def slopes(presses: PressFolder, splits: int) -> tuple[Calibrated, dict[str, float]]:
    """Calibrate on several splits; return the first and the mean errors."""
    done = [
        calibrate(presses, presses.geometry, presses.background, "photometric", seed=seed) for seed in range(splits)
    ]
    means = [calibrated.record()["held_out"]["mean"] for calibrated in done]
    image = presses.images[0]
    seconds = [_timed(lambda: done[0].estimator.indentation(image)) for _ in range(9)]
    mean = {key: float(np.mean([m[key] for m in means])) for key in means[0]}
    return done[0], {**mean, "ms": 1e3 * float(np.median(seconds))}


def depths(calibrated: Calibrated, shapes: Path) -> list[str]:
    """Return rows of the table of depths: the prism's tip, and the small sphere."""
    poses = json.loads((shapes / "poses.json").read_text())
    rows = []
    for press in PRESSES_MM:
        found_mm = 1e3 * calibrated.estimator.indentation(_image(shapes / f"prism_{press}_real.png"))
        tip_mm = found_mm[_tip(_pose(poses, press), shapes / "prism.stl", found_mm.shape)].mean()
        found_mm = 1e3 * calibrated.estimator.indentation(_image(shapes / f"sphere_{press}_real.png"))
        true_mm = _cap_mm(float(press), calibrated.estimator.geometry)
        off_mm = found_mm - true_mm
        rows.append(
            f"| {press} | {tip_mm:.3f} | {100 * (tip_mm / float(press) - 1):+.0f} % | {_rms(off_mm):.3f} | "
            f"{_rms(off_mm[true_mm > 0]):.3f} |"
        )
    return rows


def located(sensor: Path, shapes: Path, store: Path) -> list[str]:
    """Locate the prism from its images with the default components; return rows of the table of poses."""
    localizer = Localizer.create(
        shapes / "prism.stl", units="mm", symmetry="none", sensor={"name": "calibrated", "path": str(sensor)},
        grid={"name": "face", "face": "+z", "spacing_mm": 0.8}, encoder={"name": "pixel", "cells": 40},
        store=StageStore(store),
    )  # fmt: skip
    poses = json.loads((shapes / "poses.json").read_text())
    rows = []
    for press in PRESSES_MM:
        touch = localizer.read_touch(shapes / f"prism_{press}_real.png")
        localization = localizer.localize(touch)
        turns = [_off(h.T_sensor_object, _pose(poses, press), touch.geometry) for h in localization.hypotheses]
        x_mm, y_mm, yaw_deg = turns[0]
        apart = min((abs(abs(t[2] - turns[0][2]) - 180) for t in turns[1:]), default=np.inf)
        both = "yes" if apart < 5 else "no"
        half_turn_deg = (yaw_deg + 90) % 180 - 90
        rows.append(f"| {press} | {x_mm:+.2f} | {y_mm:+.2f} | {half_turn_deg:+.2f} | {both} | {len(turns)} |")
    return rows


def head(*names: str) -> str:
    """Return the head of a Markdown table."""
    return f"| {' | '.join(names)} |\n|{'---|' * len(names)}"


def _off(T: NDArray[np.float64], pose: dict[str, Any], geometry: SensorGeometry) -> tuple[float, float, float]:
    """How far a pose of the prism is off: x and y of the tip in mm, yaw in degrees."""
    tip_m = T @ np.array([0.0, 0.0, TIP_Z_M, 1.0])
    u, v = (value + 0.5 for value in pose["origin_px"])  # the set counts from the first pixel's centre
    sx, sy = geometry.scale_at_surface
    x_m, y_m = (u - geometry.cx) / sx, (v - geometry.cy) / sy
    yaw_deg = float(np.degrees(np.arctan2(T[1, 0], T[0, 0]))) - pose["theta_deg"]
    return 1e3 * float(tip_m[0] - x_m), 1e3 * float(tip_m[1] - y_m), yaw_deg


def _pose(poses: dict[str, Any], press: str) -> dict[str, Any]:
    """The pose at a press; the lightest has none of its own, but the object had not moved."""
    return poses.get(f"prism_{press}") or poses["prism_0.5"]


def _tip(pose: dict[str, Any], mesh: Path, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """The pixels (H, W) that the prism's tip covers, but for its border."""
    import trimesh

    tip = trimesh.load(mesh)
    corners = tip.vertices[tip.vertices[:, 2] > 1e3 * TIP_Z_M - 0.1][:, :2]  # type: ignore[attr-defined]
    low, high = corners.min(axis=0) + BORDER_MM, corners.max(axis=0) - BORDER_MM
    v, u = np.mgrid[: shape[0], : shape[1]]
    x, y = ((a - origin) * pose["mm_per_px"] for a, origin in zip((u, v), pose["origin_px"], strict=True))
    c, s = np.cos(np.radians(pose["theta_deg"])), np.sin(np.radians(pose["theta_deg"]))
    along, across = c * x + s * y, s * x - c * y
    return (along > low[0]) & (along < high[0]) & (across > low[1]) & (across < high[1])


def _cap_mm(press_mm: float, geometry: SensorGeometry) -> NDArray[np.float64]:
    """The small sphere's indentation (H, W), mm, pressed so deep."""
    R, pitch_mm = SMALL_SPHERE_MM, 1e3 * geometry.pixel_pitch_m
    v, u = np.mgrid[: geometry.height_px, : geometry.width_px] + 0.5
    rho2 = pitch_mm**2 * ((u - SPHERE_AT_PX[0]) ** 2 + (v - SPHERE_AT_PX[1]) ** 2)
    return np.maximum(np.sqrt(np.maximum(R**2 - rho2, 0)) - (R - press_mm), 0)


def _image(path: Path) -> NDArray[np.uint8]:
    return load_image(path, "RGB")[1]


def _rms(values: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _timed(work: Any) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data" / "tactile")
    parser.add_argument("--splits", type=int, default=3)
    parser.add_argument("--calibrations", action="store_true", help="stop before other shapes are read and located")
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        parser.error(f"there is no {arguments.data}; give --data")
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        small, calibrations = {}, {}
        print(head("set", "presses", "surface angle", "shape in the contact", "untouched gel", "image to depth"))
        for number, name in enumerate(SETS):
            presses = read(name, arguments.data, work / str(number))
            first, mean = slopes(presses, arguments.splits)
            print(
                f"| {name} | {len(presses)} | {mean['slope_deg']:.2f}° | {1e6 * mean['shape_m']:.0f} um | "
                f"{1e6 * mean['untouched_m']:.0f} um | {mean['ms']:.0f} ms |",
                flush=True,
            )
            small[name] = reduced(presses, name, work / str(number))
            calibrations[name], less = slopes(small[name], arguments.splits)
            size = "{} x {}".format(*reading_size_px(presses.camera))
            print(
                f"| {name}, reduced to {size} | | {less['slope_deg']:.2f}° | {1e6 * less['shape_m']:.0f} um | "
                f"{1e6 * less['untouched_m']:.0f} um | {less['ms']:.0f} ms |",
                flush=True,
            )
            if name == "gelslim":
                sensor = first
                write_calibration(
                    work / "sensor", presses.geometry, presses.background, first.estimator, first.record()
                )
        print()
        print(head("health by the calibration of", *small))
        print("\n".join(health_rows(calibrations, small)))
        if arguments.calibrations:
            return
        shapes = arguments.data / "gelslim_shapes"
        print()
        print(head("press, mm", "prism's tip, mm", "", "sphere, RMS over the image, mm", "and in the contact"))
        print("\n".join(depths(sensor, shapes)))
        print()
        print(head("press, mm", "x off, mm", "y off, mm", "yaw off, °", "both half turns", "hypotheses"))
        print("\n".join(located(work / "sensor", shapes, work / "store")))


if __name__ == "__main__":
    main()
