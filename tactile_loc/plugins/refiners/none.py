"""No refinement: the grid pose as it is."""

from __future__ import annotations

from tactile_loc.plugin import Candidate, Capabilities, RefinedPose, Refiner, Scene, Touch


class NoRefiner(Refiner):
    """Leaves every candidate where it is; the null object among refiners."""

    capabilities = Capabilities(refines=False)

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the candidate's pose (4, 4) unchanged, metres, and how well it explains the touch."""
        T = candidate.T_sensor_object.copy()
        return RefinedPose(T, contact_iou=scene.contact_iou(T, touch), converged=True, iterations=0)
