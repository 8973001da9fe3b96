"""Registration by ICP from many starts."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from pydantic import Field
from tactile_loc.plugin import ObjectModel, Poses, Touch
from tactile_loc.plugin.helpers import draw_rotations, invert, make_transform

from tactile_loc_benchmark.interfaces import LocatingProblem, Method, ScoredPoses
from tactile_loc_benchmark.methods.surface_fit import FitOptions, SurfaceFit
from tactile_loc_benchmark.methods.touched_points import TouchedPoints, find_deepest_point, find_sensor_pose


class IcpFromStarts(Method):
    """Point-to-plane ICP (Chen and Medioni, 1992) from many starts; the best pose has the most touched points on it.

    Many starts are the usual remedy for the local minima of ICP. Our own part is the choice of the starts: the rotation
    is random, and the object's foremost point lies at the deepest point of one of the touches. The score ignores that
    the object must not reach into the sensor where nothing touches.
    """

    paper: ClassVar[str] = "Chen and Medioni, 1992"

    class Options(FitOptions):
        """The number of starts."""

        starts: int = Field(default=400, ge=1, description="number of random rotations")
        seed: int = Field(default=0, ge=0, description="seed of the random rotations")

    def prepare(self, problem: LocatingProblem) -> None:
        """Build the object's field of nearest surface points."""
        self._fit = SurfaceFit.of(problem.object, self.options)

    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        """Return the registered poses with the highest scores. Raises TouchError if no pose fits."""
        points = TouchedPoints.of(touches, self.options.points)
        starts = draw_starts(problem.object, touches, self.options.starts, np.random.default_rng(self.options.seed))
        return self._fit.find_best(invert(points.T_base_first) @ starts, points)


def draw_starts(obj: ObjectModel, touches: Sequence[Touch], count: int, rng: np.random.Generator) -> Poses:
    """Return poses T_base_object (count, 4, 4), metres, that touch one of the touches' deepest points.

    The rotations are uniformly random. The object's point that is nearest to the sensor lies at the deepest point.
    """
    poses = []
    for k, touch in enumerate(touches):
        R = draw_rotations(len(range(k, count, len(touches))), rng)
        corners = obj.mesh.hull_corners_m @ np.swapaxes(R, -1, -2)
        foremost = corners[np.arange(len(R)), corners[..., 2].argmin(axis=1)]
        poses.append(find_sensor_pose(touch) @ make_transform(R, find_deepest_point(touch) - foremost))
    return np.concatenate(poses)
