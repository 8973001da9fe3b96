"""A shaded picture of posed meshes as an orthographic camera sees them, drawn by ray casting (open3d)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIGHT = np.array([0.35, -0.45, 0.82])  # sensor frame, unitless: from the upper right in front
CREASE_DEG = 28.0


@dataclass(frozen=True)
class View:
    """Where one looks from: `azimuth_deg` about the sensor's z, from -y to +x; `elevation_deg` above its xy plane."""

    azimuth_deg: float = 30.0
    elevation_deg: float = 34.0

    @property
    def axes(self) -> Array:
        """Rows (3, 3): right, up and towards the viewer, unit vectors of the sensor frame."""
        a, e = np.radians([self.azimuth_deg, self.elevation_deg])
        towards = np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])
        right = np.array([np.cos(a), np.sin(a), 0.0])
        return np.stack([right, np.cross(towards, right), towards])

    def project(self, points: Array) -> Array:
        """Turn points (..., 3) into picture coordinates (..., 2), right and up, same unit."""
        return np.asarray(points, float) @ self.axes[:2].T


@dataclass(frozen=True, eq=False)
class Buffers:
    """What each pixel's ray meets, (H, W): number of the surface (-1: none), depth, unit normal (H, W, 3), point."""

    surface: NDArray[np.int64]
    depth: Array
    normal: Array
    point: Array

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Where a ray meets any surface (H, W)."""
        return self.surface >= 0

    def edges(self, jump: float) -> NDArray[np.bool_]:
        """Mark (H, W) outlines, creases, and places where the depth jumps by more than `jump` (the points' unit)."""
        marked = np.zeros(self.surface.shape, bool)
        for axis in (0, 1):
            near, far = _pairs(self.normal, axis)
            crease = (near * far).sum(-1) < np.cos(np.radians(CREASE_DEG))
            a, b = _pairs(self.surface, axis)
            z0, z1 = _pairs(np.where(self.hit, self.depth, 0.0), axis)
            differs = (a != b) | ((a >= 0) & (crease | (np.abs(z1 - z0) > jump)))
            marked[: -1 if axis == 0 else None, : -1 if axis == 1 else None] |= differs
        return marked


class Tracer:
    """Surfaces, each triangles (F, 3, 3) of any one unit, seen from a view."""

    def __init__(self, surfaces: list[Array], view: View) -> None:
        import open3d as o3d

        self.view = view
        self._scene = o3d.t.geometry.RaycastingScene()
        core: Any = o3d.core
        self._tensor = core.Tensor
        for triangles in surfaces:
            corners = np.ascontiguousarray(triangles.reshape(-1, 3), np.float32)
            faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
            self._scene.add_triangles(self._tensor(corners), self._tensor(faces))
        self._distance = 4.0 * max(float(np.abs(t).max()) for t in surfaces) + 1.0

    def look(self, bounds: tuple[float, float, float, float], shape: tuple[int, int]) -> Buffers:
        """Cast a ray through each of `shape` (H, W) pixels over bounds (left, right, bottom, top) of the picture."""
        left, right, bottom, top = bounds
        height, width = shape
        u = left + (np.arange(width) + 0.5) / width * (right - left)
        v = top - (np.arange(height) + 0.5) / height * (top - bottom)
        axes = self.view.axes
        origin = u[None, :, None] * axes[0] + v[:, None, None] * axes[1] + self._distance * axes[2]
        rays = np.concatenate([origin, np.broadcast_to(-axes[2], origin.shape)], -1).astype(np.float32)
        answer = self._scene.cast_rays(self._tensor(rays))
        depth = answer["t_hit"].numpy().astype(float)
        hit = np.isfinite(depth)
        normal = answer["primitive_normals"].numpy().astype(float)
        normal *= np.where((normal @ axes[2]) < 0, -1.0, 1.0)[..., None]  # towards the viewer, however it is wound
        surface = np.where(hit, answer["geometry_ids"].numpy().astype(np.int64), -1)
        return Buffers(surface, depth, normal, origin - np.where(hit, depth, 0.0)[..., None] * axes[2])

    def shadow(self, buffers: Buffers, lift: float) -> NDArray[np.bool_]:
        """Mark (H, W) the points that another surface hides from the light; `lift` keeps them off their own surface."""
        start = buffers.point + lift * buffers.normal
        light = np.broadcast_to(LIGHT / np.linalg.norm(LIGHT), start.shape)
        rays = np.concatenate([start, light], -1).astype(np.float32)
        return self._scene.test_occlusions(self._tensor(rays)).numpy() & buffers.hit


def shade(buffers: Buffers, colours: Array, shadow: NDArray[np.bool_]) -> Array:
    """Return RGBA (H, W, 4), 0 to 1, of surfaces in `colours` (S, 3); where nothing is hit it is transparent."""
    light = LIGHT / np.linalg.norm(LIGHT)
    diffuse = np.clip(buffers.normal @ light, 0.0, 1.0) * np.where(shadow, 0.35, 1.0)
    sky = 0.5 + 0.5 * buffers.normal[..., 2]
    brightness = 0.30 + 0.22 * sky + 0.55 * diffuse
    rgb = np.clip(colours[buffers.surface] * brightness[..., None], 0.0, 1.0)
    return np.concatenate([rgb, buffers.hit[..., None].astype(float)], -1)


def shrink(image: Array, factor: int) -> Array:
    """Average blocks of `factor` x `factor` pixels of (H, W, 4) RGBA, colours weighted by their opacity."""
    height, width = image.shape[0] // factor, image.shape[1] // factor
    blocks = image[: height * factor, : width * factor].reshape(height, factor, width, factor, 4)
    alpha = blocks[..., 3:].mean(axis=(1, 3))
    rgb = (blocks[..., :3] * blocks[..., 3:]).mean(axis=(1, 3)) / np.maximum(alpha, 1e-9)
    return np.concatenate([np.clip(rgb, 0.0, 1.0), alpha], -1)


def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Array:
    """Return the triangles (12, 3, 3) of an axis-aligned box."""
    corners = np.array([(a, b, c) for c in z for b in y for a in x])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return corners[np.array([tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))])]


def _pairs(values: NDArray, axis: int) -> tuple[NDArray, NDArray]:
    return (values[:-1], values[1:]) if axis == 0 else (values[:, :-1], values[:, 1:])
