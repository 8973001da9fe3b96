import numpy as np
import pytest

from tactile_loc.view.drawn_scene import make_box
from tactile_loc.view.raytracing import LIGHT, Tracer, Viewpoint, blend, count_marked, unmultiply

FRONT = Viewpoint(azimuth_deg=0.0, elevation_deg=0.0)
BLOCK = make_box((-2, 2), (-1, 1), (0, 3))
ORANGE, BLACK = np.array([1.0, 0.5, 0.0]), np.zeros(3)


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (35, 30), (-145, 60)])
def test_the_view_is_a_rotation_with_z_up(azimuth, elevation):
    axes = Viewpoint(azimuth, elevation).axes
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes[0, 2] == 0  # the horizon is level
    assert axes[2, 2] == pytest.approx(np.sin(np.radians(elevation)))


def test_a_box_has_the_right_area_and_volume():
    a, b, c = np.moveaxis(BLOCK, 1, 0)
    normals = np.cross(b - a, c - a) / 2
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(2 * (4 * 2 + 4 * 3 + 2 * 3))
    volume = np.einsum("ij,ij->i", a, normals).sum() / 3
    assert abs(volume) == pytest.approx(4 * 2 * 3)  # all faces have the same winding


def test_rays_meet_the_nearest_surface():
    behind = make_box((-4, 4), (2, 3), (0, 5))
    seen = Tracer([BLOCK, behind], FRONT).look((-5, 5, -1, 6), (70, 100))
    share = [(seen.surface == k).mean() * 70 for k in (0, 1)]
    assert share == pytest.approx([4 * 3, 8 * 5 - 4 * 3], abs=0.5)
    right, up, towards = seen.origins
    y = right[:, 1] + up[:, None, 1] - seen.depth * towards[1]
    assert y[seen.surface == 0] == pytest.approx(-1, abs=1e-4)  # the block's front
    assert (seen.surface[0] == -1).all()  # above everything


def test_only_outlines_and_creases_are_edges():
    seen = Tracer([BLOCK], FRONT).look((-5, 5, -1, 6), (70, 100))
    marked = seen.find_edges(jump=0.1)
    assert marked.sum() == pytest.approx(2 * (40 + 30), abs=6)
    corner = Tracer([BLOCK], Viewpoint(45.0, 0.0)).look((-5, 5, -1, 6), (70, 100))
    assert corner.find_edges(jump=0.5)[35].sum() == 3  # left, the corner between two faces, right


def paint(tracer, seen, colours, factor=1):
    return tracer.paint(seen, np.array([*colours, BLACK]), 0.5, 0.01, factor)


def test_a_shadow_lies_opposite_the_light():
    floor = make_box((-20, 20), (-20, 20), (-1, 0))
    tracer = Tracer([make_box((-1, 1), (-1, 1), (4, 6)), floor], Viewpoint(0.0, 89.0))
    seen = tracer.look((-20, 20, -20, 20), (200, 200))
    red = paint(tracer, seen, [ORANGE, ORANGE])[..., 0]
    flat = (seen.surface == 1) & ~seen.find_edges(0.5)
    dark = flat & (red < 0.7 * np.median(red[flat]))
    right, up, towards = seen.origins
    x, y = (right[:, k] + up[:, None, k] - seen.depth * towards[k] for k in (0, 1))
    assert [x[dark].mean(), y[dark].mean()] == pytest.approx(-5 * LIGHT[:2] / LIGHT[2], abs=0.6)


def test_pictures_are_transparent_beside_the_object_and_dark_at_edges():
    tracer = Tracer([BLOCK], FRONT)
    seen = tracer.look((-5, 5, -1, 6), (70, 100))
    hit, edges = seen.surface >= 0, seen.find_edges(0.5)
    image = paint(tracer, seen, [ORANGE])
    assert np.array_equal(image[..., 3], hit.astype(float))
    assert (image[~hit] == 0).all()
    lit, edged = image[hit & ~edges], image[hit & edges]
    assert (lit[:, 0] > lit[:, 1]).all()
    assert (lit <= 1).all()
    assert edged[:, 0].max() < 0.3 * lit[:, 0].max()
    assert (edged >= 0).all()


def test_blocks_of_pixels_are_averaged_with_their_opacity():
    tracer = Tracer([BLOCK], FRONT)
    seen = tracer.look((-5, 5, -1, 6), (70, 100))
    fine, coarse = (paint(tracer, seen, [ORANGE], factor) for factor in (1, 2))
    assert coarse.shape == (35, 50, 4)
    assert coarse == pytest.approx(fine.reshape(35, 2, 50, 2, 4).mean(axis=(1, 3)), abs=1e-5)
    assert count_marked(seen.surface >= 0, 2) == pytest.approx(coarse[..., 3])
    part = coarse[(coarse[..., 3] > 0) & (coarse[..., 3] < 1)]
    assert unmultiply(part.copy())[:, :3] * part[:, 3:] == pytest.approx(part[:, :3], abs=1e-6)


def test_blending_shows_what_lies_below_by_the_rest_of_the_opacity():
    below, above = np.array([[[0.2, 0.4, 0.6, 1.0]]]), np.array([[[1.0, 0.0, 0.0, 1.0]]])
    assert blend(below, above, 0.25)[0, 0] == pytest.approx([0.4, 0.3, 0.45, 1.0])
    assert blend(below, np.zeros_like(above), 0.25) == pytest.approx(below)
