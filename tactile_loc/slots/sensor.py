"""The sensor slot: the geometry of a tactile sensor, and contact shapes from its images."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from tactile_loc.core.sensing.depth_maps import DepthKind, DepthUnit
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.slots.component import Component


@dataclass(frozen=True)
class DepthFiles:
    """The unit and the kind of the depths in a sensor's files, if the files do not state them. None declares nothing.

    `kind` is the meaning of the depths, as in `Touch.from_depth`.
    """

    unit: DepthUnit | None = None
    kind: DepthKind | None = None


class SensorModel(Component):
    """A tactile sensor: its geometry, and the conversion of observations to contact shapes.

    `depth_files` declares what the sensor's software writes, so that users need not state it.
    """

    slot = "sensor"
    depth_files: DepthFiles = DepthFiles()

    @property
    @abstractmethod
    def geometry(self) -> SensorGeometry:
        """The camera behind the sensing surface (metres, pixels)."""

    @abstractmethod
    def contact_shape(self, image: NDArray[Any]) -> ContactShape:
        """Convert an observation, an image (H, W, 3) uint8 or depths (H, W) in metres, to a contact shape.

        Raises TouchError if the observation does not fit the sensor.
        """

    def rectify(self, photo: NDArray[Any]) -> NDArray[Any]:
        """Return a photo as an image (H, W, 3) of the part of the gel that `geometry` sees; by default, the photo.

        `contact_shape` takes the photo as the camera took it.
        """
        return photo
