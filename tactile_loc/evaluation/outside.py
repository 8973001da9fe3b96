"""What a robot meets and a model does not know: parts that are not quite their mesh, and noise of another kind.

A scan is off by smooth errors along its normals, and a mesh for simulation has lost its small faces. `UnseenNoise` has
nothing of what `tactile_loc.core.simulation.touch_simulation.noise` draws and encoders and probabilities are fitted to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.simulation.noise import Float32, Gel, TouchNoise
from tactile_loc.io.meshes import simplify_mesh

Float64 = NDArray[np.float64]

EDGE = 0.4  # of the correlation length: longer edges are split before the surface is displaced
WAVES = 256  # that a random field is the sum of
HALVINGS = 12  # of the range in which the number of faces is looked for
SAMPLES = 4000  # points at which a decimated surface is compared


def scanned(mesh: TriangleMesh, rms_m: float, correlation_m: float, rng: np.random.Generator) -> TriangleMesh:
    """Return the surface displaced along its normals by a smooth random field, as a scan is; metres.

    The field is Gaussian with zero mean and covariance exp(-(distance / correlation)^2 / 2), drawn as a sum of waves
    (random Fourier features), and scaled so that its root mean square over the surface is `rms_m`. Edges longer than
    EDGE of the correlation length are split first.
    """
    fine = split_edges(_merged(mesh), EDGE * correlation_m)
    waves = rng.standard_normal((WAVES, 3)) / correlation_m
    phases = rng.uniform(0, 2 * np.pi, WAVES)
    field = np.cos(fine.vertices_m @ waves.T + phases).sum(axis=1)
    normals, areas = _vertex_normals(fine)
    field *= rms_m / np.sqrt(np.average(field**2, weights=areas))
    return TriangleMesh(fine.vertices_m + field[:, None] * normals, fine.faces)


def split_edges(mesh: TriangleMesh, longest_m: float) -> TriangleMesh:
    """Return the same surface with no edge longer than `longest_m` metres, and no gap where there was none.

    An edge is halved when it is the longest of all faces that share it (Rivara, 1984), until all are short.
    """
    vertices, faces = mesh.vertices_m, mesh.faces
    while True:
        corners = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)  # (F, 3, 2): the edges of each face
        edges, index = np.unique(np.sort(corners, axis=-1).reshape(-1, 2), axis=0, return_inverse=True)
        of_face = index.reshape(-1, 3)
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        rank = np.empty(len(edges), np.int64)
        rank[np.argsort(length, kind="stable")] = np.arange(len(edges))  # no two are equally long
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


def decimated(mesh: TriangleMesh, rms_m: float, rng: np.random.Generator) -> TriangleMesh:
    """Return the surface with as few faces as keep it within `rms_m` metres of its own, root mean square.

    By quadric error metrics, those of open3d.
    """
    whole = _merged(mesh)
    points = mesh.sample(SAMPLES, rng)
    few, many, best = 4, len(whole.faces), whole
    for _ in range(HALVINGS):
        if many - few < 2:
            break
        count = (few + many) // 2
        less = simplify_mesh(whole, count)
        if len(less.faces) > 3 and _rms_distance(points, less) <= rms_m:
            many, best = count, less
        else:
            few = count
    return best


@dataclass(frozen=True)
class UnseenNoise(TouchNoise):
    """Noise that nothing here is fitted to: the height of the whole image drifts slowly, and single pixels drop out.

    `tilt_m` is the standard deviation, over the sensing rectangle, of a random quadratic surface that is added to the
    measured depth; `dropout` the share of pixels in contact that show none, `salt` the share of the others that show
    contact of a random depth.
    """

    tilt_m: float = 5e-5
    dropout: float = 0.05
    salt: float = 0.001

    def corrupt(
        self, depth_m: Float32, press_depth_m: Float64, geometry: SensorGeometry, rng: np.random.Generator
    ) -> Float32:
        """Return noisy contact depths (N, H, W) float32, metres, of clean ones at full press, cut at press depths."""
        press = np.asarray(press_depth_m, np.float32)[:, None, None]
        noisy = np.minimum(np.asarray(depth_m, np.float32), press)
        gel = Gel.of(geometry)
        depth = noisy[:, gel.rows, gel.columns]  # a view
        contact = depth < press
        drifted = np.clip(depth + self._drift(len(depth), gel, rng), 0, np.nextafter(press, np.float32(0)))
        lots, shown = rng.random(depth.shape, np.float32), rng.random(depth.shape, np.float32)
        np.copyto(depth, np.where(lots < self.dropout, press, drifted), where=contact)
        np.copyto(depth, press * shown, where=~contact & (lots < self.salt))
        return noisy

    def _drift(self, count: int, gel: Gel, rng: np.random.Generator) -> Float32:
        """Random quadratic surfaces (count, H, W) of standard deviation `tilt_m` over the gel, metres."""
        x, y = (2 * (a - a.mean()) / max(np.ptp(a), 1e-12) for a in (gel.x_m, gel.y_m))
        X, Y = np.meshgrid(x, y)
        terms = np.stack([X, Y, X * Y, X * X, Y * Y]).reshape(5, -1)
        terms -= terms.mean(axis=1, keepdims=True)
        surface = rng.standard_normal((count, 5)) @ terms
        surface *= self.tilt_m / surface.std(axis=1, keepdims=True)
        return surface.reshape(count, *X.shape).astype(np.float32)


def _merged(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with one vertex at each place: a surface that is moved at its vertices must not come apart."""
    vertices, index = np.unique(mesh.vertices_m.round(9), axis=0, return_inverse=True)
    faces = index.ravel()[mesh.faces]
    a, b, c = faces.T
    return TriangleMesh(vertices, faces[(a != b) & (b != c) & (c != a)])


def _vertex_normals(mesh: TriangleMesh) -> tuple[Float64, Float64]:
    """Unit normals (V, 3), weighted by area, and a third of the area (V,) of the faces about each vertex."""
    a, b, c = np.moveaxis(mesh.triangles_m, 1, 0)
    across = 0.5 * np.cross(b - a, c - a)
    normals, areas = np.zeros_like(mesh.vertices_m), np.zeros(len(mesh.vertices_m))
    for corner in mesh.faces.T:
        np.add.at(normals, corner, across)
        np.add.at(areas, corner, np.linalg.norm(across, axis=1) / 3)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30), areas


def _rms_distance(points_m: Float64, mesh: TriangleMesh) -> float:
    """Root mean square distance of points (P, 3) from a surface, metres."""
    import open3d as o3d

    scene: Any = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices_m.astype(np.float32), mesh.faces.astype(np.uint32))
    found = scene.compute_distance(points_m.astype(np.float32)).numpy()
    return float(np.sqrt(np.mean(found.astype(float) ** 2)))
