"""Small analytic surfaces, and a renderer that shares no code with any other: what the checks hold for true."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.interfaces import Float32, Renderer
from tactile_loc.core.objects import TriangleMesh
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import SensorGeometry

Array = NDArray[np.float64]

_BOX_FACES = np.array([
    [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
    [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
])  # fmt: skip
_ROUNDING = 1e-9
RAYS = 512  # met with all triangles at once


class ReferenceRenderer(Renderer):
    """Meets every ray with every triangle, in closed form and double precision. Slow, for small meshes."""

    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depth z (N, H, W) in metres at pixel centres for poses (N, 4, 4).

        Triangles wholly beyond the contact band are left out; rays that miss the others have depth inf.
        """
        depth = np.empty((len(T_sensor_object), *geometry.shape), np.float32)
        for picture, T in zip(depth, T_sensor_object, strict=True):
            triangles = mesh.triangles_m @ T[:3, :3].T + T[:3, 3]
            in_band = triangles[..., 2].min(axis=1) <= geometry.standoff_m + geometry.max_depth_m
            picture[:] = _first_hits(triangles[in_band], geometry).reshape(geometry.shape)
        return depth


def _first_hits(triangles_m: Array, geometry: SensorGeometry) -> Array:
    """Depths (H * W,) of the nearest triangles; rays are taken in parts whose products stay in the cache."""
    rays = np.stack([s.ravel() for s in np.meshgrid(*geometry.pixel_slopes)], axis=-1)
    parts = np.split(rays, range(RAYS, len(rays), RAYS))
    return np.concatenate([_first_hits_of(part, triangles_m, geometry.is_pinhole) for part in parts])


def _first_hits_of(rays: Array, triangles_m: Array, is_pinhole: bool) -> Array:
    """Depths (K,) of rays (K, 2) by Cramer's rule (Moeller and Trumbore): u, v and z are quotients of triple products.

    A ray is x/z, y/z of a pinhole's, or x, y of a parallel one.
    """
    a, e1, e2 = triangles_m[:, 0], triangles_m[:, 1] - triangles_m[:, 0], triangles_m[:, 2] - triangles_m[:, 0]
    x, y = rays.T
    if is_pinhole:
        d = np.stack([x, y, np.ones_like(x)], -1)
        u, v, det = d @ np.cross(e2, -a).T, d @ np.cross(-a, e1).T, d @ np.cross(e2, e1).T
        z = np.einsum("fk,fk->f", e2, np.cross(-a, e1))[None]
    else:
        o, forward = np.stack([x, y, np.zeros_like(x)], -1), np.array([0.0, 0.0, 1.0])
        across = (np.cross(forward, e2), np.cross(e1, forward), np.cross(e1, e2))
        u, v, z = (o @ w.T - np.einsum("fk,fk->f", a, w) for w in across)
        det = np.cross(e2, e1)[None, :, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v, z = u / det, v / det, z / det
        inside = (u >= -_ROUNDING) & (v >= -_ROUNDING) & (u + v <= 1 + _ROUNDING) & (z > 0)
    return np.where(inside, z, np.inf).min(axis=1, initial=np.inf)


def box(low_m: tuple[float, float, float], high_m: tuple[float, float, float]) -> TriangleMesh:
    """Return a closed box between two corners, metres."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    low, high = np.array(low_m), np.array(high_m)
    return TriangleMesh(low + corners * (high - low), _BOX_FACES.copy())


def cylinder(radius_m: float, z_m: tuple[float, float], sides: int = 16) -> TriangleMesh:
    """Return a closed prism about the z axis, metres; `sides` faces approximate the cylinder from within."""
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = radius_m * np.column_stack([np.cos(turn), np.sin(turn)])
    rims = [np.column_stack([ring, np.full(sides, z)]) for z in z_m]
    i, j = np.arange(sides), np.roll(np.arange(sides), -1)
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    walls = [np.column_stack([i, j, i + sides]), np.column_stack([j, j + sides, i + sides])]
    caps = [np.column_stack([low, j, i]), np.column_stack([high, i + sides, j + sides])]
    poles = np.array([[0, 0, z_m[0]], [0, 0, z_m[1]]])
    return TriangleMesh(np.concatenate([*rims, poles]), np.concatenate(walls + caps))


def moved(mesh: TriangleMesh, by_m: tuple[float, float, float]) -> TriangleMesh:
    """Return the mesh shifted by a vector in metres."""
    return TriangleMesh(mesh.vertices_m + np.array(by_m), mesh.faces)


def copied(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh in memory of its own, for checks of who writes to it."""
    return TriangleMesh(mesh.vertices_m.copy(), mesh.faces.copy())


def scaled(mesh: TriangleMesh, factor: float) -> TriangleMesh:
    """Return the mesh made larger by a factor, about the origin."""
    return TriangleMesh(mesh.vertices_m * factor, mesh.faces)


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    """Return several surfaces as one mesh; they may intersect."""
    starts = np.cumsum([0, *(len(m.vertices_m) for m in meshes[:-1])])
    faces = [m.faces + start for m, start in zip(meshes, starts, strict=True)]
    return TriangleMesh(np.concatenate([m.vertices_m for m in meshes]), np.concatenate(faces))


@lru_cache(maxsize=1)
def stepped_block() -> TriangleMesh:
    """Return a block of 16 x 10 x 6 mm whose underside (towards -z) has a boss, a ramp and a post, all different.

    Nothing about it is symmetric, and each feature shows at another press depth: from 0 (boss) to 1.2 mm (body).
    """
    body = box((-0.008, -0.005, 0.0012), (0.008, 0.005, 0.006))
    boss = box((-0.007, -0.004, 0.0), (-0.002, 0.001, 0.002))
    post = moved(cylinder(0.0015, (0.0005, 0.003)), (0.004, -0.0025, 0.0))
    return joined(body, boss, _ramp(), post)


def _ramp() -> TriangleMesh:
    wedge = box((0.001, 0.001, 0.0002), (0.007, 0.004, 0.002))
    x, y, z = wedge.vertices_m.T
    sloping = np.where(z < 0.001, z + (x - 0.001) / 6, z)
    return TriangleMesh(np.column_stack([x, y, sloping]), wedge.faces)


@lru_cache(maxsize=1)
def ball(radius_m: float = 0.008, rounds: int = 5) -> TriangleMesh:
    """Return a sphere about the origin, metres: an octahedron whose faces are cut in four `rounds` times."""
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    signs = np.array([[x, y, z] for x in (0, 3) for y in (0, 3) for z in (0, 3)])
    triangles = corners[signs + np.arange(3)]
    for _ in range(rounds):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = a + b, b + c, c + a
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(p, axis=1) for p in parts])
        triangles /= np.linalg.norm(triangles, axis=-1, keepdims=True)
    return TriangleMesh(radius_m * triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def plate(half_m: float = 0.1) -> TriangleMesh:
    """Return a square without thickness in the plane z = 0, metres."""
    corners = half_m * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def overhang() -> TriangleMesh:
    """Return a thin foot, 0.3 mm thick, that hangs 1.2 mm before a plate: off its axis, a pinhole sees behind it."""
    foot = box((0.005, -0.006, 0.0), (0.009, 0.006, 0.0003))
    return joined(foot, box((-0.002, -0.008, 0.0015), (0.012, 0.008, 0.004)))
