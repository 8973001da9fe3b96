#!/usr/bin/env python3
"""How many touches it takes to know where an object is, if each next one is chosen, and if it is drawn by lot.

An object stands still. A first touch, from any direction, is the same for both; then one of `--approaches` sensor poses
around the object is tried: the one that `choose_next_touch` ranks first, or any. Both choose from the same approaches,
in the same run; one that meets nothing, or shows nothing but a flat face, is replaced (by the next in rank, by another
lot), and counted. Touches are drawn by ray casting, which the localizer does not use, pressed by 30 to 90 % of the
sensor's deepest press the first time, by 60 % after. Known means: the first hypothesis of all touches together is
within 1 mm (root mean square over the surface) and 1 degree, symmetry regarded, so that it would be grasped there.

For each object: the entropy of the modes after the first touch, nats; the share that is known after one touch, two,
three, ...; the mean number of touches until then, an example that is not known after the last counting as one more;
presses replaced; and the median time of a choice. Then the same of the twelve objects of the highest entropy, and of
all. Objects are FILE[:UNITS] or demo names. `--out` keeps each object's examples: what is there is not measured again.
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

from tactile_loc.core.errors import TactileLocError
from tactile_loc.core.geometry.rigid import rotation_angle
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.slots.registry import registry
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.evaluation.robot_touches import RobotTouches, draw_approaches
from tactile_loc.io.approach_files import Approach
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.locate.results.localization import Localization
from tactile_loc.store.store import StageStore
from tactile_loc.tasks.next_touch import choose_next_touch
from tactile_loc.tasks.pose_modes import MOST_MODES, PoseModes

WITHIN_M, WITHIN_RAD = 1e-3, np.radians(1.0)
PRESS = 0.6  # of the sensor's deepest
TEMPERATURE = 0.05  # that it need not be fitted: hypotheses are weighed by their evidence
Choice = Callable[[Localization, list[Approach]], Iterator[Approach]]


def choose_approach(seconds: list[float]) -> Choice:
    """Choose by what the touches so far have left in doubt."""

    def choose(found: Localization, left: list[Approach]) -> Iterator[Approach]:
        start = time.perf_counter()
        ranked = choose_next_touch(found, left).ranked
        seconds.append(time.perf_counter() - start)
        return (rated.approach for rated in ranked)

    return choose


def choose_by_lot(rng: np.random.Generator) -> Choice:
    """Choose at random."""
    return lambda found, left: (left[k] for k in rng.permutation(len(left)))


def is_known(obj: ObjectModel, found: Localization) -> bool:
    """Whether the first hypothesis is within 1 mm and 1 degree of the truth or of a pose that looks the same."""
    T, truth = found.best.T_sensor_object, np.asarray(found.touch.T_sensor_object)
    near_m = PoseMetric(obj).symmetric_distance(T[None], truth[None])[0]
    step_rad = 0.2 * WITHIN_RAD
    turns = (truth @ obj.symmetry.list_elements(max_step_rad=step_rad))[:, :3, :3]
    return bool(near_m < WITHIN_M and rotation_angle(turns.swapaxes(-1, -2) @ T[:3, :3]).min() < WITHIN_RAD)


def try_approach(
    localizer: Localizer, source: RobotTouches, found: Localization, approaches: list[Approach], choose: Choice,
    most: int, rng: np.random.Generator,
) -> tuple[int, int]:  # fmt: skip
    """After how many touches the pose is known, `most` + 1 if after none of these, and how many presses were replaced.

    `found` is what the first touch says.
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
    """All examples of one object."""
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
    """The shares that are known after 1, 2, ... touches."""
    return [float(np.mean(np.array(touches) <= n)) for n in range(1, most + 1)]


def write_line(name: str, rows: list[dict[str, Any]]) -> str:
    """A row of the table, of one object or of all."""
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
    """Measure, print a table, and keep each object's examples if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", default=list(DEMO_OBJECTS), help="FILE[:UNITS]; default: the demo objects")
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--level", default="clean", choices=list(LEVELS))
    parser.add_argument("--examples", type=int, default=20)
    parser.add_argument("--approaches", type=int, default=200)
    parser.add_argument("--most", type=int, default=6, help="touches")
    parser.add_argument("--seed", type=int, default=23)
    parser.add_argument("--store", type=Path, help="where models are kept")
    parser.add_argument("--out", type=Path, help="a folder, a file an object")
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
        print(write_line(f"the {count} in most doubt after the first touch", rows[:count]))


if __name__ == "__main__":
    main()
