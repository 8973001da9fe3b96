#!/usr/bin/env python3
"""How well objects are located from touches that are drawn outside the model that locates them.

All touches are drawn by ray casting, pressed by 30 to 90 % of the sensor's deepest press, and located with the mesh as
it is: from the same mesh; from one with smooth errors along its normals, as a scan has (0.05 and 0.1 mm root mean
square, over some 2 mm); from one decimated to 0.1 mm; and from the same with noise that nothing was fitted to
(`UnseenNoise`). For each: one touch on the known face (`face`, 3 mm) and three touches from any direction, the whole
object searched, as in `contacts.py`. The median error (root mean square over the surface, symmetry regarded), the share
within 1 mm, and how often any hypothesis was within 1 mm. Meshes are given as FILE[:UNITS] or a demo object's name.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from contacts import Located, located

from tactile_loc.core.errors import TactileLocError
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.simulation.contact_poses import random_contact_poses
from tactile_loc.core.simulation.noise import TouchNoise
from tactile_loc.core.simulation.touch_simulation import PressNoise
from tactile_loc.core.slots.registry import registry
from tactile_loc.core.slots.renderer import Renderer
from tactile_loc.core.slots.scene import Scene
from tactile_loc.evaluation.outside import UnseenNoise, decimated, scanned
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.store.store import StageStore

PRESS = (0.3, 0.9)  # of the sensor's deepest
CORRELATION_M = 2e-3
Alter = Callable[[TriangleMesh, np.random.Generator], TriangleMesh]
CASES: dict[str, tuple[Alter, TouchNoise]] = {
    "same mesh": (lambda mesh, rng: mesh, TouchNoise()),
    "scanned, 0.05 mm": (lambda mesh, rng: scanned(mesh, 5e-5, CORRELATION_M, rng), TouchNoise()),
    "scanned, 0.1 mm": (lambda mesh, rng: scanned(mesh, 1e-4, CORRELATION_M, rng), TouchNoise()),
    "decimated, 0.1 mm": (lambda mesh, rng: decimated(mesh, 1e-4, rng), TouchNoise()),
    "unseen noise": (lambda mesh, rng: mesh, UnseenNoise()),
}


def touch_on_face(
    localizer: Localizer, altered: ObjectModel, renderer: Renderer, noise: TouchNoise, rng: np.random.Generator
) -> Touch:
    """A touch of the altered object at a pose that the localizer's grid covers."""
    scene = Scene(altered, localizer.scene.geometry, renderer)
    while True:
        poses, touching = scene.in_contact(random_contact_poses(localizer.sampler, localizer.scene, 1, rng))
        press_m = scene.geometry.max_depth_m * rng.uniform(*PRESS)
        pressed, (shape,) = PressNoise(noise, scene, press_m, rng).pressed(
            poses, localizer.sampler.options.min_contact_percent
        )
        try:
            if touching[0] and shape is not None:
                return Touch(shape, scene.geometry, T_sensor_object=pressed[0])
        except TactileLocError:
            continue  # nothing but a flat face, or no contact


def measure(localizers: dict[int, Localizer], case: str, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for one touch on the known face and one for three from anywhere, of one object."""
    alter, noise = CASES[case]
    obj = localizers[1].object
    altered = dataclasses.replace(obj, mesh=alter(obj.mesh, np.random.default_rng(arguments.seed)))
    raycast = registry().create("renderer", "raycast", {})
    around = RobotTouches(altered, localizers[3].scene.geometry, raycast, PRESS, noise=noise)
    rows = []
    for touches, localizer in localizers.items():
        found = []
        for number in range(arguments.examples):
            rng = np.random.default_rng([arguments.seed, number])
            if touches == 1:
                taken = [touch_on_face(localizer, altered, raycast, noise, rng)]
            else:
                taken, _ = around.example(touches, rng)
            try:
                said = localize_together([(localizer, touch) for touch in taken])
                found.append(located(localizer, taken, said))
            except TactileLocError:
                found.append(Located())
        chosen, best = np.array([(one.chosen_mm, one.nearest_mm) for one in found]).T
        rows.append({
            "object": obj.name, "case": case, "touches": touches, "examples": len(found),
            "median_mm": float(np.median(chosen)), "within_1_mm": float((chosen < 1).mean()),
            "any_within_1_mm": float((best < 1).mean()), "faces": len(altered.mesh.faces),
        })  # fmt: skip
    return rows


def main() -> None:
    """Measure, print a table, and write the rows as JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", default=["pin", "damping_pin", "cotter"])
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--examples", type=int, default=20)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print("| object | drawn from | touches | median, mm | within 1 mm | any within 1 mm |\n|---|---|---|---|---|---|")
    for mesh in arguments.meshes:
        path, _, units = mesh.partition(":")
        with tempfile.TemporaryDirectory() as folder:
            grids = {1: {"name": "face"}, 3: {"name": "whole"}}
            localizers = {
                touches: Localizer.create(
                    path, units=units or "auto", store=StageStore(Path(folder)), sensor=arguments.sensor, grid=grid
                )
                for touches, grid in grids.items()
            }
            for case in arguments.cases:
                for row in measure(localizers, case, arguments):
                    rows.append(row)
                    print(
                        f"| {row['object']} | {case} | {row['touches']} | {row['median_mm']:.2f} | "
                        f"{row['within_1_mm']:.0%} | {row['any_within_1_mm']:.0%} |",
                        flush=True,
                    )
                    if arguments.out:
                        arguments.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
