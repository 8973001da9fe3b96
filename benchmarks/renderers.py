"""The speed and the agreement of the built-in renderers on contact poses, in one run.

    python benchmarks/renderers.py [--meshes FILE ...] [--poses 720] [--rotations 12] [--json FILE]

Every renderer draws the same contact poses: as in a pose grid, each of a few rotations has many in-plane translations.
Only the render call is timed, after a warm-up for compiling, building and uploading. The renderers take turns, and the
median of the rounds counts. All renderers are compared with ray casting, over all poses.
"""

import argparse
import json
import os
import platform
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from asked import write_head

from tactile_loc import DEMO_OBJECTS, SensorGeometry, TriangleMesh, load_object
from tactile_loc.plugin import Float32, Poses, Renderer, RenderError
from tactile_loc.plugin.helpers import bring_to_contact, draw_rotations, make_transform
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.plugins.renderers.pyrender.renderer import PyrenderRenderer
from tactile_loc.plugins.renderers.raycast import RaycastRenderer

CAMERAS = {
    "GelSlim": SensorGeometry("pinhole", 470, 470, 291.5, 289.0, 235.0, 235.0, 0.025, 0.002).resize(200, 200),
    "orthographic": SensorGeometry("orthographic", 200, 200, 5000.0, 5000.0, 100.0, 100.0, 0.025, 0.002),
}
OBJECTS = ("pin", "damping_pin", "head", "elbow_pipe")
SPREAD_M = 0.024


@dataclass(frozen=True)
class Row:
    """One renderer on one mesh and camera, compared with ray casting.

    `mask_agreement` is the share of pixels for which both agree about contact. `contact_iou` is the intersection over
    union of the contacts. `depth_difference_um` is the median difference, in micrometres, where both have contact.
    """

    camera: str
    mesh: str
    faces: int
    poses: int
    rotations: int
    renderer: str
    poses_per_s: float
    ratio_to_pyrender: float
    mask_agreement: float
    contact_iou: float
    depth_difference_um: float


def draw_poses(mesh: TriangleMesh, g: SensorGeometry, count: int, rotations: int, seed: int) -> Poses:
    """Return contact poses (N, 4, 4), at most `count`: random rotations on a square raster 24 mm wide."""
    R = draw_rotations(rotations, np.random.default_rng(seed))
    side = int(np.ceil(np.sqrt(count / rotations)))
    raster = np.linspace(-SPREAD_M / 2, SPREAD_M / 2, side)
    x, y = (a.ravel()[: count // rotations] for a in np.meshgrid(raster, raster))
    offset = np.stack([x, y, np.zeros_like(x)], axis=-1)
    T = make_transform(R[:, None], offset - (R @ mesh.centroid_m)[:, None]).reshape(-1, 4, 4)
    T, touching = bring_to_contact(mesh, T, g)
    return T[touching]


def list_available(mesh: TriangleMesh, T: Poses, g: SensorGeometry) -> dict[str, Renderer]:
    """Return the available renderers, warmed up on the mesh and the camera."""
    found: dict[str, Renderer] = {}
    for name, kind in (("raycast", RaycastRenderer), ("pyrender", PyrenderRenderer), ("heightmap", HeightmapRenderer)):
        renderer = kind()
        try:
            renderer.render(mesh, T[:2], g)
        except RenderError as error:
            print(f"{name} is skipped: {error}")
            continue
        found[name] = renderer
    return found


def measure(name: str, camera: str, mesh: TriangleMesh, T: Poses, rounds: int) -> list[Row]:
    """Time all renderers in turns on the same poses, and compare their depths with those of ray casting."""
    g = CAMERAS[camera]
    renderers = list_available(mesh, T, g)
    seconds: dict[str, list[float]] = {r: [] for r in renderers}
    pictures: dict[str, Float32] = {}
    for k in range(rounds):
        order = list(renderers)
        for r in order[k % len(order) :] + order[: k % len(order)]:
            start = time.perf_counter()
            pictures[r] = renderers[r].render(mesh, T, g)
            seconds[r].append(time.perf_counter() - start)
    speed = {r: len(T) / float(np.median(s)) for r, s in seconds.items()}
    reference = speed.get("pyrender", float("nan"))
    rotations = len(np.unique(T[:, :3, :3].reshape(len(T), 9), axis=0))
    return [
        Row(camera, name, len(mesh.faces), len(T), rotations, r, speed[r], speed[r] / reference,
            *measure_agreement(pictures[r], pictures["raycast"], g))
        for r in renderers
    ]  # fmt: skip


def measure_agreement(depth: Float32, reference: Float32, g: SensorGeometry) -> tuple[float, float, float]:
    """Return `mask_agreement`, `contact_iou` and `depth_difference_um` as defined in Row."""
    limit = np.float32(g.standoff_m + g.max_depth_m)
    touch, expected = depth < limit, reference < limit
    both = touch & expected
    difference_m = np.median(np.abs(depth[both] - reference[both]))
    return float((touch == expected).mean()), float(both.sum() / (touch | expected).sum()), float(difference_m) * 1e6


def show(rows: Sequence[Row]) -> None:
    """Print the rows as a table."""
    print("Contact poses at 200 x 200 px (medians; agreement with raycast)\n")
    names = ["camera", "mesh", "faces", "poses/rot.", "renderer"]
    names += ["poses/s", "x pyrender", "same contact %", "IoU %", "depth diff. um"]
    print(write_head(*names))
    for r in rows:
        speed = (f"{r.poses_per_s:.0f}", f"{r.ratio_to_pyrender:.1f}")
        match = (f"{100 * r.mask_agreement:.3f}", f"{100 * r.contact_iou:.2f}", f"{r.depth_difference_um:.3f}")
        what = (r.camera, r.mesh, str(r.faces), f"{r.poses}/{r.rotations}", r.renderer)
        print(f"| {' | '.join([*what, *speed, *match])} |")


def main() -> None:
    """Parse the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description="Speed and agreement of the built-in renderers.")
    parser.add_argument("--meshes", nargs="+", type=Path, default=[DEMO_OBJECTS[name].path for name in OBJECTS])
    parser.add_argument("--poses", type=int, default=720, help="poses for each mesh and camera")
    parser.add_argument("--rotations", type=int, default=12, help="distinct rotations of these poses")
    parser.add_argument("--rounds", type=int, default=3, help="rounds of drawing with each renderer")
    parser.add_argument("--seed", type=int, default=0, help="seed of the rotations")
    parser.add_argument("--json", type=Path, help="file for the results")
    args = parser.parse_args()
    rows: list[Row] = []
    for path in args.meshes:
        mesh = load_object(path, symmetry="none").mesh
        for camera, g in CAMERAS.items():
            T = draw_poses(mesh, g, args.poses, args.rotations, args.seed)
            rows += measure(path.stem, camera, mesh, T, args.rounds)
    show(sorted(rows, key=lambda r: (r.camera, r.mesh)))
    if args.json:
        machine = {"cpu_count": os.cpu_count(), "machine": platform.machine(), "python": platform.python_version()}
        args.json.write_text(json.dumps({"machine": machine, "rows": [asdict(r) for r in rows]}, indent=2) + "\n")


if __name__ == "__main__":
    main()
