#!/usr/bin/env python3
"""The time to fuse several contacts over a grid of about `--poses` poses, by number of contacts.

For each mesh (FILE[:UNITS]; default: the demo objects), one face is searched with the encoder `pixel`. There are
`--examples` examples of simulated touches with strong noise and exact sensor poses. Each touch's posterior is computed
beforehand. Only the fuser is timed, after a warm-up.
"""

import argparse
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from asked import load_asked, make_parser, open_asked
from single_touch import choose_spacing
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.store.store import StageStore

NUMBERS = (1, 2, 3, 5, 7)


def measure(path: str, arguments: argparse.Namespace, store: Path) -> str:
    """Return a row of the table: the poses, and the median and longest time, ms, for each of the `NUMBERS`."""
    obj = load_asked(path)
    grid = {"name": "face", "spacing_mm": choose_spacing(obj, {}, arguments.poses)}
    localizer = open_asked(path, grid=grid, store=StageStore(store))
    most = max(NUMBERS)
    touches = localizer.simulate(arguments.examples * most, arguments.seed, noise="strong")
    posteriors = [localizer.posteriors([touch])[0] for touch in touches]
    T_base_sensor = [invert(touch.T_sensor_object[None])[0] for touch in touches]
    cells = []
    for n in NUMBERS:
        ms = []
        for first in [0, *range(0, len(touches), most)]:  # the first example comes twice, to warm up
            some = slice(first, first + n)
            start = time.perf_counter()
            with suppress(GridError):  # finding no common pose takes as long
                localizer.fuser.fuse(posteriors[some], T_base_sensor[some], None)
            ms.append((time.perf_counter() - start) * 1e3)
        cells.append(f"{np.median(ms[1:]):.0f}, {max(ms[1:]):.0f}")
    return f"| {obj.name} | {len(localizer.model.grid)} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--poses", type=int, default=20_000, help="approximate poses of a grid")
    parser.add_argument("--examples", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print("milliseconds to fuse this many contacts: median, maximum")
    print(f"| object | poses | {' | '.join(map(str, NUMBERS))} |")
    print("|---" * (2 + len(NUMBERS)) + "|")
    with tempfile.TemporaryDirectory() as store:
        for path in arguments.objects:
            print(measure(path, arguments, Path(store)), flush=True)


if __name__ == "__main__":
    main()
