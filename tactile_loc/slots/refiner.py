"""The refiner slot: refines candidate poses."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.alternation import alternate
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

        By default, each touch refines each candidate alone, and the results are combined by their covariances: see
        `core.registration.alternation`. Override this method if the refiner can use all touches at once.
        """
        if len(views) == 1:
            return self.refine_many(views[0].touch, candidates, views[0].scene)
        return self._combine_alone(views, candidates)

    def refine_with_prior(
        self, views: Sequence[View], candidates: Sequence[Candidate], prior: Prior
    ) -> list[RefinedPose]:
        """Refine candidates as `refine_together` does, given a `prior` over poses in the first touch's sensor frame.

        By default, the prior is combined with what each touch alone says of the pose. If `refine_together` is
        overridden, the prior is ignored. Then override this method, too, if the prior can decide where the touches
        leave a pose open.
        """
        if self.refines_together or not self.capabilities.refines:
            return self.refine_together(views, candidates)
        return self._combine_alone(views, candidates, prior)

    @property
    def refines_together(self) -> bool:
        """Whether the refiner uses all touches at once, instead of each touch alone."""
        return type(self).refine_together is not Refiner.refine_together

    def _combine_alone(
        self, views: Sequence[View], candidates: Sequence[Candidate], prior: Prior | None = None
    ) -> list[RefinedPose]:
        if self.capabilities.refines:
            return alternate(views, candidates, self.refine_many, prior)
        contact_ious = np.mean(
            [
                [view.scene.contact_iou(view.T_sensor_first @ c.T_sensor_object, view.touch) for c in candidates]
                for view in views
            ],
            axis=0,
        )
        return [
            RefinedPose(c.T_sensor_object.copy(), float(iou), True, 0)
            for c, iou in zip(candidates, contact_ious, strict=True)
        ]
