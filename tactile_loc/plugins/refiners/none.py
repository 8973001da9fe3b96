"""No refinement: the grid pose is returned unchanged."""

from tactile_loc.plugin import Candidate, Capabilities, RefinedPose, Refiner, Scene, Touch


class NoRefiner(Refiner):
    """Returns every candidate's own pose."""

    capabilities = Capabilities(refines=False)

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the candidate's pose (4, 4) unchanged, metres, with its contact IoU."""
        T = candidate.T_sensor_object.copy()
        return RefinedPose(T, contact_iou=scene.contact_iou(T, touch), converged=True, iterations=0)
