"""Where on the object the sensor may be: a distribution over poses as one over the object's surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry import invert, transform_points
from tactile_loc.core.objects import TriangleMesh
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry

PATCHES = 1500  # edges are split until so many squares of their length cover the surface
MOST_SPLITS = 40
REACH = 3.0  # standard deviations to which a pose's probability is spread


@dataclass(frozen=True, eq=False)
class SurfaceDistribution:
    """Probability over a surface: `mass` (V,) of each vertex, which sums to one, and `area_m2` (V,) that it stands for.

    `spread_m` is the standard deviation by which each pose's probability is spread along the surface, metres.
    """

    mesh: TriangleMesh
    mass: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    spread_m: float

    @property
    def density(self) -> NDArray[np.float64]:
        """Probability per area (V,), 1/m^2."""
        return self.mass / np.maximum(self.area_m2, 1e-15)


def touched_points(mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> NDArray[np.int64]:
    """Return the vertex (N,) that is nearest to the sensor's centre at each pose (N, 4, 4), metres."""
    from scipy.spatial import cKDTree

    centres_m = transform_points(invert(T_sensor_object), sensor_centre(geometry)[None])[:, 0]
    return np.asarray(cKDTree(mesh.vertices_m).query(centres_m)[1], np.int64)


def sensor_centre(geometry: SensorGeometry) -> NDArray[np.float64]:
    """Return the centre (3,) of the sensing rectangle on the undeformed gel, metres of the sensor frame."""
    x0, x1, y0, y1 = geometry.rectangle
    return np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), geometry.standoff_m])


def surface_distribution(
    mesh: TriangleMesh, T_sensor_object: Poses, weights: NDArray[np.float64], geometry: SensorGeometry, spread_m: float
) -> SurfaceDistribution:
    """Return where on the surface the sensor's centre touches, given poses (N, 4, 4) and their weights (N,), sum one.

    A pose counts where the surface is nearest to the sensor's centre. Its weight is spread over the vertices around, by
    area and by a Gaussian of `spread_m` metres, but not to the back of a wall.
    """
    fine = refined(mesh, edge_m(mesh))
    mass = np.bincount(touched_points(fine, T_sensor_object, geometry), weights, len(fine.vertices_m)).astype(float)
    area = vertex_areas(fine)
    return SurfaceDistribution(fine, _spread(fine, mass, area, spread_m), area, spread_m)


def _spread(
    mesh: TriangleMesh, mass: NDArray[np.float64], area_m2: NDArray[np.float64], spread_m: float
) -> NDArray[np.float64]:
    """Spread masses (V,) to the vertices around; what it sums to stays the same."""
    from scipy.spatial import cKDTree

    tree, normals = cKDTree(mesh.vertices_m), vertex_normals(mesh)
    found = np.zeros(len(mass))
    for source in np.flatnonzero(mass):
        near = np.array(tree.query_ball_point(mesh.vertices_m[source], REACH * spread_m), np.int64)
        apart = np.linalg.norm(mesh.vertices_m[near] - mesh.vertices_m[source], axis=1) / spread_m
        share = np.exp(-0.5 * apart**2) * area_m2[near] * np.maximum(normals[near] @ normals[source], 0.0)
        if share.sum() <= 0:
            near, share = np.array([source]), np.ones(1)
        found[near] += mass[source] * share / share.sum()
    return found


def edge_m(mesh: TriangleMesh) -> float:
    """Return how long an edge may be, metres, for a smooth picture of this surface."""
    return float(np.sqrt(mesh.face_areas.sum() / PATCHES))


def refined(mesh: TriangleMesh, longest_m: float) -> TriangleMesh:
    """Return the same surface with no edge longer than `longest_m` metres: longest edges are halved until none is."""
    vertices, faces = mesh.vertices_m, mesh.faces
    for _ in range(MOST_SPLITS):
        split = _split_longest(vertices, faces, longest_m)
        if split is None:
            break
        vertices, faces = split
    places, same = np.unique(vertices, axis=0, return_inverse=True)  # neighbours halved their edge one after the other
    return TriangleMesh(places, same.ravel()[faces])


def _split_longest(
    vertices_m: NDArray[np.float64], faces: NDArray[np.int64], longest_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Halve the longest edge of every face that is too long; None when there is none."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], -1)
    lengths = np.linalg.norm(vertices_m[ends[..., 0]] - vertices_m[ends[..., 1]], axis=-1)
    long = lengths.max(axis=1) > longest_m
    if not long.any():
        return None
    # Turned so that the longest edge leads from the first corner to the second. A neighbour halves it at the same
    # middle, now or in a later turn, for it is too long there, too.
    turn = lengths[long].argmax(axis=1)
    a, b, c = (faces[long][np.arange(len(turn)), (turn + k) % 3] for k in range(3))
    edges, where = np.unique(np.sort(np.stack([a, b], 1), axis=1), axis=0, return_inverse=True)
    middle = len(vertices_m) + where.ravel()
    halves = [np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)]
    return np.concatenate([vertices_m, vertices_m[edges].mean(axis=1)]), np.concatenate([faces[~long], *halves])


def vertex_areas(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Return a third of the area of the faces around each vertex (V,), square metres."""
    areas = np.repeat(mesh.face_areas / 3.0, 3)
    return np.bincount(mesh.faces.ravel(), areas, len(mesh.vertices_m)).astype(float)


def vertex_normals(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Return unit normals (V, 3), the mean of the faces around, weighted by their areas; zero where there are none."""
    a, b, c = np.moveaxis(mesh.triangles_m, 1, 0)
    normals = np.zeros_like(mesh.vertices_m)
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], np.cross(b - a, c - a))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))
