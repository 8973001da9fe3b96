#!/usr/bin/env python3
"""The number of touches until an object's pose is known, with chosen and with random touches.

An object is at rest. The first touch, from any direction, is the same for both methods. Then one of `--approaches`
sensor poses around the object is tried: the best approach by `choose_next_touch`, or a random approach. Both methods
choose from the same approaches, in the same run. An approach that meets nothing, or only a flat face, is counted, and
replaced by the next in rank or by another random approach. Touches are drawn by ray casting, which the localizer does
not use. The press is 30 to 90 % of the sensor's deepest press the first time, and 60 % afterwards. A pose is known if
the first hypothesis from all touches is within 1 mm (root mean square over the surface) and 1 degree, modulo symmetry.

For each object, the table has the entropy of the modes after the first touch, in nats, and the share of known poses
after one, two, three, ... touches. It has the mean number of touches until the pose is known; a pose that stays unknown
counts as one touch more than the most. The last columns are the number of replaced presses, and the median time of a
choice. The last rows are for the twelve objects with the highest entropy, and for all objects. Objects are FILE[:UNITS]
or demo names. `--out` keeps each object's examples, which are not measured again.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from contacts import LEVELS

from tactile_loc.benchmark.suite import read_split
from tactile_loc.core.errors import TactileLocError
from tactile_loc.core.geometry.rigid import rotation_angle
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.slots.registry import registry
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.io.approach_files import Approach
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.locate.results.localization import Localization
from tactile_loc.store.store import StageStore
from tactile_loc.tasks.approaches import draw_approaches
from tactile_loc.tasks.next_touch import choose_next_touch
from tactile_loc.tasks.pose_modes import MOST_MODES, PoseModes

WITHIN_M, WITHIN_RAD = 1e-3, np.radians(1.0)
PRESS = 0.6  # share of the sensor's deepest press
TEMPERATURE = 0.05  # not fitted, because hypotheses are weighed by their evidence
Choice = Callable[[Localization, list[Approach]], Iterator[Approach]]


def choose_approach(seconds: list[float]) -> Choice:
    """Return a function that ranks approaches by `choose_next_touch`. It adds its times to `seconds`."""

    def choose(found: Localization, left: list[Approach]) -> Iterator[Approach]:
        start = time.perf_counter()
        ranked = choose_next_touch(found, left).ranked
        seconds.append(time.perf_counter() - start)
        return (rated.approach for rated in ranked)

    return choose


def choose_by_lot(rng: np.random.Generator) -> Choice:
    """Return a function that puts approaches in a random order."""
    return lambda found, left: (left[k] for k in rng.permutation(len(left)))


def is_known(obj: ObjectModel, found: Localization) -> bool:
    """Return whether the first hypothesis is within 1 mm and 1 degree of the truth, modulo symmetry."""
    T, truth = found.best.T_sensor_object, np.asarray(found.touch.T_sensor_object)
    near_m = PoseMetric(obj).symmetric_distance(T[None], truth[None])[0]
    step_rad = 0.2 * WITHIN_RAD
    turns = (truth @ obj.symmetry.list_elements(max_step_rad=step_rad))[:, :3, :3]
    return bool(near_m < WITHIN_M and rotation_angle(turns.swapaxes(-1, -2) @ T[:3, :3]).min() < WITHIN_RAD)


def try_approach(
    localizer: Localizer, source: RobotTouches, found: Localization, approaches: list[Approach], choose: Choice,
    most: int, rng: np.random.Generator,
) -> tuple[int, int]:  # fmt: skip
    """Return the number of touches until the pose is known, or `most` + 1, and the number of replaced presses.

    `found` is the result of the first touch.
    """
    touches, left, replaced = [found.touch], list(approaches), 0
    while not is_known(localizer.object, found):
        if len(touches) == most:
            return most + 1, replaced
        for approach in choose(found, left):
            left.remove(approach)
            touch = source.approach(
                approach.T_base_sensor, float(approach.press_m or 0), approach.name, rng, approach.travel_m
            )
            if touch is not None:
                touches.append(touch)
                break
            replaced += 1
        else:
            return most + 1, replaced
        try:
            found = localize_together([(localizer, touch) for touch in touches], top=MOST_MODES)
        except TactileLocError:
            return most + 1, replaced
    return len(touches), replaced


def measure(localizer: Localizer, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure all examples of one object."""
    raycast = registry().create("renderer", "raycast", {})
    source = RobotTouches(localizer.object, localizer.scene.geometry, raycast, **LEVELS[arguments.level])
    seconds: list[float] = []
    found: dict[str, list[tuple[int, int]]] = {"chosen": [], "random": []}
    entropies = []
    for number in range(arguments.examples):
        rng = np.random.default_rng([arguments.seed, number])
        (touch,), _ = source.draw_example(1, rng)
        first = localizer.localize(touch, top=MOST_MODES)
        entropies.append(PoseModes.of(first).entropy)
        around = draw_approaches(localizer.object, localizer.scene.geometry, arguments.approaches, PRESS, rng)
        for name, choose in (("chosen", choose_approach(seconds)), ("random", choose_by_lot(rng.spawn(1)[0]))):
            own = np.random.default_rng([arguments.seed, number, 1])
            found[name].append(try_approach(localizer, source, first, around, choose, arguments.most, own))
    touches = {name: [t for t, _ in rows] for name, rows in found.items()}
    return {
        "object": localizer.object.name, "sensor": localizer.config.sensor.name, "level": arguments.level,
        "approaches": arguments.approaches, "most": arguments.most, "touches": touches,
        "replaced": {name: [r for _, r in rows] for name, rows in found.items()}, "seconds": seconds,
        "entropies": entropies,
    }  # fmt: skip


def write_shares(touches: list[int], most: int) -> list[float]:
    """Return the shares of known poses after 1, 2, ... touches."""
    return [float(np.mean(np.array(touches) <= n)) for n in range(1, most + 1)]


def write_line(name: str, rows: list[dict[str, Any]]) -> str:
    """Return a row of the table, for one object or for all."""
    doubt = np.mean([nats for row in rows for nats in row["entropies"]])
    cells = [name, str(sum(len(row["touches"]["chosen"]) for row in rows)), f"{doubt:.2f}"]
    for kind in ("chosen", "random"):
        touches = [t for row in rows for t in row["touches"][kind]]
        more = np.array(touches) - 1
        cells += [
            " ".join(f"{share:.0%}" for share in write_shares(touches, rows[0]["most"])),
            f"{1 + more.mean():.2f}",
        ]
        cells.append(str(sum(sum(row["replaced"][kind]) for row in rows)))
    seconds = [s for row in rows for s in row["seconds"]]
    cells.append(f"{1e3 * np.median(seconds):.0f}" if seconds else "")
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Measure, print a table, and keep each object's examples if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", default=read_split("demo"), help="FILE[:UNITS]; default: the demo objects")
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--level", default="clean", choices=list(LEVELS))
    parser.add_argument("--examples", type=int, default=20)
    parser.add_argument("--approaches", type=int, default=200)
    parser.add_argument("--most", type=int, default=6, help="most touches")
    parser.add_argument("--seed", type=int, default=23)
    parser.add_argument("--store", type=Path, help="store of models")
    parser.add_argument("--out", type=Path, help="folder with a file for each object")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print("| object | examples | doubt, nats | chosen: known after 1, 2, ... touches | mean | replaced | random: known "
          "after | mean | replaced | ms a choice |\n" + "|---" * 10 + "|")  # fmt: skip
    for mesh in arguments.meshes:
        path, _, units = mesh.partition(":")
        kept = arguments.out / f"{Path(path).stem}.json" if arguments.out else None
        if kept is not None and kept.exists():
            row = json.loads(kept.read_text())
        else:
            localizer = Localizer.create(
                path, units=units or "auto", sensor=arguments.sensor, store=StageStore(arguments.store),
                grid={"name": "whole"}, temperature=TEMPERATURE,
            )  # fmt: skip
            row = measure(localizer, arguments)
            if kept is not None:
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_text(json.dumps(row, indent=1))
        rows.append(row)
        print(write_line(row["object"], [row]), flush=True)
    rows.sort(key=lambda row: -float(np.mean(row["entropies"])))
    for count in sorted({min(12, len(rows)), len(rows)}):
        print(write_line(f"the {count} with the highest entropy after the first touch", rows[:count]))


if __name__ == "__main__":
    main()
