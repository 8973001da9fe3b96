"""Draw the meshes of the demo objects from their dimensions: `python scripts/demo_meshes.py FOLDER` writes them all.

The objects are six kinds of part that are common in tactile localization. They are made with manifold3d, in
millimetres. A profile is a list of (radius, z). A path in the xz plane has rows (x, z, heading), with the heading in
radians from +x towards +z. The same code and libraries give the same bytes.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, FillRule, Manifold
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Points = Sequence[Sequence[float]] | Array

SECTIONS = 48  # a multiple of 12, so that 2-, 3-, 4- and 6-fold symmetries are exact in the mesh
CHORD_ERROR = 0.02  # mm
FAR = 100.0  # mm, beyond every object
HALF_DISC = np.array([(np.cos(a), np.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, SECTIONS // 2 + 1)])


def arc(center: Sequence[float], radius: float, start_rad: float, stop_rad: float) -> Array:
    """Return points (N, 2) of a circular arc with both ends. The chords are within `CHORD_ERROR` of the circle."""
    angles = np.linspace(start_rad, stop_rad, _steps(radius, stop_rad - start_rad) + 1)
    return np.asarray(center) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def revolved(profile: Points, sections: int = SECTIONS) -> Manifold:
    """Return the solid of a profile rotated about z. The profile starts and ends on the axis. A meridian is at +x."""
    return Manifold.revolve(CrossSection([np.asarray(profile)], FillRule.NonZero), sections)


def hexagon(across_flats: float, bottom: float, top: float) -> Manifold:
    """Return a hexagonal prism about z between two heights, with a corner on +x."""
    return Manifold.cylinder(top - bottom, across_flats / np.sqrt(3), circular_segments=6).translate((0, 0, bottom))


def straight(path: Points, stations: ArrayLike) -> Array:
    """Return the path, continued straight, with a new point at each of the distances `stations` from its end."""
    heading = path[-1][2]
    step = np.array([np.cos(heading), np.sin(heading), 0])
    return np.vstack([path, path[-1] + np.asarray(stations)[:, None] * step])


def bend(path: Points, radius: float, turn_rad: float, outer_radius: float) -> Array:
    """Return the path, continued with an arc, which bends to the left if `turn_rad` is positive.

    `outer_radius`, the solid's largest radius about the centre of the bend, sets the length of the chords.
    """
    x, z, heading = path[-1]
    side = np.copysign(radius, turn_rad)
    headings = heading + np.linspace(0, turn_rad, _steps(outer_radius, turn_rad) + 1)[1:]
    xs = x + side * (np.sin(headings) - np.sin(heading))
    zs = z - side * (np.cos(headings) - np.cos(heading))
    return np.vstack([path, np.stack([xs, zs, headings], axis=1)])


def swept(path: Array, radii: ArrayLike, section: Array) -> Manifold:
    """Return the solid that a unit section (S, 2) makes along a path, scaled by radii.

    The axes of the section point to the path's left and to -y.
    """
    scales = np.broadcast_to(radii, len(path))

    def place(points: Array) -> Array:  # `points` are those of a prism with a layer for each point of the path
        layers = np.rint(points[:, 2]).astype(int)
        (x, z, heading), (left, back) = path[layers].T, scales[layers] * points[:, :2].T
        return np.stack([x - left * np.sin(heading), -back, z + left * np.cos(heading)], axis=1)

    prism = Manifold.extrude(CrossSection([section], FillRule.NonZero), len(path) - 1, len(path) - 2)
    return prism.warp_batch(place)


def round_section(sections: int = SECTIONS) -> Array:
    """Return the section (S, 2) of a round wire of radius 1."""
    angles = np.arange(sections) * 2 * np.pi / sections
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def pin() -> Manifold:
    """Return a stepped locating pin along z, with the tip at -z. Symmetry z2.

    The origin lies in the seating shoulder. The head has a bore, and two flats that face +-y. The shank has a groove,
    and a cross hole along x.
    """
    shank = [(0, -26), (2, -26), (4, -21.5), (4, -17), (3.2, -17), (3.2, -15), (4, -15), (4, -9)]
    body = [(4.6, -9), (5, -8.6), (5, -1.2), (4.4, -1.2), (4.4, 0)]
    head = [(8, 0), (8, 4.2), (7.2, 5), (3, 5), (2.2, 4.2), (2.2, -5), (0, -6.1)]
    hole = Manifold.cylinder(FAR, 1.3, circular_segments=24, center=True).rotate((0, 90, 0)).translate((0, 0, -12))
    return (revolved(shank + body + head) ^ Manifold.cube((FAR, 12, FAR), center=True)) - hole


def damping_pin() -> Manifold:
    """Return a damping pin along z, with a barbed stem at -z and a bulb at +z. Symmetry zinf.

    The origin lies in the flange's lower face. A barb is a cone that widens from the tip, a land, and a step inwards.
    """
    stem, neck, bulb, pitch = 2.7, 3.5, 7.0, 3.5
    barbs = [
        (r, -19 + pitch * (k + at)) for k in range(4) for r, at in ((stem, 0), (3.7, 0.6), (3.7, 0.75), (stem, 0.75))
    ]
    flange = arc((9 - 1.25, 1.25), 1.25, -np.pi / 2, np.pi / 2)
    start, stop = -np.arccos(neck / bulb), np.arccos(2 / bulb)
    ball = arc((0, 4.5 - bulb * np.sin(start)), bulb, start, stop)
    tip, foot, shoulder, end = (0, -22), (stem, 0), (neck, 2.5), (0, ball[-1, 1])
    return revolved(np.vstack([tip, (1.6, -22), barbs, foot, flange, shoulder, ball, end]))


def head() -> Manifold:
    """Return a slotted bolt head along z, with the shaft at -z. The slot and two corners are along x. Symmetry z2.

    The origin lies in the seat. The edges of the round parts miss the hexagon's edges, and the chamfer's circle lies
    within the flats. So the mesh has no slivers.
    """
    rim, face, top, peak = 14.0, 9.6, 7.5, 11.9
    sphere = (9**2 + 4**2) / (2 * 4)  # the sphere of a dome with radius 9 and height 4
    dome = arc((0, peak - sphere), sphere, np.arccos(9 / sphere), np.pi / 2)
    shaft = [(0, -12), (5, -12), (6, -11), (6, 0), (rim, 0), (rim, 1.2), (9, 2.5)]
    body = revolved(np.vstack([shaft, dome[:-1], (0, peak)]))
    chamfer = revolved([(0, 0), (rim, 0), (rim, top - (rim - face) * np.tan(np.radians(30))), (face, top), (0, top)])
    half_section = (0, 0, 180 / SECTIONS)
    slot = Manifold.cube((FAR, 3, FAR), center=True).translate((0, 0, peak - 2.8 + FAR / 2))
    return body.rotate(half_section) + (hexagon(20, 0.6, top) ^ chamfer.rotate(half_section)) - slot


def elbow_pipe() -> Manifold:
    """Return a 90 degree elbow in the xz plane. Its axes meet at the origin, and x bisects their angle. Symmetry x2.

    Each end has a chamfered flange and a bead. The bore starts outside the pipe, on the cone of its own chamfer, so
    that no faces coincide.
    """
    bead = arc((8.5, 10), 1.4, np.pi, 0)
    outside = np.vstack([(0, 13.9), (0.6, 14.5), (3.5, 14.5), (3.5, 10), bead, (14, 10)])
    return _elbow(outside) - _elbow(np.array([(-0.6, 9), (0.6, 7.8), (14, 7.8)]))


def _elbow(end: Array) -> Manifold:
    """Return a round solid bent by 90 degrees. The profile (N, 2) of both ends is (distance from the end, radius)."""
    stations, radii = end.T
    reach = (20 + 14 - stations[0]) * np.sqrt(0.5)
    path = straight([(reach, reach, np.radians(225))], stations[1:] - stations[0])
    path = bend(path, 20, np.pi / 2, 30)
    bend_points = len(path) - len(end)
    path = straight(path, (stations[-1] - stations)[-2::-1])
    return swept(path, [*radii, *[radii[-1]] * bend_points, *radii[-2::-1]], round_section())


def cotter(long_leg: float = 52.0, short_leg: float = 44.0) -> Manifold:
    """Return a split cotter pin in the xz plane: eye at +z, legs along -z, and the longer leg at -x. No symmetry.

    The origin lies in the split. The wire is half round.
    """
    half_gap, tip, neck, eye, wire = 0.2, 1.5, 3.5, 3.5, 2.5
    opening = np.arccos((half_gap + neck) / (eye + neck))  # where neck and eye are tangent
    path = straight([(-half_gap, -long_leg, np.pi / 2)], [tip, long_leg])
    path = bend(path, neck, opening, neck)
    path = bend(path, eye, -(np.pi + 2 * opening), eye + wire)
    path = bend(path, neck, opening, neck)
    path = straight(path, [short_leg - tip, short_leg])
    return swept(path, [0.6 * wire, *[wire] * (len(path) - 2), 0.6 * wire], HALF_DISC)


def hook() -> Manifold:
    """Return a J hook in the xz plane: shank along z, hook towards +x. No symmetry.

    The origin lies in the collar's lower face. Wire and shank both end within the collar, without touching each other.
    The shank has ring grooves, which a touch can hardly distinguish from a thread.
    """
    wire, core, top, pitch, groove = 4.0, 3.1, 35.0, 2.0, 0.9
    path = straight([(0, 1.5, -np.pi / 2)], [1.5 + 26])
    path = bend(path, 12, np.radians(165), 12 + wire)
    round_rad = np.radians(np.arange(0, 81, 10))  # a round tip with a small flat end
    radii = [*[wire] * len(path), *wire * np.cos(round_rad)]
    path = straight(path, 7 + wire * np.sin(round_rad))
    cut = ((wire, 0), (core, 0.45), (core, 0.55), (wire, 0.875))
    rings = [(r, top - groove - pitch * (k - at)) for k in range(12, 0, -1) for r, at in cut]
    shank = revolved([(0, 3), (wire, 3), *rings, (wire, top - groove), (core, top), (0, top)], 36)
    return swept(path, radii, round_section(36)) + hexagon(16, 0, 5) + shank


BUILDERS = {draw.__name__: draw for draw in (pin, damping_pin, head, elbow_pipe, cotter, hook)}


def mesh_of(solid: Manifold) -> trimesh.Trimesh:
    """Return the surface of a solid, in metres."""
    surface = solid.to_mesh64()
    return trimesh.Trimesh(1e-3 * np.asarray(surface.vert_properties)[:, :3], surface.tri_verts, process=False)


def write_all(folder: Path, builders: Mapping[str, Callable[[], Manifold]] = BUILDERS) -> list[Path]:
    """Write the solid of each builder into `folder` as `NAME.ply` (binary, float32, metres), and return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.ply" for name in builders]
    for path in paths:
        mesh_of(builders[path.stem]()).export(path, vertex_normal=False)
    return paths


def _steps(radius: float, angle_rad: float) -> int:
    return max(2, int(np.ceil(abs(angle_rad) / (2 * np.arccos(1 - CHORD_ERROR / radius)))))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the meshes of the demo objects.")
    parser.add_argument("folder", type=Path, help="folder of the PLY files")
    write_all(parser.parse_args().folder)
