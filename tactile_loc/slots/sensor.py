"""The sensor slot: the geometry of a tactile sensor, and contact shapes from its images."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.slots.component import Component


class SensorModel(Component):
    """A tactile sensor: its geometry, and the conversion of observations to contact shapes."""

    slot = "sensor"

    @property
    @abstractmethod
    def geometry(self) -> SensorGeometry:
        """The camera behind the sensing surface (metres, pixels)."""

    @abstractmethod
    def contact_shape(self, image: NDArray[Any]) -> ContactShape:
        """Convert an observation, an image (H, W, 3) uint8 or depths (H, W) in metres, to a contact shape.

        Raises TouchError if the observation does not fit the sensor.
        """

    def simulated_image(self, shape: ContactShape, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return the image (H, W, 3) that the sensor's camera would take of a contact shape, with its noise.

        Raises ConfigError if the sensor does not read images, and CalibrationError if it cannot simulate them.
        """
        raise ConfigError(
            f"the sensor {type(self).__name__} does not read images; give the folder of tactile-loc calibrate "
            "--simulated as `sensor`"
        )
