"""The refiner slot: refines candidate poses."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.sensing.scene import Scene, View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.slots.component import Component


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

    def refine_with_prior(
        self, views: Sequence[View], candidates: Sequence[Candidate], prior: Prior
    ) -> list[RefinedPose]:
        """Refine candidates as `refine_together` does, given a `prior` over poses in the first touch's sensor frame.

        By default, the prior is ignored. Override this method if the prior can decide where the touches leave a pose
        open.
        """
        return self.refine_together(views, candidates)
