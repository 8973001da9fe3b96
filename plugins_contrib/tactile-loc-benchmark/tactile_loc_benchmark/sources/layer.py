"""Contact shapes of an elastic layer, solved by ContactMechanics (Pastewka and others)."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import ContactMechanics
import numpy as np
from ContactMechanics.Systems import NonSmoothContactSystem
from pydantic import Field
from SurfaceTopography import Topography
from tactile_loc.plugin import ContactShape, Poses, Scene, SensorGeometry, TouchError

from tactile_loc_benchmark.interfaces import SimulatedSource
from tactile_loc_benchmark.sources.elastic import (
    FAR_M,
    MM,
    ElasticOptions,
    Floats,
    find_reach_m,
    make_shape,
    measure_sides_m,
)

MOST_ITERATIONS, PENETRATION_MM = 500, 1e-4


def press_layer(reach_m: Floats, geometry: SensorGeometry, thickness_m: float, poisson: float) -> Floats:
    """Return the displacement (H, W), metres, of an elastic gel, given the object's reach (H, W) into it, metres.

    A layer of a thickness in metres and with Poisson's ratio `poisson` is solved in a window of twice the image's size.
    An infinite thickness is a half-space, with Poisson's ratio zero. Raises TouchError if the solver does not converge.
    """
    (height, width), sides_mm = reach_m.shape, tuple(MM * side for side in measure_sides_m(geometry))
    if math.isinf(thickness_m):
        shape = (height, width)
        substrate = ContactMechanics.FreeFFTElasticHalfSpace(shape, 1.0, sides_mm)
    else:
        shape, sides_mm = (2 * height, 2 * width), (2 * sides_mm[0], 2 * sides_mm[1])
        substrate = ContactMechanics.PeriodicFFTElasticHalfSpace(
            shape, 1.0, sides_mm, thickness=thickness_m * MM, poisson=poisson
        )
    heights_mm = np.full(shape, -FAR_M * MM)
    heights_mm[:height, :width] = reach_m * MM
    system = NonSmoothContactSystem(substrate, Topography(heights_mm, sides_mm))
    if not system.minimize_proxy(offset=0.0, pentol=PENETRATION_MM, maxiter=MOST_ITERATIONS).success:
        raise TouchError("ContactMechanics did not converge for this press; press less deeply")
    return np.asarray(system.disp[:height, :width] / MM)


class ElasticLayer(SimulatedSource):
    """Presses objects on an elastic layer that is bonded to a rigid plate."""

    licence: ClassVar[str] = "MIT"
    libraries: ClassVar[tuple[str, ...]] = ("ContactMechanics", "SurfaceTopography", "muGrid")

    class Options(ElasticOptions):
        """The sensor, its image size, and the gel."""

        thickness_mm: float = Field(default=4.25, gt=0, description="thickness of the gel, mm")

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        """Return the sensor's table; nothing has to be calibrated."""
        return dict(self.options.describe_sensor(self.options.thickness_mm))

    def press(self, scene: Scene, T_sensor_object: Poses, rng: np.random.Generator) -> ContactShape:
        """Return the contact shape of the layer's surface."""
        reach_m, thickness_m = find_reach_m(scene, T_sensor_object), self.options.thickness_mm / MM
        displacement_m = press_layer(reach_m, scene.geometry, thickness_m, self.options.poisson)
        return make_shape(displacement_m, scene.geometry.indentation_m)
