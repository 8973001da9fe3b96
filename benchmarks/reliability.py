#!/usr/bin/env python3
"""Whether the stated probabilities are right: how often the first pose is right, by its probability.

Objects are pressed from any direction, by 30 to 90 % of the sensor's deepest press. They are drawn by ray casting. The
surface of an elastic gel is computed by ContactMechanics. Noise is then added to each touch: none, mild and strong in
turn. Touches are located alone and together. A first pose is right if it is within 1 mm of the true pose (root mean
square over the surface, modulo symmetry). The examples are divided into bins by the probability of the first pose. The
table has the mean stated probability of each bin, the share of right poses, and the number of examples. An example
that ends in an error is left out, and counted. No example was used for a fit.

Meshes are given as FILE[:UNITS] or a demo object's name.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from asked import make_parser, make_source, open_asked, write_head
from elastic_gel import SIZES_PX, press_elastic, view_as
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.errors import TactileLocError, TouchError
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.noise import NOISE, TouchNoise
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.evaluation.robot_touches import RobotTouches, measure_noisily
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.store.store import StageStore

MM = 1e3
RIGHT_MM = 1.0
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
BIN_NAMES = [f"{low:.0%} to {high:.0%}" for low, high in itertools.pairwise(BINS)]


class Stated(NamedTuple):
    """The first pose of an example: its gel, its number of touches, its noise, its probability, and if it is right."""

    gel: str
    touches: int
    noise: str
    probability: float
    right: bool


def add_noise(touch: Touch, source: RobotTouches, noise: TouchNoise, rng: np.random.Generator) -> Touch:
    """Return the touch with noise. Raises TouchError if a sensor cannot distinguish it from no touch."""
    press_m, deepest_m = touch.indentation_m, source.geometry.max_depth_m
    geometry = source.geometry.press(press_m, deepest_m)
    depth_m = touch.contact_shape.depth_m
    clean = np.where(depth_m < np.float32(press_m), depth_m, np.float32(deepest_m))
    seen_m, measured_m = measure_noisily(noise, clean[None], press_m, geometry, rng)
    unpressed = dataclasses.replace(source.geometry, gel=touch.geometry.gel)
    return dataclasses.replace(touch, contact_shape=ContactShape(seen_m, measured_m), geometry=unpressed)


def draw_example(
    source: RobotTouches, count: int, gel: Gel, modelled: Gel, noise: TouchNoise, rng: np.random.Generator
) -> list[Touch]:
    """Return `count` touches of an object on a `gel`, as sensors with the gel `modelled` see them."""
    touches: list[Touch] = []
    while len(touches) < count:
        (touch,), _ = source.draw_example(1, rng)
        if gel.is_elastic:
            touch = view_as(press_elastic(touch, source, gel), modelled)
        try:
            touches.append(add_noise(touch, source, noise, rng))
        except TouchError:  # noise has hidden the contact
            continue
    return touches


def locate(localizer: Localizer, touches: list[Touch]) -> tuple[float, bool]:
    """Return the probability of the first pose given touches, and if it is right."""
    first = localize_together([(localizer, touch) for touch in touches]).best
    truth = np.asarray(touches[0].T_sensor_object)
    off_m = PoseMetric(localizer.object).symmetric_distance(first.T_sensor_object[None], truth[None])
    return first.probability, bool(MM * off_m[0] < RIGHT_MM)


def measure(mesh: str, layer: Gel, arguments: argparse.Namespace, store: StageStore) -> tuple[list[Stated], int]:
    """Return the first poses of one object's examples, and the number of examples that ended in an error."""
    rigid = {"name": arguments.sensor, "image_size_px": SIZES_PX[arguments.sensor]}
    elastic = {**rigid, "gel": "layer", "gel_thickness_mm": arguments.thickness_mm, "poisson": arguments.poisson}
    found, failed = [], 0
    for name, sensor, gel in (("rigid", rigid, Gel()), ("layer", elastic, layer)):
        if name not in arguments.gels:
            continue
        localizer = open_asked(mesh, store=store, sensor=sensor)
        geometry = dataclasses.replace(localizer.scene.geometry, gel=Gel())
        source = make_source(localizer.object, geometry)
        for number in range(arguments.examples):
            level = arguments.noise[number % len(arguments.noise)]
            rng = np.random.default_rng([arguments.seed, number])
            touches = draw_example(
                source, max(arguments.touches), gel, localizer.scene.geometry.gel, NOISE[level], rng
            )  # fmt: skip
            for count in arguments.touches:
                try:
                    found.append(Stated(name, count, level, *locate(localizer, touches[:count])))
                except TactileLocError:
                    failed += 1
    return found, failed


def write_row(name: str, found: Sequence[Any]) -> str:
    """Return a row of the table, given examples with a stated `probability` and whether their pose is `right`."""
    p, right = np.array([one.probability for one in found]), np.array([one.right for one in found])
    bin_of = np.clip(np.digitize(p, BINS) - 1, 0, len(BINS) - 2)
    bins = [bin_of == k for k in range(len(BINS) - 1)]
    cells = [f"{p[some].mean():.0%}, {right[some].mean():.0%} ({some.sum()})" if some.any() else "-" for some in bins]
    return f"| {name} | {p.mean():.0%}, {right.mean():.0%} ({len(p)}) | {' | '.join(cells)} |"


def main() -> None:
    """Measure, and print a table."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensor", choices=list(SIZES_PX), default="gelsight-mini")
    parser.add_argument("--gels", nargs="+", choices=("rigid", "layer"), default=["rigid", "layer"])
    parser.add_argument("--thickness-mm", type=float, default=4.0, help="of the elastic layer")
    parser.add_argument("--poisson", type=float, default=0.48)
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 3])
    parser.add_argument("--noise", nargs="+", choices=list(NOISE), default=list(NOISE))
    parser.add_argument("--examples", type=int, default=30)
    parser.add_argument("--seed", type=int, default=61)
    arguments = parser.parse_args()
    layer = Gel(arguments.thickness_mm / MM, arguments.poisson)
    found: list[Stated] = []
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        for mesh in arguments.objects:
            more, errors = measure(mesh, layer, arguments, StageStore(Path(folder)))
            found, failed = found + more, failed + errors
    print(write_head("gel", "touches", "noise", "all", *BIN_NAMES))
    for gel in arguments.gels:
        for count in arguments.touches:
            alike = [one for one in found if (one.gel, one.touches) == (gel, count)]
            for level in ("all", *arguments.noise):
                some = [one for one in alike if level in ("all", one.noise)]
                if some:
                    print(write_row(f"{gel} | {count} | {level}", some))
    print(f"{failed} examples ended in an error")


if __name__ == "__main__":
    main()
