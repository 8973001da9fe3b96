#!/usr/bin/env python3
"""The number of touches until an object's pose is known: with chosen, with random, and with the best possible touches.

An object is at rest. The first touch, from any direction, is the same for all methods. Then each method picks further
touches from the same `--approaches`, which are drawn around the poses of the first result, as `next-touch --around`
does:

- chosen: the approach that `choose_next_touch` ranks first.
- information: the approach with the most expected information, without caution. It is measured only if `--methods`
  names it.
- random: any approach. Each example is repeated with `--orders` random orders, and their mean counts.
- oracle: the best of all approaches. Each is really touched and located together with the touches so far. The oracle
  knows the true pose, so no rule can do better in one step. It prefers results that are right and certain. Then it
  prefers right results, and then those with the most probability of right poses.
- expected: the same, but each of the `--modes` likeliest poses is taken as the true one in turn. The mean result
  counts. This method does not know the true pose. It takes long, so it is measured only if `--methods` names it.

An approach that meets nothing, or only a flat face, is counted as a miss, and the method's next approach is tried. The
same approach gives the same touch to all methods. Touches are drawn by ray casting, which the localizer does not use.
The noise of the examples alternates between `--levels`. The press is 30 to 90 % of the sensor's deepest press the
first time, and 60 % afterwards. A pose is right if its pose error is at most 1 mm.

Two kinds of examples are left out. Easy ones have a certain and right result after the first touch. Undetermined ones
have no located set of touches that determines the pose. A set determines the pose if no listed wrong pose explains the
touches to within 0.02 of the true pose's imprint IoU.

The table has the mean number of touches until the first pose is right, and until it is right with the verdict certain.
The first touch counts. A pose that stays unknown counts as one touch more than the most. Further columns are the ratio
to the oracle's number of touches, the misses of a next touch, and the median time of a choice. The last rows are for
all objects, by noise. Objects are FILE[:UNITS] or demo names. `--out` keeps each object's
examples, which are not measured again.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from asked import make_parser, make_source, name_asked, open_asked
from identify import measure_once
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.poses.pose_errors import RIGHT_M, measure_pose_errors
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.recall.evaluation import is_determined
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.io.approach_files import Approach
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.planning.approaches import draw_approaches_to_modes
from tactile_loc.planning.next_touch import choose_next_touch
from tactile_loc.store.store import StageStore
from tactile_loc.tracking.pose_modes import MOST_MODES, PoseModes

PRESS = 0.6  # share of the sensor's deepest press
METHODS = ("oracle", "chosen", "random", "expected", "information")
WANTED = ("known", "certain")


class Outcome(NamedTuple):
    """A result and how good it is; `mass` is the probability of right poses."""

    found: Localization | None = None
    right: bool = False
    certain: bool = False
    mass: float = 0.0
    determined: bool = False

    @property
    def value(self) -> tuple[float, float, float]:
        """The order in which the oracle prefers results."""
        return float(self.right and self.certain), float(self.right), self.mass


@dataclass(frozen=True, eq=False)
class Example:
    """An object at rest, with its first touch and the approaches to choose from. Results are kept."""

    localizer: Localizer
    source: RobotTouches
    first: Touch
    seed: tuple[int, int]
    approaches: list[Approach] = field(default_factory=list)
    touches: dict[int, Touch | None] = field(default_factory=dict)
    outcomes: dict[tuple[int, ...], Outcome] = field(default_factory=dict)

    def touch(self, k: int) -> Touch | None:
        """Return the touch of approach k; None if it misses."""
        if k not in self.touches:
            a, rng = self.approaches[k], np.random.default_rng([*self.seed, k])
            self.touches[k] = self.source.approach(a.T_base_sensor, a.press_m or 0.0, a.name, rng, a.travel_m)
        return self.touches[k]

    def locate(self, *chosen: int) -> Outcome:
        """Return the outcome of the first touch and those of the chosen approaches."""
        key = tuple(sorted(chosen))
        if key not in self.outcomes:
            touches = [self.first, *(touch for k in key if (touch := self.touch(k)) is not None)]
            self.outcomes[key] = judge(self.localizer, touches)
        return self.outcomes[key]

    def locate_as(self, T_base_object: Poses, chosen: tuple[int, ...], k: int) -> Outcome:
        """Return the outcome of another approach k if `T_base_object` (4, 4), metres, were the true pose."""
        a, rng = self.approaches[k], np.random.default_rng([*self.seed, k, 1])
        start = invert(T_base_object) @ a.T_base_sensor
        touch = self.source.approach(start, a.press_m or 0.0, a.name, rng, a.travel_m)
        if touch is None:
            return Outcome()
        there = dataclasses.replace(touch, T_base_sensor=T_base_object @ touch.T_base_sensor)
        before = [self.first, *(known for j in chosen if (known := self.touch(j)) is not None)]
        return judge(self.localizer, [*before, there], invert(np.asarray(self.first.T_base_sensor)) @ T_base_object)


Choice = Callable[[Example, Outcome, tuple[int, ...], list[int]], Iterator[int]]


def judge(localizer: Localizer, touches: list[Touch], truth: Poses | None = None) -> Outcome:
    """Locate touches together, and compare the result with a pose (4, 4), metres, by default the true one.

    The pose is in the frame of the first touch's sensor. For another pose than the true one, it is not judged whether
    the touches determine it.
    """
    observations = [(localizer, touch) for touch in touches]
    try:
        found = localize_together(observations, top=MOST_MODES)
    except TactileLocError:
        return Outcome()
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    true = np.asarray(touches[0].T_sensor_object if truth is None else truth)
    errors_m = measure_pose_errors(localizer.object, poses, true)
    right = errors_m <= RIGHT_M
    mass = float(sum(h.probability for h, one in zip(found.hypotheses, right, strict=True) if one))
    certain = found.verdict is Verdict.CERTAIN
    determined = truth is None and is_determined(observations, found.hypotheses, errors_m)
    return Outcome(found, bool(right[0]), certain, mass, determined)


def choose_by_worth(seconds: list[float]) -> Choice:
    """Return a function that ranks approaches by `choose_next_touch`. It adds its times to `seconds`."""

    def choose(example: Example, now: Outcome, chosen: tuple[int, ...], left: list[int]) -> Iterator[int]:
        number = {id(example.approaches[k]): k for k in left}
        start = time.perf_counter()
        ranked = choose_next_touch(now.found, [example.approaches[k] for k in left]).ranked
        seconds.append(time.perf_counter() - start)
        return (number[id(rated.approach)] for rated in ranked)

    return choose


def choose_by_information(
    example: Example, now: Outcome, chosen: tuple[int, ...], left: list[int]
) -> Iterator[int]:  # fmt: skip
    """Put approaches in the order of their expected information, without caution."""
    number = {id(example.approaches[k]): k for k in left}
    ranked = choose_next_touch(now.found, [example.approaches[k] for k in left]).ranked
    return (number[id(rated.approach)] for rated in sorted(ranked, key=lambda rated: -rated.information))


def choose_by_lot(rng: np.random.Generator) -> Choice:
    """Return a function that puts approaches in a random order."""
    return lambda example, now, chosen, left: iter(rng.permutation(left).tolist())


def choose_best(example: Example, now: Outcome, chosen: tuple[int, ...], left: list[int]) -> Iterator[int]:
    """Put approaches in the order of their real outcomes, the best first. Approaches that miss are left out."""
    met = [k for k in left if example.touch(k) is not None]
    return iter(sorted(met, key=lambda k: example.locate(*chosen, k).value, reverse=True))


def choose_best_expected(most: int) -> Choice:
    """Return a function that puts approaches in the order of their mean outcomes over the `most` likeliest modes."""

    def choose(example: Example, now: Outcome, chosen: tuple[int, ...], left: list[int]) -> Iterator[int]:
        modes = PoseModes.of(now.found)
        likeliest = list(zip(modes.probabilities, modes.T_base_object, strict=True))[:most]

        def expect(k: int) -> tuple[float, ...]:
            values = [np.multiply(p, example.locate_as(T, chosen, k).value) for p, T in likeliest]
            return tuple(np.sum(values, axis=0))

        return iter(sorted(left, key=expect, reverse=True))

    return choose


def count_touches(example: Example, choose: Choice, most: int) -> dict[str, int]:
    """Return the number of touches until the pose is known, and until it is certain, or `most` + 1, and the misses."""
    counts, chosen, left, missed = dict.fromkeys(WANTED, most + 1), (), list(range(len(example.approaches))), 0
    while True:
        now, count = example.locate(*chosen), 1 + len(chosen)
        if now.right:
            counts["known"] = min(counts["known"], count)
        if now.right and now.certain:
            counts["certain"] = count
        if counts["certain"] == count or count == most or now.found is None:
            break
        for k in choose(example, now, chosen, left):
            left.remove(k)
            if example.touch(k) is not None:
                chosen = (*chosen, k)
                break
            missed += 1
        else:
            break
    return {**counts, "missed": missed, "more": len(chosen)}


def measure(mesh: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure all examples of one object."""
    localizer = open_asked(mesh, sensor=arguments.sensor, store=StageStore(arguments.store))
    geometry = localizer.scene.geometry
    seconds: list[float] = []
    counted, easy, undetermined = [], 0, 0
    for number in range(arguments.examples):
        level = arguments.levels[number % len(arguments.levels)]
        noise = NOISE[level]
        errors = {"noise": noise, "sensor_std_m": noise.sensor_m, "sensor_std_rad": noise.sensor_rad}
        source = make_source(localizer.object, geometry, **errors)
        seed = (arguments.seed, number)
        rng = np.random.default_rng(seed)
        (touch,), _ = source.draw_example(1, rng)
        example = Example(localizer, source, touch, seed)
        first = example.locate()
        if first.found is None or (first.right and first.certain):
            easy += 1
            continue
        around = draw_approaches_to_modes(PoseModes.of(first.found), arguments.approaches, rng)
        example.approaches.extend(dataclasses.replace(a, press_m=PRESS * geometry.max_depth_m) for a in around)
        orders = [choose_by_lot(lot) for lot in rng.spawn(arguments.orders)]
        choices = {
            "oracle": [choose_best], "chosen": [choose_by_worth(seconds)], "random": orders,
            "expected": [choose_best_expected(arguments.modes)], "information": [choose_by_information],
        }  # fmt: skip
        runs = {
            method: [count_touches(example, choose, arguments.most) for choose in choices[method]]
            for method in arguments.methods
        }
        if any(outcome.determined for outcome in example.outcomes.values()):
            counted.append({"level": level, **runs})
        else:
            undetermined += 1
    return {
        "object": localizer.object.name, "sensor": localizer.config.sensor.name, "approaches": arguments.approaches,
        "most": arguments.most, "examples": counted, "easy": easy, "undetermined": undetermined, "seconds": seconds,
    }  # fmt: skip


def average(examples: list[dict[str, Any]], method: str, what: str) -> float:
    """Return the mean of a count over examples, of which each counts once."""
    return float(np.mean([np.mean([run[what] for run in example[method]]) for example in examples]))


def write_line(name: str, rows: list[dict[str, Any]], methods: list[str], level: str = "") -> str:
    """Return a row of the table, for one object or for several, with all noise or one level."""
    examples = [one for row in rows for one in row["examples"] if level in ("", one["level"])]
    left_out = [str(sum(row[why] for row in rows)) for why in ("easy", "undetermined")] if not level else ["", ""]
    cells = [name, str(len(examples)), *left_out]
    if not examples:
        return f"| {' | '.join(cells + [''] * (len(methods) * 4 + 1))} |"
    for method in methods:
        means = [average(examples, method, what) for what in WANTED]
        best = [average(examples, methods[0], what) for what in WANTED]
        cells += [f"{means[0]:.2f}", f"{means[1]:.2f}", f"{means[0] / best[0]:.2f}, {means[1] / best[1]:.2f}"]
        more = average(examples, method, "more")
        cells.append(f"{average(examples, method, 'missed') / more:.2f}" if more else "")
    seconds = [s for row in rows for s in row["seconds"]]
    cells.append(f"{1e3 * np.median(seconds):.0f}" if seconds and not level else "")
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Measure, print a table, and keep each object's examples if requested."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--levels", nargs="+", default=["none", "mild"], choices=list(NOISE))
    parser.add_argument("--methods", nargs="+", default=list(METHODS[:3]), choices=METHODS)
    parser.add_argument("--modes", type=int, default=8, help="poses that the method expected takes as the true one")
    parser.add_argument("--examples", type=int, default=8)
    parser.add_argument("--approaches", type=int, default=30)
    parser.add_argument("--orders", type=int, default=4, help="random orders of each example")
    parser.add_argument("--most", type=int, default=6, help="most touches")
    parser.add_argument("--seed", type=int, default=23)
    parser.add_argument("--store", type=Path, help="store of models")
    parser.add_argument("--out", type=Path, help="folder with a file for each object")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    heads = [f"{m}: known | {m}: certain | {m}: x oracle | {m}: misses" for m in arguments.methods]
    columns = f"| object | examples | easy | undetermined | {' | '.join(heads)} | ms a choice |"
    print(f"{columns}\n{'|---' * (columns.count('|') - 1)}|")
    for mesh in arguments.objects:
        kept = arguments.out / f"{name_asked(mesh)}.json" if arguments.out else None
        rows.append(measure_once(kept, partial(measure, mesh, arguments)))
        print(write_line(rows[-1]["object"], rows[-1:], arguments.methods), flush=True)
    for level in arguments.levels:
        print(write_line(f"all, noise {level}", rows, arguments.methods, level))
    print(write_line("all", rows, arguments.methods))


if __name__ == "__main__":
    main()
