"""Exact rendering by ray casting, with open3d's RaycastingScene.

The scene is built once for each mesh, in the object frame. A pose moves the rays, not the object. Usually, only a few
percent of a picture are within the contact band. Rays are therefore cast only in the box of pixels that can see the
object within the band.
"""

from __future__ import annotations

from collections import OrderedDict
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import ComponentOptions, Float32, Poses, Renderer, RenderError, SensorGeometry, TriangleMesh

PixelBox = tuple[slice, slice]

if find_spec("open3d") is None:  # it is imported at first use, because that takes a second
    raise ModuleNotFoundError("No module named 'open3d'", name="open3d")

MOST_MESHES = 4  # meshes whose search structure is kept


class RaycastRenderer(Renderer):
    """Casts one ray through each pixel centre: exact to a fraction of a micrometre, including below overhangs."""

    def __init__(self, options: ComponentOptions | None = None) -> None:
        super().__init__(options)
        self._meshes: OrderedDict[str, tuple[Any, _Surface]] = OrderedDict()

    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths z (N, H, W) in metres at pixel centres for poses (N, 4, 4).

        Pixels without a surface are inf. Surfaces deeper than standoff + max_depth may be inf. Raises RenderError when
        open3d cannot be loaded.
        """
        scene, surface = self._prepare_scene(mesh)
        depth = np.full((len(T_sensor_object), *geometry.shape), np.inf, np.float32)
        end = geometry.standoff_m + geometry.max_depth_m
        for picture, T in zip(depth, T_sensor_object, strict=True):
            box = _find_pixel_box(surface.find_points_below(end, T), geometry)
            picture[box] = _cast(scene, _make_rays(T, box, geometry))
        return depth

    def _prepare_scene(self, mesh: TriangleMesh) -> tuple[Any, _Surface]:
        """Return the mesh's ray casting scene and edges, built at first use. The last used meshes are kept."""
        prepared = self._meshes.pop(mesh.digest, None) or (_build_scene(mesh), _Surface(mesh))
        self._meshes[mesh.digest] = prepared  # the last used comes last
        while len(self._meshes) > MOST_MESHES:
            self._meshes.popitem(last=False)
        return prepared


def _build_scene(mesh: TriangleMesh) -> Any:
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise RenderError(
            f"the raycast renderer cannot load open3d ({error}); on Debian, install libusb-1.0-0 and libgomp1, or "
            "choose `renderer` heightmap"
        ) from error
    scene = open3d.t.geometry.RaycastingScene()
    vertices, faces = np.ascontiguousarray(mesh.vertices_m, np.float32), np.ascontiguousarray(mesh.faces, np.uint32)
    scene.add_triangles(open3d.core.Tensor.from_numpy(vertices), open3d.core.Tensor.from_numpy(faces))
    return scene


def _cast(scene: Any, rays: Float32) -> Float32:
    """Return the distances (...) along rays (..., 6) to the surface. The distance is inf for a ray without a hit."""
    import open3d

    return np.asarray(scene.cast_rays(open3d.core.Tensor.from_numpy(rays))["t_hit"].numpy())


def _make_rays(T_sensor_object: NDArray[np.float64], box: PixelBox, geometry: SensorGeometry) -> Float32:
    """Return the rays (h, w, 6) of a box of pixels in the object frame: origin in metres, and direction.

    In the sensor frame, the direction's z component is one. The distance to a hit, in direction vectors, is therefore
    the camera depth.
    """
    R, t = T_sensor_object[:3, :3], T_sensor_object[:3, 3]
    x, y = geometry.pixel_slopes
    across, down = x[box[1], None] * R[0], y[box[0], None] * R[1]
    rays = np.empty((len(down), len(across), 6), np.float32)
    camera, forward = -t @ R, R[2]
    if geometry.is_pinhole:
        rays[..., :3] = camera
        np.add(down[:, None], across + forward, out=rays[..., 3:], casting="same_kind")
    else:
        np.add(down[:, None], across + camera, out=rays[..., :3], casting="same_kind")
        rays[..., 3:] = forward
    return rays


class _Surface:
    """A mesh's vertices and edges, which are used to find the mesh's part that is not deeper than a limit."""

    def __init__(self, mesh: TriangleMesh) -> None:
        count = len(mesh.vertices_m)
        ends = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        self._edges = np.stack(np.divmod(np.unique(ends[:, 0] * count + ends[:, 1]), count))
        self._vertices = mesh.vertices_m

    def find_points_below(self, limit_m: float, T_sensor_object: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (P, 3), metres, in the sensor frame. Their convex hull contains the part with z <= limit."""
        R, t = T_sensor_object[:3, :3], T_sensor_object[:3, 3]
        beyond = self._vertices @ R[2] + (t[2] - limit_m)
        near = beyond <= 0.0
        a, b = self._edges[:, near[self._edges[0]] != near[self._edges[1]]]
        share = (beyond[a] / (beyond[a] - beyond[b]))[:, None]
        crossings = (1.0 - share) * self._vertices[a] + share * self._vertices[b]
        return np.concatenate([self._vertices[near], crossings]) @ R.T + t


def _find_pixel_box(points_m: NDArray[np.float64], geometry: SensorGeometry) -> PixelBox:
    """Return the rows and columns of the pixels that can see the hull of points (P, 3), metres.

    Both are empty if there are no points.
    """
    g = geometry
    if len(points_m) == 0:
        return slice(0, 0), slice(0, 0)
    x, y, z = points_m.T
    if g.is_pinhole and z.min() <= 0.0:  # points behind the camera have no projection
        return slice(0, g.height_px), slice(0, g.width_px)
    x, y = (x / z, y / z) if g.is_pinhole else (x, y)
    return _find_span(y, g.fy, g.cy, g.height_px), _find_span(x, g.fx, g.cx, g.width_px)


def _find_span(slopes: NDArray[np.float64], f: float, c: float, size: int) -> slice:
    """Return the pixels with centres between the least and the greatest slope, and one more pixel at each end."""
    first, last = np.clip([slopes.min() * f + c - 1.5, slopes.max() * f + c + 1.5], 0, size)
    return slice(int(first), int(np.ceil(last)))
