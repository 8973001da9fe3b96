"""Tolerances of poses: the largest pose error, rotation, shape distance or displacement of one point."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Floats, Poses, invert, transform_points
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.surface_field import build_surface_field
from tactile_loc.core.poses.pose_errors import RIGHT_M, measure_pose_errors
from tactile_loc.core.runtime.errors import ConfigError, quote

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

POINTS = 200  # points of the surface whose distances are averaged
FAR_POINTS = 5000  # samples of the surface for the distances of points beyond the reach of its field
EXPECTED = (
    "give a pose error in mm, a rotation in degrees, or both, such as 0.5mm,2deg; or shape:1mm for the shape alone, or "
    "tip:0.5mm@0,0,30 for the point at x, y, z of the mesh, mm"
)
_NUMBER = r"[0-9]*\.?[0-9]+(?:e[+-]?[0-9]+)?"
_PART = re.compile(rf"({_NUMBER})\s*(mm|deg)")
_POINT = re.compile(rf"(.*)@\s*([+-]?{_NUMBER})\s*,\s*([+-]?{_NUMBER})\s*,\s*([+-]?{_NUMBER})")


@dataclass(frozen=True)
class Tolerance:
    """The largest distance, metres, and the largest rotation, radians, between poses that count as equal.

    The distance is the pose error: see `measure_pose_errors`. With a `tip_m`, a point (3,) of the object's frame,
    metres, only the displacement of this point counts. With `of_shape`, the distance is the mean distance of the
    surface at one pose from the surface at the other pose, which forgives a turned shaft. All are measured up to
    symmetry. None sets no limit; at least one limit is needed. Raises ConfigError if a limit is not positive and
    finite.
    """

    distance_m: float | None = RIGHT_M
    rotation_rad: float | None = None
    of_shape: bool = False
    tip_m: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        limits = [limit for limit in (self.distance_m, self.rotation_rad) if limit is not None]
        if not limits or not all(limit > 0 and math.isfinite(limit) for limit in limits):
            raise ConfigError(
                f"the tolerance {self.distance_m} m, {self.rotation_rad} rad is not usable; give a positive distance, "
                "a positive rotation, or both"
            )
        if self.tip_m is not None and not all(map(math.isfinite, self.tip_m)):
            raise ConfigError(f"the point {self.tip_m} of a tolerance is not finite; give its x, y and z")
        if (self.distance_m is None and (self.of_shape or self.tip_m)) or (self.of_shape and self.tip_m):
            raise ConfigError("a tolerance of the shape, or of a tip, needs one distance; give for example shape:1mm")

    @classmethod
    def parse(cls, text: str) -> Tolerance:
        """Read a tolerance in mm and degrees: `1mm`, `2deg`, `0.5mm,2deg`, `shape:1mm` or `tip:0.5mm@0,0,30`.

        The point of a tip is in mm, in the object's frame. Raises ConfigError for other texts.
        """
        kind, colon, limits_text = text.strip().lower().rpartition(":")
        point = _POINT.fullmatch(limits_text) if kind == "tip" else None
        found = [_PART.fullmatch(part.strip()) for part in (point[1] if point else limits_text).split(",")]
        limits = {part[2]: float(part[1]) for part in found if part is not None}
        readable = None not in found and len(limits) == len(found) and kind in ("", "shape", "tip")
        readable = readable and (kind != "tip" or point is not None) and (not kind or "mm" in limits)
        readable = readable and bool(kind) == bool(colon)
        if not readable or not all(0 < limit < math.inf for limit in limits.values()):
            raise ConfigError(f"the tolerance {quote(text)} cannot be read; {EXPECTED}")
        mm, deg = limits.get("mm"), limits.get("deg")
        tip_m = None if point is None else (1e-3 * float(point[2]), 1e-3 * float(point[3]), 1e-3 * float(point[4]))
        return cls(
            None if mm is None else 1e-3 * mm, None if deg is None else math.radians(deg), kind == "shape", tip_m
        )

    def __str__(self) -> str:
        """Return the text that `parse` reads: 0.5mm,2deg."""
        limits = ",".join(f"{value:.6g}{unit}" for value, unit in self._list_limits())
        if self.tip_m is not None:
            return f"tip:{limits}@{','.join(f'{1e3 * value:.6g}' for value in self.tip_m)}"
        return f"shape:{limits}" if self.of_shape else limits

    def describe(self) -> str:
        """Return the tolerance in words: 0.5 mm and 2 degrees."""
        names = {"mm": "mm", "deg": "degrees"}
        limits = " and ".join(f"{value:.6g} {names[unit]}" for value, unit in self._list_limits())
        return (
            f"{limits} at the tip" if self.tip_m is not None else f"{limits} of the shape" if self.of_shape else limits
        )

    def find_within(self, obj: ObjectModel, T: Poses, T_other: Poses) -> Bools:
        """Return whether the pose T (4, 4), metres, is within the tolerance of each pose T_other (N, 4, 4), as (N,)."""
        within = np.ones(len(T_other), bool)
        if self.rotation_rad is not None:
            turned_rad = obj.symmetry.measure_least_angle(T[:3, :3], T_other[:, :3, :3])
            within &= turned_rad <= self.rotation_rad
        if self.distance_m is not None:
            near = np.flatnonzero(within)
            within[near] = self.measure_distances(obj, T, T_other[near], self.distance_m) <= self.distance_m
        return within

    def measure_distances(self, obj: ObjectModel, T: Poses, T_other: Poses, limit_m: float = 0.0) -> Floats:
        """Return the distances (N,), metres, that the tolerance limits, of poses T_other (N, 4, 4) from T (4, 4).

        With a positive `limit_m`, metres, a distance is only right in that it is or is not above this limit.
        """
        if self.of_shape:
            return measure_shape_distances(obj.mesh, T, T_other, limit_m or math.inf)
        points_m = None if self.tip_m is None else np.array([self.tip_m])
        return measure_pose_errors(obj, T_other, T, points_m, limit_m)

    def measure_ratios(self, obj: ObjectModel, T: Poses, T_other: Poses) -> Floats:
        """Return how far poses T_other (N, 4, 4), metres, are from T (4, 4), as multiples (N,) of the tolerance."""
        ratios = np.zeros(len(T_other))
        if self.rotation_rad is not None:
            ratios = obj.symmetry.measure_least_angle(T[:3, :3], T_other[:, :3, :3]) / self.rotation_rad
        if self.distance_m is not None:
            ratios = np.maximum(ratios, self.measure_distances(obj, T, T_other) / self.distance_m)
        return ratios

    def _list_limits(self) -> list[tuple[float, str]]:
        limits = [(1e3, self.distance_m, "mm"), (180 / math.pi, self.rotation_rad, "deg")]
        return [(scale * limit, unit) for scale, limit, unit in limits if limit is not None]


def measure_shape_distances(mesh: TriangleMesh, T: Poses, T_other: Poses, most_m: float = math.inf) -> Floats:
    """Return the shape distances (N,), metres: the mean distances of the surface at poses T from that at T_other.

    One of the two has the shape (N, 4, 4), metres, and the other may have the shape (4, 4). Means up to `most_m` are
    right, and larger means may be too small.
    """
    field, points_m, moves = build_surface_field(mesh), _sample_points(mesh), invert(T_other) @ T
    distances_m = field.measure_distances(points_m, moves)
    far = np.isinf(distances_m)
    distances_m[far] = field.reach_m  # at least
    open_ = np.flatnonzero(far.any(axis=1) & (distances_m.mean(axis=1) <= most_m))
    pose, point = np.nonzero(far[open_])
    moved_m = transform_points(moves[open_][pose], points_m[point][:, None])[:, 0]
    distances_m[open_[pose], point] = _build_tree(mesh).query(moved_m)[0]
    return np.asarray(distances_m.mean(axis=1))


ONE_MILLIMETRE = Tolerance()


@lru_cache(maxsize=64)
def _build_tree(mesh: TriangleMesh) -> cKDTree:
    """Return a search tree of surface samples, dense enough for the distances of far points."""
    from scipy.spatial import cKDTree  # scipy takes a while to import

    return cKDTree(mesh.sample(FAR_POINTS, np.random.default_rng(1)))


@lru_cache(maxsize=64)
def _sample_points(mesh: TriangleMesh) -> Floats:
    return mesh.sample(POINTS, np.random.default_rng(0))
