"""Touches from the height and depth maps of tactile simulators.

CONVENTIONS states what each simulator gives, and `make_touch` converts it.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tactile_loc import Touch
from tactile_loc.plugin import SensorGeometry, SensorModel, TouchError

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # T_camera_sensor of a camera that looks along its -z axis, with y up
ROS = np.eye(4)  # T_camera_sensor of a camera with the axes of an optical frame

Meaning = Literal["distance from the camera", "indentation", "height"]


@dataclass(frozen=True)
class Convention:
    """What a simulator gives: the `array` in its words, its `meaning` and `unit`, and the axes `T_camera_sensor`.

    Rows of all arrays run down the image, and columns to the right. `source` is where the simulator states this.
    `tested` is False if only its documentation or its code was read.
    """

    array: str
    meaning: Meaning
    unit: Literal["m", "mm"]
    T_camera_sensor: NDArray[np.float64]
    source: str
    tested: bool = False


CONVENTIONS = {
    "isaac-lab": Convention(
        "VisuoTactileSensorData.tactile_depth_image, (N, H, W, 1): give one of the N",
        "distance from the camera",
        "m",
        ROS,
        "isaaclab_contrib.sensors.tacsl_sensor: distance_to_image_plane",
    ),
    "tacsl": Convention(
        "the depth image of the camera in the gel, (H, W)",
        "distance from the camera",
        "m",
        ROS,
        "the same code, as it is part of Isaac Lab",
    ),
    "taxim": Convention(
        "height_map of Taxim.render, (H, W): 0 at the gel's top, negative in contact",
        "height",
        "mm",
        ROS,
        "the docstring of Taxim.render in taxim 1.4",
        tested=True,
    ),
    "tacto": Convention(
        "the depths that tacto.Sensor.render returns, (H, W) for each camera",
        "indentation",
        "m",
        OPENGL,
        "tacto/sensor.py: depth0 - depth; tacto/renderer.py: cameras of pyrender",
    ),
    "mujoco": Convention(
        "Renderer.render after enable_depth_rendering, (H, W)",
        "distance from the camera",
        "m",
        OPENGL,
        "the documentation of mujoco.Renderer",
        tested=True,
    ),
}


def make_camera(
    fovy_rad: float, width_px: int, height_px: int, standoff_m: float, max_depth_m: float
) -> SensorGeometry:
    """Return the sensor of a simulated pinhole camera, whose image sees the angle `fovy_rad` from top to bottom.

    `standoff_m` is the distance from the camera to the undeformed gel, and `max_depth_m` the deepest press, metres.
    """
    f = 0.5 * height_px / math.tan(0.5 * fovy_rad)
    return SensorGeometry("pinhole", width_px, height_px, f, f, width_px / 2, height_px / 2, standoff_m, max_depth_m)


def make_touch(
    simulator: str,
    values: ArrayLike,
    sensor: SensorModel | SensorGeometry,
    untouched: ArrayLike | None = None,
    **more: Any,
) -> Touch:
    """Return the touch in an array of a simulator, which is one of CONVENTIONS.

    `untouched` is the array of the untouched gel, for distances from the camera. By default, the gel is flat at the
    sensor's standoff. `more` are further arguments of `Touch.from_depth`, such as `T_base_sensor`. Raises TouchError
    for an unknown simulator and for an array that does not fit the sensor, and NoContactError if nothing is touched.
    """
    if simulator not in CONVENTIONS:
        raise TouchError(f"the simulator {simulator!r} is unknown; choose one of {', '.join(CONVENTIONS)}")
    convention, seen = CONVENTIONS[simulator], _flatten(values)
    if convention.meaning == "height":
        return Touch.from_depth(seen, kind="height", sensor=sensor, unit=convention.unit, **more)
    if convention.meaning == "distance from the camera":
        geometry = sensor if isinstance(sensor, SensorGeometry) else sensor.geometry
        seen = (geometry.standoff_m if untouched is None else _flatten(untouched)) - seen
    return Touch.from_depth(np.maximum(seen, 0.0), kind="indentation", sensor=sensor, unit=convention.unit, **more)


def _flatten(values: ArrayLike) -> NDArray[np.float64]:
    """Return an array (H, W) of one with a channel, also if it is a tensor on a processor."""
    seen = np.asarray(values, float)
    return seen[..., 0] if seen.ndim == 3 and seen.shape[-1] == 1 else seen
