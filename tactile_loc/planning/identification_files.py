"""`identification.json`, the result of an identification. SI units."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.io.streams.records import Record
from tactile_loc.io.toml import Matrix
from tactile_loc.locate.identify import LEAST_REPORTED, Identification, KnownObject
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.planning.next_touch import NextTouch
from tactile_loc.planning.next_touch_files import write_next_touch

SCHEMA_VERSION = 2
NONE_OF_THESE = "none of these"
AS_PROBABLE = 0.7  # times the probability of the first object: such an object explains the touches as well


class PoseRecord(Record):
    """A pose of an object, assuming that this object was touched."""

    probability: float | None = Field(
        description="of this pose, given this object, 0 to 1; null: the object is too improbable to compute it"
    )
    T_sensor_object: Matrix = Field(description="(4, 4), m, in the first touch's sensor frame")
    imprint_iou: float = Field(description="how well it explains the touches, 0 to 1")


class KnownObjectRecord(Record):
    """One of the objects that may have been touched."""

    name: str = Field(description="the object's name")
    probability: float = Field(description="that the touches are of this object, 0 to 1")
    misfit_nats: float | None = Field(
        description="the evidence that its best pose lacks to explain the touches fully; null: it was not located",
    )
    poses: list[PoseRecord] = Field(description="its possible poses, the most probable first")


class IdentificationRecord(Record):
    """The whole file."""

    schema_version: int = Field(
        default=SCHEMA_VERSION, description="raised when a key is removed or changes its meaning"
    )
    touches: list[str] = Field(description="the touches that were identified")
    verdict: Verdict = Field(description="how far to trust the first object")
    identified: str | None = Field(description="the object that they are of; null: none of these is more probable")
    none: float = Field(description="probability that they are of none of these objects, 0 to 1")
    objects: list[KnownObjectRecord] = Field(description="the objects, the most probable first")
    next_touch: dict[str, Any] | None = Field(
        default=None, description="the rated approaches, as in next_touch.json; null: none was asked for"
    )

    @property
    def inseparable(self) -> list[str]:
        """The names of the objects that explain the touches as well as the first one; empty if there are none.

        It includes the first object. Each has at least AS_PROBABLE times its probability.
        """
        least = max(LEAST_REPORTED, AS_PROBABLE * self.objects[0].probability)
        names = [one.name for one in self.objects if one.probability >= least]
        return names if len(names) > 1 else []

    def summary(self) -> str:
        """Return the verdict and the probable objects, such as "ambiguous: hook 39 %, head 31 %"."""
        shares = [(NONE_OF_THESE, self.none), *((one.name, one.probability) for one in self.objects)]
        first, *others = sorted(shares, key=lambda share: -share[1])
        named = ", ".join(f"{name} {format_percent(p)}" for name, p in (first, *others) if p >= LEAST_REPORTED)
        why = "; the best pose does not explain the touches" if self.verdict == Verdict.POOR_FIT else ""
        if self.inseparable and self.identified is not None:
            why += f"; these touches cannot tell {' and '.join(self.inseparable)} apart"
        return f"{self.verdict}: {named or 'no object is probable'}{why}"


def make_identification_record(
    found: Identification, touches: list[str], next_touch: NextTouch | None = None
) -> IdentificationRecord:
    """Make the record of an identification; `touches` are the touches' names."""
    return IdentificationRecord(
        touches=touches,
        verdict=found.verdict,
        identified=None if found.best is None else found.best.name,
        none=found.none,
        next_touch=None if next_touch is None else write_next_touch(next_touch),
        objects=[_make_object_record(one) for one in found.objects],
    )


def _make_object_record(one: KnownObject) -> KnownObjectRecord:
    poses = [
        PoseRecord(
            probability=h.probability if one.fitted else None,
            T_sensor_object=h.T_sensor_object.tolist(),
            imprint_iou=h.imprint_iou,
        )
        for h in (one.found.hypotheses if one.found else ())
    ]
    misfit = one.misfit if np.isfinite(one.misfit) else None
    return KnownObjectRecord(name=one.name, probability=one.probability, misfit_nats=misfit, poses=poses)
