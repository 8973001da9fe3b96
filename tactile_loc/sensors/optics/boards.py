"""Two calibration boards: plates with simple raised shapes, for pressing a sensor in simulation.

The idea is from Bauza et al. (CoRL 2020, appendix), but the shapes are different. The origin of a board's frame is the
middle of the plate's upper face. The x axis is along the plate's longer side, and z points out of the raised side.
"""

import math
from collections.abc import Callable
from typing import cast

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from tactile_loc.core.geometry.rigid import Poses, make_transform, rotation_about
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

PLATE_M = (0.080, 0.060, 0.006)
COLUMNS, ROWS, PITCH_M = 7, 5, 0.010
HEIGHTS_M = (0.0020, 0.0025, 0.0030, 0.0035, 0.0040, 0.0035, 0.0030, 0.0025)  # similar for neighbours
SCALES = (1.0, 0.6, 0.8, 0.45, 0.7)  # relative to a shape's full size, which fills its place on the plate
LEANS_RAD = tuple(math.radians(d) for d in (0, 12, 0, 25, 6, 0, 18))  # tilts of consecutive shapes
SUNK_M = 0.001  # overlap of the shapes with the plate, which leaves no gap
GOLDEN_RAD = math.pi * (3 - math.sqrt(5))  # angle between neighbours' yaws, which never repeat
MOST_TILT_RAD = math.radians(8)
MIDDLE = 0.8  # share of the board, around its middle, from which the point over the sensor's middle is drawn
ABOVE_M = 0.001  # distance from the undeformed surface before a pose is brought to contact

Shape = Callable[[float, float], trimesh.Trimesh]


def make_board(number: int) -> ObjectModel:
    """Return calibration board 1 or 2, metres. Raises ConfigError for another number.

    Board 1 has cylinders, boxes, cones, spherical caps, pairs of rods and caps with a slot. Board 2 has pyramids,
    rings, ridges, steps, rods and rounded rings. Each board has 35 shapes, 2 to 4 mm high. About half of the shapes
    lean. Every shape is a closed surface that overlaps the plate.
    """
    if number not in (1, 2):
        raise ConfigError(f"there is no calibration board {number}; choose 1 or 2")
    shapes = BOARDS[number - 1]
    x, y, thickness = PLATE_M
    plate = trimesh.creation.box(bounds=[(-x / 2, -y / 2, -thickness), (x / 2, y / 2, 0.0)])
    whole = _join(plate, *_place_shapes(shapes))
    mesh = TriangleMesh(np.asarray(whole.vertices, np.float64), np.asarray(whole.faces, np.int64))
    return ObjectModel(f"calibration-board-{number}", mesh, SymmetryGroup.parse("none", mesh.centroid_m))


def draw_board_poses(board: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
    """Draw poses `T_sensor_object` (count, 4, 4), metres, of a board with its raised side towards the sensor.

    Yaw is arbitrary. Tilts are at most `MOST_TILT_RAD`, in any direction. The point over the middle of the sensing
    rectangle is drawn from the inner part of the board (see MIDDLE). At these poses, the board does not touch the gel:
    bring them to contact.
    """
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
    """Return the shapes at their places on the plate, with alternating kinds, sizes, heights and yaws."""
    placed = []
    for i in range(ROWS * COLUMNS):
        row, column = divmod(i, COLUMNS)
        radius_m = 0.5 * PITCH_M * SCALES[(row + column // 2) % len(SCALES)]
        height_m = HEIGHTS_M[(row + column) % len(HEIGHTS_M)]
        solid = shapes[(column + 2 * row) % len(shapes)](radius_m, height_m)
        solid.apply_transform(make_transform(rotation_about([1, 0, 0], LEANS_RAD[i % len(LEANS_RAD)]), np.zeros(3)))
        x_m, y_m = (column - (COLUMNS - 1) / 2) * PITCH_M, (row - (ROWS - 1) / 2) * PITCH_M
        centre = [x_m, y_m, height_m - solid.bounds[1, 2]]
        solid.apply_transform(make_transform(rotation_about([0, 0, 1], i * GOLDEN_RAD), centre))
        placed.append(solid)
    return placed


def _stack_rings(*rings: tuple[float, float], sides: int = 64) -> trimesh.Trimesh:
    """Return the hull of rings about z, each (radius, z), metres, with a number of `sides`."""
    return _wrap(np.concatenate([_trace(radius_m, z_m, sides) for radius_m, z_m in rings]))


def _make_blunt(radius_m: float, height_m: float, sides: int = 64) -> trimesh.Trimesh:
    """Make a cone or a pyramid with a blunt tip."""
    return _stack_rings((radius_m, -SUNK_M), (radius_m, 0.0), (0.25 * radius_m, height_m), sides=sides)


def _make_cap(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """Make a spherical cap of at most a hemisphere."""
    height = min(height_m, radius_m)
    sphere_m = (radius_m**2 + height**2) / (2 * height)
    angles = np.linspace(0, math.asin(min(1.0, radius_m / sphere_m)), 17)[1:]
    rings = [_trace(sphere_m * math.sin(a), height - sphere_m * (1 - math.cos(a))) for a in angles]
    return _wrap([(0.0, 0.0, height), *np.concatenate(rings), *_trace(radius_m, -SUNK_M)])


def _make_slotted(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """Make a cap with a slot through its middle, such as a screw's head."""
    whole, gap = np.asarray(_make_cap(radius_m, height_m).vertices), 0.12 * radius_m
    halves = [side * np.maximum(side * whole[:, 0], gap) for side in (-1, 1)]
    return _join(*(_wrap(np.column_stack([x, whole[:, 1:]])) for x in halves))


def _make_box(radius_m: float, height_m: float) -> trimesh.Trimesh:
    x, y = 0.86 * radius_m, 0.5 * radius_m
    return _wrap([(a, b, z) for a in (-x, x) for b in (-y, y) for z in (-SUNK_M, height_m)])


def _make_ring(radius_m: float, height_m: float) -> trimesh.Trimesh:
    solid: trimesh.Trimesh = trimesh.creation.annulus(0.6 * radius_m, radius_m, height_m + SUNK_M, sections=64)
    solid.apply_translation([0, 0, (height_m - SUNK_M) / 2])
    return solid


def _make_ridge(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """Make a rounded ridge: half of a horizontal elliptic cylinder."""
    angle = np.linspace(0, math.pi, 33)
    arc = np.stack([0.45 * radius_m * np.cos(angle), height_m * np.sin(angle)], axis=1)
    profile = [*arc, (0.45 * radius_m, -SUNK_M), (-0.45 * radius_m, -SUNK_M)]
    return _wrap([(x, y, z) for x in (-0.85 * radius_m, 0.85 * radius_m) for y, z in profile])


def _make_rod(half_length_m: float, height_m: float, radius_m: float, aside_m: float = 0.0) -> trimesh.Trimesh:
    """Make a horizontal rod with round ends, whose top is at `height_m`, with straight walls below the rod's axis."""
    hemisphere = [_trace(math.cos(a), math.sin(a), 32) for a in np.linspace(0, math.pi / 2, 9)]
    ball, x = radius_m * np.concatenate(hemisphere), half_length_m - radius_m
    upper = np.concatenate([ball + np.array([end, aside_m, height_m - radius_m]) for end in (-x, x)])
    return _wrap([*upper, *(upper * [1, 1, 0] - [0, 0, SUNK_M])])


def _make_rods(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """Make two parallel horizontal rods of different lengths with a narrow gap between them."""
    rods = ((radius_m, -1), (0.7 * radius_m, 1))
    return _join(*(_make_rod(x, height_m, 0.25 * radius_m, s * 0.28 * radius_m) for x, s in rods))


def _make_torus(radius_m: float, height_m: float) -> trimesh.Trimesh:
    thick = 0.25 * radius_m
    solid: trimesh.Trimesh = trimesh.creation.torus(radius_m - thick, thick, major_sections=48, minor_sections=24)
    solid.apply_transform(np.diag([1, 1, (height_m + SUNK_M) / (2 * thick), 1]))
    solid.apply_translation([0, 0, (height_m - SUNK_M) / 2])
    return solid


def _make_steps(radius_m: float, height_m: float) -> trimesh.Trimesh:
    """Make a hexagonal prism with a lower, wider prism around it."""
    sizes = ((radius_m, height_m - 0.0008), (0.6 * radius_m, height_m))
    return _join(*(_stack_rings((r, -SUNK_M), (r, z), sides=6) for r, z in sizes))


BOARDS: tuple[tuple[Shape, ...], ...] = (
    (
        lambda radius_m, height_m: _stack_rings((radius_m, -SUNK_M), (radius_m, height_m)),
        _make_box,
        _make_blunt,
        _make_cap,
        _make_rods,
        _make_slotted,
    ),
    (
        lambda radius_m, height_m: _make_blunt(radius_m, height_m, sides=4),
        _make_ring,
        _make_ridge,
        _make_steps,
        lambda radius_m, height_m: _make_rod(radius_m, height_m, 0.3 * radius_m),
        _make_torus,
    ),
)


def _trace(radius_m: float, z_m: float, points: int = 64) -> NDArray[np.float64]:
    """Return points (points, 3) of a circle about z, metres."""
    angle = np.arange(points) * 2 * math.pi / points
    return np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(points, z_m)], axis=1)


def _join(*solids: trimesh.Trimesh) -> trimesh.Trimesh:
    return cast("trimesh.Trimesh", trimesh.util.concatenate(list(solids)))


def _wrap(points_m: ArrayLike) -> trimesh.Trimesh:
    """Return the convex hull of points (P, 3), metres."""
    hull: trimesh.Trimesh = trimesh.Trimesh(np.asarray(points_m, float), process=False).convex_hull
    return hull
