"""The picture of an inspection: the part, coloured by its differences from the model; the untouched surface is grey."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree
from tactile_loc import TriangleMesh
from tactile_loc.plugin import SensorGeometry
from tactile_loc.plugin.helpers import draw_nearest_depths, invert, make_transform, transform_points

from tactile_loc_inspect.comparison import Floats
from tactile_loc_inspect.inspection import Inspection
from tactile_loc_inspect.scan import VOXEL_M

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 1  # index of the size of blobs whose heights are shown
SIZE_PX = 620
AROUND = 1.08  # size of a view in sizes of what it shows
NEAR = 1.6  # places apart up to which a pixel has the colour of the nearest place
GREY = 0.62
NEAR_BY_M = 5e-3
LEAST_SCALE_M = 1e-4  # least height at the end of the colours
TILT_RAD = 0.45  # of the view beside the direction of the touched surface


def draw_inspection(found: Inspection) -> Figure:
    """Return a figure with the whole part, and with the touched surface near by."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    scale_mm = 1e3 * max(LEAST_SCALE_M, *(abs(one.height_m) for one in found.differences[:3]), 0.0)
    colours = ScalarMappable(Normalize(-scale_mm, scale_mm), "RdBu_r")
    figure = Figure(figsize=(10.4, 5.4), layout="constrained")
    axes = figure.subplots(1, 2)
    mesh, looking = found.object.mesh, _choose_view(found)
    whole, near = (_Camera.around(points, looking) for points in (mesh.corners_m, _choose_near(found)))
    for ax, camera, title in zip(axes, (whole, near), ("the whole part", "near by"), strict=True):
        ax.imshow(camera.paint(mesh, found, colours), extent=camera.extent_mm, interpolation="antialiased")
        for number, one in enumerate(found.differences, 1):
            x, y = 1e3 * transform_points(camera.T_view_object, one.point_m[None])[0, :2]
            left, right, bottom, top = camera.extent_mm
            if left < x < right and top < y < bottom:
                ax.annotate(str(number), (x, y), (12, 12), textcoords="offset points", arrowprops={"arrowstyle": "-"})
        ax.set_title(title, fontsize=10)
        ax.set_xlabel("mm in this view, which is not in the frame of the part")
        ax.tick_params(labelsize=8)
    bar = figure.colorbar(colours, ax=axes, shrink=0.85)
    bar.set_label("part above the model (mm); grey: not touched")
    return figure


class _Camera:
    """An orthographic view of points, along the z axis of a frame whose rotation from the object's is `R` (3, 3)."""

    def __init__(self, R: Floats, middle_m: Floats, side_m: float, far_m: float) -> None:
        self.side_m = side_m
        self.T_view_object = make_transform(R, np.array([0, 0, 2 * far_m]) - R @ middle_m)
        scale = SIZE_PX / side_m
        half = SIZE_PX / 2
        self.geometry = SensorGeometry("orthographic", SIZE_PX, SIZE_PX, scale, scale, half, half, far_m / 2, 4 * far_m)

    @classmethod
    def around(cls, points_m: Floats, R: Floats) -> _Camera:
        """Return the view that shows points (N, 3), metres."""
        seen = points_m @ R.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        far_m = 0.05 + float(np.linalg.norm(points_m, axis=1).max() + np.linalg.norm(high - low))
        return cls(R, R.T @ ((low + high) / 2), AROUND * float((high - low)[:2].max()), far_m)

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """The borders of the picture: left, right, bottom, top."""
        half = 500 * self.side_m
        return -half, half, half, -half

    def paint(self, mesh: TriangleMesh, found: Inspection, colours: Any) -> Floats:
        """Return the picture (H, W, 4) of a mesh, coloured by the differences."""
        depth = draw_nearest_depths(mesh, self.T_view_object[None], self.geometry)[0].astype(float)
        hit = np.isfinite(depth)
        points = self.geometry.backproject(np.where(hit, depth, 0))
        normals = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
        light = 0.45 + 0.55 * np.clip(np.abs(normals @ np.array([0.35, 0.45, 0.82])), 0, 1)
        light = np.where(hit, uniform_filter(light, 2), 1)
        places = found.map
        distances, nearest = cKDTree(places.points_m).query(
            transform_points(invert(self.T_view_object), points[hit]), distance_upper_bound=NEAR * VOXEL_M
        )
        rgb = np.full((int(hit.sum()), 3), GREY)
        shown = np.isfinite(distances)
        rgb[shown] = colours.to_rgba(1e3 * places.heights_m[SHOWN][nearest[shown]])[:, :3]
        picture = np.zeros((*depth.shape, 4))
        picture[hit] = np.column_stack([rgb * light[hit][:, None], np.ones(len(rgb))])
        return picture


def _choose_near(found: Inspection) -> Floats:
    """Return the points (N, 3), metres, to show near by: about the first difference, or else the touched surface."""
    points = found.map.points_m
    first = found.differences[0] if found.differences else found.shift
    if first is None:
        return points
    middle = first.point_m
    return np.concatenate([middle - NEAR_BY_M * np.eye(3), middle + NEAR_BY_M * np.eye(3)])


def _choose_view(found: Inspection) -> Floats:
    """Return the rotation (3, 3) from the object's frame to a view of the first difference or the touched surface."""
    towards = found.differences[0].normal if found.differences else found.map.normals.mean(axis=0)
    towards = towards / max(float(np.linalg.norm(towards)), 1e-12)
    up = np.eye(3)[int(np.abs(towards).argmin())]
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    towards = np.cos(TILT_RAD) * towards + np.sin(TILT_RAD) * (right + np.cross(towards, right)) / np.sqrt(2)
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    return np.stack([right, -np.cross(towards, right), -towards])
