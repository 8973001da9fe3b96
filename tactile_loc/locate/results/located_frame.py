"""A located frame: what is known of the object's pose at one frame, and the fields that every record of it has.

The tracker, live frames, recordings and the ROS node say what they know in these words.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.errors import GridError, NoContactError, TactileLocError
from tactile_loc.core.geometry.rigid import rotate_covariance
from tactile_loc.io.mount_files import Covariance
from tactile_loc.locate.results.localization import Localization
from tactile_loc.locate.results.verdict import Verdict, name_verdict

Floats = NDArray[np.float64]


@keep_old_names(seen_from="view_from")
@dataclass(frozen=True, eq=False)
class LocatedFrame:
    """What is known of the object's pose at one frame.

    `verdict` says how far the first pose can be trusted; it is None for a frame that cannot be read, and `says` why.
    `T_sensor_object_modes` (K, 4, 4), metres, are the modes' poses, the most probable first, and `probabilities` (K,)
    theirs. `covariance` (6, 6) is the first pose's, as RefinedPose's, None if it is not known; `imprint_iou`, 0 to 1,
    is how well that pose explains the touch, NaN without a touch. `seconds` is how long locating took, NaN if nobody
    measured it.
    """

    verdict: Verdict | None
    T_sensor_object_modes: Floats = field(default_factory=lambda: np.empty((0, 4, 4)))
    probabilities: Floats = field(default_factory=lambda: np.empty(0))
    covariance: Floats | None = None
    imprint_iou: float = math.nan
    seconds: float = math.nan
    says: str = ""

    @classmethod
    def of(cls, localization: Localization) -> LocatedFrame:
        """Return what a localisation found, in the frame of its first touch's sensor."""
        poses = np.stack([one.T_sensor_object for one in localization.hypotheses])
        shares = np.array([one.probability for one in localization.hypotheses])
        best, seconds = localization.best, sum(localization.seconds.values())
        return cls(localization.verdict, poses, shares, best.refined.covariance, best.imprint_iou, seconds)

    @classmethod
    def of_error(cls, error: TactileLocError) -> LocatedFrame:
        """Return a frame that could not be located: no contact, not found or, without a verdict, refused."""
        verdict = None
        if isinstance(error, NoContactError):
            verdict = Verdict.NO_CONTACT
        elif isinstance(error, GridError):
            verdict = Verdict.NOT_FOUND
        return cls(verdict, says=str(error))

    @property
    def T_sensor_object(self) -> Floats | None:  # noqa: N802 - the transform's name
        """The most probable pose (4, 4), metres; None if there is none."""
        return self.T_sensor_object_modes[0] if len(self.T_sensor_object_modes) else None

    @property
    def probability(self) -> float | None:
        """The probability of the most probable pose, 0 to 1; None if there is none."""
        return float(self.probabilities[0]) if len(self.probabilities) else None

    @property
    def std(self) -> Floats | None:
        """Standard deviations (6,), metres and radians, of x, y, z and about them; None when they are not known."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))

    @property
    def word(self) -> str:
        """The verdict, or "refused" if there is none."""
        return name_verdict(self.verdict)

    def view_from(self, T_other_sensor: Floats) -> LocatedFrame:
        """Return the same poses as another sensor sees them, to which T_other_sensor (4, 4), metres, leads."""
        C = None if self.covariance is None else rotate_covariance(self.covariance, T_other_sensor[:3, :3])
        return replace(self, T_sensor_object_modes=T_other_sensor @ self.T_sensor_object_modes, covariance=C)


class LocatedRecord(BaseModel):
    """What every record of a located frame says, in live runs and recordings. SI units."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    number: int = Field(description="of the frame among all of its source, from 0")
    verdict: Verdict | None = Field(
        description="certain, ambiguous, poor fit, not found or no contact; null if the frame was refused"
    )
    says: str = Field(default="", description="why there is no verdict or no pose found; empty if there is")
    probability: float | None = Field(default=None, description="of the most probable pose, 0 to 1")
    imprint_iou: float | None = Field(default=None, description="how well that pose explains the frame, 0 to 1")
    covariance: Covariance | None = Field(
        default=None,
        description="of that pose, (6, 6): x, y, z of the object's origin (m) and rotations about the frame's axes "
        "(rad); null when it is not known",
    )

    @property
    def std(self) -> Floats | None:
        """Standard deviations (6,), metres and radians, of x, y, z and about them; None when they are not known."""
        return None if self.covariance is None else np.sqrt(np.diag(np.array(self.covariance)))

    @property
    def word(self) -> str:
        """The verdict, or "refused" if there is none."""
        return name_verdict(self.verdict)


def record_fields(located: LocatedFrame) -> dict[str, Any]:
    """Return the fields of a LocatedRecord that a frame decides, as JSON values."""
    C, iou = located.covariance, located.imprint_iou
    return {
        "verdict": located.verdict, "says": located.says, "probability": located.probability,
        "imprint_iou": None if math.isnan(iou) else float(iou), "covariance": None if C is None else C.tolist(),
    }  # fmt: skip


def count_frames(verdicts: Iterable[Verdict | None]) -> dict[str, int]:
    """Return how many `frames` there are, and how many were `located`, `not_found`, had `no_contact` or were `refused`.

    A pose that fits poorly is counted as located.
    """
    counts = Counter(verdicts)
    others = {
        "not_found": counts[Verdict.NOT_FOUND], "no_contact": counts[Verdict.NO_CONTACT], "refused": counts[None],
    }  # fmt: skip
    frames = counts.total()
    return {"frames": frames, "located": frames - sum(others.values()), **others}
