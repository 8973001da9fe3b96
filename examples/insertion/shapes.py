"""The parts and their holes, as convex pieces: the physics engine collides convex hulls only.

All outlines are convex polygons (K, 2), metres, counterclockwise. All points are in the part's frame: the origin is in
the middle of the handle, and the shank points along -z.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points = NDArray[np.float64]

SIDES = 64  # of the polygons that stand for circles
ROUND = 12  # a shank that fits in so many rotations is round
TIP_Z_M, SEAT_Z_M = -44e-3, -26e-3  # of the shank's tip, and of the plate's surface when the part is seated
TIP_CHAMFER_M, MOUTH_CHAMFER_M = 5e-4, 5e-4
WALL_M, SPARE_DEPTH_M, BOTTOM_M = 25e-3, 2e-3, 3e-3


@dataclass(frozen=True, eq=False)
class Part:
    """A part to insert.

    `pieces` are the corners (K, 3), metres, of convex pieces, whose union is the part. `shank` (K, 2), metres, is the
    outline that goes into the hole. The gripper can hold the handle at rotations `yaws_deg` about the part's z axis,
    and at shifts `shifts_m` (N, 2) along the gripper's x axis and the part's z axis. The shank fits into its hole at
    `fits` equally spaced rotations about z.
    """

    name: str
    pieces: tuple[Points, ...]
    shank: Points
    yaws_deg: tuple[float, ...]
    shifts_m: Points
    fits: int

    @property
    def corner_m(self) -> float:
        """The distance of the shank's corners from its axis, metres; 0 if the shank is round."""
        return 0.0 if self.fits >= ROUND else float(np.linalg.norm(self.shank, axis=1).max())

    @property
    def depth_m(self) -> float:
        """The depth of the seated shank in the hole, metres."""
        return SEAT_Z_M - TIP_Z_M


def make_peg() -> Part:
    """Return a square peg with a round handle. A groove along the handle shows the rotation about the long axis."""
    disc, z = make_circle(7e-3), (-16e-3, 24e-3)
    cuts = (((1, 0), 5.5e-3), ((0, 1), -1.5e-3), ((0, -1), -1.5e-3))  # beside the groove, and behind it
    handle = tuple(extrude(clip(disc, normal, limit_m), *z) for normal, limit_m in cuts)
    shank = make_rectangle(9e-3, 9e-3)
    yaws_deg = (0.0, 30.0, 60.0, 90.0, -30.0, -60.0)
    return Part(
        "peg", (*handle, make_shank(shank, z[0])), shank, yaws_deg, make_shifts((0,), (-6e-3, 0, 8e-3, 16e-3)), 4
    )


def make_plug() -> Part:
    """Return a plug that fits in one way only. Its handle has the same rib every 5 mm."""
    z_m = np.arange(-16e-3, 24e-3, 5e-3)
    ribs = tuple(extrude(make_rectangle(22e-3, 11e-3), z, z + 2.5e-3) for z in z_m)
    core = extrude(make_rectangle(22e-3, 9.4e-3), z_m[0], z_m[-1] + 2.5e-3)
    shank = clip(make_rectangle(14e-3, 8e-3), (np.sqrt(0.5), np.sqrt(0.5)), 8e-3 * np.sqrt(0.5))
    shifts_m = make_shifts((-7e-3, 0, 7e-3), (-6e-3, 0, 8e-3, 16e-3))
    return Part("plug", (core, *ribs, make_shank(shank, z_m[0])), shank, (0.0, 90.0, -90.0), shifts_m, 1)


def make_bolt() -> Part:
    """Return a bolt with a long hexagonal head and a round shank."""
    head, shank = make_circle(7e-3 / np.cos(np.pi / 6), 6), make_circle(4e-3)
    z = (-16e-3, 20e-3)
    yaws_deg = (0.0, 60.0, -60.0, 30.0, 90.0, -30.0)
    shifts_m = make_shifts((0,), (-6e-3, 0, 8e-3, 14e-3))
    return Part("bolt", (extrude(head, *z), make_shank(shank, z[0])), shank, yaws_deg, shifts_m, 12)


PARTS = {"peg": make_peg, "plug": make_plug, "bolt": make_bolt}


def make_shank(outline: Points, top_m: float) -> Points:
    """Return the corners of a shank from `top_m` down to the tip, whose edges are chamfered."""
    tip = place(offset(outline, -TIP_CHAMFER_M), TIP_Z_M)
    return np.concatenate([place(outline, top_m), place(outline, TIP_Z_M + TIP_CHAMFER_M), tip])


def make_hole(shank: Points, clearance_m: float) -> tuple[Points, ...]:
    """Return convex pieces of a plate with a hole for a shank; the plate's surface is at z = 0.

    The hole is `clearance_m` wider than the shank: half of it on each side. Its mouth is chamfered. There is one piece
    for each edge of the outline, and the bottom.
    """
    wall = offset(shank, clearance_m / 2)
    mouth, outer = offset(wall, MOUTH_CHAMFER_M), offset(wall, WALL_M)
    depth_m = SEAT_Z_M - TIP_Z_M + SPARE_DEPTH_M
    rings = [(wall, -depth_m), (wall, -MOUTH_CHAMFER_M), (mouth, 0.0), (outer, 0.0), (outer, -depth_m)]
    sides = tuple(
        np.concatenate([place(ring[[k, (k + 1) % len(shank)]], z_m) for ring, z_m in rings]) for k in range(len(shank))
    )
    return (*sides, extrude(outer, -depth_m - BOTTOM_M, -depth_m))


def make_shifts(x_m: ArrayLike, z_m: ArrayLike) -> Points:
    """Return all pairs (N, 2) of shifts, metres."""
    return np.stack(np.meshgrid(x_m, z_m), axis=-1).reshape(-1, 2).astype(float)


def make_circle(radius_m: float, sides: int = SIDES) -> Points:
    """Return a regular polygon; one of its sides is parallel to x."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides + np.pi / 2
    return radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def make_rectangle(x_m: float, y_m: float) -> Points:
    """Return a rectangle about the origin."""
    return 0.5 * np.array([[x_m, y_m], [-x_m, y_m], [-x_m, -y_m], [x_m, -y_m]])


def clip(outline: Points, normal: ArrayLike, limit_m: float) -> Points:
    """Return the part of an outline where the product with the unit vector `normal` (2,) is at most `limit_m`."""
    beyond, kept = outline @ np.asarray(normal, float) - limit_m, []
    for k, here in enumerate(outline):
        after = (k + 1) % len(outline)
        if beyond[k] <= 0:
            kept.append(here)
        if beyond[k] * beyond[after] < 0:
            kept.append(here + (outline[after] - here) * beyond[k] / (beyond[k] - beyond[after]))
    return np.array(kept)


def offset(outline: Points, distance_m: float) -> Points:
    """Return the outline whose edges are moved outwards by `distance_m`."""
    along = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    before = np.roll(normals, 1, axis=0)
    return outline + distance_m * (normals + before) / (1 + (normals * before).sum(axis=1))[:, None]


def place(outline: Points, z_m: float) -> Points:
    """Return an outline as points (K, 3) at the height `z_m`."""
    return np.column_stack([outline, np.full(len(outline), z_m)])


def extrude(outline: Points, low_m: float, high_m: float) -> Points:
    """Return the corners (2 K, 3) of a prism."""
    return np.concatenate([place(outline, low_m), place(outline, high_m)])
