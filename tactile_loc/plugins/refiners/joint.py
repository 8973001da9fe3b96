"""The joint refiner: registers one pose to all touches at once."""

from collections.abc import Sequence

import numpy as np

from tactile_loc.plugin import Candidate, Capabilities, Prior, RefinedPose, Refiner, Scene, Touch, View
from tactile_loc.plugin.helpers import JointRegistration, RegistrationOptions


class JointRefiner(Refiner):
    """Registers the object's surface to all touches at once, and gives the covariance of the pose."""

    capabilities = Capabilities(covariances=True)

    class Options(RegistrationOptions):
        """The options of the joint registration."""

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the pose (4, 4), metres, near the candidate's pose that explains the touch best."""
        return self.refine_together([View(touch, scene)], [candidate])[0]

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch, each as `refine` does."""
        return self.refine_together([View(touch, scene)], candidates)

    def refine_together(self, views: Sequence[View], candidates: Sequence[Candidate]) -> list[RefinedPose]:
        """Refine candidates against several touches. A candidate's own pose is kept if it fits better."""
        return self.refine_with_prior(views, candidates, None)

    def refine_with_prior(
        self, views: Sequence[View], candidates: Sequence[Candidate], prior: Prior | None
    ) -> list[RefinedPose]:
        """Refine candidates against several touches. The prior decides where the touches leave a pose open."""
        poses = np.array([candidate.T_sensor_object for candidate in candidates]).reshape(-1, 4, 4)
        return JointRegistration(self.options).refine(views, poses, prior)
