#!/usr/bin/env python3
"""Labels found in real images of a ball, compared with labels by hand: the circles, and the calibrations from them.

The public sets are those of `real_images.py`. A difference is the found value minus the value by hand. The tables have
medians and 90 % quantiles over presses. Radii are limited to the ball's radius, as in a table of presses. `offset` is
the median difference of the centres in a set. Surface angle errors are means over held-out presses of several splits,
for calibrations on the same presses. For `found on hand`, for example, the calibration learns from found labels and is
tested on labels by hand. `moved` are the found labels minus the offset.
"""

import dataclasses
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from asked import make_data_parser, write_head
from numpy.typing import NDArray
from real_images import SETS, read

from tactile_loc.core.runtime.progress import Progress
from tactile_loc.sensors.calibration.frames import PressImage
from tactile_loc.sensors.calibration.outcome import measure_press, split
from tactile_loc.sensors.calibration.presses import PressFolder
from tactile_loc.sensors.calibration.unlabelled import FoundPresses, find_presses
from tactile_loc.sensors.reading.markers import UntouchedGel
from tactile_loc.sensors.reading.photometric import PhotometricEstimator

Array = NDArray[np.float64]
COLUMNS = ("center_x_px", "center_y_px", "radius_px")
LEARNED = ("hand", "found", "moved")


def find(presses: PressFolder, name: str) -> FoundPresses:
    """Find the balls in a set's images, including the image of the untouched gel if there is one."""
    frames = [PressImage(row.image.name, image) for row, image in zip(presses.rows, presses.images, strict=True)]
    gel = [] if name == "FOTS" else [PressImage("untouched", presses.background)]
    return find_presses([*frames, *gel], SETS[name][1] / SETS[name][2])


def list_circles(presses: PressFolder) -> Array:
    """Return the circles (N, 3) of the labels by hand: centre and radius, pixels."""
    return np.array([[row.read_number(column) for column in COLUMNS] for row in presses.rows])


def relabel(presses: PressFolder, found: Array) -> PressFolder:
    """Return the same presses with other circles (N, 3), pixels. If a circle is NaN, the press keeps its own circle."""
    rows = [
        row if np.isnan(circle).any() else dataclasses.replace(row, values=row.values | _write(circle))
        for row, circle in zip(presses.rows, found, strict=True)
    ]
    return dataclasses.replace(presses, rows=tuple(rows))


def _write(circle: Array) -> dict[str, str]:
    return {column: f"{value:.2f}" for column, value in zip(COLUMNS, circle, strict=True)}


def measure_errors_deg(sets: dict[str, PressFolder], known: NDArray[np.bool_], seed: int) -> dict[str, float]:
    """Learn from each kind of labels of the same presses. Return the surface angle's error for each pair of labels."""
    hand = sets["hand"]
    learned, held_out = ([n for n in part if known[n]] for part in split(len(hand), seed))
    errors = {}
    for name, labels in sets.items():
        made = PhotometricEstimator(hand.geometry, hand.background)
        made.fit(labels.read_presses(learned), Progress())
        for tested in ("hand", "found"):
            each = [measure_press(made, *sets[tested].read_press(n))["slope_deg"] for n in held_out]
            errors[f"{name} on {tested}"] = float(np.mean(each))
    return errors


def compare(name: str, data: Path, folder: Path, splits: int) -> tuple[str, str, str]:
    """Return a set's rows of the tables of circles and of errors, and the reasons for dropped presses."""
    presses = read(name, data, folder)
    start = time.perf_counter()
    found = find(presses, name)
    seconds = (time.perf_counter() - start) / len(presses)
    used = {press.name: press.circle for press in found.used}
    by_hand = list_circles(presses)
    ours = np.full_like(by_hand, np.nan)
    for number, row in enumerate(presses.rows):
        if (circle := used.get(row.image.name)) is not None:
            ours[number] = circle.x_px, circle.y_px, circle.radius_px
    known = ~np.isnan(ours).any(axis=1)
    off = (ours - by_hand)[known]
    offset = np.median(off[:, :2], axis=0)
    centre, left = (np.hypot(*(off[:, :2] - shift).T) for shift in (np.zeros(2), offset))
    radius = 100 * np.abs(off[:, 2]) / by_hand[known, 2]
    first = (
        f"| {name} | {int(known.sum())} of {len(presses)} | {np.median(centre):.2f} | {np.quantile(centre, 0.9):.2f} | "
        f"{offset[0]:+.1f}, {offset[1]:+.1f} | {np.median(left):.2f} | {np.median(radius):.1f} % | "
        f"{np.quantile(radius, 0.9):.1f} % | {seconds:.2f} s |"
    )
    same_gel = dataclasses.replace(presses, gel=UntouchedGel.of(found.untouched))
    moved = ours - [*offset, 0]
    sets = {label: relabel(same_gel, c) for label, c in zip(LEARNED, (by_hand, ours, moved), strict=True)}
    each = [measure_errors_deg(sets, known, seed) for seed in range(splits)]
    mean = {key: float(np.mean([e[key] for e in each])) for key in each[0]}
    shown = ("hand on hand", "found on hand", "moved on hand", "found on found", "hand on found")
    dropped = Counter(press.dropped for press in found.presses if press.dropped)
    reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items()) or "none"
    return first, f"| {name} | {' | '.join(f'{mean[key]:.2f}°' for key in shown)} |", f"{name} dropped: {reasons}"


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = make_data_parser(__doc__)
    parser.add_argument("--splits", type=int, default=3)
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        for number, name in enumerate(SETS):
            rows.append(compare(name, arguments.data, Path(temporary) / str(number), arguments.splits))
    first, second, dropped = zip(*rows, strict=True)
    print(write_head("set", "used", "centre, px", "90 %", "offset, px", "without it", "radius", "90 %", "time a press"))
    print("\n".join(first))
    print()
    print(write_head("set", "hand on hand", "found on hand", "moved on hand", "found on found", "hand on found"))
    print("\n".join(second))
    print()
    print("\n".join(dropped))


if __name__ == "__main__":
    main()
