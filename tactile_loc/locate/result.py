"""What a localisation returns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.interfaces import RefinedPose
from tactile_loc.core.posterior import PosePosterior
from tactile_loc.core.sensing import Touch
from tactile_loc.locate.coverage import PoseSet


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One distinct explanation of the touches.

    `probability` is that of its whole mode, which holds `grid_poses` poses of the grid; `T_sensor_object_grid` (4, 4)
    the most probable of them, at `grid_index`; `refined` the pose below the grid's resolution, `T_sensor_object`, with
    what the refiner says of it; `imprint_iou`, 0 to 1, how well that pose explains the touches in depth and outline
    (`Scene.imprint_ious`), the mean over several. Metres.
    """

    probability: float
    T_sensor_object_grid: NDArray[np.float64]
    refined: RefinedPose
    grid_index: int
    grid_poses: int
    imprint_iou: float

    @property
    def T_sensor_object(self) -> NDArray[np.float64]:  # noqa: N802 - the field's name
        """The answer: the refined pose (4, 4), metres."""
        return self.refined.T_sensor_object


@dataclass(frozen=True, eq=False)
class Localization:
    """The answer: the posterior, its distinct hypotheses, the best first, and seconds a stage.

    Of several touches, `touch` is the first, in whose sensor's frame the answer is; `others` are the rest. `pose_set`
    are the poses that hold the truth as often as asked for, whose modes the hypotheses are.
    """

    touch: Touch
    posterior: PosePosterior
    hypotheses: tuple[Hypothesis, ...]
    seconds: dict[str, float]
    others: tuple[Touch, ...] = ()
    pose_set: PoseSet | None = None

    @property
    def best(self) -> Hypothesis:
        """The hypothesis that is ranked first."""
        return self.hypotheses[0]

    @cached_property
    def normalised_entropy(self) -> float:
        """Entropy / log N of the posterior over N poses (unitless): 0 one pose is certain, 1 nothing is known."""
        count = len(self.posterior.grid)
        return float(self.posterior.entropy / np.log(count)) if count > 1 else 0.0
