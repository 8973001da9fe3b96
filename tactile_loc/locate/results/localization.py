"""The result of a localisation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.formatting import format_percent
from tactile_loc.core.geometry.rigid import format_pose
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.conformal import PoseSet
from tactile_loc.locate.results.hypothesis import Agreement as Agreement
from tactile_loc.locate.results.hypothesis import Hypothesis as Hypothesis
from tactile_loc.locate.results.verdict import Verdict, explain_verdict, judge


@dataclass(frozen=True, eq=False)
class Localization:
    """The result: the posterior, its distinct hypotheses, the best first, and the seconds of each stage.

    Poses are in the sensor frame of the first touch, `touch`; `others` are the other touches. If a coverage was
    requested, `pose_set` contains the true pose with this probability, and the hypotheses are the modes of the set.

    The posterior includes outliers (see `agreement`), but the hypotheses do not. Touches that were `left_out` because
    they contradict the others affect neither the posterior nor the hypotheses.
    """

    touch: Touch
    posterior: PosePosterior
    hypotheses: tuple[Hypothesis, ...]
    seconds: dict[str, float]
    others: tuple[Touch, ...] = ()
    pose_set: PoseSet | None = None
    agreement: Agreement = field(default_factory=Agreement)
    left_out: tuple[Touch, ...] = ()

    @property
    def touches(self) -> tuple[Touch, ...]:
        """The touches that were localised together."""
        return (self.touch, *self.others)

    @property
    def outliers(self) -> tuple[Touch, ...]:
        """The touches that contradict all others, while the others agree."""
        return tuple(self.touches[number] for number in self.agreement.outliers)

    @property
    def best(self) -> Hypothesis:
        """The most probable hypothesis."""
        return self.hypotheses[0]

    @property
    def verdict(self) -> Verdict:
        """How far the first hypothesis can be trusted, in one word.

        The verdict is also "poor fit" if the touches contradict each other and the wrong touch is unknown.
        """
        if self.agreement.contradictory and not self.agreement.outliers:
            return Verdict.POOR_FIT
        iou = self.best.imprint_iou if self.best.is_refined else math.nan
        return judge(self.best.probability, iou, self.posterior.elsewhere)

    def summary(self) -> str:
        """Return the result in words: the verdict and its meaning, and the first pose in mm and degrees."""
        listed, best = len(self.hypotheses), self.best
        T, frame = best.T_sensor_object, "sensor's"
        if best.T_base_object is not None:
            T, frame = best.T_base_object, "base"
        x, y, z, angle_deg, axis = format_pose(T)
        return (
            f"{self.verdict}: {explain_verdict(self.verdict)}\n"
            f"first of {listed} {'pose' if listed == 1 else 'poses'}: x {x}, y {y}, z {z} mm, rotated {angle_deg} "
            f"degrees about {axis}, in the {frame} frame\n"
            f"probability {format_percent(best.probability)}, imprint IoU {format_percent(best.imprint_iou)}, "
            f"not among the poses found: {format_percent(self.posterior.elsewhere)}"
        )

    def __str__(self) -> str:
        return self.summary()

    def measure_errors_m(self, obj: ObjectModel) -> NDArray[np.float64] | None:
        """Return each hypothesis's surface distance (K,), metres, to the true pose; None if that pose is unknown."""
        T_true = self.touch.T_sensor_object
        if T_true is None:
            return None
        T = np.stack([h.T_sensor_object for h in self.hypotheses])
        return PoseMetric(obj).symmetric_distance(T, np.broadcast_to(T_true, T.shape))

    @cached_property
    def normalised_entropy(self) -> float:
        """Entropy of the posterior over N poses divided by log N: 0 if one pose is certain, 1 if all are equal."""
        count = len(self.posterior.grid)
        return float(self.posterior.entropy / np.log(count)) if count > 1 else 0.0
