"""Simulated presses of a ball with known geometry, as arrays and as the folder that `calibrate` reads."""

import csv
import dataclasses
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image

from tactile_loc import EstimatorRecipe, SensorGeometry, write_sensor_file
from tactile_loc.sensors.calibration.labels import PressLabel, label_ball
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background, render_images
from tactile_loc.sensors.optics.simulate import press_gel

MM = 1e-3
BALL_M = 3e-3
TINY = {"steps": 200, "hidden": 16, "pixels": 1024}
COLUMNS = ("image", "kind", "center_x_px", "center_y_px", "radius_px", "ball_radius_mm")


def sensor(px: int = 64, size_m: float = 0.016, max_depth_m: float = 1.5e-3, **more) -> SensorGeometry:
    """An orthographic sensor of a square field, 16 mm wide."""
    k = px / size_m
    return SensorGeometry("orthographic", px, px, k, k, px / 2, px / 2, 0.01, max_depth_m, **more)


def places(geometry: SensorGeometry) -> tuple[np.ndarray, np.ndarray]:
    """The pixel positions of an orthographic sensor: x and y (H, W), in metres."""
    return np.meshgrid(*geometry.pixel_slopes)


def ball_indentation(geometry: SensorGeometry, x_m=0.0, y_m=0.0, press_m=1e-3, ball_m=BALL_M) -> np.ndarray:
    """The depth (H, W) of a ball below the untouched surface, in metres."""
    x, y = places(geometry)
    rho2 = (x - x_m) ** 2 + (y - y_m) ** 2
    return np.maximum(np.sqrt(np.maximum(ball_m**2 - rho2, 0)) - (ball_m - press_m), 0).astype(np.float32)


def contact_radius(press_m, ball_m: float = BALL_M):
    """The radius of the circle where a ball at a press depth intersects the untouched surface, in metres."""
    return np.sqrt(2 * ball_m * press_m - press_m**2)


def gel_under(indentation_m: np.ndarray, geometry: SensorGeometry) -> np.ndarray:
    """The gel surfaces (N, H, W) under indentations (N, H, W), in metres."""
    press = indentation_m.max(axis=(1, 2))
    return press_gel(press[:, None, None] - indentation_m, press, geometry)


def visible_radius(press_m: np.ndarray, ball_m: float = BALL_M) -> np.ndarray:
    """The radii (N,) of the circles where the gel touches a ball at press depths (N,), in metres; without the skirt."""
    geometry = sensor(240, 8e-3)
    ball = np.stack([ball_indentation(geometry, press_m=p, ball_m=ball_m) for p in press_m])
    lies = (ball > 0) & (gel_under(ball, geometry) - ball < 1e-6)
    return np.sqrt(lies.sum(axis=(1, 2)) / np.pi) * geometry.pixel_pitch_m


def photographed(indentation_m: np.ndarray, geometry: SensorGeometry) -> np.ndarray:
    """Noiseless images (N, H, W, 3) of the gel under indentations (N, H, W), in metres."""
    optics = OPTICS["gelslim"].remove_noise()
    return render_images(gel_under(indentation_m, geometry), geometry, optics, np.random.default_rng(0))


def label_untouched(geometry: SensorGeometry) -> PressLabel:
    """The label of an image without contact."""
    none = np.zeros(geometry.shape, bool)
    slope = np.zeros((*geometry.shape, 2), np.float32)
    return PressLabel(np.zeros(geometry.shape, np.float32), slope, none, ~none)


@dataclass(frozen=True, eq=False)
class BallSet:
    """Presses of one ball, like a PressFolder: images (N, H, W, 3), visible circles (N, 3), pixels, and the truth.

    `indentation_m` (N, H, W) is the true indentation. It exceeds the label by the depth of the visible circle.
    The first access to any of the three draws all of them.
    """

    geometry: SensorGeometry
    background: np.ndarray
    draw: Callable[[], tuple[np.ndarray, np.ndarray, np.ndarray]]

    @cached_property
    def _drawn(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.draw()

    images = property(lambda self: self._drawn[0])
    circles = property(lambda self: self._drawn[1])
    indentation_m = property(lambda self: self._drawn[2])

    def __len__(self) -> int:
        return len(self.images)

    def read_press(self, number: int) -> tuple[np.ndarray, PressLabel]:
        x, y, radius = self.circles[number]
        return self.images[number], label_ball(self.geometry, (x, y), radius, BALL_M)

    def read_presses(self, numbers: Iterable[int]) -> Iterator[tuple[np.ndarray, PressLabel]]:
        return map(self.read_press, numbers)

    def name(self, number: int) -> str:
        return f"{number:04d}.png"

    @property
    def untouched(self) -> np.ndarray:
        return self.background

    def rows(self) -> list[dict[str, object]]:
        """The rows of the table."""
        names = ("center_x_px", "center_y_px", "radius_px")
        balls = [
            {"image": f"{i:04d}.png", "kind": "ball", "ball_radius_mm": BALL_M / MM, **dict(zip(names, c, strict=True))}
            for i, c in enumerate(self.circles.tolist())
        ]
        return [{"image": "background.png", "kind": "background"}, *balls]

    def write(self, folder: Path) -> Path:
        """Write images, table and sensor file, and return the folder."""
        folder.mkdir(parents=True, exist_ok=True)
        write_image(folder / "background.png", self.background)
        for i, image in enumerate(self.images):
            write_image(folder / f"{i:04d}.png", image)
        write_table(folder, self.rows())
        write_sensor_file(folder / "sensor.toml", self.geometry)
        return folder


def magnified(balls: BallSet, times: int) -> BallSet:
    """The same presses, with the image width and height multiplied by `times`."""
    geometry = balls.geometry.resize(times * balls.geometry.width_px, times * balls.geometry.height_px)

    def larger(pixels: np.ndarray, rows: int) -> np.ndarray:
        return pixels.repeat(times, axis=rows).repeat(times, axis=rows + 1)

    return BallSet(
        geometry, larger(balls.background, 0),
        lambda: (larger(balls.images, 1), times * balls.circles, larger(balls.indentation_m, 1)),
    )  # fmt: skip


def ball_set(count: int = 12, px: int = 64, seed: int = 0) -> BallSet:
    """Presses at random positions in the middle half of the field, 0.3 to 0.9 mm deep."""
    geometry = sensor(px)

    def draw() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        x, y = rng.uniform(-4e-3, 4e-3, (2, count))
        press = rng.uniform(3e-4, 9e-4, count)
        indentation = np.stack([ball_indentation(geometry, *p) for p in zip(x, y, press, strict=True)])
        (kx, ky), radius = geometry.scale_at_surface, visible_radius(press)
        circles = np.stack([x * kx + geometry.cx, y * ky + geometry.cy, radius * kx], axis=1)
        return photographed(indentation, geometry), circles, indentation

    return BallSet(geometry, render_background(geometry, OPTICS["gelslim"]), draw)


def write_calibrated(folder: Path, learned_from: BallSet | None = None, **options: object) -> Path:
    """Write a calibrated sensor and return its folder; without presses, its estimator is untrained."""
    from tactile_loc.sensors.calibration.folder import write_calibration
    from tactile_loc.sensors.calibration.outcome import calibrate
    from tactile_loc.sensors.reading.photometric import PhotometricEstimator

    chosen = {**TINY, **options}
    if learned_from is None:
        geometry = sensor()
        gel = render_background(geometry, OPTICS["gelslim"])
        return write_calibration(folder, PhotometricEstimator(geometry, gel, chosen), gel, {"noise_m": 5e-6})
    return calibrate(learned_from, EstimatorRecipe(chosen)).write(folder)


def write_image(path: Path, image: np.ndarray) -> Path:
    Image.fromarray(image).save(path)
    return path


def write_table(folder: Path, rows: Iterable[dict[str, object]], columns: Iterable[str] = COLUMNS) -> Path:
    with (folder / "presses.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, tuple(columns), extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    return folder / "presses.csv"


def is_same_camera(sensor: SensorGeometry, other: SensorGeometry) -> bool:
    """Whether two sensors are the same, except for the elasticity of their gels, which a calibration measures."""
    return dataclasses.replace(sensor, gel=other.gel).is_same_sensor(other)
