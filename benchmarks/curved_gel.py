#!/usr/bin/env python3
"""The errors from assuming that a curved gel is flat.

Objects are pressed from any direction on the DIGIT with a spherical gel, by 30 to 90 % of the sensor's deepest press.
The touches are drawn by ray casting. They are located with the geometry of the curved gel, and with the geometry of a
flat gel. Touches on a flat gel are the reference. For one touch and for three, the table has the median pose
error, the share within 1 mm, and the share with any hypothesis within 1 mm.
"""

import dataclasses
import tempfile
from pathlib import Path

import numpy as np
from asked import make_parser, make_source
from contacts import Located, locate
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localizer, StageStore, TactileLocError, Touch, localize_together

CASES = {  # sensor that is touched, sensor whose geometry is used for locating
    "curved gel, located as curved": ("digit-curved", "digit-curved"),
    "curved gel, taken for flat": ("digit-curved", "digit"),
    "flat gel": ("digit", "digit"),
}


def convert_touch(touch: Touch, localizer: Localizer) -> Touch:
    """Return the touch in the geometry of the localizer's sensor."""
    return dataclasses.replace(touch, geometry=localizer.scene.geometry)


def find(localizer: Localizer, touches: list[Touch]) -> Located:
    """Locate the object from touches. If this ends in an error, the result is that nothing was found."""
    try:
        return locate(localizer, touches, localize_together([(localizer, touch) for touch in touches]))
    except TactileLocError:
        return Located()


def main() -> None:
    """Measure, and print a table."""
    parser = make_parser(__doc__, read_split("pins"))
    parser.add_argument("--examples", type=int, default=30)
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    print("| object | touches | | median, mm | within 1 mm | any within 1 mm |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        store = StageStore(Path(folder))
        for name in arguments.objects:
            localizers = {
                sensor: Localizer.create(name, store=store, sensor=sensor, grid="whole")
                for sensor in ("digit-curved", "digit")
            }
            for count in (1, 3):
                for case, (touched, taken_for) in CASES.items():
                    source = make_source(localizers[touched].object, localizers[touched].scene.geometry)
                    localizer = localizers[taken_for]
                    found = []
                    for number in range(arguments.examples):
                        touches, _ = source.draw_example(count, np.random.default_rng([arguments.seed, number]))
                        found.append(find(localizer, [convert_touch(touch, localizer) for touch in touches]))
                    chosen, best = np.array([(one.chosen_mm, one.nearest_mm) for one in found]).T
                    print(
                        f"| {name} | {count} | {case} | {np.median(chosen):.2f} | {(chosen <= 1).mean():.0%} | "
                        f"{(best <= 1).mean():.0%} |",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
