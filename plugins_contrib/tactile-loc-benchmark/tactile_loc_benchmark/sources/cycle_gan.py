"""Images drawn by the CycleGAN of tactile-mnist, which was trained on real touches of a GelSight Mini.

The weights come with the package. The network gets the depths in a rigid gel, and returns a photo. The package presses
its objects by 2.1 mm. In trials, images of lighter presses hardly show them, so their readings are wrong. The suites
therefore leave this source out.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import Field
from tactile_loc.plugin import ComponentOptions, Poses, Scene, SensorGeometry
from tactile_mnist import (
    GEL_PENETRATION_DEPTH_MM,
    GELSIGHT_MINI_GEL_THICKNESS_MM,
    GELSIGHT_MINI_IMAGE_SIZE_PX,
    GELSIGHT_MINI_SENSOR_SURFACE_SIZE,
)
from tactile_mnist.tactile_renderer import mk_tactile_renderer

from tactile_loc_benchmark.interfaces import Image, SimulatedSource
from tactile_loc_benchmark.sources.calibrating import BallPresses, calibrate_on_balls

THICKNESS_M, NOMINAL_M = 1e-3 * GELSIGHT_MINI_GEL_THICKNESS_MM, 1e-3 * GEL_PENETRATION_DEPTH_MM
SIZE_PX = tuple(int(n) for n in GELSIGHT_MINI_IMAGE_SIZE_PX)
STANDOFF_M = 10e-3
# the package presses objects by NOMINAL_M; the network hardly draws presses of less than half of that
DEEPEST_M = NOMINAL_M
BALL_M, BALL_DEPTHS = 4e-3, (0.7, 1.0)  # radius, metres, and depths, shares of the deepest press


class CycleGanImages(SimulatedSource):
    """Draws images with the CycleGAN of tactile-mnist. The sensor is calibrated on balls that the network draws."""

    licence: ClassVar[str] = "MIT"
    libraries: ClassVar[tuple[str, ...]] = ("tactile-mnist", "jax")

    class Options(ComponentOptions):
        """The number of presses for the sensor's calibration."""

        presses: int = Field(default=40, ge=5, description="number of presses of a ball for the calibration")

    def __init__(self, options: ComponentOptions | None = None) -> None:
        super().__init__(options)
        width, height = SIZE_PX
        scale = width / float(GELSIGHT_MINI_SENSOR_SURFACE_SIZE[0])
        self._camera = SensorGeometry(
            "orthographic", width, height, scale, scale, width / 2, height / 2, STANDOFF_M, DEEPEST_M
        )
        self._network: Any = None

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        """Return the table of the sensor that was calibrated on balls."""
        low, high = (share * DEEPEST_M for share in BALL_DEPTHS)
        balls = BallPresses(BALL_M, self.options.presses, (low, high))
        return {"name": "calibrated", "path": str(calibrate_on_balls(self, self._camera, folder, balls))}

    def press(self, scene: Scene, T_sensor_object: Poses, rng: np.random.Generator) -> Image:
        """Return the image (H, W, 3) at the camera's size."""
        if self._network is None:
            self._network = mk_tactile_renderer("cycle_gan", "jax", "cpu")
        size_px = self._network.get_desired_depth_map_size(SIZE_PX)
        seen = Scene(scene.object, scene.geometry.resize(*size_px), scene.renderer)
        press_m = scene.geometry.indentation_m
        depth_m = np.minimum(seen.render_contact_depths(T_sensor_object[None])[0], np.float32(press_m))
        distance_m = (depth_m + np.float32(THICKNESS_M - press_m)).astype(np.float32)  # from the gel's plate
        found = self._network.render(distance_m[None], SIZE_PX)[0]
        return np.rint(255 * np.clip(found, 0, 1)).astype(np.uint8)
