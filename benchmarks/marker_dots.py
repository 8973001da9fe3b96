#!/usr/bin/env python3
"""Errors of surfaces read from real images of gels on which marker dots are drawn, and from the same images without.

`--data` is a folder with the public sets of `real_images.py`, whose gels have no dots. A lattice of soft dark dots is
drawn on each image at the camera's size. Dots move with the surface: away from the contact, in proportion to the slope
(`SPREAD_M`), and sideways by a random shear (`SHEAR_M`) that fades with the indentation. The surface that moves the
dots is the ball's, and for the other shapes the surface that is read without dots. Sensors are calibrated on the dotted
images. Errors are means over held-out presses of several splits, and multiples of the errors without dots.

The other shapes on the first sensor are read with the calibration of split 0. The prism's error is the RMS difference
of the depth in its tip from the stated press. The sphere's error is the RMS distance of the surface in the visible
circle from the sphere that fits best. The last column compares the surface with that read without dots.
"""

import dataclasses
import json
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import real_images
from asked import make_data_parser, write_head
from numpy.typing import NDArray
from real_images import PRESSES_MM, SETS, SpherePress

from tactile_loc.io.images import load_image, write_image
from tactile_loc.sensors.calibration.frames import PressImage
from tactile_loc.sensors.calibration.outcome import CalibrationOutcome, calibrate
from tactile_loc.sensors.calibration.presses import PressFolder, choose_size_px, read_presses
from tactile_loc.sensors.calibration.unlabelled import find_presses
from tactile_loc.sensors.reading.estimator import EstimatorRecipe
from tactile_loc.sensors.reading.markers import UntouchedGel
from tactile_loc.sensors.reading.reading import reduce_image

SPREAD_M, SHEAR_M = 5e-4, 2e-4  # move of the dots at a slope of 45 degrees, and largest shear
SMOOTHING_M = 3e-4  # the gel's surface moves more smoothly than the object's shape
OPACITY, SOFT_M = 0.8, 6e-5  # share of the light that a dot absorbs, and half the width of its border
SHAPES = [f"{shape}_{press}" for shape in ("prism", "sphere") for press in PRESSES_MM]


@dataclasses.dataclass(frozen=True)
class Pattern:
    """A lattice of dots: spacing and diameter in mm, and whether the dots move and are filled in."""

    spacing_mm: float
    diameter_mm: float
    moving: bool = True
    filled: bool = True

    @property
    def name(self) -> str:
        """The pattern in words."""
        words = [f"{self.spacing_mm:g} mm, {self.diameter_mm:g} mm wide", "" if self.moving else "unmoved"]
        return ", ".join(filter(None, [*words, "" if self.filled else "not filled in"]))

    def draw(
        self, image: NDArray[np.uint8], pitch_m: float, indentation_m: NDArray[np.floating] | None, seed: Sequence[int]
    ) -> NDArray[np.uint8]:
        """Return an image (H, W, 3) with dots that an indentation (H, W), metres, has moved."""
        lattice, press = np.random.default_rng(seed[:1]), np.random.default_rng(seed)
        turn, phase = lattice.uniform(0, 0.3), lattice.uniform(0, 1, 2)
        y, x = (np.mgrid[: image.shape[0], : image.shape[1]] + 0.5) * pitch_m
        if self.moving and indentation_m is not None and indentation_m.max() > 0:
            dx, dy = _move_surface(indentation_m, pitch_m, press.uniform(-SHEAR_M, SHEAR_M, 2))
            x, y = x - dx, y - dy
        along = (np.cos(turn) * x + np.sin(turn) * y) * 1e3 / self.spacing_mm + phase[0]
        across = (np.cos(turn) * y - np.sin(turn) * x) * 1e3 / self.spacing_mm + phase[1]
        away_m = np.hypot(along - np.round(along), across - np.round(across)) * 1e-3 * self.spacing_mm
        absorbed = OPACITY * 0.5 * (1 - np.tanh((away_m - 0.5e-3 * self.diameter_mm) / SOFT_M))
        return np.rint(image * (1 - absorbed[..., None])).astype(np.uint8)


PATTERNS = [Pattern(2, 0.3), Pattern(1.5, 0.4), Pattern(1.5, 0.4, moving=False), Pattern(1, 0.5)]
DENSE = Pattern(1, 0.5, filled=False)


def _move_surface(
    indentation_m: NDArray[np.floating], pitch_m: float, shear_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far the gel's surface moves along x and y (H, W), metres."""
    from scipy.ndimage import gaussian_filter

    gel = gaussian_filter(np.asarray(indentation_m, float), SMOOTHING_M / pitch_m)
    down, across = np.gradient(gel, pitch_m)
    steep, share = np.sqrt(1 + down**2 + across**2), gel / gel.max()
    return shear_m[0] * share - SPREAD_M * across / steep, shear_m[1] * share - SPREAD_M * down / steep


def draw_set(presses: PressFolder, pattern: Pattern, folder: Path, out: Path, seed: int) -> None:
    """Draw dots on the images of a folder of presses, at the camera's size, and write them to the folder `out`."""
    shutil.copytree(folder, out)
    pitch_m = presses.camera.pixel_pitch_m
    for number, row in enumerate(presses.rows):
        image = pattern.draw(presses.images[number], pitch_m, presses.label(number).indentation_m, (seed, number))
        write_image(out / row.image.name, image)
    for path in out.glob("background*.png"):
        write_image(path, pattern.draw(presses.background, pitch_m, None, (seed,)))


def read_small(folder: Path, presses: PressFolder, name: str, filled: bool = True) -> PressFolder:
    """Read a folder of presses at the size of `tactile-loc calibrate`. If not `filled`, the dots stay in the images."""
    size_px = choose_size_px(presses.camera)
    small = read_presses(folder, presses.camera, name == "FOTS", size_px)
    if filled or small.gel is None:
        return small
    images = tuple(reduce_image(load_image(row.image, "RGB")[1], size_px[::-1]) for row in small.rows)
    return dataclasses.replace(small, images=images, background=small.gel.image)


def measure_errors(presses: PressFolder, splits: int) -> tuple[CalibrationOutcome, dict[str, float]]:
    """Calibrate on several splits. Return the first calibration and the mean errors of the held-out presses."""
    done = [calibrate(presses, EstimatorRecipe(seed=seed)) for seed in range(splits)]
    means = [calibrated.mean_errors for calibrated in done]
    return done[0], {key: float(np.mean([mean[key] for mean in means])) for key in means[0]}


def write_errors(name: str, dots: str, mean: dict[str, float], base: dict[str, float]) -> str:
    """Return a row of the table of errors."""
    cells = []
    for key, factor, digits, unit in (
        ("slope_deg", 1, 2, "°"),
        ("shape_m", 1e6, 0, " um"),
        ("untouched_m", 1e6, 0, " um"),
    ):
        ratio = "" if mean is base else f" (x {mean[key] / base[key]:.2f})"
        cells.append(f"{factor * mean[key]:.{digits}f}{unit}{ratio}")
    return f"| {name} | {dots} | {' | '.join(cells)} |"


class Shapes:
    """Images of other shapes on the first sensor, at the camera's size."""

    def __init__(self, folder: Path, camera: Any) -> None:
        self.folder, self.camera = folder, camera
        self.images = {name: load_image(folder / f"{name}_real.png", "RGB")[1] for name in SHAPES}
        self.poses = json.loads((folder / "poses.json").read_text())

    def read(self, calibrated: CalibrationOutcome, gel: UntouchedGel | None, pattern: Pattern | None, seed: int,
             surfaces: dict[str, NDArray[np.float32]] | None) -> dict[str, NDArray[np.float32]]:  # fmt: skip
        """Return the indentations (h, w), metres. The `surfaces` read without dots move the dots of the `pattern`."""
        found = {}
        for number, (name, image) in enumerate(self.images.items()):
            if pattern is not None and surfaces is not None:
                moved = _enlarge(surfaces[name], image.shape[:2])
                image = pattern.draw(image, self.camera.pixel_pitch_m, moved, (seed, 1000 + number))
            image = reduce_image(image, calibrated.estimator.geometry.shape)
            if gel is not None and (pattern is None or pattern.filled):
                image = gel.clear_image(image)
            found[name] = calibrated.estimator.read_indentation(image)
        return found

    def measure(self, found: dict[str, NDArray[np.float32]], circles: dict[str, SpherePress]) -> dict[str, float]:
        """Return the RMS errors in the prism's tip and in the sphere's circle, metres."""
        prism, sphere = [], []
        shape = self.images["prism_0.5"].shape[:2]
        for press in PRESSES_MM:
            tip = real_images._find_tip(real_images._write_pose(self.poses, press), self.folder / "prism.stl", shape)
            prism.append(_enlarge(found[f"prism_{press}"], shape)[tip].mean() - 1e-3 * float(press))
            surface, circle = _enlarge(found[f"sphere_{press}"], shape), circles[press]
            away_m = self.camera.pixel_pitch_m * circle.circle.measure_distance_px(shape)
            ball_m, inside = 1e-3 * real_images.SMALL_SPHERE_MM, away_m < 1e-3 * circle.radius_mm
            tops = surface[inside] - np.sqrt(ball_m**2 - away_m[inside] ** 2)
            sphere.append(np.sqrt(np.mean((tops - tops[away_m[inside] < 0.5e-3 * circle.radius_mm].mean()) ** 2)))
        return {
            "prism": float(np.sqrt(np.mean(np.square(prism)))),
            "sphere": float(np.sqrt(np.mean(np.square(sphere)))),
        }


def _enlarge(values: NDArray[np.floating], shape: tuple[int, int]) -> NDArray[np.float64]:
    from scipy.ndimage import zoom

    return np.asarray(
        zoom(values.astype(float), np.divide(shape, values.shape), order=1, grid_mode=True, mode="nearest")
    )


def compare_circles(plain: PressFolder, dotted: Path, gel: NDArray[np.uint8]) -> str:
    """Find circles without labels in dotted images. Return the number of presses, and the distances from labels."""
    frames = [PressImage(row.image.name, load_image(dotted / row.image.name, "RGB")[1]) for row in plain.rows]
    found = find_presses([PressImage("untouched", gel), *frames])
    labels = {row.image.name: row for row in plain.rows}
    off = []
    for press in found.used:
        row, circle = labels[press.name], press.circle
        assert circle is not None
        x, y, radius = (row.read_number(c) for c in ("center_x_px", "center_y_px", "radius_px"))
        off.append((np.hypot(circle.x_px - x, circle.y_px - y), abs(circle.radius_px - radius)))
    centre, radius = np.median(off, axis=0)
    return f"{len(off)} of {len(frames)} | {centre:.2f} px | {radius:.2f} px |"


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = make_data_parser(__doc__)
    parser.add_argument("--sets", nargs="+", default=list(SETS), choices=list(SETS))
    parser.add_argument("--splits", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1, help="seed of the lattice's place and of the shear")
    arguments = parser.parse_args()
    rows: dict[str, list[str]] = {"shapes": [], "circles": [], "dots": []}
    with tempfile.TemporaryDirectory() as temporary:
        print(write_head("set", "dots", "surface angle", "shape in the contact", "untouched gel"))
        for number, name in enumerate(arguments.sets):
            folder = Path(temporary) / str(number)
            presses = real_images.read(name, arguments.data, folder)
            plain = read_small(folder, presses, name)
            first, base = measure_errors(plain, arguments.splits)
            print(write_errors(name, "none", base, base), flush=True)
            shapes = circles = surfaces = usual = None
            if name == "gelslim":
                shapes = Shapes(arguments.data / "gelslim_shapes", presses.camera)
                surfaces = shapes.read(first, None, None, 0, None)
                full, _ = measure_errors(presses, 1)
                circles = {p: SpherePress.of(full, shapes.images[f"sphere_{p}"]) for p in PRESSES_MM}
                usual = shapes.measure(surfaces, circles)
                rows["shapes"].append(f"| none | {_write_um(usual['prism'])} | {_write_um(usual['sphere'])} | |")
            if name != "FOTS":
                rows["circles"].append(f"| {name} | none | {compare_circles(presses, folder, presses.background)}")
            for pattern in [*PATTERNS, DENSE]:
                out = Path(temporary) / "dotted"
                draw_set(presses, pattern, folder, out, arguments.seed)
                small = read_small(out, presses, name, pattern.filled)
                made, mean = measure_errors(small, arguments.splits)
                print(write_errors(name, pattern.name, mean, base), flush=True)
                gel = small.gel
                assert gel is not None
                if shapes is not None and surfaces is not None and circles is not None and usual is not None:
                    found = shapes.read(made, gel, pattern, arguments.seed, surfaces)
                    errors = shapes.measure(found, circles)
                    off = np.sqrt(np.mean([np.mean((found[n] - surfaces[n])[surfaces[n] > 5e-5] ** 2) for n in SHAPES]))
                    cells = [f"{_write_um(errors[k])} (x {errors[k] / usual[k]:.2f})" for k in ("prism", "sphere")]
                    rows["shapes"].append(f"| {pattern.name} | {' | '.join(cells)} | {_write_um(off)} |")
                if pattern.filled:
                    image = load_image(out / presses.rows[0].image.name, "RGB")[1]
                    image = reduce_image(image, small.geometry.shape)
                    milliseconds = 1e3 * float(np.median([_time(gel, image) for _ in range(9)]))
                    count = 0 if gel.dots is None else len(gel.dots)
                    rows["dots"].append(
                        f"| {name} | {pattern.name} | {count} | {100 * gel.covered:.0f} % | {milliseconds:.0f} ms |"
                    )
                    if name != "FOTS":
                        untouched = pattern.draw(
                            presses.background, presses.camera.pixel_pitch_m, None, (arguments.seed,)
                        )
                        rows["circles"].append(
                            f"| {name} | {pattern.name} | {compare_circles(presses, out, untouched)}"
                        )
                shutil.rmtree(out)
    for key, head in (
        ("shapes", ("dots", "prism's tip", "sphere", "from the surface without dots")),
        ("circles", ("set", "dots", "presses used", "centre off", "radius off")),
        ("dots", ("set", "dots", "found", "covered", "filling in")),
    ):
        print("\n" + write_head(*head))
        print("\n".join(rows[key]))


def _write_um(length_m: float) -> str:
    return f"{1e6 * length_m:.0f} um"


def _time(gel: UntouchedGel, image: NDArray[np.uint8]) -> float:
    start = time.perf_counter()
    gel.clear_image(image)
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
