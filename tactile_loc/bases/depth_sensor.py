"""Base class for sensors with a fixed geometry whose observations are already contact shapes."""

import dataclasses
from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.runtime.errors import SensorError, TouchError
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.sensing.gel import DEFAULT_THICKNESS_M, RIGID, Gel, GelKind
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import FROM_DEPTH, ContactShape, Meaning, contact_shape_from_array
from tactile_loc.slots.sensor import SensorModel


class GelOptions(ComponentOptions):
    """The elasticity of the sensor's gel; None keeps what the sensor says."""

    gel: GelKind | None = Field(None, description="the gel: rigid, or an elastic layer")
    gel_thickness_mm: float | None = Field(None, gt=0, description="thickness of the elastic layer, mm")
    poisson: float | None = Field(None, ge=0, lt=0.5, description="Poisson's ratio of the elastic layer")
    gel_coating_mm: float | None = Field(None, ge=0, description="depth of the visible interface in the layer, mm")

    def make_gel(self, gel: Gel, thickness_m: float = DEFAULT_THICKNESS_M) -> Gel:
        """Return a sensor's gel, changed as these options say. Raises SensorError if they contradict each other.

        A layer is `thickness_m` metres thick if neither the gel nor the options state a thickness.
        """
        if self.gel == "rigid" and (self.gel_thickness_mm is not None or self.poisson is not None):
            raise SensorError("a rigid gel has no thickness and no Poisson's ratio; give gel=layer, or leave them out")
        if self.gel == "rigid" or (self.gel is None and not gel.is_elastic and self.gel_thickness_mm is None):
            if self.gel_coating_mm is not None:
                raise SensorError("a rigid gel has no coating; give gel=layer, or leave gel_coating_mm out")
            return RIGID
        if self.gel_thickness_mm is not None:
            chosen_m = 1e-3 * self.gel_thickness_mm
        else:
            chosen_m = gel.thickness_m or thickness_m
        coating_m = gel.coating_m if self.gel_coating_mm is None else 1e-3 * self.gel_coating_mm
        return Gel(chosen_m, gel.poisson if self.poisson is None else self.poisson, coating_m)


class DepthSensor(SensorModel):
    """Base class for sensors that take contact shapes and are not calibrated for images.

    `gel_thickness_m`, metres, is the thickness of the gel if it is elastic and its thickness is not given. Raises
    SensorError if the geometry is not plausible.
    """

    gel_thickness_m: ClassVar[float] = DEFAULT_THICKNESS_M

    def __init__(self, options: ComponentOptions | None = None) -> None:
        super().__init__(options)
        self._geometry = self._make_geometry()
        if isinstance(self.options, GelOptions):
            gel = self.options.make_gel(self._geometry.gel, self.gel_thickness_m)
            self._geometry = dataclasses.replace(self._geometry, gel=gel)

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
                "16-bit grey .png), or a calibration folder as `sensor`"
            )
        shape = contact_shape_from_array(depth, self.geometry.max_depth_m, meaning=Meaning(option=FROM_DEPTH))
        if depth.shape != self.geometry.shape:
            raise TouchError(
                f"the contact shape is {depth.shape} pixels, but the sensor's image is {self.geometry.shape} "
                "(rows, columns); choose the sensor that took it, or set its image_size_px"
            )
        return shape
