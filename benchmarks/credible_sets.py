#!/usr/bin/env python3
"""How often credible sets of poses contain the true pose, by the number of touches.

For each object there are examples of 1, 2, 3 and 7 simulated touches with strong noise. No example was used for a fit.
The truth is the grid pose nearest to the true pose. For every number of touches, the table has the share of truths in
the 50, 80 and 95 % credible sets of the fused posterior, and of the uncalibrated product of probabilities.
`conformal_sets.py` measures the sets that a requested coverage gives.

`--whole` searches the whole object. A truth that was not found counts as the least likely pose, with the probability
that the posterior gives to poses elsewhere. The share of found truths and their mean probability are printed. Meshes
are given as FILE[:UNITS] or a demo object's name; by default the demo objects.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_parser, open_asked
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.locate.localizer import Localizer, compute_posterior_together
from tactile_loc.store.store import StageStore

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
        power = 1.0 if touches == 1 else localizer.probabilities.fused_scaling.power(touches)
        found.append((fused, fused.temper(1 / power), localizer.source.find_truth(fused.grid, some[0])))
    return found


def measure_coverage(posteriors: list[PosePosterior], truths: list[int], rng: np.random.Generator) -> list[float]:
    """Return the share of truths in the credible sets of each of the `LEVELS`."""
    levels = np.array([
        p.credible_level(t, lot) if t >= 0 else 1 - p.elsewhere * (1 - lot)
        for p, t, lot in zip(posteriors, truths, rng.random(len(truths)), strict=True)
    ])  # fmt: skip
    return [float((levels <= level).mean()) for level in LEVELS]


def measure(localizer: Localizer, touches: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return one row of the table."""
    rng = np.random.default_rng(arguments.seed)
    found = draw_examples(localizer, touches, arguments.examples, arguments.seed)
    fused, product, truths = [list(column) for column in zip(*found, strict=True)]
    return {
        "object": localizer.object.name, "touches": touches, "examples": len(found),
        "without_common_pose": arguments.examples - len(found), "poses": float(np.median([len(p.grid) for p in fused])),
        "exponent": localizer.probabilities.fused_scaling.exponent, "levels": LEVELS,
        "fused": measure_coverage(fused, truths, rng), "product": measure_coverage(product, truths, rng),
        "found": float(np.mean(np.array(truths) >= 0)), "said_found": float(np.mean([1 - p.elsewhere for p in fused])),
    }  # fmt: skip


def main() -> None:
    """Measure, print a table, and write the rows as JSON if requested."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 2, 3, 7])
    parser.add_argument("--examples", type=int, default=100)
    parser.add_argument("--spacing-mm", type=float, default=4.0)
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--sensor", default="gelslim")
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print(f"{'object':14s} touches   fused 50 80 95 %     product 50 80 95 %")
    for mesh in arguments.objects:
        with tempfile.TemporaryDirectory() as store:
            localizer = open_asked(
                mesh, store=StageStore(Path(store)), sensor=arguments.sensor,
                grid="whole" if arguments.whole else {"name": "face", "spacing_mm": arguments.spacing_mm},
            )  # fmt: skip
            for touches in arguments.touches:
                rows.append(row := measure(localizer, touches, arguments))
                shares = "   ".join(" ".join(f"{share:5.0%}" for share in row[name]) for name in ("fused", "product"))
                print(
                    f"{row['object']:14s} {touches:7d}  {shares}   {row['poses']:.0f} poses"
                    f"   found {row['found']:.0%}, said {row['said_found']:.0%}", flush=True,
                )  # fmt: skip
                if arguments.out:
                    arguments.out.write_text(json.dumps(rows, indent=1))
    for touches in arguments.touches:
        of_all = [row for row in rows if row["touches"] == touches]
        fused = np.average([row["fused"] for row in of_all], axis=0, weights=[row["examples"] for row in of_all])
        shares = " ".join(f"{share:5.1%}" for share in fused)
        print(f"{'all':14s} {touches:7d}  {shares}")


if __name__ == "__main__":
    main()
