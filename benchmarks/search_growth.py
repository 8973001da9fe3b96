#!/usr/bin/env python3
"""The cost of searching a whole object, by the object's size and the number of directions.

Each object is scaled down and up, and searched with fewer and more directions. For each case, the table has the number
of distinct poses (places times yaws), the seconds to list the places, and the median time from one touch to ten refined
hypotheses. Touches come from random directions, and are drawn by ray casting. A figure shows both times against size
and number of directions.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from asked import load_asked, make_parser, make_source
from matplotlib.ticker import NullFormatter
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localizer, ObjectModel, RunConfig, StageStore, load_object
from tactile_loc.view.pictures import make_figure, save_figure

SCALES, DIRECTIONS = (0.5, 1.0, 2.0, 4.0), (1000, 4000, 16_000)
MEASURED = {"places_s": ("listing places (s)", [0.3, 1, 3, 10, 30]), "touch_s": ("one touch (s)", [0.1, 0.2, 0.4, 0.8])}


def scale_object(obj: ObjectModel, scale: float) -> ObjectModel:
    """Return the object, scaled by a factor."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{obj.name}.ply")
        trimesh.Trimesh(obj.mesh.vertices_m * scale, obj.mesh.faces, process=False).export(path)
        return load_object(path, "m")


def measure(obj: ObjectModel, directions: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Build and search one object, and return its row."""
    config = RunConfig.from_dict(
        {"sensor": arguments.sensor, "temperature": 0.03, "grid": {"name": "whole", "directions": directions}}, "growth"
    )
    with tempfile.TemporaryDirectory() as store:
        localizer, start = Localizer(config, obj, StageStore(Path(store))), time.perf_counter()
        places_s = time.perf_counter() - start
        source = make_source(obj, localizer.scene.geometry)
        seconds = []
        for number in range(arguments.touches + 1):  # the first call warms up
            (touch,), _ = source.draw_example(1, np.random.default_rng([arguments.seed, number]))
            start = time.perf_counter()
            localizer.localize(touch)
            seconds.append(time.perf_counter() - start)
        return {
            "size_mm": 1e3 * float(np.linalg.norm(obj.mesh.extents_m)), "directions": directions,
            "poses": len(localizer.places) * localizer.source.count_poses()["turns"], "places_s": places_s,
            "touch_s": float(np.median(seconds[1:])),
        }  # fmt: skip


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the times against size and directions, on logarithmic axes."""
    figure = make_figure(9, 6.5, constrained=True)
    panels = figure.subplots(2, 2, sharey="row")
    for axes, (key, (label, ticks)) in zip(panels, MEASURED.items(), strict=True):
        for name in dict.fromkeys(row["object"] for row in rows):
            own = [row for row in rows if row["object"] == name]
            by_size = [row for row in own if row["directions"] == DIRECTIONS[1]]
            by_density = [row for row in own if row["scale"] == 1.0]
            axes[0].loglog([r["size_mm"] for r in by_size], [r[key] for r in by_size], "o-", label=name)
            axes[1].loglog([r["directions"] for r in by_density], [r[key] for r in by_density], "o-", label=name)
        axes[0].set_ylabel(label)
        axes[0].set_yticks(ticks)
        axes[0].set_xlabel(f"diagonal of the object (mm), {DIRECTIONS[1]} directions")
        axes[1].set_xlabel("directions, the object as it is")
        for one in axes:
            one.grid(which="both", alpha=0.3)
            for axis in (one.xaxis, one.yaxis):
                axis.set_major_formatter("{x:g}")
                axis.set_minor_formatter(NullFormatter())
        axes[0].set_xticks([20, 50, 100, 200, 400])
        axes[1].set_xticks(DIRECTIONS)
    panels[0, 0].legend(fontsize=8)
    save_figure(path, figure)


def main() -> None:
    """Measure, print a table, and draw it if requested."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--touches", type=int, default=7)
    parser.add_argument("--seed", type=int, default=17)
    parser.add_argument("--figure", type=Path, help="PNG file of the figure")
    arguments = parser.parse_args()
    rows = []
    print("| object | diagonal, mm | directions | poses, million | places, s | one touch, ms |")
    print("|---" * 6 + "|")
    for path in arguments.objects:
        obj = load_asked(path)
        jobs = [(scale, DIRECTIONS[1]) for scale in SCALES] + [(1.0, n) for n in DIRECTIONS if n != DIRECTIONS[1]]
        for scale, directions in jobs:
            row = {"object": obj.name, "scale": scale, **measure(scale_object(obj, scale), directions, arguments)}
            rows.append(row)
            print(f"| {obj.name} | {row['size_mm']:.0f} | {directions} | {row['poses'] / 1e6:.2f} | "
                  f"{row['places_s']:.1f} | {1e3 * row['touch_s']:.0f} |", flush=True)  # fmt: skip
    if arguments.figure:
        draw(sorted(rows, key=lambda row: (row["size_mm"], row["directions"])), arguments.figure)


if __name__ == "__main__":
    main()
