"""The refiner slot: refines candidate poses."""

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
    """A pose to refine: `T_sensor_object` (4, 4), metres, its grid index and log-probability."""

    T_sensor_object: NDArray[np.float64]
    index: int
    log_p: float


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """A refined pose (4, 4), metres. `contact_iou`, 0 to 1, is the contact IoU with the touch (`Scene.contact_iou`), or
    the mean over several touches.

    `T_sensors_object` (N, 4, 4), metres, is the object's pose in the frame of each of several sensors, if the refiner
    solves for errors of sensor poses; else None. `covariance` (6, 6), if the refiner estimates it, is that of the
    pose's error: x, y, z of the object frame's origin (m), then a rotation vector (rad). Both are along the sensor's
    axes, as in ROS's PoseWithCovariance.
    """

    T_sensor_object: NDArray[np.float64]
    contact_iou: float
    converged: bool
    iterations: int
    covariance: NDArray[np.float64] | None = None
    T_sensors_object: NDArray[np.float64] | None = None


class Refiner(Component):
    """Refines candidates below the grid's resolution."""

    slot = "refiner"

    @abstractmethod
    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the refined pose; `converged` is False if nothing better than the candidate was found."""

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch, in their order, with the same results as `refine`.

        Override it if refining several candidates together is faster.
        """
        return [self.refine(touch, candidate, scene) for candidate in candidates]

    def refine_together(self, views: Sequence[View], candidates: Sequence[Candidate]) -> list[RefinedPose]:
        """Refine candidates, poses in the first touch's sensor frame, against several touches.

        By default, the candidates are refined against each touch separately. For each candidate, the result is the pose
        with the best mean imprint IoU over all touches: one of these, or the candidate itself. Override it to use all
        touches at once.
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
