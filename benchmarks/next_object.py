#!/usr/bin/env python3
"""The number of touches until the right object is certain: with proposed and with random next touches.

An object of a library is at rest. It is identified among `--among` parts: the parts that resemble it, and a random
choice of the others. Examples are left out unless the verdict on the first touches is ambiguous. Then each method picks
further touches from the same `--approaches`, which are drawn around the possible objects, as `identify --around` does:

- proposed: the approach that `choose_next_touch` ranks first.
- random: any approach. Each example is repeated with `--orders` random orders, and their mean counts.

After each touch, the object is identified from all touches. An approach that meets nothing, or only a flat face, is a
miss, and the method's next approach is tried. The same approach gives the same touch to all methods. Touches are drawn
by ray casting, which the localizer does not use. Their noise alternates between clean and mild.

The table has the mean number of touches until the right object is first, and until it is certain. The first touches
count. An object that stays unknown counts as one touch more than the most. Further columns are the share of examples
that are certain and right in the end, the share that are certain and wrong, the misses of a next touch, and the median
time of a choice. `--out` keeps each example, which is not measured again.
"""

import argparse
import dataclasses
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from identify import choose_among, choose_asked, measure_once, open_search, suffer
from tactile_loc_library.identification import identify_part
from tactile_loc_library.search import PartSearch

from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.io.approach_files import Approach
from tactile_loc.locate.identify import Identification
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.planning.approaches import draw_approaches_to_modes
from tactile_loc.planning.next_touch import choose_next_touch
from tactile_loc.tracking.pose_modes import PoseModes

PRESS = 0.6  # share of the sensor's deepest press
METHODS = ("proposed", "random")
NOISES = ("clean", "mild")


@dataclasses.dataclass(eq=False)
class Example:
    """An object at rest, with its first touches and the approaches to choose from. Answers are kept."""

    name: str
    search: PartSearch
    source: RobotTouches
    first: list[Touch]
    seed: tuple[int, ...]
    approaches: list[Approach] = dataclasses.field(default_factory=list)
    answers: dict[tuple[int, ...], Identification] = dataclasses.field(default_factory=dict)
    seconds: list[float] = dataclasses.field(default_factory=list)

    def touch(self, k: int) -> Touch | None:
        """Return the touch of approach k; None if it misses."""
        a, rng = self.approaches[k], np.random.default_rng([*self.seed, k])
        return self.source.approach(a.T_base_sensor, a.press_m or 0.0, a.name, rng, a.travel_m)

    def identify(self, *chosen: int) -> Identification:
        """Return the answer to the first touches and those of the chosen approaches."""
        key = tuple(sorted(chosen))
        if key not in self.answers:
            more = [touch for k in key if (touch := self.touch(k)) is not None]
            self.answers[key] = identify_part([*self.first, *more], self.search)
        return self.answers[key]

    def propose(self, now: Identification, left: list[int]) -> Iterator[int]:
        """Yield the approaches that are left, the one that `choose_next_touch` ranks first at first."""
        if (modes := PoseModes.of_objects(now)) is None:
            return iter(left)
        number = {id(self.approaches[k]): k for k in left}
        start = time.perf_counter()
        ranked = choose_next_touch(modes, [self.approaches[k] for k in left]).ranked
        self.seconds.append(time.perf_counter() - start)
        return iter([number[id(rated.approach)] for rated in ranked])

    def count_touches(self, order: np.random.Generator | None, most: int) -> dict[str, float]:
        """Return the number of touches until the object is first, and until it is certain, or `most` + 1.

        Approaches are proposed or, with a generator, random.
        """
        counts = {"first": most + 1.0, "certain": most + 1.0, "wrong": 0.0, "missed": 0.0}
        chosen: list[int] = []
        left = list(range(len(self.approaches)))
        while True:
            now, count = self.identify(*chosen), len(self.first) + len(chosen)
            right = now.best is not None and now.best.name == self.name
            counts["first"] = min(counts["first"], count) if right else counts["first"]
            if now.verdict is Verdict.CERTAIN:
                counts["certain" if right else "wrong"] = count if right else 1.0
            if now.verdict is Verdict.CERTAIN or count == most:
                break
            for k in self.propose(now, left) if order is None else iter(order.permutation(left).tolist()):
                left.remove(k)
                if self.touch(k) is not None:
                    chosen.append(k)
                    break
                counts["missed"] += 1
            else:
                break
        return {**counts, "more": float(len(chosen))}


def measure(search: PartSearch, name: str, level: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure an example of one object; it has no counts unless the first answer is ambiguous."""
    seed = (arguments.seed, *map(ord, name))
    rng = np.random.default_rng(seed)
    some = choose_among(search, name, arguments.among, rng)
    with search.use(search.names.index(name)) as part:
        geometry, source = part.model.scene.geometry, suffer(part.model, level)
    example = Example(name, some, source, source.draw_example(arguments.touches, rng)[0], seed)
    said = example.identify()
    row = {"object": name, "level": level, "verdict": said.verdict.value}
    if said.verdict is not Verdict.AMBIGUOUS or (modes := PoseModes.of_objects(said)) is None:
        return row
    around = draw_approaches_to_modes(modes, arguments.approaches, rng)
    example.approaches.extend(dataclasses.replace(a, press_m=PRESS * geometry.max_depth_m) for a in around)
    return {
        **row, "proposed": [example.count_touches(None, arguments.most)], "seconds": example.seconds,
        "random": [example.count_touches(lot, arguments.most) for lot in rng.spawn(arguments.orders)],
    }  # fmt: skip


def report(rows: list[dict[str, Any]], arguments: argparse.Namespace) -> None:
    """Print the table."""
    counted = [row for row in rows if "proposed" in row]
    print("| next touches | examples | until first | until certain | certain | certain, wrong | misses | ms a choice |")
    print("|---" * 8 + "|")
    for method in METHODS:
        runs = [run for row in counted for run in row[method]]
        first, certain, wrong = (np.mean([run[key] for run in runs]) for key in ("first", "certain", "wrong"))
        in_time = np.mean([run["certain"] <= arguments.most for run in runs])
        missed = np.sum([run["missed"] for run in runs]) / max(np.sum([run["more"] for run in runs]), 1)
        ms = 1e3 * np.median([s for row in counted for s in row["seconds"]]) if method == "proposed" else np.nan
        cells = f"{first:.2f} | {certain:.2f} | {in_time:.0%} | {wrong:.0%} | {missed:.2f}"
        print(f"| {method} | {len(counted)} | {cells} | {'' if np.isnan(ms) else f'{ms:.0f}'} |")


def main() -> None:
    """Measure, print the table, and keep the examples if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", type=Path, required=True, help="library on disk")
    parser.add_argument("--asked", default="", help="regular expression for the names of touched objects")
    parser.add_argument("--among", type=int, default=30, help="parts of the library of each example")
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--touches", type=int, default=1, help="first touches")
    parser.add_argument("--examples", type=int, default=20, help="ambiguous examples; others are left out")
    parser.add_argument("--approaches", type=int, default=50)
    parser.add_argument("--orders", type=int, default=2, help="random orders of each example")
    parser.add_argument("--most", type=int, default=5, help="most touches")
    parser.add_argument("--seed", type=int, default=23)
    parser.add_argument("--store", type=Path, help="store of models")
    parser.add_argument("--out", type=Path, help="folder with a file for each example")
    arguments = parser.parse_args()
    search = open_search(arguments)
    rows: list[dict[str, Any]] = []
    asked = choose_asked(search, arguments.asked, None)
    for number, name in enumerate(np.random.default_rng(arguments.seed).permutation(asked).tolist()):
        if sum("proposed" in row for row in rows) == arguments.examples:
            break
        kept = arguments.out / f"{name}.json" if arguments.out else None
        rows.append(measure_once(kept, partial(measure, search, name, NOISES[number % len(NOISES)], arguments)))
    report(rows, arguments)


if __name__ == "__main__":
    main()
