#!/usr/bin/env python3
"""Pixel matching compared with the learned encoder, on the same noisy touches, in one run.

For each mesh, one face has a grid of about `--poses` poses, and `--touches` simulated touches have poses between the
grid poses. The encoders have their default settings. Errors are medians of ADD over 10 000 surface points, modulo
symmetry, and in brackets as a share of a random pose's mean error. Meshes are given as FILE[:UNITS]; the default is all
demo objects. Results are kept in `--out`, so an interrupted run can be resumed. Training is timed when it happens.

With `--whole`, the whole object is searched instead, from touches of random directions: without noise, with mild noise
and with strong noise. The touches are drawn by ray casting, which the localizer does not use. The table has two shares
of touches. *near*: one of the 1000 most similar rotated places is within 3 mm of the true pose. *listed*: one of ten
hypotheses is within 1 mm. Both distances are root mean squares over the surface, modulo symmetry.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from asked import load_asked, make_parser, make_source, write_head
from single_touch import choose_spacing, summarise_errors
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.protocol import evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.reports.evaluation_figures import draw_violins
from tactile_loc.slots.registry import registry
from tactile_loc.store.store import StageStore
from tactile_loc.view.pictures import save_figure

ENCODERS = {"pixel": {"name": "pixel"}, "pixel, depth": {"name": "pixel", "signal": "depth"}, "moco": {"name": "moco"}}
WHOLE_ENCODERS: dict[str, dict[str, Any]] = {
    "pixel": {"name": "pixel", "signal": "depth", "cells": 16}, "moco": {"name": "moco"},
}  # fmt: skip
LEVELS = ("none", "mild", "strong")
NEAR_M, LISTED_M = 3e-3, 1e-3
LINES = ("best-1", "best-10", "best-50", "reg-1", "reg-10", "closest", "random")
MATCHED = 20_000  # number of keys for timing the matchers


def make_config(arguments: argparse.Namespace, encoder: dict[str, str], spacing_mm: float) -> RunConfig:
    """Return the configuration of one encoder's runs."""
    return RunConfig.from_dict({
        "sensor": arguments.sensor, "refiner": arguments.refiner, "encoder": encoder,
        "grid": {"name": "face", "spacing_mm": spacing_mm},
    })  # fmt: skip


def measure(obj: ObjectModel, arguments: argparse.Namespace) -> tuple[dict[str, Any], list[ExampleTable]]:
    """Locate one object's touches with each encoder. Return a row of the table and the runs."""
    base = {"sensor": arguments.sensor, "refiner": arguments.refiner}
    spacing_mm = choose_spacing(obj, base, arguments.poses)
    store = StageStore(arguments.out / "store")
    runs = []
    row: dict[str, Any] = {"object": obj.name, "symmetry": str(obj.symmetry), "spacing_mm": spacing_mm}
    for encoder, settings in ENCODERS.items():
        localizer = Localizer(make_config(arguments, settings, spacing_mm), obj, store)
        row["poses"] = localizer.model.size
        start = time.perf_counter()
        localizer.listed.matcher(localizer.scene.geometry.max_depth_m)
        if any(key.stage == "encoder" for key in store.built):
            row["train_s"] = time.perf_counter() - start
            _write_note(arguments.out, obj.name, row["train_s"])
        result = evaluate(localizer, arguments.touches, SimulatedTouches(arguments.noise, arguments.seed))
        runs.append(ExampleTable.make(result.columns, encoder=encoder))
        row[encoder] = summarise_errors(result, LINES)
    row.setdefault("train_s", _read_notes(arguments.out).get(obj.name))
    return row, runs


def _read_notes(out: Path) -> dict[str, float]:
    path = out / "training.json"
    return json.loads(path.read_text()) if path.exists() else {}


def _write_note(out: Path, name: str, seconds: float) -> None:
    """Write the duration of a training, for a run that resumes this run."""
    (out / "training.json").write_text(json.dumps({**_read_notes(out), name: seconds}) + "\n")


def report(row: dict[str, Any]) -> str:
    """Return one object's rows of the Markdown table."""
    trained = f"{row['train_s']:.0f}" if row["train_s"] else "?"
    lines = []
    for encoder in ENCODERS:
        cells = [
            f"{row[encoder]['median_mm'][k]:.2f} ({row[encoder]['median_normalised'][k]:.3f})"
            for k in LINES
            if k != "random"
        ]
        random = f"{row[encoder]['mean_mm']['random']:.1f}"
        lines.append(
            f"| {row['object']} | {row['poses']} | {encoder} | {' | '.join(cells)} | {random} | "
            f"{trained if encoder == 'moco' else ''} |"
        )
    return "\n".join(lines)


def summarise(rows: list[dict[str, Any]]) -> str:
    """Return a comparison of the learned encoder with pixels over all objects."""
    ratios = np.array([r["moco"]["median_mm"]["best-1"] / r["pixel"]["median_mm"]["best-1"] for r in rows])
    listed = {r["object"]: r["moco"]["median_mm"]["best-10"] / r["moco"]["median_mm"]["closest"] for r in rows}
    worst = max(listed, key=lambda name: listed[name])
    return (
        f"best-1, moco / pixel: below 1 on {int((ratios < 1).sum())} of {len(rows)}, geometric mean "
        f"{np.exp(np.log(ratios).mean()):.3f}, from {ratios.min():.2f} to {ratios.max():.2f}\n"
        f"best-10 of moco / closest: at most {listed[worst]:.2f} ({worst})"
    )


def time_matching(floats: int) -> dict[str, float]:
    """Return each matcher's median time, ms, for scoring `MATCHED` keys of `floats` numbers for one touch."""
    rng = np.random.default_rng(0)
    bank = rng.standard_normal((MATCHED, floats), dtype=np.float32)
    found = {}
    for name in ("dense", "faiss"):
        matcher = registry().create("matcher", name, {})
        matcher.index(bank)
        seconds = []
        for _ in range(50):
            start = time.perf_counter()
            matcher.scores(bank[:1])
            seconds.append(time.perf_counter() - start)
        found[name] = float(np.median(seconds)) * 1e3
    return found


def search_whole(obj: ObjectModel, arguments: argparse.Namespace, name: str) -> dict[str, Any]:
    """Search the whole object with one encoder. Return the shares "near" and "listed" for each level of noise."""
    changed = json.loads(arguments.moco) if name == "moco" else {}
    settings = {
        "sensor": arguments.sensor, "encoder": {**WHOLE_ENCODERS[name], **changed},
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
        for name in WHOLE_ENCODERS:
            row = search_whole(load_asked(mesh), arguments, name)
            cells = [f"{row[level][what]:.0%}" for level in LEVELS for what in ("near", "listed")]
            seconds = "" if row["train_s"] is None else f"{row['train_s']:.0f}"
            print(f"| {row['object']} | {row['places']} | {name} | {' | '.join(cells)} | {seconds} |", flush=True)
            rows.append(row)
    (arguments.out / "results.json").write_text(json.dumps({"rows": rows}, indent=1) + "\n")


def main() -> None:
    """Run the benchmark, print its table, and write results.json and violins.png."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--poses", type=int, default=10_000, help="approximate poses of a grid")
    parser.add_argument("--touches", type=int, default=150)
    parser.add_argument("--noise", default="strong")
    parser.add_argument("--sensor", default="gelslim")
    parser.add_argument("--refiner", default="icp")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--whole", action="store_true", help="search whole objects instead of one face")
    parser.add_argument("--directions", type=int, default=4000, help="directions of the whole grid")
    parser.add_argument("--moco", default="{}", help="options of moco for whole objects, as JSON")
    parser.add_argument("--out", type=Path, default=Path("out/encoders"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.whole:
        compare_whole(arguments)
        return
    rows, runs = [], []
    shown = [name for name in LINES if name != "random"]
    print(write_head("object", "poses", "encoder", *shown, "random, mean", "training, s"), flush=True)
    for mesh in arguments.objects:
        row, measured = measure(load_asked(mesh), arguments)
        rows.append(row)
        runs += measured
        print(report(row), flush=True)
    matching = time_matching(256)
    record = {"settings": {k: str(v) for k, v in vars(arguments).items()}, "rows": rows, "matching_ms": matching}
    (arguments.out / "results.json").write_text(json.dumps(record, indent=1) + "\n")
    heading = f"{arguments.touches} simulated touches for each object (noise: {arguments.noise})"
    save_figure(arguments.out / "violins.png", draw_violins(ExampleTable.join(runs), heading))
    encode = np.median([r["moco"]["median_ms"]["encode"] for r in rows])
    print(summarise(rows))
    print(f"encoding one touch with moco: {encode:.1f} ms")
    print(f"scoring {MATCHED} keys of 256 floats: {', '.join(f'{k} {v:.2f} ms' for k, v in matching.items())}")


if __name__ == "__main__":
    main()
