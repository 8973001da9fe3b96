"""A distribution over poses for pictures: over the object's surface, and over rotations.

On the surface: where the sensor's centre touches. Over rotations: the yaw about the sensor's axis, and the side of the
object that faces the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, invert, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

Array = NDArray[np.float64]

PATCHES = 1500  # squares of the longest edge's length that would cover the surface
MOST_SPLITS = 40
REACH = 3.0  # standard deviations to which a pose's probability is spread
YAW_BINS, MOST_YAWS = 36, 120
AZIMUTHS, HEIGHTS = 36, 18
LEANS = 15
SAME_SIDE_DEG, CAP_DEG = 0.5, 60.0


@dataclass(frozen=True, eq=False)
class SurfaceDistribution:
    """Probability over a surface: `mass` (V,) of each vertex, with sum one, and the vertex's `area_m2` (V,).

    `spread_m` is the standard deviation of the spread of each pose's probability along the surface, metres.
    """

    mesh: TriangleMesh
    mass: Array
    area_m2: Array
    spread_m: float

    @property
    def density(self) -> Array:
        """Probability per area (V,), 1/m^2."""
        return self.mass / np.maximum(self.area_m2, 1e-15)


def find_touched_vertices(mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> NDArray[np.int64]:
    """Return the vertex (N,) nearest to the sensor's centre at each pose (N, 4, 4), metres."""
    from scipy.spatial import cKDTree

    centres_m = transform_points(invert(T_sensor_object), geometry.gel_middle_m[None])[:, 0]
    return np.asarray(cKDTree(mesh.vertices_m).query(centres_m)[1], np.int64)


def spread_over_surface(
    mesh: TriangleMesh, T_sensor_object: Poses, weights: Array, geometry: SensorGeometry, spread_m: float
) -> SurfaceDistribution:
    """Return where the sensor's centre touches the surface, from poses (N, 4, 4) and their weights (N,) with sum one.

    Each pose counts at the vertex nearest to the sensor's centre. Its weight is spread over nearby vertices, by area
    and by a Gaussian of `spread_m` metres, but not to the back of a wall.
    """
    fine = split_long_edges(mesh, choose_edge_m(mesh))
    touched = find_touched_vertices(fine, T_sensor_object, geometry)
    mass = np.bincount(touched, weights, len(fine.vertices_m)).astype(float)
    area = compute_vertex_areas(fine)
    return SurfaceDistribution(fine, _spread(fine, mass, area, spread_m), area, spread_m)


def _spread(mesh: TriangleMesh, mass: Array, area_m2: Array, spread_m: float) -> Array:
    """Spread masses (V,) to nearby vertices; their sum stays the same."""
    from scipy.spatial import cKDTree

    tree, normals = cKDTree(mesh.vertices_m), compute_vertex_normals(mesh)
    found = np.zeros(len(mass))
    for source in np.flatnonzero(mass):
        near = np.array(tree.query_ball_point(mesh.vertices_m[source], REACH * spread_m), np.int64)
        apart = np.linalg.norm(mesh.vertices_m[near] - mesh.vertices_m[source], axis=1) / spread_m
        share = np.exp(-0.5 * apart**2) * area_m2[near] * np.maximum(normals[near] @ normals[source], 0.0)
        if share.sum() <= 0:
            near, share = np.array([source]), np.ones(1)
        found[near] += mass[source] * share / share.sum()
    return found


def choose_edge_m(mesh: TriangleMesh) -> float:
    """Return the longest edge, metres, for a smooth picture of this surface."""
    return float(np.sqrt(mesh.face_areas.sum() / PATCHES))


def split_long_edges(mesh: TriangleMesh, longest_m: float) -> TriangleMesh:
    """Return the same surface without edges longer than `longest_m` metres, by halving the longest edges."""
    vertices, faces = mesh.vertices_m, mesh.faces
    for _ in range(MOST_SPLITS):
        split = _split_longest(vertices, faces, longest_m)
        if split is None:
            break
        vertices, faces = split
    places, same = np.unique(vertices, axis=0, return_inverse=True)  # neighbours may halve a common edge separately
    return TriangleMesh(places, same.ravel()[faces])


def _split_longest(
    vertices_m: Array, faces: NDArray[np.int64], longest_m: float
) -> tuple[Array, NDArray[np.int64]] | None:
    """Halve the longest edge of every face that is too long; return None when there is none."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], -1)
    lengths = np.linalg.norm(vertices_m[ends[..., 0]] - vertices_m[ends[..., 1]], axis=-1)
    long = lengths.max(axis=1) > longest_m
    if not long.any():
        return None
    # The longest edge leads from a to b. A neighbour halves it at the same middle, now or in a later round.
    first = lengths[long].argmax(axis=1)
    a, b, c = (faces[long][np.arange(len(first)), (first + k) % 3] for k in range(3))
    edges, where = np.unique(np.sort(np.stack([a, b], 1), axis=1), axis=0, return_inverse=True)
    middle = len(vertices_m) + where.ravel()
    halves = [np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)]
    return np.concatenate([vertices_m, vertices_m[edges].mean(axis=1)]), np.concatenate([faces[~long], *halves])


def compute_vertex_areas(mesh: TriangleMesh) -> Array:
    """Return a third of the area of the faces around each vertex (V,), square metres."""
    areas = np.repeat(mesh.face_areas / 3.0, 3)
    return np.bincount(mesh.faces.ravel(), areas, len(mesh.vertices_m)).astype(float)


def compute_vertex_normals(mesh: TriangleMesh) -> Array:
    """Return unit normals (V, 3), the area-weighted mean over the faces around each vertex; zero without faces."""
    a, b, c = np.moveaxis(mesh.triangles_m, 1, 0)
    normals = np.zeros_like(mesh.vertices_m)
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], np.cross(b - a, c - a))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


@dataclass(frozen=True, eq=False)
class YawHistogram:
    """Probability by yaw about the sensor's +z: `yaw_deg` (B,) are the middles of bars, `mass` (B,) has the sum one."""

    yaw_deg: Array
    mass: Array
    width_deg: float


@dataclass(frozen=True, eq=False)
class SideMap:
    """Probability `mass` (Y, X), with sum one, by the side of the object that faces the sensor.

    "one" is a single side with `normal` (3,) in the object frame. "lean": bins are the lean of that side towards the
    sensor's x and y, degrees. "globe": bins are the azimuth and elevation of the side in the object frame, degrees, of
    equal area. `x` and `y` are the edges of the bins.
    """

    kind: Literal["one", "lean", "globe"]
    normal: Array
    x: Array
    y: Array
    mass: Array


def compute_yaw_rad(R: Array) -> Array:
    """Return the yaw (N,) about the sensor's z of rotations R_sensor_object (N, 3, 3), radians, -pi to pi.

    R = Rz(yaw) A. A is the smallest rotation that brings the facing side to the sensor (`align_to_z`). Its axis has
    no z, so A[0, 1] = A[1, 0].
    """
    yaw = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
    flipped = R[:, 2, 2] <= -1 + 1e-9  # both arguments vanish; A is diag(1, -1, -1)
    return np.where(flipped, np.arctan2(R[:, 1, 0], R[:, 0, 0]), yaw)


def count_yaws(R: Array, weights: Array) -> YawHistogram:
    """Sum weights (N,) of rotations R_sensor_object (N, 3, 3) by yaw, with bars for each lattice yaw or 10 degrees."""
    yaw_deg = np.degrees(compute_yaw_rad(R)) % 360.0
    values, which = np.unique(np.round(yaw_deg, 2) % 360.0, return_inverse=True)
    step_deg = float(np.diff(values).min()) if len(values) > 1 else 360.0 / YAW_BINS
    if len(values) <= MOST_YAWS and step_deg >= 1.0:
        return YawHistogram(values, np.bincount(which.ravel(), weights, len(values)).astype(float), min(step_deg, 30.0))
    width_deg = 360.0 / YAW_BINS
    bins = np.minimum((yaw_deg / width_deg).astype(int), YAW_BINS - 1)
    middles = np.linspace(0.5, YAW_BINS - 0.5, YAW_BINS) * width_deg
    return YawHistogram(middles, np.bincount(bins, weights, YAW_BINS).astype(float), width_deg)


def map_sides(R: Array, weights: Array) -> SideMap:
    """Sum weights (N,) of rotations R_sensor_object (N, 3, 3) by the side of the object that faces the sensor."""
    facing = -R[:, 2, :]
    mean = facing.mean(axis=0)
    if np.linalg.norm(mean) < 1e-6:
        return _map_globe(facing, weights)
    normal = mean / np.linalg.norm(mean)
    widest_deg = float(np.degrees(np.arccos(np.clip(facing @ normal, -1, 1))).max())
    if widest_deg > CAP_DEG:
        return _map_globe(facing, weights)
    return _map_lean(R, weights, normal, widest_deg)


def _map_globe(facing: Array, weights: Array) -> SideMap:
    azimuth_deg = np.degrees(np.arctan2(facing[:, 1], facing[:, 0]))
    x, heights = np.linspace(-180, 180, AZIMUTHS + 1), np.linspace(-1, 1, HEIGHTS + 1)
    mass, _, _ = np.histogram2d(np.clip(facing[:, 2], -1, 1), azimuth_deg, (heights, x), weights=weights)
    best = facing[weights.argmax()]
    return SideMap("globe", best, x, np.degrees(np.arcsin(heights)), mass)


def _map_lean(R: Array, weights: Array, normal: Array, widest_deg: float) -> SideMap:
    if widest_deg < SAME_SIDE_DEG:
        return SideMap("one", normal, np.zeros(0), np.zeros(0), np.ones((1, 1)))
    side = R @ normal
    lean_deg = np.degrees(np.arctan2(side[:, :2], -side[:, 2:]))
    edges = np.linspace(-1, 1, LEANS + 1) * (float(np.abs(lean_deg).max()) * (1 + 1 / LEANS))
    mass, _, _ = np.histogram2d(lean_deg[:, 1], lean_deg[:, 0], (edges, edges), weights=weights)
    return SideMap("lean", normal, edges, edges, mass)
