#!/usr/bin/env python3
"""How often one touch of a whole object is found, from any direction, and the cost of building and searching.

An object is pressed from random directions by 30 to 90 % of the sensor's deepest press. Every contact of at least
0.25 % of the sensor counts. Touches are drawn by ray casting, which the localizer does not use.

For each object and sensor, the table has the number of places, the seconds to build them and to fit probabilities, the
peak memory, the megabytes in the store, and the seconds to open the model. A hypothesis is right if its pose error is
at most 1 mm. The table has the share of touches whose first hypothesis is right, and the share with a right one among
ten. All other touches are *ambiguous* if another pose explains the touch as well (imprint IoU within 0.01), *not
listed* if the search found a pose within 1 mm (root mean square over the surface, before refinement), or *not found*.
Then follow the median and the 95 % quantile of the time to ten refined hypotheses, and the shares by contact area.
`--grid` and `--encoder` choose other components.
"""

import argparse
import json
import multiprocessing
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_parser, make_source, open_asked
from contacts import LEVELS, Located, locate
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localization, Localizer, StageStore, TactileLocError, Touch

AREAS = (0.0, 0.01, 0.03, 0.1, 1.0)  # limits of the contact area, share of the sensor
NEAR_MM = 1.0


def create(path: str, arguments: argparse.Namespace, sensor: str, store: Path) -> Localizer:
    """Return a localizer of the object in a mesh file."""
    chosen = {slot: json.loads(given) for slot in ("grid", "encoder") if (given := getattr(arguments, slot))}
    return open_asked(path, sensor=sensor, store=StageStore(store), **chosen)


def measure_peak_memory_mb() -> float:
    """Return this process's peak memory, MB, on Linux. getrusage would return the parent's peak if it is larger."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1e3


def build(path: str, arguments: argparse.Namespace, sensor: str, store: Path) -> dict[str, float]:
    """Build all stages for a touch. Return the number of places, the times, and the peak memory."""
    localizer, start = create(path, arguments, sensor, store), time.perf_counter()
    counted = localizer.source.count_poses()
    searched = counted.get("places", counted.get("poses"))
    places_s = time.perf_counter() - start
    _ = localizer.source.temperature_scaling  # a listed grid may fit one
    fit_s = time.perf_counter() - start - places_s
    return {"places": searched, "places_s": places_s, "fit_s": fit_s, "memory_mb": measure_peak_memory_mb()}


def build_model(
    path: str, arguments: argparse.Namespace, sensor: str, store: Path
) -> tuple[Localizer, dict[str, float]]:
    """Build a model in a separate process. Return its localizer and the costs of building and opening it."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        about = process.submit(build, path, arguments, sensor, store).result()
    localizer, start = create(path, arguments, sensor, store), time.perf_counter()
    _ = localizer.source.count_poses()
    opened_s = time.perf_counter() - start
    megabytes = sum(file.stat().st_size for file in store.rglob("*") if file.is_file()) / 1e6
    return localizer, {**about, "megabytes": megabytes, "open_s": opened_s}


def measure_nearest_m(answer: Localization, touch: Touch) -> float:
    """Return the smallest distance, in metres, of the search's poses (before refinement) from the truth."""
    return float(answer.posterior.grid.nearest(np.asarray(touch.T_sensor_object)[None])[0][0])


def measure(localizer: Localizer, arguments: argparse.Namespace, level: str) -> list[dict[str, float]]:
    """Return the result of each touch."""
    source = make_source(localizer.object, localizer.scene.geometry, **LEVELS[level])
    found = []
    for number in range(-1, arguments.touches):
        (touch,), _ = source.draw_example(1, np.random.default_rng([arguments.seed, max(number, 0)]))
        start = time.perf_counter()
        try:
            answer = localizer.localize(touch)
            seconds = time.perf_counter() - start
            said, searched_m = locate(localizer, [touch], answer), measure_nearest_m(answer, touch)
        except TactileLocError:
            seconds, said, searched_m = time.perf_counter() - start, Located(), np.inf
        if number >= 0:  # the first call warms up
            one = {"seconds": seconds, "area": touch.contact_share, "searched_mm": 1e3 * searched_m}
            found.append({**said._asdict(), **one})
    return found


def write_shares(found: list[dict[str, float]]) -> dict[str, float]:
    """Return the shares of touches, or NaN without touches."""
    first = np.array([one["chosen_mm"] <= NEAR_MM for one in found])
    among = np.array([one["nearest_mm"] <= NEAR_MM for one in found])
    ambiguous = np.array([bool(one["undetermined"]) for one in found])
    searched = np.array([one["searched_mm"] < NEAR_MM for one in found])
    seconds = np.array([one["seconds"] for one in found])
    if not found:
        return {}
    return {
        "touches": len(found), "first": first.mean(), "among": among.mean(), "ambiguous": (~among & ambiguous).mean(),
        "not_listed": (~among & ~ambiguous & searched).mean(), "not_found": (~among & ~ambiguous & ~searched).mean(),
        "median_s": np.median(seconds), "slow_s": np.quantile(seconds, 0.95),
    }  # fmt: skip


def write_line(start: list[str], one: dict[str, float]) -> str:
    """Return a row of the table."""
    percent = [f"{one[key]:.0%}" for key in ("first", "among", "ambiguous", "not_listed", "not_found")]
    times = [f"{1e3 * one[key]:.0f}" for key in ("median_s", "slow_s")]
    return f"| {' | '.join([*start, str(one['touches']), *percent, *times])} |"


def main() -> None:
    """Measure, print tables, and write the rows as JSON if requested."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensors", nargs="+", default=["gelslim", "gelsight-mini"])
    parser.add_argument("--level", default="clean", choices=list(LEVELS))
    parser.add_argument("--touches", type=int, default=200)
    parser.add_argument("--grid", default='{"name": "whole"}', help="grid as JSON")
    parser.add_argument("--encoder", help="encoder as JSON; default: the grid's")
    parser.add_argument("--seed", type=int, default=17)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print("| object | sensor | places | build, s | fit, s | memory, GB | MB | open, s | touches | first | among ten | "
          "ambiguous | not listed | not found | median, ms | 95 %, ms |")  # fmt: skip
    print("|---" * 16 + "|")
    for path in arguments.objects:
        for sensor in arguments.sensors:
            with tempfile.TemporaryDirectory() as store:
                localizer, about = build_model(path, arguments, sensor, Path(store))
                found = measure(localizer, arguments, arguments.level)
            rows += [{"object": localizer.object.name, "sensor": sensor, **about, **one} for one in found]
            words = [localizer.object.name, sensor, f"{about['places']:.0f}", f"{about['places_s']:.1f}",
                     f"{about['fit_s']:.0f}", f"{1e-3 * about['memory_mb']:.2f}", f"{about['megabytes']:.0f}",
                     f"{about['open_s']:.2f}"]  # fmt: skip
            print(write_line(words, write_shares(found)), flush=True)
            if arguments.out:
                arguments.out.write_text(json.dumps(rows, indent=1))
    print(
        "\n| contact area | touches | first | among ten | ambiguous | not listed | not found | median, ms | 95 %, ms |"
    )
    print("|---" * 9 + "|")
    for low, high in pairwise(AREAS):
        some = [row for row in rows if low <= row["area"] < high]
        if some:
            print(write_line([f"{100 * low:g} to {100 * high:g} %"], write_shares(some)))
    print(write_line(["all"], write_shares(rows)))


if __name__ == "__main__":
    main()
