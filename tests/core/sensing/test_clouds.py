import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.ndimage import distance_transform_edt, gaussian_filter

from tactile_loc.core.geometry.rigid import make_translation
from tactile_loc.core.sensing.clouds import (
    OUTLINE_PX,
    OUTLINE_REACH_PX,
    SIDES,
    find_nearest_contact,
    make_contact_cloud,
    make_outline_cloud,
    spread_points,
)
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, compute_contact_depth
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer

RADIUS_M = 0.008
CAMERAS = {
    "pinhole": SensorGeometry("pinhole", 90, 70, 82.0, 80.0, 41.0, 36.5, 0.021, 0.002),
    "orthographic": SensorGeometry("orthographic", 90, 70, 4000.0, 3900.0, 41.0, 36.5, 0.021, 0.002),
}


@pytest.fixture(params=list(CAMERAS))
def camera(request: pytest.FixtureRequest) -> SensorGeometry:
    return CAMERAS[request.param]


def square(geometry: SensorGeometry, low: int, high: int, press_m: float = 0.002) -> ContactShape:
    """Return flat contact at depth 0 on rows and columns low ... high - 1, and no contact elsewhere."""
    depth = np.full(geometry.shape, press_m, np.float32)
    depth[low:high, low:high] = 0.0
    return ContactShape(depth, press_m)


def test_the_cloud_of_a_ball_has_points_and_normals_of_the_ball(camera, make_object):
    ball = make_object(trimesh.creation.icosphere(6, RADIUS_M)).mesh
    centre = np.array([0.001, -0.002, camera.standoff_m + RADIUS_M])
    depth = compute_contact_depth(
        ZBufferRenderer().render(ball, make_translation(centre)[None], camera), camera, camera.max_depth_m
    )[0]
    shape = ContactShape(depth, camera.max_depth_m)
    points, normals = make_contact_cloud(shape, camera, walls=False)
    assert len(points) == len(normals) == shape.contact.sum() > 500
    radial = (points - centre) / RADIUS_M
    np.testing.assert_allclose(np.linalg.norm(radial, axis=1), 1.0, atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    alike = np.einsum("pk,pk->p", normals, radial)
    assert np.median(alike) > 0.9995
    assert alike.min() > 0.95, "differences at the rim are one-sided"
    assert (normals[:, 2] < 0).all()


def walls_of(shape: ContactShape, camera: SensorGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (P, 3) and normals (P, 3) that walls add to those of the surface."""
    flat, _ = make_contact_cloud(shape, camera, walls=False)
    points, normals = make_contact_cloud(shape, camera)
    np.testing.assert_array_equal(points[: len(flat)], flat)
    return points[len(flat) :], normals[len(flat) :]


@pytest.mark.parametrize(("low", "high"), [(20, 50), (30, 31), (0, 0)])
def test_each_pixel_of_a_flat_square_is_a_point_that_faces_the_sensor(camera, low, high):
    points, normals = make_contact_cloud(square(camera, low, high), camera, walls=False)
    sx, sy = camera.scale_at_surface
    rows, columns = np.mgrid[low:high, low:high].reshape(2, -1) + 0.5
    expected = [(columns - camera.cx) / sx, (rows - camera.cy) / sy, np.full(rows.shape, camera.standoff_m)]
    np.testing.assert_allclose(points, np.stack(expected, axis=1), atol=1e-9)
    np.testing.assert_allclose(normals, np.broadcast_to([0, 0, -1.0], points.shape), atol=1e-9)
    if low == high:
        assert make_contact_cloud(square(camera, low, high), camera)[0].shape == (0, 3)


def test_a_flat_square_has_walls_on_its_outline_with_lateral_normals(camera):
    walls, normals = walls_of(square(camera, 20, 50), camera)
    pitch = camera.pixel_pitch_m
    levels = int(camera.max_depth_m / pitch)
    assert len(walls) == 4 * 30 * levels
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert not normals[:, 2].any()
    sx, sy = camera.scale_at_surface
    sides = [
        (0, -1, (20 - camera.cx) / sx),
        (0, 1, (50 - camera.cx) / sx),
        (1, -1, (20 - camera.cy) / sy),
        (1, 1, (50 - camera.cy) / sy),
    ]
    for axis, sign, where in sides:
        outward = sign * normals[:, axis] > 0.99
        assert outward.sum() > 20 * levels, "most of a side; normals at its ends may differ"
        np.testing.assert_allclose(walls[outward][:, axis], where, atol=0.05 * pitch)
    z = np.unique(walls[:, 2].round(9)) - camera.standoff_m
    np.testing.assert_allclose(z, pitch * np.arange(1, levels + 1), atol=1e-9)


def test_walls_face_out_of_the_contact(camera):
    """A step along the normal leaves the contact, a step against it stays inside."""
    x, y = np.meshgrid(np.arange(90) - 45.0, np.arange(70) - 35.0)
    for inside in (np.hypot(x, y) < 22, np.hypot(x, y) > 22, np.abs(x * np.cos(0.4) + y * np.sin(0.4)) < 8):
        shape = ContactShape(np.where(inside, 0.0, 0.002).astype(np.float32), 0.002)
        points, normals = walls_of(shape, camera)
        sx, sy = camera.scale_at_surface
        for sign, expected in ((1, False), (-1, True)):
            at = points[:, :2] * [sx, sy] + [camera.cx, camera.cy] + 2.5 * sign * normals[:, :2]
            columns, rows = np.clip(np.floor(at).astype(int), 0, [89, 69]).T
            assert (inside[rows, columns] == expected).mean() > 0.97


def test_an_outline_faces_down_the_slope_of_the_smoothed_mask(camera):
    rows, columns = np.indices(camera.shape)
    contact = np.hypot(rows - 30, 0.6 * (columns - 41)) < 14 + 4 * np.sin(columns / 3)
    shape = ContactShape(np.where(contact, np.float32(0), np.float32(0.002)), 0.002)
    slopes = [gaussian_filter(1.0 * contact, OUTLINE_PX, order, radius=OUTLINE_REACH_PX) for order in ((0, 1), (1, 0))]
    borders = [contact & ~np.roll(contact, (-down, -right), (0, 1)) for down, right in SIDES]
    outwards = -np.concatenate([np.stack(slopes, axis=-1)[border] for border in borders])
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    _, normals = make_outline_cloud(shape, camera)
    np.testing.assert_allclose(normals[:, :2] * np.sqrt(2), outwards, atol=1e-12)
    _, normals = walls_of(shape, camera)
    levels = len(normals) // len(outwards)
    np.testing.assert_allclose(normals[:, :2], np.repeat(outwards, levels, axis=0), atol=1e-12)


def test_a_square_in_the_corner_has_no_walls_at_the_sensor_border(camera):
    points, normals = walls_of(square(camera, 0, 30), camera)
    assert len(points) > 0
    assert (normals[:, :2] > -0.2).all(), "only the sides towards the middle end in a wall"
    sx, sy = camera.scale_at_surface
    at = np.column_stack([points[:, 0] * sx + camera.cx, points[:, 1] * sy + camera.cy])
    np.testing.assert_allclose(at.max(axis=1), 30.0, atol=0.1)


def test_masked_pixels_have_no_points_and_no_walls(camera):
    observed = np.ones(camera.shape, bool)
    observed[:, 35:] = False
    masked = dataclasses.replace(camera, observed=observed)
    assert len(make_contact_cloud(square(camera, 20, 50), masked, walls=False)[0]) == 30 * 15
    points, normals = walls_of(square(camera, 20, 50), masked)
    assert len(points) == (30 + 2 * 15) * int(camera.max_depth_m / camera.pixel_pitch_m)
    assert points[:, 0].max() < (35 - camera.cx) / camera.scale_at_surface[0]
    assert normals[:, 0].max() < 0.3


def test_a_step_within_the_contact_is_no_wall(camera):
    shape = square(camera, 20, 50)
    shape.depth_m[30:40, 30:40] = 0.001
    points, _ = make_contact_cloud(shape, camera)
    assert len(points) == len(make_contact_cloud(square(camera, 20, 50), camera)[0])


@pytest.mark.parametrize("share", [0.002, 0.05, 0.5, 1.0])
def test_nearest_contact_is_as_near_as_in_a_distance_transform(share):
    contact = np.random.default_rng(0).random((37, 52)) < share
    contact[5, 7] = True
    rows, columns = find_nearest_contact(contact)
    down, right = np.indices(contact.shape)
    assert contact[rows, columns].all()
    squared = (rows - down) ** 2 + (columns - right) ** 2
    np.testing.assert_allclose(np.sqrt(squared), distance_transform_edt(~contact), atol=1e-9)


def test_nearest_contact_needs_contact():
    with pytest.raises(ValueError, match="contact"):
        find_nearest_contact(np.zeros((4, 5), bool))


def test_spread_points_are_farthest_from_those_before_and_not_too_near():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [10, 0, 0], [4, 0, 0]])
    assert spread_points(points, 3) == [0, 2, 3]
    assert spread_points(points, 9, first=2, least=1.0) == [2, 0, 3]
