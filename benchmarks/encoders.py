#!/usr/bin/env python3
"""Whole objects searched with pixels and with the learned encoder, from touches of random directions.

Touches are without noise, with mild noise and with strong noise. They are drawn by ray casting, which the localizer
does not use. The table has two shares of touches. *near*: one of the 1000 most similar rotated places is within 3 mm of
the true pose. *listed*: one of ten hypotheses is within 1 mm. Both distances are root mean squares over the surface,
modulo symmetry. Meshes are given as FILE[:UNITS]; the default is all demo objects. Results are kept in `--out`, so an
interrupted run can be resumed. Training is timed when it happens. `tactile-loc paper` compares encoders on one face.
"""

import argparse
import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from asked import load_asked, make_parser, make_source, write_head
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localizer, ObjectModel, RunConfig, StageStore
from tactile_loc.core.sensing.noise import NOISE

ENCODERS: dict[str, dict[str, Any]] = {
    "pixel": {"name": "pixel", "signal": "depth", "cells": 16}, "moco": {"name": "moco"},
}  # fmt: skip
LEVELS = ("none", "mild", "strong")
NEAR_M, LISTED_M = 3e-3, 1e-3


def _read_notes(out: Path) -> dict[str, float]:
    path = out / "training.json"
    return json.loads(path.read_text()) if path.exists() else {}


def _write_note(out: Path, name: str, seconds: float) -> None:
    """Write the duration of a training, for a run that resumes this run."""
    (out / "training.json").write_text(json.dumps({**_read_notes(out), name: seconds}) + "\n")


def search_whole(obj: ObjectModel, arguments: argparse.Namespace, name: str) -> dict[str, Any]:
    """Search the whole object with one encoder. Return the shares "near" and "listed" for each level of noise."""
    changed = json.loads(arguments.moco) if name == "moco" else {}
    settings = {
        "sensor": arguments.sensor, "encoder": {**ENCODERS[name], **changed},
        "grid": {"name": "whole", "directions": arguments.directions}, "temperature": 0.02,  # keeps the order
    }  # fmt: skip
    localizer = Localizer(RunConfig.from_dict(settings), obj, StageStore(arguments.out / "store"))
    search = localizer.source.place_search
    start = time.perf_counter()
    _ = localizer.source.trained
    if any(key.stage == "encoder" for key in localizer.store.built):
        _write_note(arguments.out, obj.name, time.perf_counter() - start)
    row: dict[str, Any] = {"object": obj.name, "places": len(search.places), "encoder": name}
    row["train_s"] = _read_notes(arguments.out).get(obj.name) if name == "moco" else None
    for level in LEVELS:
        noise = dataclasses.replace(NOISE[level], press_share=(1.0, 1.0))
        source = make_source(obj, localizer.scene.geometry, noise=noise)
        near: list[bool] = []
        listed: list[bool] = []
        for number in range(arguments.touches):
            (touch,), _ = source.draw_example(1, np.random.default_rng([arguments.seed, number]))
            found = np.stack([h.T_sensor_object for h in localizer.localize(touch).hypotheses])
            alike, _ = search.alike(touch, localizer.config.search.candidates)
            for within_m, poses, said in ((NEAR_M, alike, near), (LISTED_M, found, listed)):
                truth = np.broadcast_to(np.asarray(touch.T_sensor_object), poses.shape)
                said.append(bool((search.metric.symmetric_distance(poses, truth) < within_m).any()))
        row[level] = {"near": float(np.mean(near)), "listed": float(np.mean(listed))}
    return row


def compare_whole(arguments: argparse.Namespace) -> None:
    """Print a table of whole objects searched with each encoder, and write results.json."""
    names = ["object", "places", "encoder", *(f"{what}, {level}" for level in LEVELS for what in ("near", "listed"))]
    print(write_head(*names, "training, s"), flush=True)
    rows = []
    for mesh in arguments.objects:
        for name in ENCODERS:
            row = search_whole(load_asked(mesh), arguments, name)
            cells = [f"{row[level][what]:.0%}" for level in LEVELS for what in ("near", "listed")]
            seconds = "" if row["train_s"] is None else f"{row['train_s']:.0f}"
            print(f"| {row['object']} | {row['places']} | {name} | {' | '.join(cells)} | {seconds} |", flush=True)
            rows.append(row)
    (arguments.out / "results.json").write_text(json.dumps({"rows": rows}, indent=1) + "\n")


def main() -> None:
    """Run the benchmark, print its table, and write results.json."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--touches", type=int, default=150)
    parser.add_argument("--sensor", default="gelslim")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--directions", type=int, default=4000, help="directions of the whole grid")
    parser.add_argument("--moco", default="{}", help="options of moco, as JSON")
    parser.add_argument("--out", type=Path, default=Path("out/encoders"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    compare_whole(arguments)


if __name__ == "__main__":
    main()
