"""Refinement by the chosen refiner, or by the joint registration where that refiner cannot be used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tactile_loc.core.geometry.rigid import move_covariance
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.sensing.scene import View
from tactile_loc.locate.result.localization import Hypothesis
from tactile_loc.slots.refiner import Refiner


@dataclass(frozen=True)
class Refinement:
    """The chosen refiner and the joint registration.

    If `together` is "joint", the joint registration refines against several touches, unless the refiner can do so
    itself.
    """

    refiner: Refiner
    registration: JointRegistration
    together: Literal["joint", "each"]

    def refine(
        self, views: Sequence[View], candidates: Sequence[Candidate], prior: Prior | None = None
    ) -> list[RefinedPose]:
        """Refine candidates against one touch, or against several.

        A `prior` over poses in the first touch's sensor frame decides where the touches leave a pose open.
        """
        masks = not all(view.touch.has_depths for view in views) and self.refiner.capabilities.refines
        if not masks and (len(views) == 1 or not self.is_joint):
            if prior is None:
                return self.refiner.refine_together(views, candidates)
            return self.refiner.refine_expected(views, candidates, prior)
        return self.registration.refine(views, np.stack([candidate.T_sensor_object for candidate in candidates]), prior)

    @property
    def is_joint(self) -> bool:
        """Whether the joint registration refines against several touches, because the refiner takes only one touch."""
        one_at_a_time = type(self.refiner).refine_together is Refiner.refine_together
        return one_at_a_time and self.refiner.capabilities.refines and self.together == "joint"

    def explain_others(self, name: str, searched: bool) -> str:
        """Return the tasks that the joint registration does instead of the refiner `name`, and the reason; "" if none.

        `searched` states whether the whole object is searched.
        """
        if self.refiner.capabilities.covariances:
            return ""
        parts = [
            "improves the poses in the search of the whole object" if searched else "",
            "refines poses to several touches together" if self.is_joint else "",
        ]
        others = " and ".join(part for part in parts if part)
        if not self.refiner.capabilities.refines:
            return f"the joint registration {others}, because {name} does not refine" if others else ""
        also = f". The joint registration also {others}" if others else ""
        return (
            f"{name} refines the poses; their covariances come from the joint registration, because {name} gives "
            f"none{also}"
        )

    def add_covariances(self, views: Sequence[View], hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
        """Add covariances, given the touches, to hypotheses whose refiner gives none, or none for the base frame.

        They come from the joint registration. Poses that were not refined get no covariance. If a refiner gives only a
        covariance in the sensor frame, the error of the sensor's pose is added to it.
        """
        found = [h.refined for h in hypotheses]
        unknown = [k for k, pose in enumerate(found) if pose.covariance is None]
        if unknown and self.refiner.capabilities.refines:
            for k, pose in zip(
                unknown, self.registration.add_covariances(views, [found[k] for k in unknown]), strict=True
            ):
                found[k] = pose
        refined = (_add_sensor_error(views[0], pose) for pose in found)
        return tuple(replace(h, refined=pose) for h, pose in zip(hypotheses, refined, strict=True))


def _add_sensor_error(view: View, pose: RefinedPose) -> RefinedPose:
    """Return the pose with a `reported_covariance`, if it has none: its covariance plus the error of the sensor's pose.

    The error of the sensor's pose is a twist about the middle of the gel.
    """
    if pose.covariance is None or pose.reported_covariance is not None:
        return pose
    error = np.diag([view.sensor_std_m**2] * 3 + [view.sensor_std_rad**2] * 3)
    moved = move_covariance(error, pose.T_sensor_object[:3, 3] - view.touch.geometry.gel_middle_m)
    return replace(pose, reported_covariance=pose.covariance + moved)
