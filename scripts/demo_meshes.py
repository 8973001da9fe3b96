"""Makes the demo objects' meshes from their dimensions: `python scripts/demo_meshes.py FOLDER` writes them all.

Six kinds of part that tactile localization is commonly tried on. A demo object is what its function returns for the
default dimensions, which are in metres; each dimensions' docstring gives the object's frame.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import demo_solids as solids
import numpy as np
from demo_solids import Array, arc_profile, bend, revolved, straight, swept

from tactile_loc.core.errors import OutputError

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class PinDimensions:
    """A stepped locating pin: z is its axis, tip at -z; the origin lies in the shoulder that seats; flats face +-y."""

    tip_radius_m: float = 0.0020
    tip_length_m: float = 0.0045
    shank_radius_m: float = 0.0040
    shank_length_m: float = 0.0170
    groove_radius_m: float = 0.0032
    groove_width_m: float = 0.0020
    groove_above_tip_m: float = 0.0090
    cross_hole_radius_m: float = 0.0013
    cross_hole_above_tip_m: float = 0.0140
    body_radius_m: float = 0.0050
    body_length_m: float = 0.0090
    relief_depth_m: float = 0.0006
    relief_width_m: float = 0.0012
    head_radius_m: float = 0.0080
    head_height_m: float = 0.0050
    across_flats_m: float = 0.0120
    bore_radius_m: float = 0.0022
    bore_depth_m: float = 0.0100
    chamfer_m: float = 0.0008


@dataclass(frozen=True)
class DampingPinDimensions:
    """A damping pin: z is its axis, barbed stem at -z, bulb at +z; the origin lies in the flange's lower face."""

    stem_radius_m: float = 0.0027
    stem_length_m: float = 0.0220
    tip_radius_m: float = 0.0016
    tip_length_m: float = 0.0030
    barb_radius_m: float = 0.0037
    barb_pitch_m: float = 0.0035
    barb_count: int = 4
    flange_radius_m: float = 0.0090
    flange_height_m: float = 0.0025
    neck_radius_m: float = 0.0035
    neck_length_m: float = 0.0020
    bulb_radius_m: float = 0.0070
    bulb_flat_radius_m: float = 0.0020


@dataclass(frozen=True)
class HeadDimensions:
    """A slotted bolt head: z is its axis, shaft at -z; the origin lies in the seat; slot and two corners along x."""

    shaft_radius_m: float = 0.0060
    shaft_length_m: float = 0.0120
    shaft_chamfer_m: float = 0.0010
    flange_radius_m: float = 0.0140
    flange_rim_m: float = 0.0012
    flange_height_m: float = 0.0025
    across_flats_m: float = 0.0200
    hex_top_m: float = 0.0075
    hex_face_radius_m: float = 0.0096
    hex_chamfer_rad: float = float(np.radians(30))
    dome_radius_m: float = 0.0090
    dome_base_m: float = 0.0079
    dome_height_m: float = 0.0040
    slot_width_m: float = 0.0030
    slot_depth_m: float = 0.0028


@dataclass(frozen=True)
class ElbowPipeDimensions:
    """A 90 degree elbow in the xz plane: the pipes' axes meet in the origin, x halves the angle between them."""

    outer_radius_m: float = 0.0100
    bore_radius_m: float = 0.0078
    bend_radius_m: float = 0.0200
    leg_length_m: float = 0.0140
    flange_radius_m: float = 0.0145
    flange_height_m: float = 0.0035
    chamfer_m: float = 0.0006
    bead_radius_m: float = 0.0014
    bead_from_end_m: float = 0.0085


@dataclass(frozen=True)
class CotterDimensions:
    """A split cotter pin in the xz plane: legs along -z, eye at +z, the longer leg at -x; the origin is the split."""

    wire_radius_m: float = 0.0025
    gap_m: float = 0.0004
    long_leg_m: float = 0.0520
    short_leg_m: float = 0.0440
    tip_length_m: float = 0.0015
    tip_scale: float = 0.6
    neck_radius_m: float = 0.0035
    eye_radius_m: float = 0.0035


@dataclass(frozen=True)
class HookDimensions:
    """A J hook in the xz plane: shank along z, hook towards +x; the origin lies in the collar's lower face."""

    wire_radius_m: float = 0.0040
    bend_radius_m: float = 0.0120
    bend_rad: float = float(np.radians(165))
    straight_length_m: float = 0.0260
    mouth_length_m: float = 0.0070
    collar_across_flats_m: float = 0.0160
    collar_height_m: float = 0.0050
    shank_radius_m: float = 0.0040
    shank_length_m: float = 0.0300
    ring_pitch_m: float = 0.0020
    ring_depth_m: float = 0.0009
    ring_count: int = 12


PIN = PinDimensions()
DAMPING_PIN = DampingPinDimensions()
HEAD = HeadDimensions()
ELBOW_PIPE = ElbowPipeDimensions()
COTTER = CotterDimensions()
HOOK = HookDimensions()


def pin(dimensions: PinDimensions = PIN) -> trimesh.Trimesh:
    """Return the locating pin's mesh, metres. Symmetry z2."""
    d = dimensions
    turned = revolved(_pin_profile(d))
    reach, half_flats = 2 * d.head_radius_m, d.across_flats_m / 2
    above = solids.box((-reach, half_flats, 0), (reach, reach, reach))
    below = solids.box((-reach, -reach, 0), (reach, -half_flats, reach))
    hole = solids.prism(d.cross_hole_radius_m, -reach, reach, sections=24)
    hole.apply_transform(_Z_TO_X)
    hole.apply_translation([0, 0, d.cross_hole_above_tip_m - d.shank_length_m - d.body_length_m])
    return solids.difference(turned, above, below, hole)


def _pin_profile(d: PinDimensions) -> Array:
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


def damping_pin(dimensions: DampingPinDimensions = DAMPING_PIN) -> trimesh.Trimesh:
    """Return the damping pin's mesh, metres. Symmetry zinf."""
    d = dimensions
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


def _barb(d: DampingPinDimensions) -> list[tuple[float, float]]:
    """Return one barb's (radius, height): a cone that widens away from the tip, a short land, a step back."""
    cone, land = 0.6 * d.barb_pitch_m, 0.75 * d.barb_pitch_m
    return [(d.stem_radius_m, 0), (d.barb_radius_m, cone), (d.barb_radius_m, land), (d.stem_radius_m, land)]


def head(dimensions: HeadDimensions = HEAD) -> trimesh.Trimesh:
    """Return the slotted head's mesh, metres. Symmetry z2."""
    d = dimensions
    # No slivers: the facets' edges miss the hexagon's, and the chamfer's circle lies within the flats, not tangent.
    half_section = np.pi / solids.SECTIONS
    corner, face = d.across_flats_m / np.sqrt(3), d.hex_face_radius_m
    hexagon = solids.prism(corner, d.flange_rim_m / 2, d.hex_top_m, sections=6)
    drop = (d.flange_radius_m - face) * np.tan(d.hex_chamfer_rad)
    r, top = d.flange_radius_m, d.hex_top_m
    chamfer = revolved([(0, 0), (r, 0), (r, top - drop), (face, top), (0, top)], phase_rad=half_section)
    turned = revolved(_head_profile(d), phase_rad=half_section)
    peak, half_slot = d.dome_base_m + d.dome_height_m, d.slot_width_m / 2
    slot = solids.box((-r, -half_slot, peak - d.slot_depth_m), (r, half_slot, 2 * peak))
    return solids.difference(solids.union(turned, solids.intersection(hexagon, chamfer)), slot)


def _head_profile(d: HeadDimensions) -> Array:
    c, r, foot_z = d.shaft_chamfer_m, d.shaft_radius_m, -d.shaft_length_m
    inner = d.dome_radius_m
    shaft = [(0, foot_z), (r - c, foot_z), (r, foot_z + c), (r, 0)]
    flange = [(d.flange_radius_m, 0), (d.flange_radius_m, d.flange_rim_m), (inner, d.flange_height_m)]
    sphere = (d.dome_radius_m**2 + d.dome_height_m**2) / (2 * d.dome_height_m)
    centre = (0.0, d.dome_base_m + d.dome_height_m - sphere)
    dome = arc_profile(centre, sphere, np.arccos(inner / sphere), np.pi / 2)
    return np.vstack([shaft, flange, dome[:-1], (0, dome[-1, 1])])


def elbow_pipe(dimensions: ElbowPipeDimensions = ELBOW_PIPE) -> trimesh.Trimesh:
    """Return the pipe elbow's mesh, metres. Symmetry x2."""
    d, c = dimensions, dimensions.chamfer_m
    ring, beyond = d.flange_radius_m, c
    bead = arc_profile((d.bead_from_end_m, d.outer_radius_m), d.bead_radius_m, np.pi, 0)
    height = d.flange_height_m
    flange = [(0, ring - c), (c, ring), (height, ring), (height, d.outer_radius_m)]
    outside = np.vstack([flange, bead, (d.leg_length_m, d.outer_radius_m)])
    # The bore starts outside the pipe, on the cone of its own chamfer, so that no faces coincide.
    bore = np.array([(-beyond, d.bore_radius_m + c + beyond), (c, d.bore_radius_m), (d.leg_length_m, d.bore_radius_m)])
    return solids.difference(_elbow(d, outside), _elbow(d, bore))


def _elbow(d: ElbowPipeDimensions, end: Array) -> trimesh.Trimesh:
    """Return the round solid bent by 90 degrees, both of whose ends have the (N, 2) profile (from the end, radius)."""
    reach = (d.bend_radius_m + d.leg_length_m - end[0, 0]) * np.sqrt(0.5)
    stations, radii = end.T
    path = straight(solids.path_from(reach, reach, np.radians(225)), stations[1:] - stations[0])
    path = bend(path, d.bend_radius_m, np.pi / 2, d.bend_radius_m + d.outer_radius_m)
    turned = len(path) - len(end)
    path = straight(path, (stations[-1] - stations)[-2::-1])
    return swept(path, solids.disc(), np.concatenate([radii, np.full(turned, radii[-1]), radii[-2::-1]]))


def cotter(dimensions: CotterDimensions = COTTER) -> trimesh.Trimesh:
    """Return the cotter pin's mesh, metres. No symmetry."""
    d, tip = dimensions, dimensions.tip_length_m
    neck, eye, wire = d.neck_radius_m, d.eye_radius_m, d.wire_radius_m
    opening = np.arccos((d.gap_m / 2 + neck) / (eye + neck))  # where neck and eye are tangent
    path = straight(solids.path_from(-d.gap_m / 2, -d.long_leg_m, np.pi / 2), [tip, d.long_leg_m])
    path = bend(path, neck, opening, neck)
    path = bend(path, eye, -(np.pi + 2 * opening), eye + wire)
    path = bend(path, neck, opening, neck)
    path = straight(path, [d.short_leg_m - tip, d.short_leg_m])
    radii = np.full(len(path), wire)
    radii[[0, -1]] *= d.tip_scale
    return swept(path, solids.half_disc(), radii)


def hook(dimensions: HookDimensions = HOOK) -> trimesh.Trimesh:
    """Return the J hook's mesh, metres. No symmetry."""
    d = dimensions
    inside = 0.3 * d.collar_height_m  # wire and shank both end within the collar, apart from one another
    path = straight(solids.path_from(0, inside, -np.pi / 2), [inside + d.straight_length_m])
    path = bend(path, d.bend_radius_m, d.bend_rad, d.bend_radius_m + d.wire_radius_m)
    round_rad = np.radians(np.arange(0, 81, 10))  # a round tip, ground flat at its very end
    path = straight(path, d.mouth_length_m + d.wire_radius_m * np.sin(round_rad))
    radii = np.full(len(path), d.wire_radius_m)
    radii[-len(round_rad) :] *= np.cos(round_rad)
    collar = solids.prism(d.collar_across_flats_m / np.sqrt(3), 0, d.collar_height_m, sections=6)
    return solids.union(swept(path, solids.disc(36), radii), collar, revolved(_shank_profile(d), 36))


def _shank_profile(d: HookDimensions) -> Array:
    """Return the shank above the collar, grooved by rings: a touch can hardly tell them from a thread's helix."""
    r, core, top = d.shank_radius_m, d.shank_radius_m - d.ring_depth_m, d.collar_height_m + d.shank_length_m
    bottom = 0.6 * d.collar_height_m
    ring_z = top - d.ring_depth_m - d.ring_pitch_m * np.arange(d.ring_count, 0, -1)
    cut = [(r, 0.0), (core, 0.45), (core, 0.55), (r, 1.0 - 0.125)]
    rings = [(radius, z + share * d.ring_pitch_m) for z in ring_z for radius, share in cut]
    return np.array([(0, bottom), (r, bottom), *rings, (r, top - d.ring_depth_m), (core, top), (0, top)])


_Z_TO_X = np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]], dtype=np.float64)

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
