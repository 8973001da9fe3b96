"""The file `next_touch.json`: the rated approaches. SI units."""

from __future__ import annotations

import math

from pydantic import Field

from tactile_loc.io.streams.records import Record
from tactile_loc.io.toml import Matrix
from tactile_loc.planning.next_touch import NextTouch, RatedApproach

SCHEMA_VERSION = 1


class RatedRecord(Record):
    """An approach and its expected result."""

    rank: int = Field(description="1 is the best")
    name: str = Field(description="its name in the list")
    T_base_sensor: Matrix = Field(description="where its sensor starts, (4, 4), m; it moves along its z")
    press_m: float | None = Field(description="how deep it presses, m; null: as deep as the touch before")
    information_nats: float = Field(description="expected drop of the modes' entropy")
    entropy_nats: float = Field(description="expected entropy afterwards")
    worth: float = Field(
        0.0, description="cautiously expected drop, nats, per expected cost; the approaches are ranked by it"
    )
    meets: float = Field(description="probability that it meets the object, 0 to 1")
    travel_m: list[float | None] = Field(description="travel until contact with each mode, m; null: it misses")
    cost: float = Field(description="its cost")


class OutOfReachRecord(Record):
    """An approach that cannot be made, and the reason."""

    name: str = Field(description="its name in the list")
    reason: str = Field(description="why it cannot be made")


class ModeRecord(Record):
    """A pose that is still possible."""

    object: str = Field("", description="the object's name; empty in older files")
    probability: float = Field(description="0 to 1; those of all modes sum to one")
    T_base_object: Matrix = Field(description="(4, 4), m; in the frame of the approaches")


class NextTouchRecord(Record):
    """The whole file."""

    schema_version: int = Field(
        default=SCHEMA_VERSION, description="raised when a key is removed or changes its meaning"
    )
    object: str = Field(description="the object's name, or the names of all possible objects")
    symmetry: str = Field(description="its rotations onto itself: modes that differ by one are merged; of each object")
    modes: list[ModeRecord] = Field(description="the distinct poses that are still possible, the likeliest first")
    unlisted: float = Field(description="probability of poses that the result does not list, 0 to 1")
    entropy_nats: float = Field(description="the entropy of the modes, before the touch")
    ranked: list[RatedRecord] = Field(description="the approaches, the best first")
    out_of_reach: list[OutOfReachRecord] = Field(description="approaches that cannot be made")
    alike: list[list[int]] = Field(description="groups of modes, from 1, that no approach tells apart")
    doubt_left: float = Field(
        description="probability that the truth is in such a group, but is not its likeliest mode"
    )
    stops: bool = Field(False, description="true: no approach tells any of the probable modes apart, so stop touching")

    def name_mode(self, number: int) -> str:
        """Return a mode's number, from 1, with the object's name if several objects are possible."""
        several = len({mode.object for mode in self.modes}) > 1
        return f"{number} ({self.modes[number - 1].object})" if several else str(number)


def make_next_touch_record(found: NextTouch) -> NextTouchRecord:
    """Make the record of rated approaches."""
    modes = found.modes
    objects = [obj for obj, _ in modes.by_object]
    return NextTouchRecord(
        object=" or ".join(obj.name for obj in objects),
        symmetry=" or ".join(str(obj.symmetry) for obj in objects),
        unlisted=modes.unlisted,
        modes=[
            ModeRecord(object=obj.name, probability=float(p), T_base_object=T.tolist())
            for obj, p, T in zip(modes.mode_objects, modes.probabilities, modes.T_base_object, strict=True)
        ],
        entropy_nats=modes.entropy,
        ranked=[_record_rated(k, one) for k, one in enumerate(found.ranked, start=1)],
        out_of_reach=[OutOfReachRecord(name=one.name, reason=reason) for one, reason in found.out_of_reach],
        alike=[[number + 1 for number in group] for group in found.alike],
        doubt_left=found.doubt_left,
        stops=found.stops,
    )


def _record_rated(rank: int, one: RatedApproach) -> RatedRecord:
    return RatedRecord(
        rank=rank,
        name=one.approach.name,
        T_base_sensor=one.approach.T_base_sensor.tolist(),
        press_m=one.approach.press_m,
        information_nats=one.information,
        entropy_nats=one.entropy,
        worth=one.worth,
        meets=one.meets,
        travel_m=[None if math.isnan(m) else m for m in one.travel_m.tolist()],
        cost=one.cost,
    )
