"""The test object: a plate with ten numbered places, each with a shape of its own.

The plate's frame has x to the right and y up, seen from above, and z away from the plate. Its origin is in the middle
of the plate's top. All lengths of this module are millimetres. The object is a height field, so that it prints without
support: no wall overhangs. No place looks the same after a turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from manifold3d import CrossSection, Manifold, OpType
from numpy.typing import NDArray
from tactile_loc import ObjectModel, TriangleMesh
from tactile_loc.plugin.helpers import SymmetryGroup

VERSION = 1  # of the shape: photos of one version can be compared
NAME = "test-object"
SIDE, THICKNESS = 60.0, 4.0  # of the plate
COLUMNS, ROWS = (-21.0, -7.0, 7.0, 21.0), (18.0, 0.0, -18.0)  # centre lines of the places: x and y
TOP = 2.0  # height of each place above the plate
RADIUS = 5.0  # of the circle about each place's centre that holds its shape
CORNER, NUMBER = 0.8, 0.6  # heights of the raised corner and of the numbers
LINE, LINE_DEPTH, NOTCH = 0.6, 0.4, 1.0  # width and depth of the centre lines, and depth of the notches
STROKE, DIGIT = 1.0, (3.0, 5.0)  # line width of the numbers, and width and height of a digit
STEP, RAMP, CROWN = 0.2, 0.6, 20.0  # height of steps, length of the ramp of the L, radius of the crowned triangle
MERGED = 1e-3  # shorter edges are merged, so that rounded files stay watertight
ROUND = 0.003  # most distance of a circle's chords from the circle
SEGMENTS_OF_DIGITS = ("abcdef", "bc", "abdeg", "abcdg", "bcfg", "acdfg", "acdefg", "abc", "abcdefg", "abcdfg")


@dataclass(frozen=True)
class NumberedPlace:
    """A numbered place, with the x and y of its centre, and the least `feature` that it holds, mm."""

    number: int
    name: str
    x: float
    y: float
    feature: float

    @property
    def centre_m(self) -> NDArray[np.float64]:
        """The centre of the place's top (3,) in the object's frame, metres."""
        return np.array([self.x, self.y, TOP]) / 1e3


SHAPES = (  # names and least features: radii of curvature, or widths
    ("dome", 5.0),
    ("cone", 0.5),
    ("roof edge", 0.6),
    ("step in L form", 2.5),
    ("cylinder ridge", 3.0),
    ("off-centre pyramid", 0.6),
    ("group of bumps", 0.5),
    ("groove comb", 0.6),
    ("crowned triangle", 20.0),
    ("flat face with a bump", 2.0),
)
PLACES = tuple(
    NumberedPlace(number, name, COLUMNS[(number - 1) % len(COLUMNS)], ROWS[(number - 1) // len(COLUMNS)], feature)
    for number, (name, feature) in enumerate(SHAPES, 1)
)


@cache
def make_object() -> ObjectModel:
    """Return the test object, metres."""
    found = make_solid().to_mesh64()
    mesh = TriangleMesh(
        np.asarray(found.vert_properties[:, :3], np.float64) / 1e3, np.asarray(found.tri_verts, np.int64)
    )
    return ObjectModel(NAME, mesh, SymmetryGroup.parse("none", mesh.centroid_m))


def write_stl(path: Path) -> None:
    """Write the object as a binary STL file, mm."""
    import trimesh

    mesh = make_object().mesh
    trimesh.Trimesh(1e3 * mesh.vertices_m, mesh.faces).export(path, file_type="stl")


def write_places(path: Path) -> None:
    """Write the table of the places, mm."""
    rows = ["number,name,x_mm,y_mm,z_mm,feature_mm"]
    rows += [f"{one.number},{one.name},{one.x:g},{one.y:g},{TOP:g},{one.feature:g}" for one in PLACES]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def make_solid() -> Manifold:
    """Return the whole object."""
    parts = [_make_plate(), *_make_corner()]
    parts += [_shape_place(place.number).translate((place.x, place.y, 0)) for place in PLACES]
    parts += [
        _write_number(place.number).translate((place.x - RADIUS - 0.5, place.y - RADIUS - 0.7 - DIGIT[1], 0))
        for place in PLACES
    ]
    return Manifold.batch_boolean(parts, OpType.Add).simplify(MERGED)


def _box(x: float, y: float, width: float, height: float, bottom: float, top: float) -> Manifold:
    """Return a box with its lower left corner at x and y."""
    return Manifold.cube((width, height, top - bottom)).translate((x, y, bottom))


def _make_plate() -> Manifold:
    """Return the plate, with a line along each centre line and a notch at each of its ends."""
    half = SIDE / 2
    cut = [_box(x - LINE / 2, -half, LINE, SIDE, -LINE_DEPTH, 1) for x in COLUMNS]
    cut += [_box(-half, y - LINE / 2, SIDE, LINE, -LINE_DEPTH, 1) for y in ROWS]
    notch = Manifold.cube((NOTCH * 2**0.5,) * 2 + (2 * THICKNESS + 2,), True).rotate((0, 0, 45))
    cut += [notch.translate((x, side, 0)) for x in COLUMNS for side in (-half, half)]
    cut += [notch.translate((side, y, 0)) for y in ROWS for side in (-half, half)]
    return Manifold.batch_boolean([_box(-half, -half, SIDE, SIDE, -THICKNESS, 0), *cut], OpType.Subtract)


def _make_corner() -> list[Manifold]:
    """Return the raised corner at the lower right, beside the places 9 and 10."""
    half = SIDE / 2
    return [_box(half - 7, -half, 7, 2, -1, CORNER), _box(half - 2, -half, 2, 7, -1, CORNER)]


def _write_number(number: int) -> Manifold:
    """Return a number of seven-segment digits, with its lower left corner at the origin."""
    (w, h), s = DIGIT, STROKE
    bars = {
        "a": (0, h - s, w, s),
        "b": (w - s, h / 2 - s / 2, s, h / 2 + s / 2),
        "c": (w - s, 0, s, h / 2 + s / 2),
        "d": (0, 0, w, s),
        "e": (0, 0, s, h / 2 + s / 2),
        "f": (0, h / 2 - s / 2, s, h / 2 + s / 2),
        "g": (0, h / 2 - s / 2, w, s),
    }
    boxes = [
        _box(k * (w + 0.8) + bars[name][0], *bars[name][1:], -0.5, NUMBER)
        for k, digit in enumerate(str(number))
        for name in SEGMENTS_OF_DIGITS[int(digit)]
    ]
    return Manifold.batch_boolean(boxes, OpType.Add)


def _count_segments(radius: float) -> int:
    """Return the number of chords of a circle, a multiple of four."""
    return 4 * math.ceil(math.pi / math.acos(1 - ROUND / radius) / 4)


def _bump(x: float, y: float, radius: float, top: float = TOP) -> Manifold:
    """Return a post with a round tip at x and y."""
    post = Manifold.cylinder(top - radius + 0.5, radius * 1.15, radius, _count_segments(radius)).translate((0, 0, -0.5))
    return (post + Manifold.sphere(radius, _count_segments(radius)).translate((0, 0, top - radius))).translate(
        (x, y, 0)
    )


def _cap(x: float, y: float, radius: float, top: float) -> Manifold:
    """Return the part of a sphere above the plate."""
    return (
        Manifold.sphere(radius, _count_segments(radius)).translate((x, y, top - radius)).trim_by_plane((0, 0, 1), -0.5)
    )


def _extrude(corners: list[tuple[float, float]], top: float = TOP) -> Manifold:
    """Return the prism of a polygon, whose corners are listed anticlockwise."""
    return Manifold.extrude(CrossSection([corners]), top + 0.5).translate((0, 0, -0.5))


def _shape_place(number: int) -> Manifold:
    """Return the shape of a place, with its centre at the origin."""
    return (
        _make_dome,
        _make_cone,
        _make_roof,
        _make_step,
        _make_cylinder,
        _make_pyramid,
        _make_bumps,
        _make_comb,
        _make_triangle,
        _make_face,
    )[number - 1]()


def _make_dome() -> Manifold:
    return _cap(-0.6, -0.4, 5.0, TOP) + _bump(3.0, 2.5, 0.8, 1.8)


def _make_cone() -> Manifold:
    return Manifold.cylinder(TOP + 0.5, 4.5, 0.5, _count_segments(4.5)).translate((0.4, -0.3, -0.5)) + _bump(
        -2.6, 2.4, 0.8, 1.8
    )


def _make_roof() -> Manifold:
    """Return a roof whose sides fall by 35 and 45 degrees, and whose ends differ."""
    corners = [
        *((x, y, z) for x in (-3.8, 3.8) for y in (-3.2, 2.3) for z in (-0.5, 0)),
        *((x, y, TOP) for x in (-3.8, 2.0) for y in (-0.3, 0.3)),
    ]
    return Manifold.hull_points(np.array(corners, float)).rotate((0, 0, 20))


def _make_step() -> Manifold:
    """Return an L on a block. The L's inner sides are ramps, so that the gel follows them."""
    low, bars = TOP - STEP, []
    for (x0, x1, y0, y1), (dx, dy) in (((-3.5, 3.5, -3.2, -0.7), (0, RAMP)), ((-3.5, -1.0, -3.2, 2.8), (RAMP, 0))):
        top = [(x, y, TOP) for x in (x0, x1) for y in (y0, y1)]
        base = [(x, y, z) for x in (x0, x1 + dx) for y in (y0, y1 + dy) for z in (-0.5, low)]
        bars.append(Manifold.hull_points(np.array(top + base, float)))
    return bars[0] + bars[1] + _box(-3.5, -3.2, 7.0, 6.0, -0.5, low)


def _make_cylinder() -> Manifold:
    ridge = Manifold.cylinder(7, 3, 3, _count_segments(3), True).rotate((0, 90, 0)).translate((0, 0, TOP - 3))
    return ridge.trim_by_plane((0, 0, 1), -0.5).rotate((0, 0, -30)) + _bump(2.4, 2.6, 0.8, 1.8)


def _make_pyramid() -> Manifold:
    base = [(x, y, z) for x in (-3.5, 3.5) for y in (-3.5, 3.5) for z in (-0.5, 0)]
    tip = [(1.2 + x, 0.8 + y, TOP) for x in (-0.3, 0.3) for y in (-0.3, 0.3)]
    return Manifold.hull_points(np.array(base + tip, float))


def _make_bumps() -> Manifold:
    bumps = ((-2.4, -2.0, 1.5), (2.3, -2.4, 1.0), (2.5, 1.7, 0.75), (-0.9, 2.6, 0.5))
    return Manifold.batch_boolean([_bump(*bump) for bump in bumps], OpType.Add)


def _make_comb() -> Manifold:
    """Return ribs of 1 mm, two of them lower, with grooves of 0.6, 0.9 and 1.3 mm. The last rib is shorter."""
    ribs = [(-3.4, 5.2, TOP), (-1.8, 5.2, TOP - STEP), (0.1, 5.2, TOP), (2.4, 4.0, TOP - STEP)]
    return Manifold.batch_boolean([_box(x, -2.6, 1.0, y, -0.5, top) for x, y, top in ribs], OpType.Add)


def _make_triangle() -> Manifold:
    """Return a triangle whose top is a part of a large sphere."""
    return _extrude([(-3.6, -2.4), (3.9, -1.6), (-1.2, 3.4)]) ^ _cap(0, 0, CROWN, TOP)


def _make_face() -> Manifold:
    face = _extrude([(-4.0, -2.8), (4.0, -2.8), (4.0, 2.8), (-4.0, 2.8)], TOP - 0.3)
    return face + _cap(1.6, -0.6, 2.0, TOP)
