#!/usr/bin/env python3
"""Errors of locating objects from touches that do not follow the localizer's model.

All touches are drawn by ray casting, pressed by 30 to 90 % of the sensor's deepest press, and located with the original
mesh. They are drawn from four sources. The first is the same mesh. The second is a mesh with smooth errors along its
normals, as in a scan (0.05 or 0.1 mm root mean square, with a correlation length of 2 mm). The third is a mesh
decimated to 0.1 mm. The fourth is the same mesh with noise to which nothing was fitted (`UnseenNoise`). Each case has
one touch on the known face (`face`, 3 mm), and three touches from any direction with a search of the whole object, as
in `contacts.py`. The table has the median pose error, the share within 1 mm, and the share with any hypothesis within
1 mm. Meshes are given as FILE[:UNITS] or a demo object's name.
"""

import argparse
import dataclasses
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_parser, make_source, open_asked
from contacts import Located, locate
from numpy.typing import NDArray
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.noise import GelPixels, TouchNoise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.simulate.contact_poses import draw_contact_poses
from tactile_loc.simulate.touch_simulation import PressNoise
from tactile_loc.slots.registry import registry
from tactile_loc.slots.renderer import Renderer
from tactile_loc.store.store import StageStore

Float64 = NDArray[np.float64]

PRESS = (0.3, 0.9)  # share of the sensor's deepest press
CORRELATION_M = 2e-3
Alter = Callable[[TriangleMesh, np.random.Generator], TriangleMesh]
EDGE = 0.4  # longest edge, in correlation lengths, of a surface that is displaced
WAVES = 256  # number of waves in the sum of a random field
HALVINGS = 12  # number of times that the search range for the number of faces is halved
SAMPLES = 4000  # number of points for comparing a decimated surface


def simulate_scan(mesh: TriangleMesh, rms_m: float, correlation_m: float, rng: np.random.Generator) -> TriangleMesh:
    """Return the surface, displaced along its normals by a smooth random field, as in a scan.

    The field is Gaussian with zero mean and covariance exp(-(distance / correlation)^2 / 2). It is a sum of waves
    (random Fourier features), scaled to a root mean square of `rms_m` metres over the surface. Edges longer than `EDGE`
    correlation lengths are split first.
    """
    fine = split_edges(_merge_vertices(mesh), EDGE * correlation_m)
    waves = rng.standard_normal((WAVES, 3)) / correlation_m
    phases = rng.uniform(0, 2 * np.pi, WAVES)
    field = np.cos(fine.vertices_m @ waves.T + phases).sum(axis=1)
    normals, areas = fine.vertex_normals, _compute_vertex_areas(fine)
    field *= rms_m / np.sqrt(np.average(field**2, weights=areas))
    return TriangleMesh(fine.vertices_m + field[:, None] * normals, fine.faces)


def split_edges(mesh: TriangleMesh, longest_m: float) -> TriangleMesh:
    """Return the same surface with no edge longer than `longest_m` metres, and without new gaps.

    A long edge is halved if it is the longest edge of every face that shares it (Rivara, 1984). This is repeated until
    no edge is too long.
    """
    vertices, faces = mesh.vertices_m, mesh.faces
    while True:
        corners = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)  # (F, 3, 2): the edges of each face
        edges, index = np.unique(np.sort(corners, axis=-1).reshape(-1, 2), axis=0, return_inverse=True)
        of_face = index.reshape(-1, 3)
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        rank = np.empty(len(edges), np.int64)
        rank[np.argsort(length, kind="stable")] = np.arange(len(edges))  # makes all lengths distinct
        side = rank[of_face].argmax(axis=1)
        longest = of_face[np.arange(len(faces)), side]
        shared = np.bincount(of_face.ravel(), minlength=len(edges)) == np.bincount(longest, minlength=len(edges))
        halved = np.flatnonzero(shared & (length > longest_m))
        if len(halved) == 0:
            return TriangleMesh(vertices, faces)
        middle = np.full(len(edges), -1)
        middle[halved] = len(vertices) + np.arange(len(halved))
        vertices = np.concatenate([vertices, vertices[edges[halved]].mean(axis=1)])
        new = middle[longest]
        turned = np.take_along_axis(faces, (side[:, None] + np.arange(3)) % 3, axis=1)  # the longest edge comes first
        a, b, c = turned[new >= 0].T
        m = new[new >= 0]
        faces = np.concatenate([faces[new < 0], np.stack([a, m, c], 1), np.stack([m, b, c], 1)])


def decimate(mesh: TriangleMesh, rms_m: float, rng: np.random.Generator) -> TriangleMesh:
    """Return the surface with the fewest faces whose RMS distance from the original is at most `rms_m` metres.

    The method is open3d's quadric error decimation.
    """
    whole = _merge_vertices(mesh)
    points = mesh.sample(SAMPLES, rng)
    few, many, best = 4, len(whole.faces), whole
    for _ in range(HALVINGS):
        if many - few < 2:
            break
        count = (few + many) // 2
        less = _simplify(whole, count)
        if len(less.faces) > 3 and _measure_rms_distance(points, less) <= rms_m:
            many, best = count, less
        else:
            few = count
    return best


def _simplify(mesh: TriangleMesh, faces: int) -> TriangleMesh:
    import open3d as o3d

    corners, triangles = (
        o3d.utility.Vector3dVector(mesh.vertices_m),
        o3d.utility.Vector3iVector(mesh.faces.astype(np.int32)),
    )
    fewer = o3d.geometry.TriangleMesh(corners, triangles).simplify_quadric_decimation(faces)
    return TriangleMesh(np.asarray(fewer.vertices, float), np.asarray(fewer.triangles, np.int64))


@dataclasses.dataclass(frozen=True)
class UnseenNoise(TouchNoise):
    """Noise to which nothing is fitted: a slow drift of the whole image's height, and drop-outs of single pixels.

    `tilt_m` is the standard deviation, over the sensing rectangle, of a random quadratic surface that is added to the
    measured depth. `dropout` is the share of pixels in contact that appear without contact. `salt` is the share of
    pixels without contact that appear in contact at a random depth.
    """

    tilt_m: float = 5e-5
    dropout: float = 0.05
    salt: float = 0.001

    def corrupt(
        self, depth_m: Float32, press_depth_m: Float64, geometry: SensorGeometry, rng: np.random.Generator
    ) -> Float32:
        """Return noisy contact depths (N, H, W) float32, metres, limited to the press depths.

        `depth_m` are the clean depths at full press.
        """
        press = np.asarray(press_depth_m, np.float32)[:, None, None]
        noisy = np.minimum(np.asarray(depth_m, np.float32), press)
        gel = GelPixels.of(geometry)
        depth = noisy[:, gel.rows, gel.columns]  # a view
        contact = depth < press
        drifted = np.clip(depth + self._draw_drift(len(depth), gel, rng), 0, np.nextafter(press, np.float32(0)))
        lots, shown = rng.random(depth.shape, np.float32), rng.random(depth.shape, np.float32)
        np.copyto(depth, np.where(lots < self.dropout, press, drifted), where=contact)
        np.copyto(depth, press * shown, where=~contact & (lots < self.salt))
        return noisy

    def _draw_drift(self, count: int, gel: GelPixels, rng: np.random.Generator) -> Float32:
        """Return random quadratic surfaces (count, H, W) of standard deviation `tilt_m` over the gel, metres."""
        x, y = (2 * (a - a.mean()) / max(np.ptp(a), 1e-12) for a in (gel.x_m, gel.y_m))
        X, Y = np.meshgrid(x, y)
        terms = np.stack([X, Y, X * Y, X * X, Y * Y]).reshape(5, -1)
        terms -= terms.mean(axis=1, keepdims=True)
        surface = rng.standard_normal((count, 5)) @ terms
        surface *= self.tilt_m / surface.std(axis=1, keepdims=True)
        return surface.reshape(count, *X.shape).astype(np.float32)


def _merge_vertices(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh with only one vertex at each place, so that no gaps open if vertices are moved."""
    vertices, index = np.unique(mesh.vertices_m.round(9), axis=0, return_inverse=True)
    faces = index.ravel()[mesh.faces]
    a, b, c = faces.T
    return TriangleMesh(vertices, faces[(a != b) & (b != c) & (c != a)])


def _compute_vertex_areas(mesh: TriangleMesh) -> Float64:
    """Return, for each vertex, a third of the area (V,) of its faces, m^2."""
    return np.bincount(mesh.faces.ravel(), np.repeat(mesh.face_areas / 3, 3), len(mesh.vertices_m))


def _measure_rms_distance(points_m: Float64, mesh: TriangleMesh) -> float:
    """Return the root mean square distance of points (P, 3) from a surface, metres."""
    import open3d as o3d

    scene: Any = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices_m.astype(np.float32), mesh.faces.astype(np.uint32))
    found = scene.compute_distance(points_m.astype(np.float32)).numpy()
    return float(np.sqrt(np.mean(found.astype(float) ** 2)))


CASES: dict[str, tuple[Alter, TouchNoise]] = {
    "same mesh": (lambda mesh, rng: mesh, TouchNoise()),
    "scanned, 0.05 mm": (lambda mesh, rng: simulate_scan(mesh, 5e-5, CORRELATION_M, rng), TouchNoise()),
    "scanned, 0.1 mm": (lambda mesh, rng: simulate_scan(mesh, 1e-4, CORRELATION_M, rng), TouchNoise()),
    "decimated, 0.1 mm": (lambda mesh, rng: decimate(mesh, 1e-4, rng), TouchNoise()),
    "unseen noise": (lambda mesh, rng: mesh, UnseenNoise()),
}


def touch_on_face(
    localizer: Localizer, altered: ObjectModel, renderer: Renderer, noise: TouchNoise, rng: np.random.Generator
) -> Touch:
    """Return a touch of the altered object at a pose that the localizer's grid covers."""
    scene = Scene(altered, localizer.scene.geometry, renderer)
    while True:
        poses, touching = scene.bring_to_contact(draw_contact_poses(localizer.sampler, localizer.scene, 1, rng))
        press_m = scene.geometry.max_depth_m * rng.uniform(*PRESS)
        pressed, (shape,) = PressNoise(noise, scene, press_m, rng).press(
            poses, localizer.sampler.options.min_contact_percent
        )
        try:
            if touching[0] and shape is not None:
                return Touch(shape, scene.geometry, T_sensor_object=pressed[0])
        except TactileLocError:
            continue  # nothing but a flat face, or no contact


def measure(localizers: dict[int, Localizer], case: str, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return two rows for one object: for a touch on the known face, and for three touches from any direction."""
    alter, noise = CASES[case]
    obj = localizers[1].object
    altered = dataclasses.replace(obj, mesh=alter(obj.mesh, np.random.default_rng(arguments.seed)))
    renderer = registry().create("renderer", "zbuffer", {})
    around = make_source(altered, localizers[3].scene.geometry, press=PRESS, noise=noise)
    rows = []
    for touches, localizer in localizers.items():
        found = []
        for number in range(arguments.examples):
            rng = np.random.default_rng([arguments.seed, number])
            if touches == 1:
                taken = [touch_on_face(localizer, altered, renderer, noise, rng)]
            else:
                taken, _ = around.draw_example(touches, rng)
            try:
                said = localize_together([(localizer, touch) for touch in taken])
                found.append(locate(localizer, taken, said))
            except TactileLocError:
                found.append(Located())
        chosen, best = np.array([(one.chosen_mm, one.nearest_mm) for one in found]).T
        rows.append({
            "object": obj.name, "case": case, "touches": touches, "examples": len(found),
            "median_mm": float(np.median(chosen)), "within_1_mm": float((chosen <= 1).mean()),
            "any_within_1_mm": float((best <= 1).mean()), "faces": len(altered.mesh.faces),
        })  # fmt: skip
    return rows


def main() -> None:
    """Measure, print a table, and write the rows as JSON if requested."""
    parser = make_parser(__doc__, read_split("pins"))
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--examples", type=int, default=20)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print("| object | drawn from | touches | median, mm | within 1 mm | any within 1 mm |\n|---|---|---|---|---|---|")
    for mesh in arguments.objects:
        with tempfile.TemporaryDirectory() as folder:
            grids = {1: {"name": "face"}, 3: {"name": "whole"}}
            localizers = {
                touches: open_asked(mesh, store=StageStore(Path(folder)), sensor=arguments.sensor, grid=grid)
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
