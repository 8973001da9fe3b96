"""`identification.json`, the result of an identification, in SI units, and the same result in words."""

from collections.abc import Sequence
from typing import Any

from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.json_keys import Key, Keys, write_keys
from tactile_loc.locate.identify import LEAST_REPORTED, Identification, KnownObject
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.planning.next_touch import NextTouch
from tactile_loc.planning.next_touch_files import write_next_touch

SCHEMA_VERSION = 2  # it increases if a key is removed or gets another meaning
NONE_OF_THESE = "none of these"
AS_PROBABLE = 0.7  # times the probability of the first object: such an object explains the touches as well

IDENTIFICATION: Keys = {
    "schema_version": Key("integer", "version of this format"),
    "touches": Key("texts", "the touches that were identified"),
    "verdict": Key("text", "how far to trust the first object"),
    "identified": Key("text or null", "the object that they are of; null: none of these is more probable"),
    "none": Key("number", "probability that they are of none of these objects, 0 to 1"),
    "objects": Key("list", "the objects, the most probable first"),
    "next_touch": Key("object or null", "the rated approaches, as in next_touch.json; null: none was asked for"),
}

OBJECT: Keys = {
    "name": Key("text", "the object's name"),
    "probability": Key("number", "that the touches are of this object, 0 to 1"),
    "misfit_nats": Key(
        "number or null", "the evidence that its best pose lacks to explain the touches fully; null: it was not located"
    ),
    "poses": Key("list", "its possible poses, the most probable first"),
}

POSE: Keys = {
    "probability": Key("number", "of this pose, given this object, 0 to 1"),
    "T_sensor_object": Key("4 x 4 numbers", "m, in the first touch's sensor frame"),
    "imprint_iou": Key("number", "how well it explains the touches, 0 to 1"),
}


def write_identification(
    found: Identification, touches: Sequence[Touch], next_touch: NextTouch | None = None
) -> dict[str, Any]:
    """Return the document of an identification of touches, and of the next touch, if it was asked for."""
    return write_keys(
        IDENTIFICATION,
        found,
        schema_version=SCHEMA_VERSION,
        touches=[touch.name for touch in touches],
        identified=None if found.best is None else found.best.name,
        objects=[_write_object(one) for one in found.objects],
        next_touch=None if next_touch is None else write_next_touch(next_touch),
    )


def _write_object(one: KnownObject) -> dict[str, Any]:
    hypotheses = one.found.hypotheses if one.found else ()
    poses = [write_keys(POSE, h) for h in hypotheses]
    return write_keys(OBJECT, one, misfit_nats=one.misfit, poses=poses)


def list_inseparable(found: Identification) -> list[str]:
    """Return the names of the objects that explain the touches as well as the first one; empty if there are none.

    It includes the first object. Each has at least AS_PROBABLE times its probability.
    """
    least = max(LEAST_REPORTED, AS_PROBABLE * found.objects[0].probability)
    names = [one.name for one in found.objects if one.probability >= least]
    return names if len(names) > 1 else []


def describe_identification(found: Identification) -> str:
    """Return the verdict and the probable objects, such as "ambiguous: hook 39 %, head 31 %"."""
    shares = [(NONE_OF_THESE, found.none), *((one.name, one.probability) for one in found.objects)]
    first, *others = sorted(shares, key=lambda share: -share[1])
    named = ", ".join(f"{name} {format_percent(p)}" for name, p in (first, *others) if p >= LEAST_REPORTED)
    why = "; the best pose does not explain the touches" if found.verdict is Verdict.POOR_FIT else ""
    inseparable = list_inseparable(found)
    if inseparable and found.best is not None:
        why += f"; these touches cannot tell {' and '.join(inseparable)} apart"
    return f"{found.verdict}: {named or 'no object is probable'}{why}"
