"""Whether touches determine a pose: an exhaustive search for other poses that fit noiseless touches.

The search shares nothing with the verdict. It uses no places, no encoder, no imprint IoU and no registration of the
project. A dense sample of the object's surface, turned in steps of 5 degrees, is aligned with the deepest contact of
the first touch. A field of signed distances rates all these poses by the touches' points. The best ones, and the true
pose turned about the object's principal axes, are moved by Gauss-Newton steps, and drawn by ray casting. A pose fits if
its depths differ from those of each touch by at most MARGIN_M (root mean square over the pixels that either of them has
in contact).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from tactile_loc import ObjectModel, Touch
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.plugin import Poses, Renderer, Scene
from tactile_loc.plugin.helpers import invert, make_contact_cloud, make_transform, rotation_about, transform_points

Float64 = NDArray[np.float64]

FAR_M = 1e-3  # pose error from which another pose counts
MARGIN_M = 3e-5
STARTS, TURNS = 3000, 72  # points of the surface, and turns about their normals
POINTS, KEPT, STEPS, DRAWN = 40, 400, 25, 100  # points of each touch, poses that are moved, steps, and poses drawn
CELL_M, AROUND_M = 4e-4, 4e-3  # of the field, at least; and its border
MOST_CELLS = 160  # along the longest side


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distances from an object's surface, metres, negative inside, on a regular grid."""

    object: ObjectModel

    @cached_property
    def cell_m(self) -> float:
        """The size of a cell, metres."""
        return max(CELL_M, float(self.object.mesh.extents_m.max() + 2 * AROUND_M) / MOST_CELLS)

    @cached_property
    def origin_m(self) -> Float64:
        """The corner (3,) of the grid, metres."""
        return np.asarray(self.object.mesh.vertices_m.min(axis=0) - AROUND_M)

    @cached_property
    def scene(self) -> Any:
        """The search structure of the surface."""
        import open3d as o3d

        scene, mesh = o3d.t.geometry.RaycastingScene(), self.object.mesh
        scene.add_triangles(mesh.vertices_m.astype(np.float32), mesh.faces.astype(np.uint32))
        return scene

    @cached_property
    def values_m(self) -> Float64:
        """The distances (X, Y, Z), metres."""
        counts = np.ceil((self.object.mesh.extents_m + 2 * AROUND_M) / self.cell_m).astype(int) + 1
        axes = [self.origin_m[k] + self.cell_m * np.arange(counts[k]) for k in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)
        return np.asarray(self.scene.compute_signed_distance(points).numpy(), float)

    def measure(self, points_m: Float64) -> Float64:
        """Return the signed distances (...,), metres, of points (..., 3), interpolated on the grid."""
        cells = np.moveaxis((points_m - self.origin_m) / self.cell_m, -1, 0)
        return np.asarray(map_coordinates(self.values_m, cells, order=1, mode="nearest"))

    def find_nearest(self, points_m: Float64) -> tuple[Float64, Float64]:
        """Return how far points (..., 3), metres, are from the surface's triangles nearest to them, and their normals.

        The distances (...,) are along the normals (..., 3), and positive outside.
        """
        found = self.scene.compute_closest_points(points_m.astype(np.float32))
        normals = np.asarray(found["primitive_normals"].numpy(), float)
        offsets = points_m - np.asarray(found["points"].numpy(), float)
        return np.einsum("...i,...i->...", offsets, normals), normals


def find_rival(obj: ObjectModel, renderer: Renderer, touches: Sequence[Touch], field: DistanceField) -> float:
    """Return the pose error, metres, of the nearest other pose that fits noiseless touches; 0 if none is found.

    The true poses of the touches are known. Poses with an error of up to FAR_M are not other poses.
    """
    truth = np.asarray(touches[0].T_sensor_object)
    between = [np.asarray(t.T_sensor_object) @ invert(truth) for t in touches]  # T_sensor_first of each touch
    clouds = [make_contact_cloud(t.touching_shape, t.geometry, walls=False) for t in touches]
    rng = np.random.default_rng(0)
    points = []
    for (cloud, _), T in zip(clouds, between, strict=True):
        some = cloud[rng.choice(len(cloud), min(POINTS, len(cloud)), replace=False)]
        points.append(transform_points(invert(T), some))
    points_m = np.concatenate(points)
    weights = np.concatenate([np.full(len(some), 1 / len(some)) for some in points])
    first, normals = clouds[0]
    deepest = int(first[:, 2].argmin())
    # the deepest point of a touch lies on the object, whose outward normal there faces the sensor
    starts = _align(obj, first[deepest], normals[deepest], rng)
    T = np.concatenate([_keep_best(field, starts, points_m, weights), truth @ _turn(obj)])
    T = _descend(field, T, points_m, weights)
    off_m = measure_pose_errors(obj, T, truth)
    others = np.flatnonzero(off_m > FAR_M)
    others = others[np.argsort(_rate(field, T[others], points_m, weights))][:DRAWN]
    fits = [
        k
        for k in others
        if all(_fits(obj, renderer, touch, B @ T[k]) for touch, B in zip(touches, between, strict=True))
    ]
    return float(off_m[fits].min()) if fits else 0.0


def _align(obj: ObjectModel, point_m: Float64, normal: Float64, rng: np.random.Generator) -> Poses:
    """Return poses (STARTS * TURNS, 4, 4) that put a point of the surface at a point (3,), facing along a normal."""
    faces = rng.choice(len(obj.mesh.faces), STARTS, p=obj.mesh.face_areas / obj.mesh.face_areas.sum())
    corners = obj.mesh.triangles_m[faces]
    u = np.sort(rng.random((STARTS, 2)), axis=1)
    places = np.einsum("kc,kcd->kd", np.column_stack([u[:, 0], u[:, 1] - u[:, 0], 1 - u[:, 1]]), corners)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = across / np.linalg.norm(across, axis=1, keepdims=True)
    target = _make_frame(normal[None])[0]
    frames = np.swapaxes(_make_frame(outward), -1, -2)
    turns = rotation_about([0.0, 0.0, 1.0], np.arange(TURNS) * 2 * np.pi / TURNS)
    R = (target @ turns @ frames[:, None]).reshape(-1, 3, 3)
    return make_transform(R, point_m - np.einsum("nij,nj->ni", R, np.repeat(places, TURNS, axis=0)))


def _turn(obj: ObjectModel) -> Poses:
    """Return turns (N, 4, 4) about the principal axes: in steps of 5 degrees about each, and then by half a turn."""
    middle_m = obj.mesh.centroid_m
    axes = np.linalg.svd(obj.mesh.sample(STARTS, np.random.default_rng(0)) - middle_m, full_matrices=False)[2]
    halves = np.stack([np.eye(3), *(rotation_about(axis, np.pi) for axis in axes)])
    turns = np.concatenate([rotation_about(axis, np.arange(TURNS) * 2 * np.pi / TURNS) for axis in axes])
    R = (halves[:, None] @ turns).reshape(-1, 3, 3)
    return make_transform(R, middle_m - R @ middle_m)


def _make_frame(normals: Float64) -> Float64:
    """Return rotations (N, 3, 3) whose third column is a unit normal (N, 3)."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    x = np.cross(least, normals)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(normals, x), normals], axis=-1)


def _rate(field: DistanceField, T: Poses, points_m: Float64, weights: Float64) -> Float64:
    """Return the weighted mean squared distances (K,) of points in the first sensor's frame from the surface at T."""
    rated = [(field.measure(_see(some, points_m)) ** 2) @ weights for some in np.array_split(T, max(1, len(T) // 4000))]
    return np.concatenate(rated)


def _see(T: Poses, points_m: Float64) -> Float64:
    return points_m @ np.swapaxes(invert(T)[:, :3, :3], -1, -2) + invert(T)[:, None, :3, 3]


def _keep_best(field: DistanceField, T: Poses, points_m: Float64, weights: Float64) -> Poses:
    return T[np.argsort(_rate(field, T, points_m, weights), kind="stable")[: KEPT * 10 : 10]]


def _descend(field: DistanceField, T: Poses, points_m: Float64, weights: Float64) -> Poses:
    """Move poses (K, 4, 4) by damped Gauss-Newton steps, so that all points come to the surface."""
    from tactile_loc.core.geometry.lie import exponential

    for _ in range(STEPS):
        seen = _see(T, points_m)
        d, slopes = field.find_nearest(seen)
        J = np.concatenate([np.cross(seen, slopes), slopes], axis=-1)  # of a twist of the points in the object's frame
        A = np.einsum("kpi,p,kpj->kij", J, weights, J) + 1e-9 * np.eye(6)
        b = np.einsum("kpi,p,kp->ki", J, weights, d)
        step = -np.linalg.solve(A, b[..., None])[..., 0]
        step *= np.minimum(1.0, 2e-3 / np.maximum(np.linalg.norm(step[:, 3:], axis=1), 1e-12))[:, None]
        moved = exponential(step, np.zeros((len(T), 3)))
        T = T @ invert(moved)
    return T


def _fits(obj: ObjectModel, renderer: Renderer, touch: Touch, T: Poses) -> bool:
    """Return whether a pose (4, 4) in the frame of a touch's own sensor shows what the noiseless touch shows."""
    scene = Scene(obj, touch.geometry, renderer)
    poses = scene.bring_near_contact(T[None], 2e-4)
    made, seen = scene.render_gel_depths(poses, touch.press_depth_m)[0], touch.contact_shape.depth_m
    press = np.float32(touch.press_depth_m)
    either = ((made < press) | (seen < press)) & touch.geometry.observed_mask
    return bool(np.sqrt(np.mean((made - seen)[either] ** 2)) <= MARGIN_M) if either.any() else False
