"""Base class for sensors with a fixed geometry whose observations are already contact shapes."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import TouchError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, contact_shape_from_array
from tactile_loc.core.slots.component import ComponentOptions
from tactile_loc.core.slots.sensor import SensorModel


class DepthSensor(SensorModel):
    """Base class for sensors that take contact shapes and are not calibrated for images.

    Raises SensorError if the geometry is not plausible.
    """

    def __init__(self, options: ComponentOptions | None = None) -> None:
        super().__init__(options)
        self._geometry = self._make_geometry()

    @abstractmethod
    def _make_geometry(self) -> SensorGeometry:
        """Return the geometry (metres, pixels) from the options."""

    @property
    def geometry(self) -> SensorGeometry:
        """The camera behind the sensing surface (metres, pixels)."""
        return self._geometry

    def contact_shape(self, image: NDArray[Any]) -> ContactShape:
        """Convert depths (H, W), metres, from full penetration, to a contact shape.

        NaN, or a depth of at least the maximal depth, means no contact. Raises TouchError if the observation is an
        image, or if its size, type or unit is wrong.
        """
        depth = np.asarray(image)
        if depth.ndim == 3 or depth.dtype == np.uint8:
            raise TouchError(
                f"the sensor {type(self).__name__} is not calibrated for images; give a contact shape (.npz, .npy or "
                "16-bit grey .png), or a calibration folder as --sensor"
            )
        shape = contact_shape_from_array(depth, self.geometry.max_depth_m)
        if depth.shape != self.geometry.shape:
            raise TouchError(
                f"the contact shape is {depth.shape} pixels, but the sensor's image is {self.geometry.shape} "
                "(rows, columns); choose the sensor that took it, or set its image_size_px"
            )
        return shape
