"""Shaded pictures of posed meshes from an orthographic camera."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, make_transform
from tactile_loc.core.sensing.zbuffer import draw_nearest_faces

Bounds = tuple[float, float, float, float]

LIGHT = np.array([0.35, -0.45, 0.82])  # direction towards the light in the sensor frame: up, right and in front
CREASE_DEG = 28.0
LIT_PX = 1000  # pixels along the longer side of the picture seen from the light
IN_SHADOW = 0.35  # share of the diffuse light in shadow


@dataclass(frozen=True)
class Viewpoint:
    """A viewing direction.

    `azimuth_deg` is the viewer's angle about the sensor's z, from -y towards +x. `elevation_deg` is the viewer's angle
    above the sensor's xy plane.
    """

    azimuth_deg: float = 30.0
    elevation_deg: float = 34.0

    @property
    def axes(self) -> Floats:
        """Unit vectors in the sensor frame, as rows (3, 3): right, up, and towards the viewer."""
        a, e = np.radians([self.azimuth_deg, self.elevation_deg])
        towards = np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])
        right = np.array([np.cos(a), np.sin(a), 0.0])
        return np.stack([right, np.cross(towards, right), towards])

    def project(self, points: Floats) -> Floats:
        """Return the picture coordinates (..., 2), right and up, of points (..., 3), in the points' unit."""
        return np.asarray(points, float) @ self.axes[:2].T


@dataclass(frozen=True, eq=False)
class Buffers:
    """The first hit of each pixel's ray, in a picture with `bounds` (left, right, bottom, top).

    `surface` and `face` (H, W) are indices of the surface and face, or -1 without a hit. `depth` (H, W) is the length
    of the ray.
    """

    surface: NDArray[np.int32]
    face: NDArray[np.int32]
    depth: Float32
    face_normals: Floats
    """Unit normals (F, 3) of all faces, towards the viewer."""
    surface_of_face: NDArray[np.int32]
    """The index (F,) of each face's surface."""
    origins: tuple[Floats, Floats, Floats]
    """The rays' starts and direction: right (W, 3), up (H, 3) and towards (3,).

    A ray starts at the sum of its column's `right` and its row's `up`. Its direction is minus `towards`.
    """
    bounds: Bounds

    @cached_property
    def hit(self) -> Bools:
        """Mask (H, W) of the pixels whose ray hits a surface."""
        return self.surface >= 0

    def find_surfaces(self, places: Floats) -> NDArray[np.int32]:
        """Return the surfaces (N,), or -1, that the picture shows at places (N, 2), right and up."""
        left, right, bottom, top = self.bounds
        height, width = self.surface.shape
        columns = ((places[:, 0] - left) / (right - left) * width).astype(int).clip(0, width - 1)
        rows = ((top - places[:, 1]) / (top - bottom) * height).astype(int).clip(0, height - 1)
        return self.surface[rows, columns]

    def locate(self, axes: Floats, lift: float) -> tuple[Float32, Float32, Float32]:
        """Return coordinates x, y and z (K,) of the hits along axes (3, 3), rows, moved by `lift` along the normals."""
        rows, columns = np.nonzero(self.hit)
        depth, face = self.depth[self.hit], self.face[self.hit]
        right, up, towards, normals = (np.asarray(of @ axes.T, np.float32) for of in (*self.origins, self.face_normals))
        x, y, z = (
            right[columns, k] + up[rows, k] - depth * towards[k] + (np.float32(lift) * normals[:, k])[face]
            for k in range(3)
        )
        return x, y, z

    def find_edges(self, jump: float) -> Bools:
        """Return a mask (H, W) of outlines, creases, and depth steps larger than `jump` (in the points' unit)."""
        marked = np.zeros(self.surface.shape, bool)
        depth = np.where(self.hit, self.depth, np.float32(0))
        for axis in (0, 1):
            a, b = _pair_neighbours(self.surface, axis)
            z0, z1 = _pair_neighbours(depth, axis)
            differs = (a != b) | (np.abs(z1 - z0) > jump)
            near, far = _pair_neighbours(self.face, axis)
            two = (near != far) & ~differs
            cosines = (self.face_normals[near[two]] * self.face_normals[far[two]]).sum(axis=-1)
            differs[two] = cosines < np.cos(np.radians(CREASE_DEG))
            marked[: -1 if axis == 0 else None, : -1 if axis == 1 else None] |= differs
        return marked


class Tracer:
    """Renders surfaces from a view. Each surface is an array of triangles (F, 3, 3), all in the same unit."""

    def __init__(self, surfaces: list[Floats], view: Viewpoint) -> None:
        self.view = view
        self._triangles = np.concatenate(surfaces)
        numbers = np.arange(len(surfaces), dtype=np.int32)
        self._of_face = np.repeat(numbers, [len(triangles) for triangles in surfaces])
        self._normals = compute_normals(self._triangles)
        self._distance = 4.0 * float(np.abs(self._triangles).max()) + 1.0

    def look(self, bounds: Bounds, shape: tuple[int, int]) -> Buffers:
        """Cast a ray through each pixel of a picture with `shape` (H, W).

        `bounds` are the picture's borders (left, right, bottom, top), in the unit of the surfaces.
        """
        axes = self.view.axes
        depth, face, u, v = self._render_along(axes, bounds, shape)
        # triangles may have any winding
        towards = np.where(self._normals @ axes[2] < 0, -1.0, 1.0)[:, None] * self._normals
        origins = u[:, None] * axes[0] + self._distance * axes[2], v[:, None] * axes[1], axes[2]
        surface = np.append(self._of_face, np.int32(-1))[face]
        return Buffers(surface, face, depth, towards, self._of_face, origins, bounds)

    def cast_shadow(self, buffers: Buffers, lift: float) -> Bools:
        """Return a mask (H, W) of the pixels in shadow, found with a second picture that is seen from the light.

        Points are moved along their normals by `lift` plus 1.5 pixels of the picture seen from the light, so that they
        do not shade themselves.
        """
        towards = LIGHT / np.linalg.norm(LIGHT)
        right = np.cross([0.0, 1.0, 0.0], towards)
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(towards, right), towards])
        flat = self._triangles.reshape(-1, 3) @ axes[:2].T
        low, high = flat.min(axis=0), flat.max(axis=0)
        pixel = float((high - low).max()) / LIT_PX
        rows, columns = (int(np.ceil(size / pixel)) + 1 for size in (high - low)[::-1])
        bounds = low[0], low[0] + columns * pixel, low[1], low[1] + rows * pixel
        depth, *_ = self._render_along(axes, bounds, (rows, columns))
        x, y, z = buffers.locate(axes, lift + 1.5 * pixel)
        column = ((x - np.float32(low[0])) / np.float32(pixel)).astype(np.int32).clip(0, columns - 1)
        row = (rows - 1 - ((y - np.float32(low[1])) / np.float32(pixel)).astype(np.int32)).clip(0, rows - 1)
        hidden = np.zeros(buffers.surface.shape, bool)
        hidden[buffers.hit] = depth[row, column] < self._distance - z
        return hidden

    def _render_along(
        self, axes: Floats, bounds: Bounds, shape: tuple[int, int]
    ) -> tuple[Float32, NDArray[np.int32], Floats, Floats]:
        """Return the depths and faces (H, W) that rays along -axes[2] hit, and the pixels' positions.

        The positions are u (W,) along axes[0] and v (H,) along axes[1].
        """
        left, right, bottom, top = bounds
        height, width = shape
        u = left + (np.arange(width) + 0.5) / width * (right - left)
        v = top - (np.arange(height) + 0.5) / height * (top - bottom)
        looking = make_transform(axes * [[1.0], [-1.0], [-1.0]], [0.0, 0.0, self._distance])
        depth, face = draw_nearest_faces(self._triangles, looking, u, -v)
        return depth, face, u, v


def shade(buffers: Buffers, colours: Floats, shadow: Bools) -> Float32:
    """Return a picture as RGBA (H, W, 4), 0 to 1; pixels without a hit are transparent.

    `colours` (S, 3) has a colour for each surface. `shadow` (H, W) marks the pixels in shadow.
    """
    normals, (surfaces, last) = buffers.face_normals, (buffers.surface_of_face, len(buffers.face_normals))
    diffuse = np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    sky = 0.5 + 0.5 * normals[:, 2]
    palette = np.zeros((2 * last + 1, 4), np.float32)  # the faces in the light and in shadow, and no face
    for start, lit in ((0, 1.0), (last, IN_SHADOW)):
        brightness = 0.30 + 0.22 * sky + 0.55 * lit * diffuse
        palette[start : start + last, :3] = np.clip(colours[surfaces] * brightness[:, None], 0.0, 1.0)
    palette[:-1, 3] = 1.0
    return palette.take(np.where(buffers.hit, buffers.face + np.int32(last) * shadow, np.int32(2 * last)), axis=0)


def shrink(image: Float32, factor: int) -> Float32:
    """Average blocks of `factor` x `factor` pixels of a picture (H, W, 4), RGBA. Opacity weights the colours."""
    alpha = image[..., 3:]
    return unmultiply(average(np.concatenate([alpha * image[..., :3], alpha], axis=-1), factor))


def average(image: Float32, factor: int) -> Float32:
    """Average blocks of `factor` x `factor` pixels of a picture (H, W, C)."""
    height, width = (size // factor * factor for size in image.shape[:2])
    total = sum(image[row:height:factor, column:width:factor] for row in range(factor) for column in range(factor))
    return np.asarray(total / np.float32(factor**2))


def unmultiply(image: Float32) -> Float32:
    """Divide the colours of a picture (H, W, 4), RGBA, by their opacity, in place, and return it."""
    image[..., :3] /= np.maximum(image[..., 3:], np.float32(1e-9))
    return image.clip(0.0, 1.0, out=image)


def compute_normals(triangles: Floats) -> Floats:
    """Return the unit normals (F, 3) of triangles (F, 3, 3); zero for degenerate triangles."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def _pair_neighbours(values: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    return (values[:-1], values[1:]) if axis == 0 else (values[:, :-1], values[:, 1:])
