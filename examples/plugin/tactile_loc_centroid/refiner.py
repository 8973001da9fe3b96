"""The centroid refiner: slides the candidate in x and y until the centre of its contact is that of the touch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import Candidate, ComponentOptions, RefinedPose, Refiner, Scene, SensorGeometry, Touch


class CentroidRefiner(Refiner):
    """Slides the candidate a few times and keeps the pose whose contact overlaps best with the touch's contact."""

    class Options(ComponentOptions):
        """Every option has a default and a description, which is its help text."""

        steps: int = Field(default=4, ge=1, description="number of slides")

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the pose (4, 4) in metres with the largest intersection over union of contacts."""
        T = candidate.T_sensor_object.copy()
        best = RefinedPose(T, contact_iou=0.0, converged=False, iterations=0)
        wanted = touch.contact_shape.contact & touch.geometry.observed_mask
        for step in range(self.options.steps + 1):
            seen = scene.contact_shape(T, touch.press_depth_m).contact & touch.geometry.observed_mask
            iou = float((seen & wanted).sum() / (seen | wanted).sum())
            if iou > best.contact_iou:
                best = RefinedPose(T, iou, converged=step > 0, iterations=step)
            if not seen.any():
                break
            slid = T.copy()
            slid[:2, 3] += centre_m(wanted, touch.geometry) - centre_m(seen, touch.geometry)
            T = scene.bring_to_contact(slid[None])[0][0]
        return best


def centre_m(contact: NDArray[np.bool_], geometry: SensorGeometry) -> NDArray[np.float64]:
    """Return the centre (x, y) in metres, on the sensing surface, of the pixels (H, W) in contact."""
    surface = np.full(geometry.shape, geometry.standoff_m)
    centre: NDArray[np.float64] = geometry.backproject(surface)[contact, :2].mean(axis=0)
    return centre
