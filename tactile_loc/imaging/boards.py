"""Two calibration boards: plates with simple raised shapes, to press on a sensor anywhere and learn what it shows.

After the idea of Bauza et al. (CoRL 2020, appendix); the shapes are our own. A board's frame has its origin in the
middle of the plate's upper face, x along the longer side and z out of the raised side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.geometry.rigid import Poses, make_transform, rotation_about
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

if TYPE_CHECKING:
    import trimesh

PLATE_M = (0.080, 0.060, 0.006)
COLUMNS, ROWS, PITCH_M = 7, 5, 0.010
HEIGHTS_M = (0.0020, 0.0025, 0.0030, 0.0035, 0.0040, 0.0035, 0.0030, 0.0025)  # neighbours touch together
SCALES = (1.0, 0.6, 0.8, 0.45, 0.7)  # of a shape's full size, which fills its place on the plate
LEANS_RAD = tuple(math.radians(d) for d in (0, 12, 0, 25, 6, 0, 18))  # of one shape after another
SUNK_M = 0.001  # how far the shapes reach into the plate: they overlap, so that no gap is left
GOLDEN_RAD = math.pi * (3 - math.sqrt(5))  # turns neighbours by angles that never repeat
MOST_TILT_RAD = math.radians(8)
MIDDLE = 0.8  # of the board, whose parts come over the middle of the sensor: at its ends there is little to see
ABOVE_M = 0.001  # of the undeformed surface, before a pose is brought to contact

Shape = Callable[[float, float], "trimesh.Trimesh"]


def make_board(number: int) -> ObjectModel:
    """Return calibration board 1 or 2, metres. Raises ConfigError for another number.

    Board 1 has cylinders, boxes, cones, spherical caps, pairs of rods and caps with a slot, board 2 pyramids, rings,
    ridges, steps, rods and rounded rings: 35 each, half of them leaning, 2 to 4 mm high. Every part is closed, and
    overlaps the plate without being united with it.
    """
    import trimesh

    if number not in (1, 2):
        raise ConfigError(f"there is no calibration board {number}; give 1 or 2")
    first = (_make_cylinder, _make_box, _make_cone, _make_cap, _make_rods, _make_slotted)
    second = (_make_pyramid, _make_ring, _make_ridge, _make_steps, _make_rod, _make_torus)
    shapes = first if number == 1 else second
    x, y, thickness = PLATE_M
    plate = trimesh.creation.box(bounds=[(-x / 2, -y / 2, -thickness), (x / 2, y / 2, 0.0)])
    whole = _join(plate, *_place_shapes(shapes))
    mesh = TriangleMesh(np.asarray(whole.vertices, np.float64), np.asarray(whole.faces, np.int64))
    return ObjectModel(f"calibration-board-{number}", mesh, SymmetryGroup.parse("none", mesh.centroid_m))


def draw_board_poses(board: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
    """Draw poses `T_sensor_object` (count, 4, 4), metres, of a board above the sensor, its raised side down on it.

    Any yaw, tilts up to `MOST_TILT_RAD` in any direction, any place of the board over the middle of the sensing
    rectangle. All of the board lies beyond the undeformed surface: bring the poses to contact.
    """
    from scipy.spatial.transform import Rotation

    yaw, towards = (rng.uniform(0, 2 * math.pi, count) for _ in range(2))
    tilt = MOST_TILT_RAD * rng.random(count)
    axis = np.stack([np.cos(towards), np.sin(towards), np.zeros(count)], axis=-1)
    tilted = Rotation.from_rotvec(tilt[:, None] * axis).as_matrix()
    R = tilted @ rotation_about([0, 0, 1], yaw) @ np.diag([1.0, -1.0, -1.0])
    half = MIDDLE * np.array([COLUMNS, ROWS]) * PITCH_M / 2
    place = np.concatenate([rng.uniform(-half, half, (count, 2)), np.zeros((count, 1))], axis=1)
    x0, x1, y0, y1 = geometry.rectangle
    t = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0]) - np.einsum("nij,nj->ni", R, place)
    lowest = (board.mesh.vertices_m @ R[:, 2, :].T).min(axis=0)
    t[:, 2] = geometry.standoff_m + ABOVE_M - lowest
    return make_transform(R, t)


def _place_shapes(shapes: tuple[Shape, ...]) -> list[trimesh.Trimesh]:
    """The shapes at their places on the plate, in turn, of sizes, heights and yaws that follow one another."""
    placed = []
    for i in range(ROWS * COLUMNS):
        row, column = divmod(i, COLUMNS)
        kind = (column + 2 * row) % len(shapes)
        radius_m = 0.5 * PITCH_M * SCALES[(row + column // 2) % len(SCALES)]
        height_m = HEIGHTS_M[(row + column) % len(HEIGHTS_M)]
        solid = shapes[kind](radius_m, height_m)
        solid.apply_transform(make_transform(rotation_about([1, 0, 0], LEANS_RAD[i % len(LEANS_RAD)]), np.zeros(3)))
        centre = [
            (column - (COLUMNS - 1) / 2) * PITCH_M,
            (row - (ROWS - 1) / 2) * PITCH_M,
            height_m - solid.bounds[1, 2],
        ]
        solid.apply_transform(make_transform(rotation_about([0, 0, 1], i * GOLDEN_RAD), centre))
        placed.append(solid)
    return placed


def _make_cylinder(radius_m: float, height_m: float) -> trimesh.Trimesh:
    return _wrap([*_trace(radius_m, -SUNK_M), *_trace(radius_m, height_m)])


def _make_cone(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """A cone with a blunt tip."""
    return _wrap([*_trace(radius_m, -SUNK_M), *_trace(radius_m, 0.0), *_trace(0.25 * radius_m, height_m)])


def _make_cap(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """The cap of a sphere, as high as asked for, at most half of it."""
    height = min(height_m, radius_m)
    sphere_m = (radius_m**2 + height**2) / (2 * height)
    widest = math.asin(min(1.0, radius_m / sphere_m))
    rings = [
        _trace(sphere_m * math.sin(a), height - sphere_m * (1 - math.cos(a)))
        for a in np.linspace(0, widest, 17)[1:]
    ]  # fmt: skip
    return _wrap([(0.0, 0.0, height), *np.concatenate(rings), *_trace(radius_m, -SUNK_M)])


def _make_slotted(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """A cap with a slot through its middle, as a screw's head."""
    whole, gap = np.asarray(_make_cap(radius_m, height_m).vertices), 0.12 * radius_m
    halves = [side * np.maximum(side * whole[:, 0], gap) for side in (-1, 1)]
    return _join(*(_wrap(np.column_stack([x, whole[:, 1:]])) for x in halves))


def _make_box(radius_m: float, height_m: float) -> trimesh.Trimesh:
    x, y = 0.86 * radius_m, 0.5 * radius_m
    return _wrap([(a, b, z) for a in (-x, x) for b in (-y, y) for z in (-SUNK_M, height_m)])


def _make_pyramid(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """A square pyramid with a blunt tip."""
    corners = [
        _trace(radius_m, -SUNK_M, 4),
        _trace(radius_m, 0.0, 4),
        _trace(0.25 * radius_m, height_m, 4),
    ]
    return _wrap(np.concatenate(corners))


def _make_ring(radius_m: float, height_m: float) -> trimesh.Trimesh:
    import trimesh

    solid: trimesh.Trimesh = trimesh.creation.annulus(0.6 * radius_m, radius_m, height_m + SUNK_M, sections=64)
    solid.apply_translation([0, 0, (height_m - SUNK_M) / 2])
    return solid


def _make_ridge(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """A rounded ridge: half an elliptic cylinder, lying."""
    angle = np.linspace(0, math.pi, 33)
    arc = np.stack([0.45 * radius_m * np.cos(angle), height_m * np.sin(angle)], axis=1)
    profile = [*arc, (0.45 * radius_m, -SUNK_M), (-0.45 * radius_m, -SUNK_M)]
    return _wrap([(x, y, z) for x in (-0.85 * radius_m, 0.85 * radius_m) for y, z in profile])


def _make_rod(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """A lying rod with round ends, sunk to half of itself or less."""
    return _make_capsule(radius_m, 0.3 * radius_m, height_m, 0.0)


def _make_rods(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """Two lying rods side by side, a narrow gap between them; one is longer."""
    rods = ((radius_m, -1), (0.7 * radius_m, 1))
    return _join(*(_make_capsule(x, 0.25 * radius_m, height_m, s * 0.28 * radius_m) for x, s in rods))


def _make_capsule(half_length_m: float, radius_m: float, height_m: float, aside_m: float) -> trimesh.Trimesh:
    """A lying rod of this radius, its top at a height, with straight walls below its middle."""
    ball = radius_m * _trace_hemisphere()
    x = half_length_m - radius_m
    upper = np.concatenate([ball + np.array([end, aside_m, height_m - radius_m]) for end in (-x, x)])
    return _wrap([*upper, *(upper * [1, 1, 0] - [0, 0, SUNK_M])])


def _make_torus(radius_m: float, height_m: float) -> trimesh.Trimesh:
    import trimesh

    thick = 0.25 * radius_m
    solid: trimesh.Trimesh = trimesh.creation.torus(radius_m - thick, thick, major_sections=48, minor_sections=24)
    solid.apply_transform(np.diag([1, 1, (height_m + SUNK_M) / (2 * thick), 1]))
    solid.apply_translation([0, 0, (height_m - SUNK_M) / 2])
    return solid


def _make_steps(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """A hexagonal prism with a lower, wider one around it."""
    sizes = ((radius_m, height_m - 0.0008), (0.6 * radius_m, height_m))
    prisms = [_wrap([*_trace(r, -SUNK_M, 6), *_trace(r, z, 6)]) for r, z in sizes]
    return _join(*prisms)


def _trace(radius_m: float, z_m: float, points: int = 64) -> NDArray[np.float64]:
    """Points (points, 3) of a circle about z, metres."""
    angle = np.arange(points) * 2 * math.pi / points
    return np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(points, z_m)], axis=1)


def _trace_hemisphere() -> NDArray[np.float64]:
    """Points (P, 3) of the upper half of a unit sphere."""
    rings = [_trace(math.cos(a), math.sin(a), 32) for a in np.linspace(0, math.pi / 2, 9)]
    return np.concatenate(rings)


def _join(*solids: trimesh.Trimesh) -> trimesh.Trimesh:
    import trimesh

    return cast("trimesh.Trimesh", trimesh.util.concatenate(list(solids)))


def _wrap(points_m: ArrayLike) -> trimesh.Trimesh:
    """The convex solid around points (P, 3), metres."""
    import trimesh

    hull: trimesh.Trimesh = trimesh.Trimesh(np.asarray(points_m, float), process=False).convex_hull
    return hull
