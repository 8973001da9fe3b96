"""The file `next_touch.json`: the rated approaches. SI units."""

from typing import Any

from tactile_loc.io.json_keys import Key, Keys, write_keys
from tactile_loc.planning.next_touch import NextTouch

SCHEMA_VERSION = 1  # it increases if a key is removed or gets another meaning

NEXT_TOUCH: Keys = {
    "schema_version": Key("integer", "version of this format"),
    "object": Key("text", "the object's name, or the names of all possible objects"),
    "symmetry": Key("text", "its rotations onto itself: modes that differ by one are merged; of each object"),
    "modes": Key("list", "the distinct poses that are still possible, the likeliest first"),
    "unlisted": Key("number", "probability of poses that the result does not list, 0 to 1"),
    "entropy_nats": Key("number", "the entropy of the modes, before the touch"),
    "ranked": Key("list", "the approaches, the best first"),
    "out_of_reach": Key("list", "names of approaches that cannot be made, each with the reason"),
    "alike": Key("list", "groups of modes, from 1, that no approach tells apart"),
    "doubt_left": Key("number", "probability that the truth is in such a group, but is not its likeliest mode"),
    "stops": Key("true or false", "true: no approach tells any of the probable modes apart, so stop touching"),
}

MODE: Keys = {
    "object": Key("text", "the object's name"),
    "probability": Key("number", "0 to 1; those of all modes sum to one"),
    "T_base_object": Key("4 x 4 numbers", "m; in the frame of the approaches"),
}

RATED: Keys = {
    "rank": Key("integer", "1 is the best"),
    "name": Key("text", "its name in the list"),
    "T_base_sensor": Key("4 x 4 numbers", "where its sensor starts, m; it moves along its z"),
    "press_m": Key("number or null", "how deep it presses, m; null: as deep as the touch before"),
    "information_nats": Key("number", "expected drop of the modes' entropy"),
    "entropy_nats": Key("number", "expected entropy afterwards"),
    "worth": Key("number", "cautiously expected drop, nats, per expected cost; the approaches are ranked by it"),
    "meets": Key("number", "probability that it meets the object, 0 to 1"),
    "travel_m": Key("list", "travel until contact with each mode, m; null: it misses"),
    "cost": Key("number", "its cost"),
}


def write_next_touch(found: NextTouch) -> dict[str, Any]:
    """Return the document of rated approaches."""
    modes = found.modes
    parts = zip(modes.objects, modes.probabilities, modes.T_base_object, strict=True)
    return write_keys(
        NEXT_TOUCH,
        found,
        schema_version=SCHEMA_VERSION,
        object=modes.object_names,
        symmetry=modes.symmetries,
        modes=[write_keys(MODE, None, object=obj.name, probability=p, T_base_object=T) for obj, p, T in parts],
        unlisted=modes.unlisted,
        entropy_nats=modes.entropy,
        ranked=[
            write_keys(
                RATED,
                one,
                rank=rank,
                name=one.approach.name,
                T_base_sensor=one.approach.T_base_sensor,
                press_m=one.approach.press_m,
                information_nats=one.information,
                entropy_nats=one.entropy,
            )
            for rank, one in enumerate(found.ranked, 1)
        ],
        out_of_reach=[{"name": one.name, "reason": reason} for one, reason in found.out_of_reach],
        alike=[[number + 1 for number in group] for group in found.alike],
    )
