#!/usr/bin/env python3
"""How well touches are located by the outline of their contact alone, compared with touches that have depths.

Objects are pressed from any direction, by 30 to 90 % of the sensor's deepest press, and drawn by ray casting. From each
touch, only the contact mask is kept. The press is known, or assumed. In ragged masks, half of the pixels on both sides
of the outline are flipped at random, and the mask is eroded or dilated by one pixel, or neither. A pose is right if its
pose error is at most 1 mm: the largest displacement of any surface point, modulo symmetry. The table has the share of
examples whose first pose is right, and the share with a right one among the listed poses. It also has the number of
examples whose first pose would be certain by its probability alone, and how many of these are right.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from asked import make_parser, make_source, name_asked, open_asked, write_head
from elastic_gel import SIZES_PX
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion

from tactile_loc import Localizer, NoContactError, StageStore, TactileLocError, Touch, localize_together
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.io.options import CERTAIN

MM = 1e3
RIGHT_MM = 1.0
SHOWN = ("depths", "mask, press known", "mask, press assumed", "ragged mask, press assumed")


class Found(NamedTuple):
    """An example: what its touches show, their number, the errors of its poses, and the time to locate it.

    `first_mm` and `nearest_mm` are the pose errors of the first pose and of the nearest listed pose. `probability`,
    0 to 1, is stated for the first pose.
    """

    object: str
    shown: str
    touches: int
    first_mm: float = np.inf
    nearest_mm: float = np.inf
    probability: float = 0.0
    seconds: float = 0.0


def make_ragged(mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return a mask (H, W) with errors along its outline."""
    change = (binary_erosion, np.array, binary_dilation)[rng.integers(3)]
    changed = change(mask)
    outline = binary_dilation(changed) ^ binary_erosion(changed)
    ragged = np.where(outline & (rng.random(mask.shape) < 0.5), ~changed, changed)
    return np.asarray(ragged if ragged.any() else mask)


def show(touch: Touch, shown: str, localizer: Localizer, rng: np.random.Generator) -> Touch:
    """Return a touch with what is `shown` of it. Raises NoContactError if noise hides it."""
    if shown == "depths":
        return touch
    mask = touch.contact_shape.contact & touch.geometry.observed_mask
    return Touch.from_mask(
        make_ragged(mask, rng) if shown.startswith("ragged") else mask, sensor=localizer.sensor, name=touch.name,
        press_depth_m=touch.press_depth_m if shown.endswith("known") else None,
        T_base_sensor=touch.T_base_sensor, T_sensor_object=touch.T_sensor_object,
    )  # fmt: skip


def locate(localizer: Localizer, touches: list[Touch], about: Found) -> Found:
    """Return an example with the result of its touches; one that ends in an error keeps infinite pose errors."""
    start = time.perf_counter()
    try:
        found = localize_together([(localizer, touch) for touch in touches])
    except TactileLocError:
        return about
    seconds = time.perf_counter() - start
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    errors_mm = MM * measure_pose_errors(localizer.object, poses, np.asarray(touches[0].T_sensor_object))
    return about._replace(
        first_mm=float(errors_mm[0]),
        nearest_mm=float(errors_mm.min()),
        probability=found.probability_within(),
        seconds=seconds,
    )


def measure(mesh: str, arguments: argparse.Namespace, store: StageStore) -> list[Found]:
    """Return the examples of one object."""
    sensor = {"name": arguments.sensor, "image_size_px": SIZES_PX[arguments.sensor]}
    localizer = open_asked(mesh, store=store, sensor=sensor, grid=arguments.grid)
    source = make_source(localizer.object, localizer.scene.geometry)
    found = []
    for number in range(arguments.examples):
        drawn, _ = source.draw_example(max(arguments.touches), np.random.default_rng([arguments.seed, number]))
        for shown in SHOWN:
            rng = np.random.default_rng([arguments.seed, number, 1])
            try:
                touches = [show(touch, shown, localizer, rng) for touch in drawn]
            except NoContactError:
                continue
            for count in arguments.touches:
                found.append(locate(localizer, touches[:count], Found(name_asked(mesh), shown, count)))
    return found


def write_row(name: str, found: list[Found]) -> str:
    """Return a row of the table."""
    first, listed = (np.array([getattr(one, key) <= RIGHT_MM for one in found]) for key in ("first_mm", "nearest_mm"))
    sure = np.array([one.probability >= CERTAIN for one in found])
    seconds = np.median([one.seconds for one in found])
    return (
        f"| {name} | {len(found)} | {first.mean():.0%} | {listed.mean():.0%} | {sure.sum()} | {(sure & first).sum()} | "
        f"{seconds:.1f} |"
    )


def main() -> None:
    """Measure, and print a table."""
    parser = make_parser(__doc__, ["pin", "cotter", "hook"])
    parser.add_argument("--sensor", choices=list(SIZES_PX), default="gelsight-mini")
    parser.add_argument("--grid", default="whole")
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 3])
    parser.add_argument("--examples", type=int, default=20)
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        store = StageStore(Path(folder))
        found = [one for mesh in arguments.objects for one in measure(mesh, arguments, store)]
    sure = f"above {CERTAIN:.0%}"
    print(write_head("object", "shown", "touches", "examples", "first", "listed", sure, "of these right", "s"))
    for name in [*dict.fromkeys(one.object for one in found), "all"]:
        for shown in SHOWN:
            for count in arguments.touches:
                some = [one for one in found if (one.shown, one.touches) == (shown, count)]
                some = [one for one in some if name in ("all", one.object)]
                if some:
                    print(write_row(f"{name} | {shown} | {count}", some))


if __name__ == "__main__":
    main()
