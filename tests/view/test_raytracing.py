import numpy as np
import pytest

from tactile_loc.view.drawn_scene import make_box
from tactile_loc.view.raytracing import LIGHT, Tracer, Viewpoint, shade, shrink

FRONT = Viewpoint(azimuth_deg=0.0, elevation_deg=0.0)
BLOCK = make_box((-2, 2), (-1, 1), (0, 3))


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (35, 30), (-145, 60)])
def test_the_view_is_a_rotation_with_z_up(azimuth, elevation):
    axes = Viewpoint(azimuth, elevation).axes
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes[0, 2] == 0  # the horizon is level
    assert axes[2, 2] == pytest.approx(np.sin(np.radians(elevation)))


def test_the_front_view_has_x_to_the_right_and_z_up():
    assert FRONT.project(np.array([1.0, 5.0, 2.0])) == pytest.approx([1.0, 2.0])
    assert Viewpoint(90.0, 0.0).project(np.array([1.0, 5.0, 2.0])) == pytest.approx([5.0, 2.0])  # from +x


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
    front = seen.surface[seen.hit] == 0
    _, y, _ = seen.locate(np.eye(3), lift=0.5)
    assert y[front] == pytest.approx(-1.5, abs=1e-4)  # the block's front, moved along its normals
    assert (seen.surface[0] == -1).all()  # above everything


def test_only_outlines_and_creases_are_edges():
    seen = Tracer([BLOCK], FRONT).look((-5, 5, -1, 6), (70, 100))
    marked = seen.find_edges(jump=0.1)
    assert marked.sum() == pytest.approx(2 * (40 + 30), abs=6)
    corner = Tracer([BLOCK], Viewpoint(45.0, 0.0)).look((-5, 5, -1, 6), (70, 100))
    assert corner.find_edges(jump=0.5)[35].sum() == 3  # left, the corner between two faces, right


def test_a_shadow_lies_opposite_the_light():
    floor = make_box((-20, 20), (-20, 20), (-1, 0))
    tracer = Tracer([make_box((-1, 1), (-1, 1), (4, 6)), floor], Viewpoint(0.0, 89.0))
    seen = tracer.look((-20, 20, -20, 20), (200, 200))
    dark = (tracer.cast_shadow(seen, 0.01) & (seen.surface == 1))[seen.hit]
    x, y, _ = seen.locate(np.eye(3), lift=0.0)
    assert [x[dark].mean(), y[dark].mean()] == pytest.approx(-5 * LIGHT[:2] / LIGHT[2], abs=0.6)


def test_shading_is_transparent_beside_the_object_and_shrinking_weights_by_opacity():
    tracer = Tracer([BLOCK], FRONT)
    seen = tracer.look((-5, 5, -1, 6), (70, 100))
    image = shade(seen, np.array([[1.0, 0.5, 0.0]]), np.zeros(seen.surface.shape, bool))
    assert np.array_equal(image[..., 3], seen.hit.astype(float))
    lit = image[seen.hit]
    assert (lit[:, 0] > lit[:, 1]).all()
    assert (lit >= 0).all()
    assert (lit <= 1).all()
    shadowed = shade(seen, np.array([[1.0, 0.5, 0.0]]), seen.hit)
    assert (shadowed[seen.hit][:, 0] < lit[:, 0]).all()
    image = np.zeros((2, 4, 4))
    image[0, 0] = [1.0, 0.2, 0.0, 1.0]
    small = shrink(image, 2)
    assert small.shape == (1, 2, 4)
    assert small[0, 0] == pytest.approx([1.0, 0.2, 0.0, 0.25])
    assert small[0, 1, 3] == 0
