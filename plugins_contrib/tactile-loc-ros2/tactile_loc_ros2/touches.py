"""The touches that the node's services collect, locate together, identify and continue. This module imports no ROS."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tactile_loc import (
    Approach,
    Localization,
    Localizer,
    LocatedFrame,
    PoseModes,
    RatedApproach,
    TactileLocError,
    Touch,
    choose_next_touch,
    draw_approaches_to_modes,
    identify,
    localize_together,
    read_approaches,
    suggest_next_step,
)
from tactile_loc.plugin import ConfigError, TouchError

MOST_LISTED = 5  # alternative objects in the answer of identify
SEED = 0  # of random approaches


@dataclass(frozen=True, eq=False)
class Reply:
    """The answer of a service: whether it succeeded, and a `message` in JSON.

    `found` is the result of locating the touches, and `suggested` the next approach; None if not asked for.
    """

    success: bool
    message: str
    found: Localization | None = None
    suggested: RatedApproach | None = None

    @classmethod
    def of(cls, **values: Any) -> Reply:
        """Make the answer of a service that succeeded, from JSON values."""
        return cls(True, json.dumps(values, allow_nan=False))

    @classmethod
    def of_error(cls, error: TactileLocError) -> Reply:
        """Make the answer of a service that failed."""
        return cls(False, json.dumps({"error": str(error)}))


class TouchSet:
    """Touches of one object at rest.

    At most `most` touches are kept. Poses are in the base frame of the touches or, without one, in the sensor's frame;
    `frame` is its name.
    `library` holds the objects to identify. `approaches` is a file of approaches; without it, `approach_count` random
    ones are drawn.
    """

    def __init__(
        self,
        localizer: Localizer,
        library: Sequence[Localizer] = (),
        approaches: str = "",
        approach_count: int = 200,
        most: int = 8,
    ) -> None:
        self._localizer, self._library, self._most = localizer, library, most
        self._approaches, self._approach_count = approaches, approach_count
        self._touches: list[Touch] = []
        self._stamps_ns: list[int] = []
        self._found: Localization | None = None
        self.frame = ""

    def __len__(self) -> int:
        return len(self._touches)

    @property
    def stamp_ns(self) -> int:
        """The stamp of the newest touch, ns; 0 without a touch."""
        return max(self._stamps_ns, default=0)

    def add(self, read_touch: Callable[[], Touch], stamp_ns: int, frame: str = "") -> Reply:
        """Add the touch that `read_touch` returns, of an image with this stamp.

        Each image can be added once; images without a stamp are not compared. `frame` is the name of the
        frame in which poses are given.
        """
        return self._answer(lambda: self._add(read_touch, stamp_ns, frame))

    def clear(self) -> Reply:
        """Forget all touches."""
        count = len(self)
        self._touches, self._stamps_ns, self._found = [], [], None
        return Reply.of(touches=0, cleared=count)

    def locate(self) -> Reply:
        """Locate the object by all touches together."""
        return self._answer(self._locate)

    def identify(self) -> Reply:
        """Find out which object of the library the touches belong to."""
        return self._answer(self._identify)

    def suggest(self) -> Reply:
        """Suggest the approach that is expected to tell most about the pose."""
        return self._answer(self._suggest)

    def _answer(self, serve: Callable[[], Reply]) -> Reply:
        try:
            return serve()
        except TactileLocError as error:
            return Reply.of_error(error)

    def _add(self, read_touch: Callable[[], Touch], stamp_ns: int, frame: str) -> Reply:
        if stamp_ns and stamp_ns in self._stamps_ns:
            raise TouchError("the newest image has already been added; wait for another image")
        if len(self) >= self._most:
            raise TouchError(f"there are already {len(self)} touches; clear them, or raise the option most_touches")
        touch = read_touch()
        if len(self) and touch.T_base_sensor is None:
            raise TouchError("several touches need the sensor's poses; give the option base_frame")
        name = f"touch {len(self) + 1}"
        self._touches.append(replace(touch, name=name))
        self._stamps_ns.append(stamp_ns)
        self._found, self.frame = None, frame
        contact_mm2 = 1e6 * float(touch.contact_shape.contact.sum()) * touch.geometry.pixel_pitch_m**2
        sizes = {"contact_mm2": round(contact_mm2, 3), "press_depth_mm": round(1e3 * touch.press_depth_m, 4)}
        return Reply.of(touches=len(self), name=name, stamp_ns=stamp_ns, **sizes)

    def _require_found(self) -> Localization:
        """Return the result of all touches, located now if that was not done yet."""
        if not self._touches:
            raise TouchError("there is no touch; call add_touch while the sensor touches the object")
        if self._found is None:
            self._found = localize_together([(self._localizer, touch) for touch in self._touches])
        return self._found

    def _locate(self) -> Reply:
        found = self._require_found()
        located = view_in_base(found)
        says = describe_located(located, self.frame) | {
            "probability": round_known(found.probability_within()),
            "covariance": None if located.covariance is None else located.covariance.tolist(),
            "touches": len(self),
            "poses": len(found.hypotheses),
            "outliers": [touch.name for touch in found.outliers],
            "next_step": suggest_next_step(found),
        }
        return replace(Reply.of(**says), found=found)

    def _identify(self) -> Reply:
        if not self._library:
            raise ConfigError("there are no objects to identify; give their mesh files in the option library")
        if not self._touches:
            raise TouchError("there is no touch; call add_touch while the sensor touches the object")
        answer = identify(self._touches, self._library)
        best = answer.best
        listed = [{"name": one.name, "probability": round(one.probability, 4)} for one in answer.objects[:MOST_LISTED]]
        found = {"verdict": answer.verdict.value, "object": None if best is None else best.name}
        return Reply.of(**found, objects=listed, none=round(answer.none, 4), touches=len(self))

    def _suggest(self) -> Reply:
        found = self._require_found()
        chosen = choose_next_touch(found, self._list_approaches(found))
        best = chosen.best
        reply = Reply.of(
            frame=self.frame,
            name=best.approach.name,
            T_frame_sensor=best.approach.T_base_sensor.tolist(),
            information_nats=round(best.information, 4),
            entropy_nats=round(best.entropy, 4),
            meets=round(best.meets, 4),
            travel_m=best.approach.travel_m,
            verdict=found.verdict.value,
            compared=len(chosen.ranked),
            out_of_reach=len(chosen.out_of_reach),
        )
        return replace(reply, found=found, suggested=best)

    def _list_approaches(self, found: Localization) -> list[Approach]:
        if self._approaches:
            return list(read_approaches(self._approaches, found.touch.T_base_sensor))
        return draw_approaches_to_modes(PoseModes.of(found), self._approach_count, np.random.default_rng(SEED))


def round_known(number: float | None) -> float | None:
    """Return a number with four decimals; None, which JSON can express, if it is unknown or not finite."""
    return None if number is None or not math.isfinite(number) else round(float(number), 4)


def describe_located(located: LocatedFrame, frame: str) -> dict[str, Any]:
    """Return a result whose poses are in `frame` as JSON values, in SI units; None stands for what is unknown.

    `freedom` is stated in words, and as in result.json.
    """
    T, freedom = located.T_sensor_object, located.freedom
    return {
        "frame": frame,
        "verdict": located.verdict and located.verdict.value,
        "probability": round_known(located.probability),
        "imprint_iou": round_known(located.imprint_iou),
        "freedom": None if freedom is None else {"says": str(freedom), **freedom.to_json()},
        "T_frame_object": None if T is None else T.tolist(),
    }


def view_in_base(found: Localization) -> LocatedFrame:
    """Return a result's poses in the base frame or, if it is unknown, in the first touch's sensor frame.

    In the base frame, the covariance includes the errors of the sensors' poses.
    """
    located = LocatedFrame.of(found)
    poses = [one.T_base_object for one in found.hypotheses if one.T_base_object is not None]
    if len(poses) < len(found.hypotheses):
        return located
    turned = [one.base_covariance for one in found.hypotheses]
    covariances = np.stack([np.full((6, 6), np.nan) if C is None else C for C in turned])
    first = located.base_covariance
    return replace(located, T_sensor_object_modes=np.stack(poses), covariance=first, covariances=covariances)
