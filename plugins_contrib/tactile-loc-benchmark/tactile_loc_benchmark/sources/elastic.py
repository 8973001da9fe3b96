"""What the sources with an elastic gel have in common: the sensor, the object's reach into the gel, and the shape."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.plugin import ComponentOptions, ContactShape, Poses, Scene, SensorGeometry

MM = 1e3
FAR_M = 50e-3  # distance of an object that is nowhere near a pixel

Floats = NDArray[np.float64]


class ElasticOptions(ComponentOptions):
    """The sensor, its image size, and the gel."""

    sensor: str = Field(default="gelsight-mini", description="the sensor's name")
    image_size_px: tuple[int, int] = Field(
        default=(128, 96), description="image size (width, height), pixels; twice this size takes eight times as long"
    )
    poisson: float = Field(default=0.48, ge=0, lt=0.5, description="Poisson's ratio of the gel")

    def describe_sensor(self, thickness_mm: float) -> dict[str, Any]:
        """Return the sensor's table, with an elastic gel of a thickness in mm."""
        gel = {"gel": "layer", "gel_thickness_mm": thickness_mm, "poisson": self.poisson}
        return {"name": self.sensor, "image_size_px": list(self.image_size_px), **gel}


def find_reach_m(scene: Scene, T_sensor_object: Poses) -> Floats:
    """Return how far (H, W), metres, a pressed pose (4, 4) reaches into the undeformed gel; negative beside it."""
    depth_m = scene.render_contact_depths(T_sensor_object[None])[0].astype(float)
    seen = depth_m < np.float32(scene.geometry.max_depth_m)
    return np.where(seen, scene.geometry.indentation_m - depth_m, -FAR_M)


def make_shape(displacement_m: Floats, press_m: float) -> ContactShape:
    """Return the contact shape of a gel's displacement (H, W), metres."""
    return ContactShape(np.clip(press_m - displacement_m, 0, press_m).astype(np.float32), press_m)


def measure_sides_m(geometry: SensorGeometry) -> tuple[float, float]:
    """Return the height and the width of the image on the undeformed gel, metres."""
    sx, sy = geometry.scale_at_surface
    return geometry.height_px / sy, geometry.width_px / sx
