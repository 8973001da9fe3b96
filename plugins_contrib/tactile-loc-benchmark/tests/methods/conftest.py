"""Touches of a block without symmetry, drawn exactly, and what a method knows about the block."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from tactile_loc import RobotTouches
from tactile_loc.core.poses.tolerance import measure_shape_distances
from tactile_loc.plugin import ObjectModel, Poses, Touch
from tactile_loc.plugin.helpers import make_transform, rotation_about
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer
from tactile_loc.plugins.sensors.presets import GelSightMini
from tactile_loc.testing.problems import make_block

from tactile_loc_benchmark.interfaces import LocatingProblem, Method
from tactile_loc_benchmark.methods.surface_fit import TIE

T_BASE_OBJECT = make_transform(rotation_about([1.0, -2.0, 0.5], 2.1), [0.2, -0.1, 0.05])
SEED = 3


@dataclass(frozen=True, eq=False)
class Example:
    """Three touches of an object in the base frame, without the true pose."""

    problem: LocatingProblem
    touches: list[Touch]
    T_base_object: Poses

    @property
    def object(self) -> ObjectModel:
        return self.problem.object

    def measure_error_m(self, method: Method) -> float:
        """Return the shape distance of the method's best pose from the true pose, metres.

        If several poses have the best score, the least distance counts: the method cannot tell these poses apart.
        """
        method.prepare(self.problem)
        found = method.locate(self.problem, self.touches)
        best = found.T_base_object[found.scores >= found.scores.max() - TIE]
        return float(measure_shape_distances(self.object.mesh, best, self.T_base_object).min())


@pytest.fixture(scope="session")
def example(tmp_path_factory) -> Example:
    obj, geometry = make_block(2.0), GelSightMini().geometry
    drawn, _ = RobotTouches(obj, geometry, ZBufferRenderer()).draw_example(3, np.random.default_rng(SEED))
    touches = [replace(t, T_base_sensor=T_BASE_OBJECT @ t.T_base_sensor, T_sensor_object=None) for t in drawn]
    folder = tmp_path_factory.mktemp("methods")
    return Example(LocatingProblem(obj, {"name": "gelsight-mini"}, geometry, folder), touches, T_BASE_OBJECT)
