"""Both exact renderers draw the depths that follow from geometry."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import compute_contact_depth

NANOMETRES_100 = 1e-7


def ball_depth(rays, centre_m, radius_m):
    """Depth at which rays first meet a ball; inf where they miss."""
    origin, direction = rays
    a = (direction**2).sum(-1)
    b = (direction * (centre_m - origin)).sum(-1)
    root = b**2 - a * (((centre_m - origin) ** 2).sum(-1) - radius_m**2)
    return np.where(root >= 0.0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)


def test_a_sphere_has_its_analytic_depth(exact_renderer, camera, sphere, inner_radius_m, rays):
    centre = np.array([0.0023, -0.0034, camera.standoff_m + 0.008])
    depth = exact_renderer.render(sphere, make_transform(np.eye(3), centre)[None], camera)[0]
    outer, inner = ball_depth(rays(camera), centre, 0.008), ball_depth(rays(camera), centre, inner_radius_m)
    band = outer < camera.standoff_m + camera.max_depth_m - 5e-6
    assert band.sum() > 200
    assert (depth[band] >= outer[band] - NANOMETRES_100).all()
    assert (depth[band] <= inner[band] + NANOMETRES_100).all()
    assert (inner[band] - outer[band]).max() < 3e-6, "the tessellation is too coarse for this test"
    assert (depth[inner > camera.standoff_m + camera.max_depth_m + 5e-6] > camera.standoff_m + camera.max_depth_m).all()


def test_the_contact_depth_of_a_sphere_follows_the_closed_form(exact_renderer, sphere):
    """Seen straight from above, the contact depth at distance q from the contact is r - sqrt(r^2 - q^2)."""
    g = SensorGeometry("orthographic", 41, 41, 10_000.0, 10_000.0, 20.5, 20.5, 0.02, 0.002)
    T = make_transform(np.eye(3), [0.0, 0.0, 0.028])[None]
    shape = compute_contact_depth(exact_renderer.render(sphere, T, g), g, 0.002)[0]
    q = (np.arange(41) - 20) * 1e-4
    np.testing.assert_allclose(shape[20], 0.008 - np.sqrt(0.008**2 - q**2), atol=2e-6)
    np.testing.assert_allclose(shape[:, 20], 0.008 - np.sqrt(0.008**2 - q**2), atol=2e-6)


@pytest.mark.parametrize(("axis", "tilt_rad"), [((0, 1, 0), 0.0), ((1, 0.3, 0), 0.12), ((-0.2, 1, 0.4), -0.9)])
def test_a_tilted_plane_has_its_analytic_depth(exact_renderer, camera, quad, rays, axis, tilt_rad):
    T = make_transform(rotation_about(axis, tilt_rad), [0.001, 0.002, camera.standoff_m + 0.001])
    depth = exact_renderer.render(quad, T[None], camera)[0]
    origin, direction = rays(camera)
    normal = T[:3, 2]
    truth = ((T[:3, 3] - origin) @ normal) / (direction @ normal)
    band = (truth >= camera.standoff_m) & (truth <= camera.standoff_m + camera.max_depth_m)
    assert band.sum() > 50
    np.testing.assert_allclose(depth[band], truth[band], atol=NANOMETRES_100)


def plate(x_m: tuple[float, float], z_m: float) -> tuple[list[list[float]], list[list[int]]]:
    (x0, x1), y = x_m, 0.003
    return [[x0, -y, z_m], [x1, -y, z_m], [x1, y, z_m], [x0, y, z_m]], [[0, 1, 2], [0, 2, 3]]


def test_a_pinhole_camera_sees_below_an_overhang(exact_renderer):
    """Rays diverge: a ray that just misses the inner edge of a plate hits the surface behind the plate."""
    g = SensorGeometry("pinhole", 200, 21, 400.0, 400.0, 20.0, 10.5, 0.02, 0.002)
    (front, faces), (hidden, _) = plate((0.005, 0.006), 0.02), plate((0.00501, 0.006), 0.0215)
    mesh = TriangleMesh(np.array(front + hidden), np.array(faces + [[a + 4, b + 4, c + 4] for a, b, c in faces]))
    row = exact_renderer.render(mesh, np.eye(4)[None], g)[0, 10]
    slope = (np.arange(200) + 0.5 - 20.0) / 400.0
    below = (slope * 0.0215 > 0.00502) & (slope * 0.02 < 0.005)
    assert below.sum() >= 5
    np.testing.assert_allclose(row[below], 0.0215, atol=NANOMETRES_100)
    np.testing.assert_allclose(row[(slope * 0.02 > 0.005) & (slope * 0.02 < 0.006)], 0.02, atol=NANOMETRES_100)


def test_pixels_without_a_surface_are_inf(exact_renderer, camera, sphere):
    aside = make_transform(np.eye(3), [0.3, 0.0, camera.standoff_m + 0.008])
    assert np.isinf(exact_renderer.render(sphere, aside[None], camera)).all()


def test_half_the_resolution_keeps_the_view(exact_renderer, camera, quad):
    """Resizing keeps the view: a plane's mean depth in 2 x 2 pixels is the depth of the larger pixel."""
    T = make_transform(rotation_about([0.4, 1, 0], 0.03), [0, 0, camera.standoff_m + 0.001])[None]
    fine = exact_renderer.render(quad, T, camera)[0]
    height, width = (size // 2 for size in camera.shape)
    coarse = exact_renderer.render(quad, T, camera.resize(width, height))[0]
    np.testing.assert_allclose(fine.reshape(height, 2, width, 2).mean((1, 3)), coarse, rtol=1e-4)
