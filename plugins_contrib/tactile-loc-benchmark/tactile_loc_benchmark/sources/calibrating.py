"""Calibration of a source's sensor on images of the source itself, with the same steps as `tactile-loc calibrate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
from tactile_loc import StageStore, calibrate_folder, label_presses
from tactile_loc.plugin import ObjectModel, Scene, SensorError, SensorGeometry, TriangleMesh, registry
from tactile_loc.plugin.helpers import SymmetryGroup, make_transform

from tactile_loc_benchmark.interfaces import Image, SimulatedSource

RENDERER = "zbuffer"
INSIDE = 0.2  # the ball's centre keeps this share of the image's sides from the border
ABOVE_M = 5e-3  # distance between the ball and the gel in the image of the untouched gel
LIGHT_M = 1e-4  # nominal press of the untouched gel
ROUNDS = 5  # of the division of an icosahedron's faces; the ball is round to a micrometre


@dataclass(frozen=True)
class BallPresses:
    """Presses of a ball of `radius_m` at random places, by `depth_m` (least, most); all in metres."""

    radius_m: float = 3e-3
    count: int = 50
    depth_m: tuple[float, float] = (0.3e-3, 0.9e-3)
    seed: int = 31

    def draw_poses(self, camera: SensorGeometry) -> list[tuple[np.ndarray, float]]:
        """Return the pressed ball's poses (4, 4) and the press depths, metres.

        The first ball is above the gel. Poses and depths depend only on the seed.
        """
        rng = np.random.default_rng(self.seed)
        x0, x1, y0, y1 = camera.rectangle
        poses = [(self._place(camera, (x0 + x1) / 2, (y0 + y1) / 2, -ABOVE_M), LIGHT_M)]
        for _ in range(self.count):
            x, y = np.array([x0, y0]) + np.array([x1 - x0, y1 - y0]) * (INSIDE + (1 - 2 * INSIDE) * rng.random(2))
            press_m = float(rng.uniform(*self.depth_m))
            poses.append((self._place(camera, x, y, press_m), press_m))
        return poses

    def _place(self, camera: SensorGeometry, x_m: float, y_m: float, press_m: float) -> np.ndarray:
        return make_transform(np.eye(3), [x_m, y_m, camera.surface_m - press_m + self.radius_m])

    def make_object(self) -> ObjectModel:
        """Return the ball, with its centre at the origin."""
        import trimesh

        ball = trimesh.creation.icosphere(ROUNDS, self.radius_m)
        mesh = TriangleMesh(np.asarray(ball.vertices, np.float64), np.asarray(ball.faces, np.int64))
        return ObjectModel("ball", mesh, SymmetryGroup.parse("none", mesh.centroid_m))


def calibrate_on_balls(source: SimulatedSource, camera: SensorGeometry, folder: Path, balls: BallPresses) -> Path:
    """Press a ball with a source that draws images, calibrate the `camera` on them, and return the sensor's folder.

    The balls are found in the images, as by `tactile-loc calibrate` without a table. Images and sensor are written into
    `folder`. Raises TactileLocError if the images cannot be used.
    """
    presses = folder / "presses"
    presses.mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(press_ball(source, camera, balls)):
        PIL.Image.fromarray(image).save(presses / f"image-{number:03d}.png")
    (presses / "presses.csv").unlink(missing_ok=True)  # of an interrupted calibration
    label_presses(presses, None, 1e3 * balls.radius_m, 1e3 * camera.pixel_pitch_m)
    return calibrate_sensor(presses, camera, folder / "sensor")


def press_ball(source: SimulatedSource, camera: SensorGeometry, balls: BallPresses) -> list[Image]:
    """Return images (H, W, 3) uint8 of the untouched gel, and of the presses of a ball.

    Raises SensorError if the source draws no images.
    """
    ball, renderer = balls.make_object(), registry().create("renderer", RENDERER, {})
    images: list[Image] = []
    for number, (T, press_m) in enumerate(balls.draw_poses(camera)):
        scene = Scene(ball, camera.press(press_m, camera.max_depth_m), renderer)
        image: Any = source.press(scene, T, np.random.default_rng([balls.seed, number]))
        if not isinstance(image, np.ndarray):
            raise SensorError("the source draws contact shapes, not images; its sensor needs no calibration")
        images.append(image)
    return images


def calibrate_sensor(presses: Path, camera: SensorGeometry, folder: Path) -> Path:
    """Calibrate a sensor on a folder of presses with its table, and write it to `folder`. Raises TactileLocError."""
    store = StageStore(folder.parent / "store")  # keeps the stages of an interrupted calibration
    return calibrate_folder(presses, camera, store=store).write(folder)
