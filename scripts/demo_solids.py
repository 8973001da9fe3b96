"""Building blocks of the demo objects: revolved profiles, planar sweeps, prisms and their unions, all in metres.

A profile is (N, 2) rows (radius, z). A path lies in the xz plane: (N, 3) rows (x, z, heading), the heading in radians
from +x towards +z. A section is (S, 2) rows (left of the path, y), convex and counter-clockwise or clockwise alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.errors import MissingLibraryError

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

SECTIONS = 48  # a multiple of 12, so that 2-, 3-, 4- and 6-fold symmetries are exact in the mesh
CHORD_ERROR_M = 2e-5


def arc_profile(center_m: Sequence[float], radius_m: float, start_rad: float, stop_rad: float) -> Array:
    """Return (N, 2) points of a circular arc, ends included, no chord further than CHORD_ERROR_M from the circle."""
    angles = np.linspace(start_rad, stop_rad, _steps(radius_m, stop_rad - start_rad) + 1)
    return np.asarray(center_m) + radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def revolved(profile_m: ArrayLike, sections: int = SECTIONS, phase_rad: float = 0.0) -> trimesh.Trimesh:
    """Return the solid that the (N, 2) profile (radius, z) sweeps about z; it starts and ends on the axis.

    The first of its meridians lies at `phase_rad` from +x.
    """
    import trimesh

    solid = trimesh.creation.revolve(np.asarray(profile_m, dtype=np.float64), sections=sections)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(phase_rad), -np.sin(phase_rad)], [np.sin(phase_rad), np.cos(phase_rad)]]
    solid.apply_transform(turn)
    return _outward(solid)


def prism(radius_m: float, bottom_m: float, top_m: float, sections: int) -> trimesh.Trimesh:
    """Return a regular prism about z between two heights, a corner on +x at the given radius."""
    return revolved([(0, bottom_m), (radius_m, bottom_m), (radius_m, top_m), (0, top_m)], sections)


def box(lower_m: Sequence[float], upper_m: Sequence[float]) -> trimesh.Trimesh:
    """Return the axis-aligned box between two corners (x, y, z)."""
    import trimesh

    solid: trimesh.Trimesh = trimesh.creation.box(bounds=[lower_m, upper_m])
    return solid


def path_from(x_m: float, z_m: float, heading_rad: float) -> Array:
    """Return a path of one point, (1, 3)."""
    return np.array([[x_m, z_m, heading_rad]], dtype=np.float64)


def straight(path: Array, stations_m: ArrayLike) -> Array:
    """Return the path continued straight on, with a point at each distance from its present end."""
    x, z, heading = path[-1]
    distances = np.asarray(stations_m, dtype=np.float64)
    points = [x + distances * np.cos(heading), z + distances * np.sin(heading), np.full_like(distances, heading)]
    return np.vstack([path, np.stack(points, axis=1)])


def bend(path: Array, radius_m: float, turn_rad: float, outer_radius_m: float) -> Array:
    """Return the path continued by an arc, to the left if `turn_rad` is positive.

    The solid's largest radius about the centre of the bend sets how fine the arc is cut.
    """
    x, z, heading = path[-1]
    side = np.copysign(radius_m, turn_rad)
    headings = heading + np.linspace(0, turn_rad, _steps(outer_radius_m, turn_rad) + 1)[1:]
    xs = x + side * (np.sin(headings) - np.sin(heading))
    zs = z - side * (np.cos(headings) - np.cos(heading))
    return np.vstack([path, np.stack([xs, zs, headings], axis=1)])


def disc(sections: int = SECTIONS) -> Array:
    """Return the (S, 2) section of a round wire of radius 1 about the path."""
    angles = np.arange(sections) * 2 * np.pi / sections
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def half_disc(steps: int = SECTIONS // 2) -> Array:
    """Return the (S, 2) section of a half-round wire of radius 1, flat along the path, round to its left."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, steps + 1)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def swept(path: Array, section: Array, radii_m: ArrayLike) -> trimesh.Trimesh:
    """Return the solid of a (S, 2) unit section swept along the path (P, 3), scaled at each point by radii_m (P,)."""
    import trimesh

    x, z, heading = path.T[:, :, None]
    scaled = np.asarray(radii_m, dtype=np.float64)[:, None, None] * np.vstack([section, section.mean(axis=0)])
    left, y = scaled[..., 0], scaled[..., 1]
    rings = np.stack([x - left * np.sin(heading), y, z + left * np.cos(heading)], axis=2)
    n, count = len(path), len(section)
    vertices = np.vstack([rings[:, :-1].reshape(-1, 3), rings[[0, -1], -1]])
    return _outward(trimesh.Trimesh(vertices, _tube_faces(n, count), process=False))


def union(*solids: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the union of solids. Raises MissingLibraryError without manifold3d."""
    return _boolean("union", solids)


def difference(*solids: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the first solid less the others. Raises MissingLibraryError without manifold3d."""
    return _boolean("difference", solids)


def intersection(*solids: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return what all the solids share. Raises MissingLibraryError without manifold3d."""
    return _boolean("intersection", solids)


def _boolean(
    operation: Literal["union", "difference", "intersection"], solids: Sequence[trimesh.Trimesh]
) -> trimesh.Trimesh:
    import trimesh

    try:
        import manifold3d  # noqa: F401
    except ImportError as error:
        raise MissingLibraryError("Drawing the demo objects needs manifold3d: pip install manifold3d.") from error
    result: trimesh.Trimesh = trimesh.boolean.boolean_manifold(list(solids), operation)
    return result


def _tube_faces(rings: int, count: int) -> NDArray[np.int64]:
    """Return the (F, 3) faces of `rings` rings of `count` vertices and two cap centres that follow them."""
    ring, around = np.arange(count), np.roll(np.arange(count), -1)
    base = np.arange(rings - 1)[:, None] * count
    a, b = (base + ring).ravel(), (base + around).ravel()
    side = np.vstack([np.stack([a, b, b + count], axis=1), np.stack([a, b + count, a + count], axis=1)])
    start, end, last = np.full(count, rings * count), np.full(count, rings * count + 1), (rings - 1) * count
    caps = np.vstack([np.stack([start, around, ring], axis=1), np.stack([end, last + ring, last + around], axis=1)])
    return np.vstack([side, caps])


def _outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def _steps(radius_m: float, angle_rad: float) -> int:
    return max(2, int(np.ceil(abs(angle_rad) / (2 * np.arccos(1 - CHORD_ERROR_M / radius_m)))))
