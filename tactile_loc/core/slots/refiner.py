"""The refiner slot: candidates in, refined poses out."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.component import Component
from tactile_loc.core.slots.scene import Scene, View


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose to refine: `T_sensor_object` (4, 4) in metres, its grid index and log-probability."""

    T_sensor_object: NDArray[np.float64]
    index: int
    log_p: float


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """A refined pose (4, 4) in metres. `contact_iou`, 0 to 1 (unitless), tells how well it explains the touch's
    outline: `Scene.contact_iou`, the mean over several touches.

    `T_sensors_object` (N, 4, 4), metres, is where each sensor of several touches sees the object, if the refiner solves
    for the errors of sensor poses; None: where they are said to be.
    `covariance` (6, 6), if the refiner knows it, is that of the error of x, y, z of the object frame's origin (m) and
    of a rotation vector (rad), both along the sensor's axes: the order and frame of ROS's PoseWithCovariance.
    """

    T_sensor_object: NDArray[np.float64]
    contact_iou: float
    converged: bool
    iterations: int
    covariance: NDArray[np.float64] | None = None
    T_sensors_object: NDArray[np.float64] | None = None


class Refiner(Component):
    """Moves a candidate below the grid's resolution."""

    slot = "refiner"

    @abstractmethod
    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the refined pose; `converged` is False when nothing better than the candidate was found."""

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch, in their order; the same as `refine` one by one.

        Override it where candidates together are faster than one after another.
        """
        return [self.refine(touch, candidate, scene) for candidate in candidates]

    def refine_together(self, views: Sequence[View], candidates: Sequence[Candidate]) -> list[RefinedPose]:
        """Refine candidates, poses in the first touch's sensor frame, against several touches.

        Each touch refines all of them. What one touch gains by that others may lose: of these poses and the candidate
        itself the one is taken that all touches together like best. Override it to regard all touches at once.
        """
        if len(views) == 1:
            return self.refine_many(views[0].touch, candidates, views[0].scene)
        rows = [[RefinedPose(c.T_sensor_object, 0.0, False, 0) for c in candidates]]
        for view in views:
            T_first_sensor = invert(view.T_sensor_first)
            seen = [dataclasses.replace(c, T_sensor_object=view.T_sensor_first @ c.T_sensor_object) for c in candidates]
            found = self.refine_many(view.touch, seen, view.scene)
            rows.append([dataclasses.replace(r, T_sensor_object=T_first_sensor @ r.T_sensor_object) for r in found])
        poses = np.array([[r.T_sensor_object for r in row] for row in rows])
        ious = np.array([np.mean([view.imprint_ious(T) for view in views], axis=0) for T in poses])
        best = ious.argmax(axis=0)
        return [rows[b][k] for k, b in enumerate(best)]
