"""examples/insertion: the convex pieces of parts and holes."""

import numpy as np
import pytest
from shapes import (
    BOTTOM_M,
    MOUTH_CHAMFER_M,
    PARTS,
    SEAT_Z_M,
    SPARE_DEPTH_M,
    TIP_Z_M,
    WALL_M,
    clip,
    make_hole,
    make_rectangle,
    offset,
    place,
)
from trimesh.convex import convex_hull

CLEARANCE_M = 3e-4
DEPTH_M = SEAT_Z_M - TIP_Z_M + SPARE_DEPTH_M

parts = pytest.mark.parametrize("name", PARTS)


def area(outline) -> float:
    x, y = outline.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def contains(piece, points_m, slack_m=0.0) -> np.ndarray:
    """Return which points are inside a convex piece that is smaller by `slack_m`."""
    hull = convex_hull(piece)
    beyond = np.einsum("fk,pfk->pf", hull.face_normals, points_m[:, None] - hull.triangles[:, 0])
    return (beyond < -slack_m).all(axis=1)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@parts
def test_the_pieces_of_a_hole_fill_the_plate_except_the_hole(name):
    shank = PARTS[name]().shank
    wall = offset(shank, CLEARANCE_M / 2)
    outer, mouth = offset(wall, WALL_M), offset(wall, MOUTH_CHAMFER_M)
    funnel = convex_hull(np.concatenate([place(wall, -MOUTH_CHAMFER_M), place(mouth, 0.0)])).volume
    hole = area(wall) * (DEPTH_M - MOUTH_CHAMFER_M) + funnel
    plate = area(outer) * (DEPTH_M + BOTTOM_M)
    pieces = make_hole(shank, CLEARANCE_M)
    assert sum(convex_hull(piece).volume for piece in pieces) == pytest.approx(plate - hole, rel=1e-9)


@parts
@pytest.mark.parametrize("clearance_m", [1e-4, 5e-4])
def test_the_hole_is_wider_than_the_shank_by_the_clearance(name, clearance_m):
    """The shank may be moved by half of the clearance towards each side, and no farther."""
    part = PARTS[name]()
    wall = offset(part.shank, clearance_m / 2)
    along = np.roll(wall, -1, axis=0) - wall
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    gaps = ((wall * normals).sum(axis=1))[:, None] - normals @ part.shank.T
    np.testing.assert_allclose(gaps.min(axis=1), clearance_m / 2, rtol=1e-6)


@parts
def test_a_part_is_one_closed_surface_with_the_volume_of_its_pieces(name, rng):
    from meshes import build_surface

    part = PARTS[name]()
    surface = build_surface(part)
    assert surface.is_watertight
    assert surface.body_count == 1
    low, high = surface.bounds
    points = rng.uniform(low, high, (20_000, 3))
    inside = np.any([contains(piece, points) for piece in part.pieces], axis=0)
    assert inside.mean() * np.prod(high - low) == pytest.approx(surface.volume, rel=0.05)


@parts
def test_a_part_stands_on_its_tip_and_fits_where_it_says(name):
    part = PARTS[name]()
    corners = np.concatenate(part.pieces)
    assert corners[:, 2].min() == pytest.approx(TIP_Z_M)
    turn = 2 * np.pi / part.fits
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = part.shank @ R.T
    wall = offset(part.shank, 5e-4)
    along = np.roll(wall, -1, axis=0) - wall
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1)
    assert (normals @ turned.T <= (wall * normals).sum(axis=1)[:, None]).all()


def test_the_plug_fits_in_one_way_only():
    shank = PARTS["plug"]().shank
    assert len(shank) == 5
    half_turned = -shank
    assert not any(np.allclose(half_turned, np.roll(shank, k, axis=0), atol=1e-6) for k in range(5))
    assert area(clip(make_rectangle(14e-3, 8e-3), (-1, 0), 0.0)) == pytest.approx(7e-3 * 8e-3)
