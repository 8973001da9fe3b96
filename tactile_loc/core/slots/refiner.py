"""The refiner slot: refines candidate poses."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.poses.priors import Prior
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
    """A refined pose `T_sensor_object` (4, 4), metres.

    `contact_iou`, 0 to 1, is the contact IoU with the touch (see `Scene.contact_iou`), or the mean over several
    touches. `covariance` (6, 6) is the covariance of the pose's error, if the refiner estimates it. The error is x, y,
    z of the object frame's origin (m), then a rotation vector (rad). Both are along the sensor's axes, as in ROS's
    PoseWithCovariance. `T_sensors_object` (N, 4, 4), metres, are the object's poses in the frames of several sensors,
    if the refiner corrects the sensors' poses; else None.

    `T_reported_object` (4, 4), metres, is the pose relative to the reported pose of the sensor, which may be wrong.
    It is T_sensor_object unless the refiner corrects the sensor's pose. T_base_object is T_base_sensor @
    T_reported_object. Its `reported_covariance` (6, 6), in the order and axes of `covariance`, includes the errors of
    the sensors' poses. `imprint_iou`, 0 to 1, is the imprint IoU with the touch, or the mean over several touches, if
    the refiner computes it.
    """

    T_sensor_object: NDArray[np.float64]
    contact_iou: float
    converged: bool
    iterations: int
    covariance: NDArray[np.float64] | None = None
    T_sensors_object: NDArray[np.float64] | None = None
    T_reported_object: NDArray[np.float64] | None = None
    reported_covariance: NDArray[np.float64] | None = None
    imprint_iou: float | None = None


class Refiner(Component):
    """Refines candidate poses beyond the resolution of the grid."""

    slot = "refiner"

    @abstractmethod
    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the refined pose. Its `converged` is False if no pose better than the candidate was found."""

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch, in their order, with the same results as `refine`.

        Override this method if refining several candidates together is faster.
        """
        return [self.refine(touch, candidate, scene) for candidate in candidates]

    def refine_together(self, views: Sequence[View], candidates: Sequence[Candidate]) -> list[RefinedPose]:
        """Refine candidates, given as poses in the frame of the first touch's sensor, against several touches.

        By default, each candidate is refined against each touch separately. The result is the refined pose with the
        best mean imprint IoU over all touches, or the candidate itself if its mean is best. Override this method to use
        all touches at once.
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

    def refine_expected(
        self, views: Sequence[View], candidates: Sequence[Candidate], prior: Prior
    ) -> list[RefinedPose]:
        """Refine candidates as `refine_together` does, given a `prior` over poses in the first touch's sensor frame.

        By default, the prior is ignored. Override this method if the prior can decide where the touches leave a pose
        open.
        """
        return self.refine_together(views, candidates)
