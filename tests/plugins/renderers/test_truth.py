"""Both exact renderers draw the depths that follow from geometry."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, rotation_about

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
