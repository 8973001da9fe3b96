#!/usr/bin/env python3
"""Whether `tactile-loc touchability` predicts how often touches are certain, and right, on parts of other sources.

For each part, the prediction is that of the command with its defaults: `--touches` touches at random places, drawn by
the renderer that the localizer uses, and located. They are compared with `--found` other touches, at places and with
noise of another seed, drawn by the renderer `--drawn-by`, and located by the same localizer. Both have the noise
`--noise`. The share that ends certain, and the share within 1 mm, are in per cent. `chance` is the largest difference
that 95 % of such pairs of samples have if both shares are equal. `--out` keeps finished touches, which are not located
again.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from asked import ROOT, make_parser, name_asked, open_asked, write_head
from tactile_loc_touchability.study import PRESS_SHARE, SensorSetup, Study, StudyOptions, run_studies

from tactile_loc import Localizer, LocalWorkers, StageStore
from tactile_loc.plugin import Progress

MESHES = ROOT.parent / "shared" / "data" / "meshes"
PARTS = (
    *(
        f"automate/{name}.obj:m"
        for name in (
            "00014_plug",
            "00062_plug",
            "00103_plug",
            "00308_plug",
            "00345_plug",
            "00437_plug",
            "00652_plug",
            "00703_plug",
            "00731_socket",
        )
    ),
    *(f"o2ac/{name}.stl:mm" for name in ("05_MBRFA30-2-P6", "15_SLBNR6", "18_SCB3-10")),
)
SHARES = ("certain", "right")
NORMAL = 1.96  # standard deviations that hold 95 % of a normal distribution


def study(localizer: Localizer, options: StudyOptions, out: Path) -> Study:
    """Return the study of a localizer's object, in one process."""
    workers = LocalWorkers(1, 1, out / "workers.log")
    press_m = PRESS_SHARE * localizer.scene.geometry.max_depth_m
    return run_studies([SensorSetup(localizer, press_m)], options, out, workers, Progress())[0]


def measure(mesh: str, arguments: argparse.Namespace, out: Path) -> list[float]:
    """Return the predicted and found shares of a part and their chance, and the predicted share without feature, %."""
    localizer = open_asked(mesh, sensor=arguments.sensor, store=StageStore(out / "store"))
    asked = StudyOptions(arguments.touches, 0, noise=arguments.noise)
    predicted = study(localizer, asked, out)
    drawn = replace(asked, touches=arguments.found, renderer=arguments.drawn_by, seed=1)
    of, real = predicted.list_shares()[0], study(localizer, drawn, out).list_shares()[0]
    values = []
    for name in SHARES:
        p = (of[name] * of["sets"] + real[name] * real["sets"]) / (of["sets"] + real["sets"])
        chance = NORMAL * np.sqrt(p * (1 - p) * (1 / of["sets"] + 1 / real["sets"]))
        values += [100 * of[name], 100 * real[name], 100 * chance]
    return [*values, 100 * of["nothing"]]


def main() -> None:
    """Measure all parts, and print a table."""
    parser = make_parser(__doc__, [str(MESHES / part) for part in PARTS])
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--noise", default="mild", choices=("none", "mild", "strong"))
    parser.add_argument("--touches", type=int, default=400)
    parser.add_argument("--found", type=int, default=200)
    parser.add_argument("--drawn-by", default="raycast")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "touchability", help="folder of finished touches")
    arguments = parser.parse_args()
    heads = [f"{name}: {what}" for name in ("certain", "within 1 mm") for what in ("predicted", "found", "chance")]
    print(write_head("part", *heads, "no feature"))
    rows = []
    for mesh in arguments.objects:
        rows.append(measure(mesh, arguments, arguments.out))
        print(f"| {name_asked(mesh)} | {' | '.join(f'{value:.1f}' for value in rows[-1])} |", flush=True)
    table = np.array(rows)
    off = np.abs(table[:, [0, 3]] - table[:, [1, 4]])
    print(f"\n{write_head('share', 'mean difference', 'largest', 'parts within 5 points', 'parts within chance')}")
    for k, name in enumerate(("certain", "within 1 mm")):
        within = (off[:, k] <= 5).sum(), (off[:, k] <= table[:, 3 * k + 2]).sum()
        print(
            f"| {name} | {off[:, k].mean():.1f} | {off[:, k].max():.1f} | {within[0]} of {len(off)} "
            f"| {within[1]} of {len(off)} |"
        )


if __name__ == "__main__":
    main()
