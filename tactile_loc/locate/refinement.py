"""Refinement by the chosen refiner, or by the joint registration where that refiner cannot be used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.slots.refiner import Candidate, RefinedPose, Refiner
from tactile_loc.core.slots.scene import View
from tactile_loc.locate.results.localization import Hypothesis


@dataclass(frozen=True)
class Refinement:
    """The chosen refiner and the joint registration.

    If `together` is "joint", the joint registration refines against several touches, unless the refiner can do so
    itself.
    """

    refiner: Refiner
    registration: JointRegistration
    together: Literal["joint", "each"]

    def refine(self, views: Sequence[View], candidates: Sequence[Candidate]) -> list[RefinedPose]:
        """Refine candidates against one touch, or against several."""
        if len(views) == 1 or not self.is_joint:
            return self.refiner.refine_together(views, candidates)
        return self.registration.refine(views, np.stack([candidate.T_sensor_object for candidate in candidates]))

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
        """Add the joint registration's covariances, given the touches, to hypotheses whose refiner gives no covariance.

        Poses that were not refined get no covariance.
        """
        unknown = [k for k, h in enumerate(hypotheses) if h.refined.covariance is None]
        if not unknown or not self.refiner.capabilities.refines:
            return tuple(hypotheses)
        found = list(hypotheses)
        poses = np.stack([hypotheses[k].T_sensor_object for k in unknown])
        for k, covariance in zip(unknown, self.registration.estimate_covariances(views, poses), strict=True):
            found[k] = replace(hypotheses[k], refined=replace(hypotheses[k].refined, covariance=covariance))
        return tuple(found)
