#!/usr/bin/env python3
"""The number of presses for a calibration: the error of the surface angle against the number of training presses.

The public sets are those of `real_images.py`, reduced as by `tactile-loc calibrate`, with labels by hand. Each of
several splits holds out a fifth of the presses, whatever the number of training presses. Training presses are chosen
from the others, at random or spread over the gel. Spreading starts with the press nearest to the gel's middle, and
repeatedly adds the press farthest from all chosen presses.
"""

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from asked import make_data_parser, write_head
from numpy.typing import NDArray
from real_images import SETS, read, reduce

from tactile_loc.core.runtime.progress import Progress
from tactile_loc.sensors.calibration.outcome import measure_press, split
from tactile_loc.sensors.calibration.presses import PressFolder
from tactile_loc.sensors.reading.photometric import PhotometricEstimator

COUNTS = (1, 2, 5, 10, 20)


def choose_at_random(presses: PressFolder, among: Sequence[int], count: int, seed: int) -> list[int]:
    """Return the numbers of `count` random presses. With the same seed, a larger choice contains a smaller one."""
    order = np.random.default_rng(1000 + seed).permutation(among)
    return sorted(order[:count].tolist())


def spread(presses: PressFolder, among: Sequence[int], count: int, seed: int) -> list[int]:
    """Return the numbers of `count` presses that are far from each other."""
    places = {number: _place(presses, number) for number in among}
    chosen = [min(among, key=lambda number: float(np.hypot(*(places[number] - 0.5))))]
    while len(chosen) < count:
        left = [number for number in among if number not in chosen]
        chosen.append(max(left, key=lambda number: min(np.hypot(*(places[number] - places[c])) for c in chosen)))
    return sorted(chosen)


def _place(presses: PressFolder, number: int) -> NDArray[np.float64]:
    """Return the position of a press: shares (2,) of the image's width and height."""
    rows, columns = np.nonzero(presses.label(number).contact)
    return np.array([columns.mean(), rows.mean()]) / presses.geometry.shape[::-1]


def measure_error_deg(presses: PressFolder, count: int, choose: Callable[..., list[int]], seed: int) -> float:
    """Return the mean error of the surface angle on the held-out presses, after learning from `count` others."""
    others, held_out = split(len(presses), seed)
    learned = choose(presses, others, min(count, len(others)), seed)
    made = PhotometricEstimator(presses.geometry, presses.background)
    made.fit(presses.read_presses(learned), Progress())
    return float(np.mean([measure_press(made, *presses.read_press(number))["slope_deg"] for number in held_out]))


def write_row(
    name: str, presses: PressFolder, choose: Callable[..., list[int]], counts: Sequence[int], splits: int
) -> str:
    """Return a set's row of the table: errors in degrees, the last one for all presses that are not held out."""
    available = len(split(len(presses), 0)[0])
    cells = []
    for count in (*counts, available):
        each = [measure_error_deg(presses, count, choose, seed) for seed in range(splits)] if count <= available else []
        cells.append(f"{np.mean(each):.2f}" if each else "")
    return f"| {name}, {choose.__name__.replace('_', ' ')} | {' | '.join(cells)} ({available}) |"


def main() -> None:
    """Run the benchmark and print its table."""
    parser = make_data_parser(__doc__)
    parser.add_argument("--splits", type=int, default=3)
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    arguments = parser.parse_args()
    print(write_head("set", *map(str, arguments.counts), "all"))
    with tempfile.TemporaryDirectory() as temporary:
        for name in arguments.sets:
            folder = Path(temporary) / name.replace(" ", "-")
            presses = reduce(read(name, arguments.data, folder), name, folder)
            for choose in (choose_at_random, spread):
                print(write_row(name, presses, choose, arguments.counts, arguments.splits), flush=True)


if __name__ == "__main__":
    main()
