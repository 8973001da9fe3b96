"""Makes the demo objects' meshes from their dimensions: `python scripts/demo_meshes.py FOLDER` writes them all.

Six kinds of part that tactile localization is commonly tried on. A demo object is what its function returns for the
default dimensions, in metres and radians. A comment gives each object's frame.

A profile is (N, 2) rows (radius, z). A path lies in the xz plane: (N, 3) rows (x, z, heading), the heading in radians
from +x towards +z. A section is (S, 2) rows (left of the path, y), convex.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from types import SimpleNamespace as Dimensions
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from trimesh.creation import box

from tactile_loc.core.errors import MissingLibraryError, OutputError

Array = NDArray[np.float64]
Operation = Literal["union", "difference", "intersection"]

SECTIONS = 48  # a multiple of 12, so that 2-, 3-, 4- and 6-fold symmetries are exact in the mesh
CHORD_ERROR_M = 2e-5
Z_TO_X = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]], dtype=np.float64)

# A stepped locating pin: z is its axis, tip at -z; the origin lies in the shoulder that seats; flats face +-y.
PIN = Dimensions(
    tip_radius_m=0.0020, tip_length_m=0.0045, shank_radius_m=0.0040, shank_length_m=0.0170, groove_radius_m=0.0032,
    groove_width_m=0.0020, groove_above_tip_m=0.0090, cross_hole_radius_m=0.0013, cross_hole_above_tip_m=0.0140,
    body_radius_m=0.0050, body_length_m=0.0090, relief_depth_m=0.0006, relief_width_m=0.0012, head_radius_m=0.0080,
    head_height_m=0.0050, across_flats_m=0.0120, bore_radius_m=0.0022, bore_depth_m=0.0100, chamfer_m=0.0008,
)  # fmt: skip
# A damping pin: z is its axis, barbed stem at -z, bulb at +z; the origin lies in the flange's lower face.
DAMPING_PIN = Dimensions(
    stem_radius_m=0.0027, stem_length_m=0.0220, tip_radius_m=0.0016, tip_length_m=0.0030, barb_radius_m=0.0037,
    barb_pitch_m=0.0035, barb_count=4, flange_radius_m=0.0090, flange_height_m=0.0025, neck_radius_m=0.0035,
    neck_length_m=0.0020, bulb_radius_m=0.0070, bulb_flat_radius_m=0.0020,
)  # fmt: skip
# A slotted bolt head: z is its axis, shaft at -z; the origin lies in the seat; slot and two corners along x.
HEAD = Dimensions(
    shaft_radius_m=0.0060, shaft_length_m=0.0120, shaft_chamfer_m=0.0010, flange_radius_m=0.0140, flange_rim_m=0.0012,
    flange_height_m=0.0025, across_flats_m=0.0200, hex_top_m=0.0075, hex_face_radius_m=0.0096,
    hex_chamfer_rad=float(np.radians(30)), dome_radius_m=0.0090, dome_base_m=0.0079, dome_height_m=0.0040,
    slot_width_m=0.0030, slot_depth_m=0.0028,
)  # fmt: skip
# A 90 degree elbow in the xz plane: the pipes' axes meet in the origin, x halves the angle between them.
ELBOW_PIPE = Dimensions(
    outer_radius_m=0.0100, bore_radius_m=0.0078, bend_radius_m=0.0200, leg_length_m=0.0140, flange_radius_m=0.0145,
    flange_height_m=0.0035, chamfer_m=0.0006, bead_radius_m=0.0014, bead_from_end_m=0.0085,
)  # fmt: skip
# A split cotter pin in the xz plane: legs along -z, eye at +z, the longer leg at -x; the origin is the split.
COTTER = Dimensions(
    wire_radius_m=0.0025, gap_m=0.0004, long_leg_m=0.0520, short_leg_m=0.0440, tip_length_m=0.0015, tip_scale=0.6,
    neck_radius_m=0.0035, eye_radius_m=0.0035,
)  # fmt: skip
# A J hook in the xz plane: shank along z, hook towards +x; the origin lies in the collar's lower face.
HOOK = Dimensions(
    wire_radius_m=0.0040, bend_radius_m=0.0120, bend_rad=float(np.radians(165)), straight_length_m=0.0260,
    mouth_length_m=0.0070, collar_across_flats_m=0.0160, collar_height_m=0.0050, shank_radius_m=0.0040,
    shank_length_m=0.0300, ring_pitch_m=0.0020, ring_depth_m=0.0009, ring_count=12,
)  # fmt: skip


def arc_profile(center_m: Sequence[float], radius_m: float, start_rad: float, stop_rad: float) -> Array:
    """Return (N, 2) points of a circular arc, ends included, no chord further than CHORD_ERROR_M from the circle."""
    angles = np.linspace(start_rad, stop_rad, _steps(radius_m, stop_rad - start_rad) + 1)
    return np.asarray(center_m) + radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def revolved(profile_m: ArrayLike, sections: int = SECTIONS, phase_rad: float = 0.0) -> trimesh.Trimesh:
    """Return the solid that the (N, 2) profile (radius, z) sweeps about z; it starts and ends on the axis.

    The first of its meridians lies at `phase_rad` from +x.
    """
    solid = trimesh.creation.revolve(np.asarray(profile_m, dtype=np.float64), sections=sections)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(phase_rad), -np.sin(phase_rad)], [np.sin(phase_rad), np.cos(phase_rad)]]
    solid.apply_transform(turn)
    return _outward(solid)


def prism(radius_m: float, bottom_m: float, top_m: float, sections: int) -> trimesh.Trimesh:
    """Return a regular prism about z between two heights, a corner on +x at the given radius."""
    return revolved([(0, bottom_m), (radius_m, bottom_m), (radius_m, top_m), (0, top_m)], sections)


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
    x, z, heading = path.T[:, :, None]
    scaled = np.asarray(radii_m, dtype=np.float64)[:, None, None] * np.vstack([section, section.mean(axis=0)])
    left, y = scaled[..., 0], scaled[..., 1]
    rings = np.stack([x - left * np.sin(heading), y, z + left * np.cos(heading)], axis=2)
    n, count = len(path), len(section)
    vertices = np.vstack([rings[:, :-1].reshape(-1, 3), rings[[0, -1], -1]])
    return _outward(trimesh.Trimesh(vertices, _tube_faces(n, count), process=False))


def boolean(operation: Operation, *solids: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the union or intersection of solids, or the first less the others; needs manifold3d."""
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


def pin(d: Dimensions = PIN) -> trimesh.Trimesh:
    """Return the locating pin's mesh, metres. Symmetry z2."""
    turned = revolved(_pin_profile(d))
    reach, half_flats = 2 * d.head_radius_m, d.across_flats_m / 2
    above = box(bounds=[(-reach, half_flats, 0), (reach, reach, reach)])
    below = box(bounds=[(-reach, -reach, 0), (reach, -half_flats, reach)])
    hole = prism(d.cross_hole_radius_m, -reach, reach, sections=24)
    hole.apply_transform(Z_TO_X)
    hole.apply_translation([0, 0, d.cross_hole_above_tip_m - d.shank_length_m - d.body_length_m])
    return boolean("difference", turned, above, below, hole)


def _pin_profile(d: Dimensions) -> Array:
    tip_z, step_z = -d.shank_length_m - d.body_length_m, -d.body_length_m
    groove_z, r, body = tip_z + d.groove_above_tip_m, d.shank_radius_m, d.body_radius_m
    groove_top = groove_z + d.groove_width_m
    relief, relief_z = body - d.relief_depth_m, -d.relief_width_m
    c, top, bore, bore_z = d.chamfer_m, d.head_height_m, d.bore_radius_m, d.head_height_m - d.bore_depth_m
    tip = [(0, tip_z), (d.tip_radius_m, tip_z), (r, tip_z + d.tip_length_m)]
    groove = [(r, groove_z), (d.groove_radius_m, groove_z), (d.groove_radius_m, groove_top), (r, groove_top)]
    step = [(r, step_z), (body - c / 2, step_z), (body, step_z + c / 2), (body, relief_z), (relief, relief_z)]
    head = [(relief, 0), (d.head_radius_m, 0), (d.head_radius_m, top - c), (d.head_radius_m - c, top)]
    hole = [(bore + c, top), (bore, top - c), (bore, bore_z), (0, bore_z - bore / 2)]
    return np.array(tip + groove + step + head + hole)


def damping_pin(d: Dimensions = DAMPING_PIN) -> trimesh.Trimesh:
    """Return the damping pin's mesh, metres. Symmetry zinf."""
    barb_z = -d.stem_length_m + d.tip_length_m + d.barb_pitch_m * np.arange(d.barb_count)
    tip = [(0, -d.stem_length_m), (d.tip_radius_m, -d.stem_length_m)]
    barbs = [(r, z + dz) for z in barb_z for r, dz in _barb(d)]
    rim = d.flange_height_m / 2
    flange = arc_profile((d.flange_radius_m - rim, rim), rim, -np.pi / 2, np.pi / 2)
    neck_z = d.flange_height_m + d.neck_length_m
    start, stop = -np.arccos(d.neck_radius_m / d.bulb_radius_m), np.arccos(d.bulb_flat_radius_m / d.bulb_radius_m)
    bulb = arc_profile((0, neck_z - d.bulb_radius_m * np.sin(start)), d.bulb_radius_m, start, stop)
    foot, neck = (d.stem_radius_m, 0), (d.neck_radius_m, d.flange_height_m)
    return revolved(np.vstack([tip, barbs, foot, flange, neck, bulb, (0, bulb[-1, 1])]))


def _barb(d: Dimensions) -> list[tuple[float, float]]:
    """Return one barb's (radius, height): a cone that widens away from the tip, a short land, a step back."""
    cone, land = 0.6 * d.barb_pitch_m, 0.75 * d.barb_pitch_m
    return [(d.stem_radius_m, 0), (d.barb_radius_m, cone), (d.barb_radius_m, land), (d.stem_radius_m, land)]


def head(d: Dimensions = HEAD) -> trimesh.Trimesh:
    """Return the slotted head's mesh, metres. Symmetry z2."""
    # No slivers: the facets' edges miss the hexagon's, and the chamfer's circle lies within the flats, not tangent.
    half_section = np.pi / SECTIONS
    corner, face = d.across_flats_m / np.sqrt(3), d.hex_face_radius_m
    hexagon = prism(corner, d.flange_rim_m / 2, d.hex_top_m, sections=6)
    drop = (d.flange_radius_m - face) * np.tan(d.hex_chamfer_rad)
    r, top = d.flange_radius_m, d.hex_top_m
    chamfer = revolved([(0, 0), (r, 0), (r, top - drop), (face, top), (0, top)], phase_rad=half_section)
    turned = revolved(_head_profile(d), phase_rad=half_section)
    peak, half_slot = d.dome_base_m + d.dome_height_m, d.slot_width_m / 2
    slot = box(bounds=[(-r, -half_slot, peak - d.slot_depth_m), (r, half_slot, 2 * peak)])
    return boolean("difference", boolean("union", turned, boolean("intersection", hexagon, chamfer)), slot)


def _head_profile(d: Dimensions) -> Array:
    c, r, foot_z = d.shaft_chamfer_m, d.shaft_radius_m, -d.shaft_length_m
    inner = d.dome_radius_m
    shaft = [(0, foot_z), (r - c, foot_z), (r, foot_z + c), (r, 0)]
    flange = [(d.flange_radius_m, 0), (d.flange_radius_m, d.flange_rim_m), (inner, d.flange_height_m)]
    sphere = (d.dome_radius_m**2 + d.dome_height_m**2) / (2 * d.dome_height_m)
    centre = (0.0, d.dome_base_m + d.dome_height_m - sphere)
    dome = arc_profile(centre, sphere, np.arccos(inner / sphere), np.pi / 2)
    return np.vstack([shaft, flange, dome[:-1], (0, dome[-1, 1])])


def elbow_pipe(d: Dimensions = ELBOW_PIPE) -> trimesh.Trimesh:
    """Return the pipe elbow's mesh, metres. Symmetry x2."""
    c = d.chamfer_m
    ring, beyond = d.flange_radius_m, c
    bead = arc_profile((d.bead_from_end_m, d.outer_radius_m), d.bead_radius_m, np.pi, 0)
    height = d.flange_height_m
    flange = [(0, ring - c), (c, ring), (height, ring), (height, d.outer_radius_m)]
    outside = np.vstack([flange, bead, (d.leg_length_m, d.outer_radius_m)])
    # The bore starts outside the pipe, on the cone of its own chamfer, so that no faces coincide.
    bore = np.array([(-beyond, d.bore_radius_m + c + beyond), (c, d.bore_radius_m), (d.leg_length_m, d.bore_radius_m)])
    return boolean("difference", _elbow(d, outside), _elbow(d, bore))


def _elbow(d: Dimensions, end: Array) -> trimesh.Trimesh:
    """Return the round solid bent by 90 degrees, both of whose ends have the (N, 2) profile (from the end, radius)."""
    reach = (d.bend_radius_m + d.leg_length_m - end[0, 0]) * np.sqrt(0.5)
    stations, radii = end.T
    path = straight([(reach, reach, np.radians(225))], stations[1:] - stations[0])
    path = bend(path, d.bend_radius_m, np.pi / 2, d.bend_radius_m + d.outer_radius_m)
    turned = len(path) - len(end)
    path = straight(path, (stations[-1] - stations)[-2::-1])
    return swept(path, disc(), np.concatenate([radii, np.full(turned, radii[-1]), radii[-2::-1]]))


def cotter(d: Dimensions = COTTER) -> trimesh.Trimesh:
    """Return the cotter pin's mesh, metres. No symmetry."""
    tip = d.tip_length_m
    neck, eye, wire = d.neck_radius_m, d.eye_radius_m, d.wire_radius_m
    opening = np.arccos((d.gap_m / 2 + neck) / (eye + neck))  # where neck and eye are tangent
    path = straight([(-d.gap_m / 2, -d.long_leg_m, np.pi / 2)], [tip, d.long_leg_m])
    path = bend(path, neck, opening, neck)
    path = bend(path, eye, -(np.pi + 2 * opening), eye + wire)
    path = bend(path, neck, opening, neck)
    path = straight(path, [d.short_leg_m - tip, d.short_leg_m])
    radii = np.full(len(path), wire)
    radii[[0, -1]] *= d.tip_scale
    return swept(path, half_disc(), radii)


def hook(d: Dimensions = HOOK) -> trimesh.Trimesh:
    """Return the J hook's mesh, metres. No symmetry."""
    inside = 0.3 * d.collar_height_m  # wire and shank both end within the collar, apart from one another
    path = straight([(0, inside, -np.pi / 2)], [inside + d.straight_length_m])
    path = bend(path, d.bend_radius_m, d.bend_rad, d.bend_radius_m + d.wire_radius_m)
    round_rad = np.radians(np.arange(0, 81, 10))  # a round tip, ground flat at its very end
    path = straight(path, d.mouth_length_m + d.wire_radius_m * np.sin(round_rad))
    radii = np.full(len(path), d.wire_radius_m)
    radii[-len(round_rad) :] *= np.cos(round_rad)
    collar = prism(d.collar_across_flats_m / np.sqrt(3), 0, d.collar_height_m, sections=6)
    return boolean("union", swept(path, disc(36), radii), collar, revolved(_shank_profile(d), 36))


def _shank_profile(d: Dimensions) -> Array:
    """Return the shank above the collar, grooved by rings: a touch can hardly tell them from a thread's helix."""
    r, core, top = d.shank_radius_m, d.shank_radius_m - d.ring_depth_m, d.collar_height_m + d.shank_length_m
    bottom = 0.6 * d.collar_height_m
    ring_z = top - d.ring_depth_m - d.ring_pitch_m * np.arange(d.ring_count, 0, -1)
    cut = [(r, 0.0), (core, 0.45), (core, 0.55), (r, 1.0 - 0.125)]
    rings = [(radius, z + share * d.ring_pitch_m) for z in ring_z for radius, share in cut]
    return np.array([(0, bottom), (r, bottom), *rings, (r, top - d.ring_depth_m), (core, top), (0, top)])


BUILDERS: Mapping[str, Callable[[], trimesh.Trimesh]] = MappingProxyType(
    {f.__name__: f for f in (pin, damping_pin, head, elbow_pipe, cotter, hook)}
)


def write_all(folder: Path) -> list[Path]:
    """Write every demo object into `folder` as `NAME.ply` (binary, float32, metres) and return the paths.

    The same code and libraries give the same bytes. Raises OutputError if the folder cannot be written,
    MissingLibraryError without manifold3d.
    """
    paths = []
    for name, build in BUILDERS.items():
        paths.append(_write(build(), Path(folder) / f"{name}.ply"))
    return paths


def _write(mesh: trimesh.Trimesh, path: Path) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        mesh.export(path, vertex_normal=False)
    except OSError as error:
        raise OutputError(f"The mesh {path} cannot be written ({error.strerror}); choose another folder.") from error
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the meshes of the demo objects.")
    parser.add_argument("folder", type=Path, help="where the PLY files go")
    write_all(parser.parse_args().folder)
