"""A located frame: the object's pose at one frame, and the keys that all files of located frames share.

The tracker, live runs, recordings and the ROS node use located frames.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.lie import rotate_covariance
from tactile_loc.core.geometry.pose_words import describe_first
from tactile_loc.core.runtime.errors import GridError, NoContactError, TactileLocError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.io.json_keys import Key, Keys, write_keys
from tactile_loc.locate.result.freedom import Freedom
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict, explain_verdict, name_verdict

Floats = NDArray[np.float64]


LOCATED: Keys = {  # what all files of located frames have, in live runs and recordings
    "verdict": Key(
        "text or null", "certain, ambiguous, poor fit, not found or no contact; null if the frame was refused"
    ),
    "says": Key("text", "why there is no verdict or no pose; else empty"),
    "probability": Key(
        "number or null",
        "of the most probable pose, 0 to 1; in a track, as the start (1) or the last search states it, where 0.89 and "
        "0.998 are limits of the fit",
    ),
    "imprint_iou": Key("number or null", "how well that pose explains the frame, 0 to 1"),
    "covariance": Key(
        "6 x 6 numbers or null",
        "of that pose: x, y, z of the object's origin (m) and rotations about the frame's axes (rad); null if unknown",
    ),
}


@dataclass(frozen=True, eq=False)
class LocatedFrame:
    """The object's pose at one frame.

    `verdict` rates the first pose; it is None for a frame that cannot be read. If there is no pose, `says` gives the
    reason. `T_sensor_object_modes` (K, 4, 4), metres, are the modes' poses, the most probable first, with
    `probabilities` (K,) and `covariances` (K, 6, 6), as in RefinedPose. Unknown covariances are NaN, or all are left
    out. `covariance` (6, 6) is that of the first pose; None if unknown.
    `imprint_iou`, 0 to 1, states how well the first pose explains the touch; NaN without a touch. `seconds` is the time
    to locate the frame; NaN if not measured. `freedom` is what the touches leave open about the first pose; None if it
    is unknown, as in a track.

    `time_s` is when the frame was taken, seconds; NaN if unknown. `T_base_object` (4, 4), metres, is the first pose in
    the frame of the sensors' poses, with `base_covariance` (6, 6); None if the sensors' poses are unknown.
    """

    verdict: Verdict | None
    T_sensor_object_modes: Floats = field(default_factory=lambda: np.empty((0, 4, 4)))
    probabilities: Floats = field(default_factory=lambda: np.empty(0))
    covariance: Floats | None = None
    imprint_iou: float = math.nan
    seconds: float = math.nan
    says: str = ""
    freedom: Freedom | None = None
    time_s: float = math.nan
    T_base_object: Floats | None = None
    base_covariance: Floats | None = None
    covariances: Floats = field(default_factory=lambda: np.empty((0, 6, 6)))

    @classmethod
    def of(cls, localization: Localization) -> LocatedFrame:
        """Make the frame of a localisation, with poses in the first touch's sensor frame."""
        poses = np.stack([one.T_sensor_object for one in localization.hypotheses])
        shares = np.array([one.probability for one in localization.hypotheses])
        best, seconds = localization.best, sum(localization.seconds.values())
        return cls(
            localization.verdict,
            poses,
            shares,
            best.refined.covariance,
            best.imprint_iou,
            seconds,
            freedom=localization.freedom,
            T_base_object=best.T_base_object,
            base_covariance=best.base_covariance,
            covariances=stack_covariances(one.covariance for one in localization.hypotheses),
        )

    @classmethod
    def of_error(cls, error: TactileLocError) -> LocatedFrame:
        """Make the frame of a touch that raised an error.

        The verdict is "no contact", "not found" or, for a touch that was refused, None.
        """
        verdict = None
        if isinstance(error, NoContactError):
            verdict = Verdict.NO_CONTACT
        elif isinstance(error, GridError):
            verdict = Verdict.NOT_FOUND
        return cls(verdict, says=str(error))

    @property
    def T_sensor_object(self) -> Floats | None:  # noqa: N802 - the transform's name
        """The most probable pose (4, 4), metres; None if there is no pose."""
        return self.T_sensor_object_modes[0] if len(self.T_sensor_object_modes) else None

    @property
    def probability(self) -> float | None:
        """The probability of the most probable pose, 0 to 1; None if there is no pose."""
        return float(self.probabilities[0]) if len(self.probabilities) else None

    @property
    def std(self) -> Floats | None:
        """Standard deviations (6,) of x, y, z, metres, and of the rotations about them, radians; None if unknown."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))

    @property
    def word(self) -> str:
        """The verdict, or "refused" if there is no verdict."""
        return name_verdict(self.verdict)

    def __str__(self) -> str:
        """Return one line: the verdict, the time, and the first pose in mm and degrees, or why there is none."""
        said = [self.word if math.isnan(self.time_s) else f"{self.word} at {self.time_s:.3f} s"]
        if (T := self.T_sensor_object) is None:
            return f"{said[0]}: {self.says or explain_verdict(self.verdict)}"
        count = len(self.probabilities)
        if self.T_base_object is None:
            said.append(describe_first(T, count, "sensor's"))
        else:
            said.append(describe_first(self.T_base_object, count, "base"))
        if math.isfinite(self.imprint_iou):
            said.append(f"imprint IoU {format_percent(self.imprint_iou)}")
        return "; ".join(said)

    def to_json(self) -> dict[str, Any]:
        """Return the values of LOCATED, as JSON values; the poses are not among them."""
        return write_keys(LOCATED, self)

    @classmethod
    def of_json(cls, values: dict[str, Any], T: list[list[float]] | None) -> LocatedFrame:
        """Make a frame from the values of LOCATED and the rows of its most probable pose, metres, if it has one."""
        verdict, says = values["verdict"] and Verdict(values["verdict"]), values["says"]
        if T is None:
            return cls(verdict, says=says)
        C, iou, p = values["covariance"], values["imprint_iou"], values["probability"]
        covariance, iou = None if C is None else np.array(C), math.nan if iou is None else iou
        return cls(verdict, np.array([T]), np.array([p or 0.0]), covariance, iou, says=says)

    def view_from(self, T_other_sensor: Floats) -> LocatedFrame:
        """Return the same poses in another sensor's frame; T_other_sensor is (4, 4), metres."""
        T, R = T_other_sensor @ self.T_sensor_object_modes, T_other_sensor[:3, :3]
        C = None if self.covariance is None else rotate_covariance(self.covariance, R)
        turned = stack_covariances(rotate_covariance(one, R) for one in self.covariances)
        return replace(self, T_sensor_object_modes=T, covariance=C, covariances=turned)


def stack_covariances(covariances: Iterable[Floats | None]) -> Floats:
    """Return covariances as (K, 6, 6); an unknown covariance is NaN."""
    known = [np.full((6, 6), np.nan) if one is None else one for one in covariances]
    return np.array(known).reshape(-1, 6, 6)


def count_frames(verdicts: Iterable[Verdict | None]) -> dict[str, int]:
    """Return the number of all `frames`, and of frames with each result.

    The results are `located`, `not_found`, `no_contact` and `refused`. A frame is located if its verdict is `certain`,
    `ambiguous` or `poor_fit`, which are also counted.
    """
    counts = Counter(verdicts)
    found = {
        "certain": counts[Verdict.CERTAIN],
        "ambiguous": counts[Verdict.AMBIGUOUS],
        "poor_fit": counts[Verdict.POOR_FIT],
    }
    others = {"not_found": counts[Verdict.NOT_FOUND], "no_contact": counts[Verdict.NO_CONTACT], "refused": counts[None]}
    frames = counts.total()
    return {"frames": frames, "located": frames - sum(others.values()), **found, **others}
