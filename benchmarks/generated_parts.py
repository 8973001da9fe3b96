#!/usr/bin/env python3
"""Plausible parts of machines, made from random numbers: a folder of STL files in millimetres.

A part's name determines its shape: `gear-00012` is always the same gear. Two parts in ten resemble an earlier part of
their family: one is its mirror image, and one has a small hole more. So a library has parts that touches can hardly
tell apart, as real catalogues do.

Libraries have parts of FAMILIES, with flat faces, cylinders and sharp edges. Parts of ROUNDED, such as castings and
bent rods, have mostly curved faces and few edges. The descriptor is trained on both.
"""

import argparse
import math
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

Rng = np.random.Generator
# last digits of the numbers of parts that resemble an earlier part of the same ten, and of this part
MIRRORED, DRILLED, ORIGINAL = 8, 9, 1
DIGITS = 5
SEGMENTS = 48  # of a circle
LEAST_LEFT = 0.3  # share of a casting that is left if it is cut flat
THROUGH = 1.2  # length of a cutting tool, in units of the material that it cuts


def make_cylinder(height: float, radius: float, top: float | None = None, segments: int = SEGMENTS) -> Manifold:
    """Return a cylinder or a cone on the plane z = 0, mm."""
    return Manifold.cylinder(height, radius, radius if top is None else top, segments)


def make_box(*size: float) -> Manifold:
    """Return a box on the plane z = 0, centred in x and y, mm."""
    return Manifold.cube(size, True).translate([0, 0, size[2] / 2])


def drill(
    part: Manifold, radius: float, at: Sequence[float] | NDArray[np.float64], segments: int = SEGMENTS
) -> Manifold:
    """Return the part with a hole along z through the point `at` (x, y), mm."""
    low, high = part.bounding_box()[2], part.bounding_box()[5]
    tool = make_cylinder(THROUGH * (high - low), radius, segments=segments)
    return part - tool.translate([*at, low - (THROUGH - 1) / 2 * (high - low)])


def make_ring(count: int, radius: float) -> NDArray[np.float64]:
    """Return points (count, 2) on a circle, mm."""
    angle_rad = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)


def make_shaft(rng: Rng) -> Manifold:
    """Return a stepped shaft with grooves, and perhaps a flat, a keyway or a cross hole."""
    part, z, radius = Manifold(), 0.0, rng.uniform(3, 7)
    for _ in range(rng.integers(2, 6)):
        height = rng.uniform(4, 14)
        part += make_cylinder(height, radius).translate([0, 0, z])
        if rng.random() < 0.3:
            part -= (make_cylinder(1.2, radius + 1) - make_cylinder(1.2, 0.85 * radius)).translate(
                [0, 0, z + rng.uniform(1, height - 2)]
            )
        z += height
        radius = float(np.clip(radius * rng.uniform(0.6, 1.5), 2.0, 12.0))
    chosen, at_z = rng.integers(4), rng.uniform(0.2, 0.8) * z
    if chosen == 0:
        part -= make_box(30, 30, rng.uniform(6, 12)).translate([0, rng.uniform(16.5, 18), at_z])
    if chosen == 1:
        part -= make_box(rng.uniform(1.5, 3), 30, rng.uniform(6, 12)).translate([0, 16.5, at_z])
    if chosen == 2:
        part -= make_cylinder(60, rng.uniform(0.8, 1.8)).rotate([90, 0, 0]).translate([0, 30, at_z])
    return part


def make_plate(rng: Rng) -> Manifold:
    """Return a plate with pockets, holes and slots."""
    length, width, height = rng.uniform(25, 60), rng.uniform(18, 40), rng.uniform(3, 10)
    outline = CrossSection.square([length, width], True)
    if rng.random() < 0.6:
        outline = outline.offset(-3, manifold3d.JoinType.Round).offset(3, manifold3d.JoinType.Round, 2.0, 32)
    part = Manifold.extrude(outline, height)
    for _ in range(rng.integers(1, 5)):
        size = rng.uniform(4, 0.4 * width, 2)
        at = (rng.random(2) - 0.5) * [length - size[0], width - size[1]]
        part -= make_box(*size, height).translate([*at, rng.uniform(0.3, 0.85) * height])
    for _ in range(rng.integers(1, 6)):
        at = (rng.random(2) - 0.5) * [length - 6, width - 6]
        part = drill(part, rng.uniform(1, 3), at)
    for _ in range(rng.integers(0, 3)):
        boss = make_cylinder(height + rng.uniform(1, 5), rng.uniform(2, 5))
        part += boss.translate([*(rng.random(2) - 0.5) * [length - 10, width - 10], 0])
    return part


def make_bracket(rng: Rng) -> Manifold:
    """Return an angle or a channel with holes, perhaps with a rib."""
    thick, width = rng.uniform(2, 5), rng.uniform(12, 35)
    first, second = rng.uniform(15, 40, 2)
    part = make_box(first, width, thick) + make_box(thick, width, second).translate([(thick - first) / 2, 0, 0])
    if rng.random() < 0.3:
        part += make_box(thick, width, rng.uniform(8, 30)).translate([(first - thick) / 2, 0, 0])
    if rng.random() < 0.5:
        reach = 0.6 * min(first, second)
        rib = CrossSection([[(0, 0), (reach, 0), (0, reach)]])
        rib = Manifold.extrude(rib, rng.uniform(2, 4)).rotate([90, 0, 0])
        part += rib.translate([thick - first / 2, rng.uniform(-0.3, 0.3) * width, thick])
    for _ in range(rng.integers(1, 4)):
        part = drill(part, rng.uniform(1.2, 3), (rng.random(2) - 0.3) * [first - 10, 0.6 * width])
    hole = make_cylinder(first, rng.uniform(1.2, 3)).rotate([0, 90, 0])
    return part - hole.translate([-first, rng.uniform(-0.25, 0.25) * width, rng.uniform(0.5, 0.8) * second])


def make_gear(rng: Rng) -> Manifold:
    """Return a spur gear with a hub, a bore, and perhaps a keyway or lightening holes."""
    teeth, module = int(rng.integers(9, 28)), rng.uniform(0.8, 1.8)
    inner, outer = module * (teeth - 2.5) / 2, module * (teeth + 2) / 2
    turn = 2 * np.pi / teeth
    phases = turn * np.array([-0.32, -0.14, 0.14, 0.32])
    corners = [
        (radius * math.cos(k * turn + phase), radius * math.sin(k * turn + phase))
        for k in range(teeth)
        for phase, radius in zip(phases, (inner, outer, outer, inner), strict=True)
    ]
    height, bore = rng.uniform(4, 12), rng.uniform(0.2, 0.45) * inner
    part = Manifold.extrude(CrossSection([corners]), height)
    if rng.random() < 0.6:
        part += make_cylinder(height + rng.uniform(2, 8), bore + rng.uniform(1.5, 3.5))
    part = drill(part, bore, (0, 0))
    if rng.random() < 0.5:
        part -= make_box(bore, 2 * bore, 4 * height).translate([0, bore, -1])
    if inner - bore > 8 and rng.random() < 0.5:
        for at in make_ring(int(rng.integers(3, 7)), (inner + bore) / 2 + 1):
            part = drill(part, 0.2 * (inner - bore), at)
    return part


def make_housing(rng: Rng) -> Manifold:
    """Return an open box with bosses, windows and perhaps a lip."""
    size, wall = rng.uniform([20, 18, 12], [50, 40, 30]), rng.uniform(1.5, 3.5)
    part = make_box(*size) - make_box(*size - 2 * wall).translate([0, 0, wall])
    part -= make_box(*(size - 2 * wall)[:2], size[2]).translate([0, 0, size[2] / 2])
    for sign in [(1, 1), (1, -1), (-1, 1), (-1, -1)][: rng.integers(0, 5)]:
        at = np.array(sign) * (size[:2] / 2 - wall - 2)
        radius = rng.uniform(2, 3.5)
        boss = make_cylinder(rng.uniform(0.5, 1.1) * size[2], radius) - make_cylinder(60, 0.4 * radius)
        part += boss.translate([*at, 0])
    for _ in range(rng.integers(1, 4)):
        window = make_box(rng.uniform(3, 12), 30, rng.uniform(3, 0.6 * size[2]))
        part -= window.translate([rng.uniform(-0.3, 0.3) * size[0], 15, rng.uniform(0.2, 0.6) * size[2]]).rotate(
            [0, 0, 90.0 * rng.integers(4)]
        )
    if rng.random() < 0.5:
        part += make_box(size[0] + 8, rng.uniform(8, 16), wall)
    return part


def make_flange(rng: Rng) -> Manifold:
    """Return a flange with a hub, a bore and a circle of bolts, perhaps cut flat on one side."""
    radius, height = rng.uniform(12, 28), rng.uniform(3, 8)
    hub = rng.uniform(0.3, 0.6) * radius
    part = make_cylinder(height, radius) + make_cylinder(height + rng.uniform(3, 18), hub, hub * rng.uniform(0.7, 1))
    part = drill(part, rng.uniform(0.4, 0.65) * hub, (0, 0))
    for at in make_ring(int(rng.integers(3, 9)), (radius + hub) / 2):
        part = drill(part, rng.uniform(0.9, 1.1) * min(2.5, 0.3 * (radius - hub)), at)
    if rng.random() < 0.4:
        part -= make_box(2 * radius, radius, 3 * height).translate([0, radius * rng.uniform(1.2, 1.4), -1])
    return part


def make_clip(rng: Rng) -> Manifold:
    """Return a bent strip: a random path with rounded corners, extruded."""
    at, heading = np.zeros(2), 0.0
    thick, width = rng.uniform(1.5, 4), rng.uniform(5, 18)
    part = CrossSection()
    for _ in range(rng.integers(3, 7)):
        there = at + rng.uniform(6, 18) * np.array([math.cos(heading), math.sin(heading)])
        ends = [CrossSection.circle(thick / 2, 24).translate(point) for point in (at, there)]
        part += CrossSection.batch_hull(ends)
        at, heading = there, heading + rng.uniform(0.6, 1.8) * rng.choice([-1, 1, 1])
    solid = Manifold.extrude(part, width)
    if rng.random() < 0.5:
        solid -= make_cylinder(4 * thick, 0.22 * width).rotate([90, 0, 0]).translate([5, 2 * thick, width / 2])
    return solid


def make_bolt(rng: Rng) -> Manifold:
    """Return a bolt with a hexagonal, round or square head, perhaps with a socket, a slot, a collar or grooves."""
    radius, length = rng.uniform(2, 6), rng.uniform(12, 40)
    head, tall = radius * rng.uniform(1.5, 2.2), radius * rng.uniform(0.8, 1.6)
    sides = int(rng.choice([4, 6, SEGMENTS]))
    part = make_cylinder(tall, head, segments=sides) + make_cylinder(length + tall, radius)
    if rng.random() < 0.4:
        part += make_cylinder(rng.uniform(1, 2), head * rng.uniform(1.1, 1.4)).translate([0, 0, tall])
    chosen = rng.integers(4)
    if chosen == 0:
        part -= make_cylinder(0.6 * tall, 0.5 * head, segments=6)
    if chosen == 1:
        part -= make_box(0.25 * head, 3 * head, 0.4 * tall)
    if chosen == 2:
        pitch = rng.uniform(1.2, 2.5)
        for k in range(int(0.5 * length / pitch)):
            groove = make_cylinder(pitch / 2, radius + 1) - make_cylinder(pitch / 2, 0.85 * radius)
            part -= groove.translate([0, 0, tall + length - pitch * (k + 1)])
    return part + make_cylinder(radius / 3, radius, 0.7 * radius).translate([0, 0, length + tall])


def make_plug(rng: Rng) -> Manifold:
    """Return a plug: a polygon extruded on a base, with ribs, a chamfer, and perhaps contacts."""
    sides = int(rng.integers(3, 9))
    angles = np.sort(rng.uniform(0, 2 * np.pi, sides) * 0.25 + 2 * np.pi * np.arange(sides) / sides * 0.75)
    radii = rng.uniform(7, 13, sides)
    outline = CrossSection([[(r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]])
    base, tall = rng.uniform(3, 7), rng.uniform(8, 22)
    part = Manifold.extrude(outline.offset(rng.uniform(1, 4), manifold3d.JoinType.Round, 2.0, 32), base)
    part += Manifold.extrude(outline, tall, scale_top=[rng.uniform(0.75, 1)] * 2).translate([0, 0, base])
    for _ in range(rng.integers(0, 3)):
        rib = make_box(rng.uniform(1.5, 3), 2 * radii.max() + 4, tall)
        part += rib.rotate([0, 0, rng.uniform(0, 180)]).translate([0, 0, 0.5 * base])
    for _ in range(rng.integers(0, 4)):
        part = drill(part, rng.uniform(0.8, 2), rng.uniform(-5, 5, 2))
    return part


def make_fitting(rng: Rng) -> Manifold:
    """Return an elbow or a tee of pipes with collars."""
    radius = rng.uniform(4, 8)
    bore = radius * rng.uniform(0.5, 0.8)
    solid, hollow = Manifold.sphere(radius, SEGMENTS), Manifold.sphere(bore, SEGMENTS)
    turns = [(0, 0), (rng.choice([60, 90, 90, 120]), 0)] + [(90, rng.uniform(60, 180))] * int(rng.random() < 0.4)
    for tilt, turn in turns:
        length = rng.uniform(1.8, 4) * radius
        arm, cut = make_cylinder(length, radius), make_cylinder(length + 1, bore)
        if rng.random() < 0.6:
            wide = rng.uniform(2, 6)
            sides = int(rng.choice([6, 8, SEGMENTS]))
            arm += make_cylinder(wide, radius * rng.uniform(1.15, 1.5), segments=sides).translate([0, 0, length - wide])
        solid += arm.rotate([0, tilt, turn])
        hollow += cut.rotate([0, tilt, turn])
    return solid - hollow


def make_knob(rng: Rng) -> Manifold:
    """Return a turned knob with flutes and a bore."""
    count = int(rng.integers(4, 8))
    radii, heights = rng.uniform(5, 14, count), np.cumsum(rng.uniform(2, 6, count))
    profile = [(0.0, 0.0), *zip(radii.tolist(), heights.tolist(), strict=True), (0.0, float(heights[-1]))]
    part = Manifold.revolve(CrossSection([profile]), SEGMENTS)
    for at in make_ring(int(rng.integers(3, 12)), radii.max() + rng.uniform(-0.5, 1.5)):
        if rng.random() < 0.95:
            part = drill(part, rng.uniform(1.5, 3), at)
    bore = make_cylinder(rng.uniform(0.4, 1.2) * heights[-1], rng.uniform(1.5, 3.5))
    return part - bore.translate([0, 0, -0.01])


def make_cam(rng: Rng) -> Manifold:
    """Return a lever or a cam: hulls of discs of several heights, with holes."""
    part, at, height = Manifold(), np.zeros(2), rng.uniform(4, 9)
    ends = []
    for _ in range(rng.integers(2, 4)):
        radius, there = rng.uniform(4, 9), at + rng.uniform(-22, 22, 2)
        discs = [make_cylinder(height, r).translate([*p, 0]) for r, p in ((radius, at), (radius * 0.6, there))]
        part += Manifold.batch_hull(discs)
        part += make_cylinder(height + rng.uniform(0, 6), radius).translate([*at, 0])
        ends.append(at)
        at = there
    for end in ends:
        part = drill(part, rng.uniform(1.5, 3.5), end)
    return part


def make_rod(rng: Rng) -> Manifold:
    """Return a bent round rod of varying thickness, perhaps with balls at its ends, or flattened."""
    at, along = np.zeros(3), draw_direction(rng)
    radius, part = rng.uniform(1.5, 6), Manifold()
    first = radius * rng.choice([1, 1, rng.uniform(1.2, 2)])
    part += make_ball(first, at)
    for _ in range(rng.integers(1, 6)):
        there = at + rng.uniform(1, 6) * radius * along
        thinner = float(np.clip(radius * rng.uniform(0.7, 1.4), 1.2, 9))
        part += Manifold.batch_hull([make_ball(radius, at), make_ball(thinner, there)])
        at, radius = there, thinner
        along = along + rng.uniform(0.3, 1.5) * draw_direction(rng)
        along /= np.linalg.norm(along)
    part += make_ball(radius * rng.choice([1, 1, rng.uniform(1.2, 2)]), at)
    return part.scale([1, 1, rng.choice([1, 1, rng.uniform(0.5, 0.9)])])


def make_casting(rng: Rng) -> Manifold:
    """Return rounded blocks that run into each other, with holes in any direction, perhaps cut flat."""
    part = Manifold()
    for _ in range(rng.integers(1, 4)):
        size, radius = rng.uniform(3, 14, 3), rng.uniform(1, 5)
        corners = rng.uniform(-1, 1, (int(rng.integers(3, 9)), 3)) * size
        block = Manifold.batch_hull([make_ball(radius * rng.uniform(0.6, 1.4), corner) for corner in corners])
        part += block.translate(rng.uniform(-8, 8, 3).tolist())
    for _ in range(rng.integers(0, 4)):
        tool = make_cylinder(80, rng.uniform(1, 4)) if rng.random() < 0.7 else make_ball(rng.uniform(2, 7), np.zeros(3))
        part -= place_at_random(tool, 12, rng)
    if rng.random() < 0.4:
        low, high = np.array(part.bounding_box()).reshape(2, 3)
        cut = part.trim_by_plane(draw_direction(rng).tolist(), -0.2 * float(np.linalg.norm(high - low)))
        part = cut if cut.volume() > LEAST_LEFT * part.volume() else part
    return keep_largest(part)


def make_dome(rng: Rng) -> Manifold:
    """Return a body turned from a smooth curve, or a ring, perhaps oval, with a hollow, or with holes."""
    angle, waves = np.linspace(0, np.pi, 40), rng.normal(0, 0.5, 3) / np.arange(2, 5)
    away = rng.uniform(6, 16) * (1 + np.sum([w * np.cos(k * angle) for k, w in enumerate(waves, 2)], axis=0))
    away = np.maximum(away, 1)
    profile = np.stack([away * np.sin(angle), rng.uniform(0.4, 1.6) * away * -np.cos(angle)], axis=1)
    if ring := rng.random() < 0.3:
        turn = np.linspace(0, 2 * np.pi, 40)[:-1]
        size = rng.uniform(1.5, 6, 2)
        profile = np.stack([size[0] * np.cos(turn) + size[0] * rng.uniform(1.2, 4), size[1] * np.sin(turn)], axis=1)
    part = Manifold.revolve(CrossSection([profile]), SEGMENTS)
    part = part.scale([1, rng.choice([1, rng.uniform(0.5, 0.9)]), 1])
    if not ring and rng.random() < 0.4:
        part -= part.scale([0.8, 0.8, 0.8]).translate([0, 0, rng.uniform(2, 8)])
    for _ in range(rng.integers(0, 4)):
        tool = make_cylinder(80, rng.uniform(1, 4)).translate([0, 0, rng.choice([0, -40])])
        part -= place_at_random(tool, 9, rng)
    return keep_largest(part)


def make_ball(radius: float, at: NDArray[np.float64]) -> Manifold:
    """Return a ball about a point (3,), mm."""
    return Manifold.sphere(radius, SEGMENTS).translate(at.tolist())


def place_at_random(tool: Manifold, reach: float, rng: Rng) -> Manifold:
    """Return a tool in a random direction, moved by at most `reach` along each axis, mm."""
    return tool.rotate(rng.uniform(0, 360, 3).tolist()).translate(rng.uniform(-reach, reach, 3).tolist())


def keep_largest(part: Manifold) -> Manifold:
    """Return the largest of the separate pieces of a part."""
    return max(part.decompose(), key=Manifold.volume)


def draw_direction(rng: Rng) -> NDArray[np.float64]:
    """Return a random unit vector (3,)."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector), float)


FAMILIES: dict[str, Callable[[Rng], Manifold]] = {
    "shaft": make_shaft, "plate": make_plate, "bracket": make_bracket, "gear": make_gear, "housing": make_housing,
    "flange": make_flange, "clip": make_clip, "bolt": make_bolt, "plug": make_plug, "fitting": make_fitting,
    "knob": make_knob, "cam": make_cam,
}  # fmt: skip
ROUNDED = {"rod": make_rod, "casting": make_casting, "dome": make_dome}
EVERY = FAMILIES | ROUNDED


def list_names(count: int, families: Sequence[str] = tuple(FAMILIES)) -> list[str]:
    """Return the names of `count` parts, of all families in turn."""
    return [f"{families[k % len(families)]}-{k // len(families):0{DIGITS}d}" for k in range(count)]


def make_part(name: str) -> Manifold:
    """Return the part with this name, mm."""
    family, _, number = name.rpartition("-")
    kind = int(number) % 10
    if kind in (MIRRORED, DRILLED):
        like = make_part(f"{family}-{int(number) - kind + ORIGINAL:0{DIGITS}d}")
        return like.mirror([1, 0, 0]) if kind == MIRRORED else drill(like, 1.2, draw_inside(like, name))
    return EVERY[family](np.random.default_rng([int(number), zlib.crc32(family.encode())]))


def list_likenesses(name: str) -> list[str]:
    """Return the names of the parts that resemble a part on purpose. Other names than those of parts have none."""
    family, _, number = name.rpartition("-")
    if family not in EVERY or int(number) % 10 not in (ORIGINAL, MIRRORED, DRILLED):
        return []
    first = int(number) // 10 * 10
    return [like for k in (ORIGINAL, MIRRORED, DRILLED) if (like := f"{family}-{first + k:0{DIGITS}d}") != name]


def draw_inside(part: Manifold, name: str) -> NDArray[np.float64]:
    """Return a point (2,), mm, at which a hole along z meets the part."""
    corners = np.asarray(part.to_mesh().vert_properties)[:, :2]
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    return np.asarray(corners[rng.choice(len(corners), 3)].mean(axis=0), float)


def make_mesh(name: str) -> trimesh.Trimesh:
    """Return the surface of the part with this name, mm."""
    mesh = make_part(name).to_mesh()
    return trimesh.Trimesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))


def main() -> None:
    """Write the parts. Parts that are already there are not made again."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--families", nargs="+", choices=list(EVERY), default=list(FAMILIES))
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name in list_names(arguments.count, arguments.families):
        path = arguments.folder / f"{name}.stl"
        if not path.exists():
            make_mesh(name).export(path)


if __name__ == "__main__":
    main()
