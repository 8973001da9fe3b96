"""Images drawn by Taxim, a tactile simulator that was written by others.

Taxim draws the colours of two real sensors with flat gels. Its gel is no elastic layer. It follows the object where the
object reaches deeper than a share of the press, and is smoothed with Gaussian pyramids elsewhere.
"""

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.plugin import ComponentOptions, Poses, Scene, SensorGeometry

from tactile_loc_benchmark.interfaces import Image, SimulatedSource
from tactile_loc_benchmark.sources.calibrating import BallPresses, calibrate_on_balls

# with several threads, sums are rounded differently from call to call; jax reads this when it is imported
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
import taxim

MM = 1e3
CALIBRATIONS = {"gelsight": taxim.CALIB_GELSIGHT, "gelsight-mini": taxim.CALIB_GELSIGHT_MINI}
SIZE_PX = (320, 240)
STANDOFF_M, DEEPEST_M = 10e-3, 1e-3

Make = Literal["gelsight", "gelsight-mini"]
Float32 = NDArray[np.float32]


class TaximGel:
    """Taxim with the colours of one of CALIBRATIONS and a flat gel. Images have the size of `geometry`."""

    def __init__(self, make: Make, geometry: SensorGeometry) -> None:
        self.geometry = geometry
        calibration = CALIBRATIONS[make]
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for file in calibration.iterdir():
                (folder / file.name).symlink_to(file)
            (folder / "gelmap.npy").unlink()
            np.save(folder / "gelmap.npy", np.zeros_like(np.load(calibration / "gelmap.npy", allow_pickle=False)))
            width_px = read_sensor(make)["w"]
            pitch_mm = MM * geometry.pixel_pitch_m * geometry.width_px / width_px
            self._taxim = taxim.Taxim(folder, params={"sensor": {"pixmm": pitch_mm}}, backend="jax")

    def draw_image(self, depth_m: Float32, press_m: float) -> Image:
        """Return the image (H, W, 3) uint8, given the contact depths (H, W), metres, in a rigid gel."""
        found = np.asarray(self._taxim.render(_find_heights_mm(depth_m, press_m)))
        return np.rint(255 * found).clip(0, 255).astype(np.uint8)

    def find_surface_m(self, depth_m: Float32, press_m: float) -> Float32:
        """Return the indentation (H, W), metres, of Taxim's gel, given the contact depths (H, W) in a rigid gel."""
        surface_mm, _ = self._taxim._TaximJax__compute_gel_pad_deformation(  # not public
            _find_heights_mm(depth_m, press_m)
        )
        return np.asarray(-surface_mm / MM, np.float32)


def _find_heights_mm(depth_m: Float32, press_m: float) -> Float32:
    return (MM * (np.minimum(depth_m, press_m) - press_m)).astype(np.float32)


def read_sensor(make: Make) -> dict[str, Any]:
    """Return Taxim's numbers of a sensor: its size in pixels, `w` and `h`, and the size of a pixel, `pixmm`."""
    return dict(json.loads((CALIBRATIONS[make] / "params.json").read_text(encoding="utf-8"))["sensor"])


class TaximImages(SimulatedSource):
    """Draws images with Taxim. The sensor is calibrated on balls that Taxim draws."""

    licence: ClassVar[str] = "MIT"
    libraries: ClassVar[tuple[str, ...]] = ("taxim", "jax")

    class Options(ComponentOptions):
        """The sensor, and the number of presses for its calibration."""

        sensor: Make = Field(default="gelsight-mini", description="the sensor whose colours Taxim draws")
        presses: int = Field(default=50, ge=5, description="number of presses of a ball for the calibration")

    def __init__(self, options: ComponentOptions | None = None) -> None:
        super().__init__(options)
        known = read_sensor(self.options.sensor)
        scale = MM * SIZE_PX[0] / (known["w"] * known["pixmm"])
        width, height = SIZE_PX
        self._camera = SensorGeometry(
            "orthographic", width, height, scale, scale, width / 2, height / 2, STANDOFF_M, DEEPEST_M
        )
        self._gel: TaximGel | None = None

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        """Return the table of the sensor that was calibrated on balls."""
        sensor = calibrate_on_balls(self, self._camera, folder, BallPresses(count=self.options.presses))
        return {"name": "calibrated", "path": str(sensor)}

    def press(self, scene: Scene, T_sensor_object: Poses, rng: np.random.Generator) -> Image:
        """Return the image (H, W, 3) at the camera's size."""
        if self._gel is None:
            self._gel = TaximGel(self.options.sensor, self._camera)
        seen = Scene(scene.object, scene.geometry.resize(*SIZE_PX), scene.renderer)
        depth_m = seen.render_contact_depths(T_sensor_object[None])[0]
        return self._gel.draw_image(depth_m, scene.geometry.indentation_m)
