"""A calibrated sensor: reads tactile images with the folder that `tactile-loc calibrate` wrote."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import ContactShape, SensorGeometry
from tactile_loc.plugin.helpers import DepthSensor, GelOptions
from tactile_loc.sensors.calibration.folder import Calibration, read_calibration
from tactile_loc.sensors.reading.reading import find_contact_shape, find_gel_surface, read_by_laws


class CalibratedSensor(DepthSensor):
    """Reads images of the gel, and contact shapes. Raises CalibrationError when the folder is incomplete."""

    class Options(GelOptions):
        """The `path` of the calibration folder, and optionally `zero`, a newer image of the untouched gel."""

        path: str = Field(description="calibration folder written by `tactile-loc calibrate`")
        zero: str | None = Field(default=None, description="newer image of the untouched gel to compare images with")

    def describe(self) -> dict[str, Any]:
        """Return JSON values that identify the sensor by the folder's content, not by its path."""
        gel = {"gel": self.geometry.gel.describe()} if self.geometry.gel.is_elastic else {}
        return {**super().describe(), "options": {**self.calibration.describe(), **gel}}

    def contact_shape(self, image: NDArray[Any]) -> ContactShape:
        """Return the contact shape of an image (H, W, 3) uint8, or of depths (H, W) in metres.

        Raises TouchError for an image of another sensor, or an image without contact.
        """
        image = np.asarray(image)
        if image.ndim == 2 and image.dtype != np.uint8:
            return super().contact_shape(image)
        known, seen = self.calibration, self.calibration.read(image, self.geometry.gel)
        limits = known.noise_m, known.false_press_m
        if not self.geometry.gel.is_elastic:
            return find_contact_shape(seen.indentation_m, self.geometry, *limits)
        if self.options.gel is None and known.geometry.gel.is_elastic:
            return read_by_laws(seen, self.geometry, *limits)
        return find_gel_surface(seen.indentation_m, self.geometry, *limits)

    def rectify(self, photo: NDArray[Any]) -> NDArray[Any]:
        """Return the image of equal scale of a photo (H, W, 3). Raises TouchError for a photo of another size."""
        return self.calibration.rectify(photo)

    def _make_geometry(self) -> SensorGeometry:
        zero = None if self.options.zero is None else Path(self.options.zero).expanduser()
        self.calibration: Calibration = read_calibration(Path(self.options.path).expanduser(), zero)
        return self.calibration.geometry
