#!/usr/bin/env python3
"""Reads real presses on an elastic gel: absolute depths of a ball and of a flat prism, and the prism's pose.

A sensor is calibrated with `tactile-loc calibrate` on the balls of the public set gelslim_balls. Another ball and a
prism of the set gelslim_shapes are then read, at presses that the set states. The first table has the measured gel. The
second has the depths, constant included: of the ball, and its RMS difference from the elastic truth in the contact; and
of the prism, with the RMS differences between the read surface and the modelled gel within 3 mm of the tip. The third
has the pose of the prism, located in the image with the whole object searched.

`--data` is a folder with both sets. `--picture` also draws the pressure and the profiles.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_data_parser, write_head
from numpy.typing import NDArray
from real_images import PRESSES_MM, _find_tip, _measure_off, _read_image, _write_pose

from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel, recover_contact
from tactile_loc.locate.localizer import Localizer
from tactile_loc.sensors.calibration.folder import Calibration, read_calibration
from tactile_loc.sensors.calibration.gel_fit import press_balls
from tactile_loc.sensors.reading.reading import measure_press_m, require_image

MM = 1e3
MM_PER_PX, BALL_MM = 0.059259, 2.92
BALL_PX = (208.5, 166.5)  # centre of the small ball in its images
NEAR_MM, BORDER_MM = 3.0, 0.3  # of the tip: compared surroundings, and its border, which is not averaged
SETTLED = 20  # iterations of the solver


def calibrate(balls: Path, out: Path) -> Calibration:
    """Run `tactile-loc calibrate` on the balls, and return the calibrated sensor."""
    words = ["calibrate", balls, "--ball-radius", BALL_MM, "--mm-per-px", MM_PER_PX]
    command = [sys.executable, "-m", "tactile_loc_cli.main", *map(str, words), "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True)
    return read_calibration(out)


def report_gel(known: Calibration) -> list[str]:
    """Return the row of the first table."""
    gel = known.record["gel"]
    cells = (
        f"{MM * gel['thickness_m']:.1f}", f"{MM * gel['std_m']:.1f}", f"{MM * gel['coating_m']:.2f}",
        f"{gel['contact']:.2f}", f"{100 * gel['rms']:.0f} %", f"{100 * gel['rigid_rms']:.0f} %",
    )  # fmt: skip
    return [f"| {' | '.join(cells)} |"]


def measure_ball(known: Calibration, image: NDArray[np.uint8], press_m: float) -> tuple[float, float]:
    """Return the read press depth of the ball, and the RMS error of the surface in the contact, mm."""
    geometry = known.geometry
    read_m = known.read(image).indentation_m
    x, y = (
        geometry.pixel_pitch_m * (np.arange(side) + 0.5) - at * MM_PER_PX / MM
        for side, at in zip(geometry.shape[::-1], BALL_PX, strict=True)
    )
    away = np.hypot(x[None], y[:, None])
    truth = press_balls(Gel(geometry.gel.thickness_m, geometry.gel.poisson), BALL_MM / MM)
    depth = int(np.abs(truth.surface_m[:, 0] - press_m).argmin())
    wanted_m = np.interp(away, truth.away_m, truth.surface_m[depth])
    off_m = (read_m - wanted_m)[away < truth.contact_m[depth]]
    return MM * measure_press_m(read_m, geometry), MM * float(np.sqrt(np.mean(off_m**2)))


def measure_prism(known: Calibration, image: NDArray[np.uint8], tip: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return the mean depth that is read on the prism's tip, and the RMS differences from a layer and a rigid gel, mm.

    Both gels are pressed by this depth.
    """
    from scipy.ndimage import binary_erosion, distance_transform_edt

    read_m = known.read(image).indentation_m
    inner = binary_erosion(tip, iterations=round(BORDER_MM / MM / known.geometry.pixel_pitch_m))
    press_m = float(read_m[inner].mean())
    flat = np.where(tip, 0, press_m).astype(np.float32)
    shown_m = press_m - deform_gel(flat[None], press_m, known.geometry.press(press_m), SETTLED)[0]
    near = distance_transform_edt(~tip) * known.geometry.pixel_pitch_m * MM < NEAR_MM
    layer, rigid = (np.sqrt(np.mean((model - read_m)[near] ** 2)) for model in (shown_m, press_m - flat))
    return MM * press_m, MM * float(layer), MM * float(rigid)


def report_depths(known: Calibration, shapes: Path, poses: dict[str, Any]) -> list[str]:
    """Return the rows of the second table."""
    rows = []
    for press in PRESSES_MM:
        ball_mm, off_mm = measure_ball(known, _read_image(shapes / f"sphere_{press}_real.png"), float(press) / MM)
        tip = find_tip(shapes, poses, press)
        tip_mm, layer_mm, rigid_mm = measure_prism(known, _read_image(shapes / f"prism_{press}_real.png"), tip)
        rows.append(f"| {press} | {ball_mm:.3f} | {off_mm:.3f} | {tip_mm:.3f} | {layer_mm:.3f} | {rigid_mm:.3f} |")
    return rows


def find_tip(shapes: Path, poses: dict[str, Any], press: str) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of the reduced image that the prism's tip covers."""
    return _find_tip(_write_pose(poses, press), shapes / "prism.stl", (320, 320), 0.0)[::2, ::2]


def report_poses(folder: Path, shapes: Path, poses: dict[str, Any]) -> list[str]:
    """Return the rows of the third table. The yaw is compared modulo the prism's half turn."""
    rows = []
    for refiner in ("joint", "render"):
        for gel in ("layer", "rigid"):
            sensor = {"name": "calibrated", "path": str(folder), **({"gel": "rigid"} if gel == "rigid" else {})}
            localizer = Localizer.create(shapes / "prism.stl", units="mm", sensor=sensor, refiner=refiner)
            for press in PRESSES_MM:
                touch = localizer.read_touch(shapes / f"prism_{press}_real.png")
                first = localizer.localize(touch).hypotheses[0]
                pose = _write_pose(poses, press)
                half = {**pose, "origin_px": [(value + 0.5) / 2 - 0.5 for value in pose["origin_px"]]}
                x_mm, y_mm, yaw_deg = _measure_off(first.T_sensor_object, half, touch.geometry)
                yaw_deg = (yaw_deg + 90) % 180 - 90
                rows.append(
                    f"| {press} | {gel} | {refiner} | {x_mm:+.2f} | {y_mm:+.2f} | {yaw_deg:+.2f} | "
                    f"{first.probability:.2f} | {first.imprint_iou:.2f} |"
                )
    return rows


def draw(known: Calibration, shapes: Path, poses: dict[str, Any], out: Path) -> None:
    """Draw the pressure under the prism and, along a line across it, the rigid, the modelled and the read gel."""
    import matplotlib.pyplot as plt

    geometry, pitch_mm = known.geometry, MM * known.geometry.pixel_pitch_m
    figure, axes = plt.subplots(2, 4, figsize=(11, 5.2), layout="constrained")
    for press, top, below in zip(PRESSES_MM, *axes, strict=True):
        image = _read_image(shapes / f"prism_{press}_real.png")
        small = known.gel.clear_image(require_image(image, known.untouched, known.camera_px))
        integrated, slopes = known.estimator.read(small)
        assert slopes is not None
        contact = recover_contact(slopes, integrated > 0.2 * integrated.max(), geometry)
        tip = find_tip(shapes, poses, press)
        rows, columns = (np.flatnonzero(tip.any(axis=axis)) for axis in (1, 0))
        window = np.s_[rows[0] - 15 : rows[-1] + 15, columns[0] - 20 : columns[-1] + 20]
        top.imshow(contact.pressure[window], cmap="magma", vmax=np.quantile(contact.pressure[tip], 0.95))
        top.contour(tip[window], [0.5], colors="white", linewidths=0.8)
        top.set(title=f"{press} mm: pressure", xticks=[], yticks=[])
        row = int(rows.mean())
        press_m = float(contact.displacement_m[tip].mean())
        flat = np.where(tip, 0, press_m).astype(np.float32)
        shown = press_m - deform_gel(flat[None], press_m, geometry.press(press_m), SETTLED)[0]
        x_mm = (np.arange(len(tip[row])) - columns.mean()) * pitch_mm
        for surface, style, label in (
            (press_m - flat, "k:", "rigid gel"), (shown, "C0-", "elastic gel"),
            (contact.displacement_m, "C3--", "read from a photo"),
        ):  # fmt: skip
            below.plot(x_mm, -MM * surface[row], style, label=label)
        below.set(xlabel="x (mm)", xlim=(-7, 7))
    axes[1, 0].set_ylabel("gel surface (mm)")
    axes[1, 0].legend(loc="lower left", fontsize=7)
    figure.savefig(out, dpi=90)


def main() -> None:
    """Measure, and print three tables."""
    parser = make_data_parser(__doc__)
    parser.add_argument("--picture", type=Path, help="PNG to draw")
    arguments = parser.parse_args()
    shapes = arguments.data / "gelslim_shapes"
    poses = json.loads((shapes / "poses.json").read_text())
    with tempfile.TemporaryDirectory() as temporary:
        known = calibrate(arguments.data / "gelslim_balls", Path(temporary) / "sensor")
        print(
            write_head("thickness, mm", "standard deviation", "coating, mm", "contact / circle", "unexplained", "rigid")
        )
        print("\n".join(report_gel(known)), flush=True)
        print()
        print(write_head("stated, mm", "ball, mm", "RMS, mm", "prism's tip, mm", "layer's RMS, mm", "rigid RMS, mm"))
        print("\n".join(report_depths(known, shapes, poses)), flush=True)
        print()
        print(write_head("stated, mm", "gel", "refiner", "x off, mm", "y off, mm", "yaw off, °", "probability", "IoU"))
        print("\n".join(report_poses(known.folder, shapes, poses)), flush=True)
        if arguments.picture is not None:
            draw(known, shapes, poses, arguments.picture)


if __name__ == "__main__":
    main()
