#!/usr/bin/env python3
"""Whether verdicts are right: how often the first pose is right, by its fitted probability and by its verdict.

Touches are drawn as in reliability.py, with other seeds. A first pose is right if the mean distance of its surface from
the true surface is below 1 mm. An example is determined if no listed pose with a wrong surface explains the touches as
well as the true pose: to within 0.02 of its imprint IoU. The first table has the mean fitted probability, the share of
right poses and the number of examples, by the probability. The second table counts verdicts. The numbers of the fit
come from other touches of the objects of `FITTED`. Each example is appended to a file, from which the same command
continues.

Meshes are given as FILE[:UNITS] or a demo object's name.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from asked import make_parser, make_source, name_asked, open_asked, write_head
from elastic_gel import SIZES_PX
from reliability import BIN_NAMES, MM, RIGHT_MM, draw_example, write_row
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.poses.tolerance import measure_surface_distances
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.gel import RIGID, Gel
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.recall.evaluation import is_determined
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.store.store import StageStore

FITTED = (
    "hook", "pin", "head", "cotter", "damping_pin", "elbow_pipe", "00062_plug", "00103_plug", "00345_plug",
    "00486_plug", "00652_plug", "00703_plug",
)  # fmt: skip
THICKNESS_MM, POISSON = 4.0, 0.48  # of the layer
GELS = {"rigid": RIGID, "layer": Gel(THICKNESS_MM / MM, POISSON)}


class Judged(NamedTuple):
    """An example: its object, gel, noise, number and number of touches, and how it was judged.

    `probability`, 0 to 1, is that of a right first pose. `off_mm` is the surface distance of the first pose; 4 mm or
    more count alike. An example that ended in an error has the verdict "error".
    """

    object: str
    gel: str
    noise: str
    number: int
    touches: int
    verdict: str = "error"
    probability: float = 0.0
    off_mm: float = np.inf
    determined: bool = False

    @property
    def right(self) -> bool:
        """Whether the first pose is right."""
        return self.off_mm < RIGHT_MM


def judge(localizer: Localizer, touches: list[Touch], about: Judged) -> Judged:
    """Return an example with its verdict."""
    observations = [(localizer, touch) for touch in touches]
    try:
        found = localize_together(observations)
    except TactileLocError:
        return about
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    off_m = measure_surface_distances(localizer.object.mesh, poses, np.asarray(touches[0].T_sensor_object))
    return about._replace(
        verdict=str(found.verdict), probability=found.probability_within(), off_mm=MM * float(off_m[0]),
        determined=is_determined(observations, found.hypotheses, off_m, RIGHT_MM / MM),
    )  # fmt: skip


def measure(
    mesh: str, gel: str, arguments: argparse.Namespace, store: StageStore, known: set[tuple[object, ...]]
) -> Iterator[Judged]:
    """Yield the examples of one object on one gel that are not `known`."""
    sensor = {"name": arguments.sensor, "image_size_px": SIZES_PX[arguments.sensor]}
    if gel != "rigid":
        sensor |= {"gel": "layer", "gel_thickness_mm": THICKNESS_MM, "poisson": POISSON}
    localizer = open_asked(mesh, store=store, sensor=sensor)
    modelled = localizer.scene.geometry.gel
    geometry = dataclasses.replace(localizer.scene.geometry, gel=RIGID)
    source = make_source(localizer.object, geometry)
    levels = list(NOISE)
    for number in range(arguments.examples):
        about = Judged(name_asked(mesh), gel, levels[number % len(levels)], number, 0)
        missing = [count for count in arguments.touches if about._replace(touches=count)[:5] not in known]
        if missing:
            rng = np.random.default_rng([arguments.seed, number])
            touches = draw_example(source, max(arguments.touches), GELS[gel], modelled, NOISE[about.noise], rng)
        for count in missing:
            yield judge(localizer, touches[:count], about._replace(touches=count))


def write_verdicts(name: str, found: list[Judged]) -> str:
    """Return a row of the second table."""
    certain = [one for one in found if one.verdict == "certain"]
    determined = [one for one in found if one.determined]
    called = sum(one.verdict == "certain" for one in determined)
    others = [sum(one.verdict == verdict for one in found) for verdict in ("ambiguous", "poor fit", "not found")]
    cells = [len(certain), sum(one.right for one in certain), *others, f"{called} of {len(determined)}"]
    return f"| {name} | {len(found)} | {' | '.join(map(str, cells))} |"


def print_tables(found: list[Judged], arguments: argparse.Namespace) -> None:
    """Print both tables: for the objects of the fit and for the others, by gel, touches and noise."""
    groups = {"fitted": [one for one in found if one.object in FITTED]}
    groups["others"] = [one for one in found if one.object not in FITTED]
    print(write_head("objects", "touches", "all", *BIN_NAMES))
    for name, group in groups.items():
        for count in ("all", *arguments.touches):
            some = [one for one in group if count in ("all", one.touches) and one.verdict != "error"]
            if some:
                print(write_row(f"{name} | {count}", some))
    verdicts = ("certain", "of these right", "ambiguous", "poor fit", "not found", "determined: certain")
    print("\n" + write_head("gel", "touches", "noise", "examples", *verdicts))
    for gel in GELS:
        for count in arguments.touches:
            for level in NOISE:
                some = [one for one in found if (one.gel, one.touches, one.noise) == (gel, count, level)]
                if some:
                    print(write_verdicts(f"{gel} | {count} | {level}", some))
    print(write_verdicts("all | all | all", found))


def main() -> None:
    """Measure, and print the tables."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensor", choices=list(SIZES_PX), default="gelsight-mini")
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 2, 3, 5])
    parser.add_argument("--examples", type=int, default=12)
    parser.add_argument("--seed", type=int, default=907)
    parser.add_argument("--rows", type=Path, default=Path("verdicts.jsonl"), help="file of the examples")
    arguments = parser.parse_args()
    lines = arguments.rows.read_text().splitlines() if arguments.rows.exists() else []
    found = [Judged(**json.loads(line)) for line in lines]
    known: set[tuple[object, ...]] = {one[:5] for one in found}
    with tempfile.TemporaryDirectory() as folder, arguments.rows.open("a") as rows:
        for mesh in arguments.objects:
            for gel in GELS:
                for one in measure(mesh, gel, arguments, StageStore(Path(folder)), known):
                    found.append(one)
                    rows.write(json.dumps(one._asdict()) + "\n")
                    rows.flush()
    print_tables(found, arguments)


if __name__ == "__main__":
    main()
