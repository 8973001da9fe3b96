"""The distribution over poses, prepared for pictures: over the object's surface, and over rotations.

The surface shows where the sensor's centre probably touches. A rotation is described by the yaw about the sensor's
axis, and by the side of the object that faces the sensor.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints, Poses, invert, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

PATCHES = 1500  # area of the surface, divided by the square of the longest edge
MOST_SPLITS = 40
REACH = 3.0  # a pose's probability is spread over this distance, in standard deviations
YAW_BINS, MOST_YAWS = 36, 120
AZIMUTHS, HEIGHTS = 36, 18
LEANS = 15
SAME_SIDE_DEG, CAP_DEG = 0.5, 60.0


@dataclass(frozen=True, eq=False)
class SurfaceDistribution:
    """Probability over a surface.

    `mass` (V,) is the probability at each vertex, with sum one. `area_m2` (V,) is the area around each vertex.
    `spread_m` is the standard deviation, in metres, with which each pose's probability is spread along the surface.
    """

    mesh: TriangleMesh
    mass: Floats
    area_m2: Floats
    spread_m: float

    @property
    def density(self) -> Floats:
        """Probability per area at each vertex (V,), 1/m^2."""
        return self.mass / np.maximum(self.area_m2, 1e-15)


def find_touched_vertices(mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Ints:
    """Return the index (N,) of the vertex nearest to the sensor's centre at each pose (N, 4, 4), metres."""
    from scipy.spatial import cKDTree

    centres_m = transform_points(invert(T_sensor_object), geometry.gel_middle_m[None])[:, 0]
    return np.asarray(cKDTree(mesh.vertices_m).query(centres_m)[1], np.int64)


def spread_over_surface(
    mesh: TriangleMesh, T_sensor_object: Poses, weights: Floats, geometry: SensorGeometry, spread_m: float
) -> SurfaceDistribution:
    """Return the probability, over the surface, of where the sensor's centre touches.

    `weights` (N,), with sum one, are the probabilities of the poses (N, 4, 4), metres. Each pose counts at the vertex
    nearest to the sensor's centre. The weight is then spread over nearby vertices, in proportion to their areas and to
    a Gaussian of `spread_m` metres. The back of a wall gets no weight from its front.
    """
    from trimesh import remesh

    split: Any = remesh.subdivide_to_size
    longest_m = float(np.sqrt(mesh.face_areas.sum() / PATCHES))  # for a smooth picture
    fine = TriangleMesh(*split(mesh.vertices_m, mesh.faces, longest_m, MOST_SPLITS))
    touched = find_touched_vertices(fine, T_sensor_object, geometry)
    mass = np.bincount(touched, weights, len(fine.vertices_m)).astype(float)
    area = compute_vertex_areas(fine)
    return SurfaceDistribution(fine, _spread(fine, mass, area, spread_m), area, spread_m)


def _spread(mesh: TriangleMesh, mass: Floats, area_m2: Floats, spread_m: float) -> Floats:
    """Spread masses (V,) to nearby vertices; the sum of all masses stays the same."""
    from scipy.spatial import cKDTree

    tree, normals = cKDTree(mesh.vertices_m), mesh.vertex_normals
    found = np.zeros(len(mass))
    for source in np.flatnonzero(mass):
        near = np.array(tree.query_ball_point(mesh.vertices_m[source], REACH * spread_m), np.int64)
        apart = np.linalg.norm(mesh.vertices_m[near] - mesh.vertices_m[source], axis=1) / spread_m
        share = np.exp(-0.5 * apart**2) * area_m2[near] * np.maximum(normals[near] @ normals[source], 0.0)
        if share.sum() <= 0:
            near, share = np.array([source]), np.ones(1)
        found[near] += mass[source] * share / share.sum()
    return found


def compute_vertex_areas(mesh: TriangleMesh) -> Floats:
    """Return, for each vertex (V,), a third of the area of the faces around it, in square metres."""
    areas = np.repeat(mesh.face_areas / 3.0, 3)
    return np.bincount(mesh.faces.ravel(), areas, len(mesh.vertices_m)).astype(float)


def compute_yaw_rad(R: Floats) -> Floats:
    """Return the yaw (N,) about the sensor's z of rotations R_sensor_object (N, 3, 3), radians, -pi to pi.

    R = Rz(yaw) A. A is the smallest rotation that makes the facing side face the sensor (`align_to_z`). The rotation
    axis of A has no z component, so A[0, 1] = A[1, 0].
    """
    yaw = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
    flipped = R[:, 2, 2] <= -1 + 1e-9  # both arguments of arctan2 are zero; A is diag(1, -1, -1)
    return np.where(flipped, np.arctan2(R[:, 1, 0], R[:, 0, 0]), yaw)


def count_yaws(R: Floats, weights: Floats) -> dict[str, Any]:
    """Sum the weights (N,), with sum one, of rotations R_sensor_object (N, 3, 3) by yaw about the sensor's +z.

    Returns JSON values: the middles `deg` (B,) of bars, which are `width` degrees wide, and the probability `percent`
    (B,) of each. If there are at most `MOST_YAWS` yaws, at least 1 degree apart, each yaw has a bar. Otherwise, a bar
    is 10 degrees wide.
    """
    yaw_deg = np.degrees(compute_yaw_rad(R)) % 360.0
    middles, which = np.unique(np.round(yaw_deg, 2) % 360.0, return_inverse=True)
    bins, width_deg = which.ravel(), 360.0 / YAW_BINS
    step_deg = float(np.diff(middles).min()) if len(middles) > 1 else width_deg
    if len(middles) <= MOST_YAWS and step_deg >= 1.0:
        width_deg = min(step_deg, 30.0)
    else:
        bins = np.minimum((yaw_deg / width_deg).astype(int), YAW_BINS - 1)
        middles = np.asarray((np.arange(YAW_BINS) + 0.5) * width_deg)
    percent = 100 * np.bincount(bins, weights, len(middles))
    return {"deg": middles.round(3).tolist(), "percent": percent.tolist(), "width": width_deg}


def map_sides(R: Floats, weights: Floats) -> dict[str, Any]:
    """Sum the weights (N,), with sum one, of rotations R_sensor_object (N, 3, 3) by the side that faces the sensor.

    Returns JSON values: the probability `percent` (Y, X) of bins with the edges `x` and `y`, degrees, and the `normal`
    (3,) of a side in the object frame.
    Kind "one": the side `normal` faces the sensor in all poses, and there are no bins.
    Kind "lean": the bins are the angles by which the side `normal` leans towards the sensor's x and y.
    Kind "globe": the bins are the azimuth and elevation of the facing side in the object frame, with equal areas;
    `normal` is the side of the most probable rotation.
    """
    facing: Floats = -R[:, 2, :]
    mean: Floats = facing.mean(axis=0)
    normal = mean / max(float(np.linalg.norm(mean)), 1e-6)
    widest_deg = float(np.degrees(np.arccos(np.clip(facing @ normal, -1, 1))).max())
    kind, x, y, mass = "one", np.zeros(0), np.zeros(0), np.ones((1, 1))
    if widest_deg > CAP_DEG:
        kind, normal = "globe", facing[weights.argmax()]
        azimuth_deg = np.degrees(np.arctan2(facing[:, 1], facing[:, 0]))
        x, heights = np.linspace(-180, 180, AZIMUTHS + 1), np.linspace(-1, 1, HEIGHTS + 1)
        mass, _, _ = np.histogram2d(np.clip(facing[:, 2], -1, 1), azimuth_deg, (heights, x), weights=weights)
        y = np.degrees(np.arcsin(heights))
    elif widest_deg >= SAME_SIDE_DEG:
        kind, side = "lean", R @ normal
        lean_deg = np.degrees(np.arctan2(side[:, :2], -side[:, 2:]))
        x = y = np.linspace(-1, 1, LEANS + 1) * (float(np.abs(lean_deg).max()) * (1 + 1 / LEANS))
        mass, _, _ = np.histogram2d(lean_deg[:, 1], lean_deg[:, 0], (y, x), weights=weights)
    arrays = {"normal": normal, "x": x, "y": y, "percent": 100 * mass}
    return {"kind": kind, **{name: values.tolist() for name, values in arrays.items()}}
