"""Real images of a prism with known poses, on a GelSlim-like sensor that is calibrated on real presses of a ball.

The folder is that of a public repository (RVSATHU/GelSight-Sim2Real). The prism's poses were fitted to the outline of
its tip in the images. The tip is symmetric under a half turn, and the sides of the prism are vertical. So one touch
determines the tip's position and yaw, and the press.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import PIL.Image
from pydantic import Field
from tactile_loc import convert_presses, load_object
from tactile_loc.plugin import ComponentOptions, ConfigError, ObjectModel, Poses, SensorGeometry
from tactile_loc.plugin.helpers import make_transform, rotation_about

from tactile_loc_benchmark.interfaces import RecordedSource, RecordedTouch
from tactile_loc_benchmark.sources.calibrating import calibrate_sensor

BALLS, SHAPES, POSES, MESH = "gelslim_balls", "gelslim_shapes", "poses.json", "prism.stl"
BALL_MM, MM_PER_PX = 2.92, 0.059259
SIDE_PX = 320
STANDOFF_M, DEEPEST_M = 10e-3, 1.5e-3
TIP_Z_M = 20e-3  # the prism's tip in the mesh
HALF = 0.5  # the poses count pixels from the centre of the first pixel
PRISM = "prism"


class GelslimShapes(RecordedSource):
    """Real touches of a prism at four press depths."""

    licence: ClassVar[str] = "none stated"

    class Options(ComponentOptions):
        """The folder of the recordings."""

        data: str = Field(description=f"folder with {BALLS} and {SHAPES}")

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        """Return the table of the sensor that was calibrated on the real presses of a ball."""
        presses = folder / "presses"
        convert_presses(self._find(BALLS), presses, BALL_MM, MM_PER_PX)
        return {"name": "calibrated", "path": str(calibrate_sensor(presses, make_camera(), folder / "sensor"))}

    def find_objects(self) -> Mapping[str, ObjectModel]:
        """Return the prism. Raises ConfigError if the recording is missing, and ObjectError if the mesh is."""
        return {PRISM: load_object(self._find(SHAPES) / MESH, "mm", "z2", name=PRISM)}

    def read_touches(self, name: str) -> Iterable[RecordedTouch]:
        """Return the touches of the prism. The lightest press has the position of the next one."""
        folder = self._find(SHAPES)
        poses = json.loads((folder / POSES).read_text(encoding="utf-8"))
        nearest = min(poses, key=_read_press_mm)
        for path in sorted(folder.glob(f"{PRISM}_*_real.png")):
            key = path.stem.removesuffix("_real")
            T = place_prism(poses.get(key, poses[nearest]), 1e-3 * _read_press_mm(key))
            yield RecordedTouch(np.asarray(PIL.Image.open(path).convert("RGB")), T, key)

    def _find(self, name: str) -> Path:
        folder = Path(self.options.data).expanduser() / name
        if not folder.is_dir():
            raise ConfigError(f"there is no folder {folder}; state the folder of the recorded touches, `data`")
        return folder


def make_camera() -> SensorGeometry:
    """Return the camera of the images."""
    scale, middle = 1e3 / MM_PER_PX, SIDE_PX / 2
    return SensorGeometry("orthographic", SIDE_PX, SIDE_PX, scale, scale, middle, middle, STANDOFF_M, DEEPEST_M)


def place_prism(pose: Mapping[str, Any], press_m: float) -> Poses:
    """Return the pressed prism's pose `T_sensor_object` (4, 4), metres, given its pose in the image.

    The pose in the image has the pixel `origin_px` of the mesh's z axis, and the angle `theta_deg`. The mesh's z axis
    points to the camera, and its y axis up in the image.
    """
    camera = make_camera()
    scale = camera.scale_at_surface[0]
    x_m, y_m = ((value + HALF - SIDE_PX / 2) / scale for value in pose["origin_px"])
    turned = rotation_about([0, 0, 1], float(np.radians(pose["theta_deg"])))
    return make_transform(turned @ np.diag([1.0, -1.0, -1.0]), [x_m, y_m, camera.surface_m - press_m + TIP_Z_M])


def _read_press_mm(key: str) -> float:
    return float(key.rpartition("_")[2])
