"""Contact shapes of an elastic half-space, solved by tamaas (Frérot and others).

tamaas prescribes the load, and a press prescribes the indentation. So the load is searched for, with the secant method.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import tamaas
from tactile_loc.plugin import ContactShape, Poses, Scene, SensorGeometry, TouchError

from tactile_loc_benchmark.interfaces import SimulatedSource
from tactile_loc_benchmark.sources.elastic import ElasticOptions, Floats, find_reach_m, make_shape, measure_sides_m

THICK_MM = 1e3  # a layer of this thickness acts as a half-space
TOLERANCE = 1e-4  # of the solver
NEAR = 0.005  # greatest error of the indentation, share of the press
MOST_LOADS = 8
STEPS = (1 / 3, 3.0)  # least and greatest ratio of consecutive loads
SINKING = 1.5  # exponent of a ball's load in its indentation (Hertz)
OPERATOR = "dcfft"  # the convolution of a window that does not repeat
FIRST = 1.4  # share of the load of a flat round punch with the same rigid contact: objects are rounder


class HalfSpaceSolver:
    """An elastic half-space under a window, with the shear modulus one."""

    def __init__(self, geometry: SensorGeometry, poisson: float) -> None:
        tamaas.set_log_level(tamaas.LogLevel.error)
        self.sides_m = measure_sides_m(geometry)
        self.poisson = poisson
        self.model = tamaas.ModelFactory.createModel(
            tamaas.model_type.basic_2d, list(self.sides_m), list(geometry.shape)
        )
        self.model.E, self.model.nu = 2 * (1 + poisson), poisson
        tamaas.ModelFactory.registerNonPeriodic(self.model, OPERATOR)

    def press(self, reach_m: Floats) -> Floats:
        """Return the displacement (H, W), metres, given the object's reach (H, W) into the undeformed gel, metres.

        Raises TouchError if no load gives the indentation.
        """
        press_m = float(reach_m.max())
        solver = tamaas.PolonskyKeerRey(self.model, reach_m, TOLERANCE)
        solver.setIntegralOperator(OPERATOR)
        load, before = self._guess_load(reach_m), (0.0, 0.0)
        for number in range(MOST_LOADS):
            solver.solve(load)
            displacement_m = np.zeros_like(self.model.displacement)
            self.model.operators[OPERATOR](self.model.traction, displacement_m)
            missing_m = float((reach_m - displacement_m)[self.model.traction > 0].mean())
            if abs(missing_m) < NEAR * press_m:
                return displacement_m
            if number == 0:
                ratio = (press_m / max(press_m - missing_m, 1e-3 * press_m)) ** SINKING
            else:
                ratio = 1 - missing_m / load * (load - before[0]) / (missing_m - before[1])
            before = load, missing_m
            load *= float(np.clip(ratio, *STEPS))
        raise TouchError("tamaas found no load for this press; press less deeply")

    def _guess_load(self, reach_m: Floats) -> float:
        """Return a mean pressure from that of a flat round punch with the area of the rigid contact."""
        area_m2 = float(np.prod(self.sides_m))
        radius_m = float(np.sqrt((reach_m > 0).mean() * area_m2 / np.pi))
        return FIRST * 2 * radius_m * float(reach_m.max()) / ((1 - self.poisson) * area_m2)


class ElasticHalfSpace(SimulatedSource):
    """Presses objects on an elastic half-space: a gel that is much thicker than the contact is wide."""

    licence: ClassVar[str] = "AGPL-3.0"
    libraries: ClassVar[tuple[str, ...]] = ("tamaas",)

    class Options(ElasticOptions):
        """The sensor, its image size, and the gel."""

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        """Return the sensor's table; nothing has to be calibrated."""
        return dict(self.options.describe_sensor(THICK_MM))

    def press(self, scene: Scene, T_sensor_object: Poses, rng: np.random.Generator) -> ContactShape:
        """Return the contact shape of the half-space's surface."""
        reach_m = find_reach_m(scene, T_sensor_object)
        displacement_m = HalfSpaceSolver(scene.geometry, self.options.poisson).press(reach_m)
        return make_shape(displacement_m, scene.geometry.indentation_m)
