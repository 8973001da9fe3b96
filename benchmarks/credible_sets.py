#!/usr/bin/env python3
"""How often credible sets of poses contain the true pose, by the number of touches.

For each object there are examples of 1, 2, 3 and 7 simulated touches with strong noise. No example was used for a fit.
The truth is the grid pose nearest to the true pose. For every number of touches, the table has the share of truths in
the 50, 80 and 95 % credible sets of the fused posterior, and of the uncalibrated product of probabilities.

The sets are those of the grid's posterior, before poses are refined. Meshes are given as FILE[:UNITS] or a demo
object's name; by default the demo objects.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_parser, open_asked
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localizer, PosePosterior, StageStore
from tactile_loc.locate.probability.temperature import SHARED
from tactile_loc.locate.several_touches import compute_posterior_together
from tactile_loc.plugin import GridError
from tactile_loc.plugin.helpers import invert

LEVELS = (0.5, 0.8, 0.95)


def draw_examples(
    localizer: Localizer, touches: int, count: int, seed: int
) -> list[tuple[PosePosterior, PosePosterior, int]]:
    """Return, for each example, the fused posterior, the plain product, and the index of the truth."""
    found = []
    drawn = localizer.simulate(touches * count, seed + touches, noise="strong")
    for start in range(0, len(drawn), touches):
        some = [replace(t, T_base_sensor=invert(np.asarray(t.T_sensor_object))) for t in drawn[start : start + touches]]
        try:
            fused = compute_posterior_together([(localizer, touch) for touch in some])
        except GridError:  # no pose touches all sensors
            continue
        truth = int(fused.grid.nearest(np.asarray(some[0].T_sensor_object)[None])[1][0])
        found.append((fused, fused.temper(touches**SHARED), truth))
    return found


def measure_coverage(posteriors: list[PosePosterior], truths: list[int], rng: np.random.Generator) -> list[float]:
    """Return the share of truths in the credible sets of each of the `LEVELS`."""
    each = zip(posteriors, truths, rng.random(len(truths)), strict=True)
    levels = np.array([posterior.credible_level(truth, lot) for posterior, truth, lot in each])
    return [float((levels <= level).mean()) for level in LEVELS]


def measure(localizer: Localizer, touches: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return one row of the table."""
    rng = np.random.default_rng(arguments.seed)
    found = draw_examples(localizer, touches, arguments.examples, arguments.seed)
    fused, product, truths = [list(column) for column in zip(*found, strict=True)]
    return {
        "object": localizer.object.name,
        "touches": touches,
        "examples": len(found),
        "without_common_pose": arguments.examples - len(found),
        "poses": float(np.median([len(p.grid) for p in fused])),
        "levels": LEVELS,
        "fused": measure_coverage(fused, truths, rng),
        "product": measure_coverage(product, truths, rng),
    }


def main() -> None:
    """Measure, print a table, and write the rows as JSON if requested."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 2, 3, 7])
    parser.add_argument("--examples", type=int, default=100)
    parser.add_argument("--spacing-mm", type=float, default=4.0)
    parser.add_argument("--sensor", default="gelslim")
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print(f"{'object':14s} touches   fused 50 80 95 %     product 50 80 95 %")
    for mesh in arguments.objects:
        with tempfile.TemporaryDirectory() as store:
            grid = {"name": "face", "spacing_mm": arguments.spacing_mm}
            localizer = open_asked(mesh, store=StageStore(Path(store)), sensor=arguments.sensor, grid=grid)
            for touches in arguments.touches:
                rows.append(row := measure(localizer, touches, arguments))
                shares = "   ".join(" ".join(f"{share:5.0%}" for share in row[name]) for name in ("fused", "product"))
                print(f"{row['object']:14s} {touches:7d}  {shares}   {row['poses']:.0f} poses", flush=True)
                if arguments.out:
                    arguments.out.write_text(json.dumps(rows, indent=1))
    for touches in arguments.touches:
        of_all = [row for row in rows if row["touches"] == touches]
        fused = np.average([row["fused"] for row in of_all], axis=0, weights=[row["examples"] for row in of_all])
        shares = " ".join(f"{share:5.1%}" for share in fused)
        print(f"{'all':14s} {touches:7d}  {shares}")


if __name__ == "__main__":
    main()
