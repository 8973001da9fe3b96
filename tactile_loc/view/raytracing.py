"""Shaded pictures of posed meshes from an orthographic camera.

A picture is an array (H, W, 4) of colours, 0 to 1, multiplied by their opacity, and the opacity.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, make_transform
from tactile_loc.core.runtime.compiled import njit
from tactile_loc.core.sensing.zbuffer import draw_nearest_faces

Bounds = tuple[float, float, float, float]

LIGHT = np.array([0.35, -0.45, 0.82])  # direction towards the light in the sensor frame: up, right and in front
CREASE_DEG = 28.0
LIT_PX = 750  # pixels along the longer side of the picture seen from the light
IN_SHADOW = 0.35  # share of the diffuse light in shadow
EDGE_OPACITY = 0.75


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

    `face` (H, W) are indices of faces, or -1 without a hit. `depth` (H, W) is the length of the ray.
    """

    face: NDArray[np.int32]
    depth: Float32
    normals: Float32
    """Unit normals (F, 3) of all faces, towards the viewer."""
    surface_of_face: NDArray[np.int32]
    """The index (F,) of each face's surface."""
    origins: tuple[Floats, Floats, Floats]
    """The rays' starts and direction: right (W, 3), up (H, 3) and towards (3,).

    A ray starts at the sum of its column's `right` and its row's `up`. Its direction is minus `towards`.
    """
    bounds: Bounds

    @cached_property
    def surface(self) -> NDArray[np.int32]:
        """The indices (H, W) of the surfaces, or -1 without a hit."""
        return np.append(self.surface_of_face, np.int32(-1))[self.face]

    def find_surfaces(self, places: Floats) -> NDArray[np.int32]:
        """Return the surfaces (N,), or -1, that the picture shows at places (N, 2), right and up."""
        left, right, bottom, top = self.bounds
        height, width = self.face.shape
        columns = ((places[:, 0] - left) / (right - left) * width).astype(int).clip(0, width - 1)
        rows = ((top - places[:, 1]) / (top - bottom) * height).astype(int).clip(0, height - 1)
        return self.surface[rows, columns]

    def find_edges(self, jump: float) -> Bools:
        """Return a mask (H, W) of outlines, creases, and depth steps larger than `jump` (in the points' unit)."""
        marked = np.empty(self.face.shape, bool)
        _mark_edges((self.face, self.depth, self.surface_of_face, self.normals), _limit_edges(jump), marked)
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
        normals = np.where(self._normals @ axes[2] < 0, -1.0, 1.0)[:, None] * self._normals
        origins = u[:, None] * axes[0] + self._distance * axes[2], v[:, None] * axes[1], axes[2]
        return Buffers(face, depth, normals.astype(np.float32), self._of_face, origins, bounds)

    def paint(self, seen: Buffers, colours: Floats, jump: float, lift: float, factor: int) -> Float32:
        """Return a shaded picture, in which blocks of `factor` x `factor` pixels are averaged.

        The first rows of `colours` (S + 1, 3) are those of the surfaces, and the last row is the colour of edges:
        outlines, creases and depth steps larger than `jump`. A second picture, seen from the light, finds the shadows.
        Points are moved along their normals by `lift` plus 1.5 of its pixels, so that they do not shade themselves.
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
        lit, *_ = self._render_along(axes, bounds, (rows, columns))
        # all positions in pixels of the picture seen from the light, down and right from its corner
        scale, corner = (
            np.array([1.0, -1.0, -1.0]) / pixel,
            np.array([-low[0], -low[1] - rows * pixel, -self._distance]),
        )
        starts, up, along, lifted = (
            np.asarray(part @ axes.T * scale, np.float32)
            for part in (*seen.origins, (lift + 1.5 * pixel) * seen.normals)
        )
        starts += (corner * scale).astype(np.float32)
        height, width = (size // factor for size in seen.face.shape)
        picture = np.zeros((height, width, 4), np.float32)
        shown = seen.face, seen.depth, seen.surface_of_face, seen.normals
        light = starts, up, along, lifted, lit / np.float32(pixel)
        _paint(shown, _limit_edges(jump), light, _mix_colours(seen, colours), factor, picture)
        return picture

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


def _mix_colours(seen: Buffers, colours: Floats) -> Float32:
    """Return the colours (2, 2, F, 3) of faces in the light and in shadow, without and with an edge."""
    diffuse = np.clip(seen.normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    sky = 0.5 + 0.5 * seen.normals[:, 2]
    plain = [
        np.clip(colours[seen.surface_of_face] * (0.30 + 0.22 * sky + 0.55 * share * diffuse)[:, None], 0.0, 1.0)
        for share in (1.0, IN_SHADOW)
    ]
    edged = [(1 - EDGE_OPACITY) * colour + EDGE_OPACITY * colours[-1] for colour in plain]
    return np.stack([plain, edged], axis=1).astype(np.float32)


def count_marked(mask: Bools, factor: int) -> Float32:
    """Return the share of marked pixels (H, W), 0 to 1, in blocks of `factor` x `factor` pixels of a mask."""
    height, width = (size // factor for size in mask.shape)
    blocks = mask[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))


def blend(below: Float32, above: Float32, opacity: float) -> Float32:
    """Return a picture with another one over it that is seen through."""
    above = np.float32(opacity) * above
    return above + (1 - above[..., 3:]) * below


def unmultiply(image: Float32) -> Float32:
    """Divide the colours of a picture by their opacity, in place, and return it."""
    image[..., :3] /= np.maximum(image[..., 3:], np.float32(1e-9))
    return image.clip(0.0, 1.0, out=image)


def compute_normals(triangles: Floats) -> Floats:
    """Return the unit normals (F, 3) of triangles (F, 3, 3); zero for degenerate triangles."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def _limit_edges(jump: float) -> tuple[np.float32, np.float32]:
    """Return the depth step, and the cosine of the angle between two faces, beyond which there is an edge."""
    return np.float32(jump), np.float32(np.cos(np.radians(CREASE_DEG)))


@njit
def _mark_edges(shown, limits, marked):
    """Fill the mask `marked` (H, W): see `Buffers.find_edges`."""
    for row in range(marked.shape[0]):
        for column in range(marked.shape[1]):
            marked[row, column] = _is_edge(row, column, shown, limits)


@njit
def _is_edge(row, column, shown, limits):
    """Return whether there is an edge between a pixel and the one below it, or the one right of it."""
    (face, depth, of_face, normals), (jump, cosine) = shown, limits
    one = face[row, column]
    for down, across in ((1, 0), (0, 1)):
        if row + down >= face.shape[0] or column + across >= face.shape[1]:
            continue
        other = face[row + down, column + across]
        if one == other:
            if one >= 0 and abs(depth[row, column] - depth[row + down, column + across]) > jump:
                return True
            continue
        if one < 0 or other < 0 or of_face[one] != of_face[other]:
            return True
        if abs(depth[row, column] - depth[row + down, column + across]) > jump:
            return True
        n, m = normals[one], normals[other]
        if n[0] * m[0] + n[1] * m[1] + n[2] * m[2] < cosine:
            return True
    return False


@njit
def _paint(shown, limits, light, colours, factor, picture):
    """Fill `picture` (H, W, 4), which is zero, with the means of blocks of pixels: see `Tracer.paint`.

    `light` has the rays' starts (W, 3) and (H, 3), their direction (3,), the moves of points (F, 3), and the depths in
    the picture seen from the light. All are in pixels of that picture, and x is right, y is down, z is away.
    """
    (face, depth), (starts, up, along, lifted, lit) = shown[:2], light
    share = np.float32(1.0 / factor**2)
    for row in range(picture.shape[0] * factor):
        for column in range(picture.shape[1] * factor):
            f = face[row, column]
            if f < 0:
                continue
            d = depth[row, column]
            x = starts[column, 0] + up[row, 0] - d * along[0] + lifted[f, 0]
            y = starts[column, 1] + up[row, 1] - d * along[1] + lifted[f, 1]
            z = starts[column, 2] + up[row, 2] - d * along[2] + lifted[f, 2]
            u, v = min(max(int(x), 0), lit.shape[1] - 1), min(max(int(y), 0), lit.shape[0] - 1)
            colour = colours[int(lit[v, u] < z), int(_is_edge(row, column, shown, limits)), f]
            mean = picture[row // factor, column // factor]
            mean[0] += share * colour[0]
            mean[1] += share * colour[1]
            mean[2] += share * colour[2]
            mean[3] += share
