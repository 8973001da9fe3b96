"""The demo objects' dimensions, in metres. Each docstring gives the object's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
