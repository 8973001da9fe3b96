"""Contact with a gel that is a cap of a sphere, against the formula of two spheres that touch."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from tactile_loc.core.clouds import contact_cloud
from tactile_loc.core.contact import bring_to_contact, upright_relief
from tactile_loc.core.geometry import translation
from tactile_loc.core.objects import TriangleMesh
from tactile_loc.core.registry import registry
from tactile_loc.core.sensing import ContactShape, SensorGeometry, contact_depth

GEL_M, BALL_M, PRESS_M = 35e-3, 4e-3, 5e-4
FACET_M = 2e-6  # of the ball
PLACES = [(0.0, 0.0), (3e-3, 5e-3), (-5e-3, 7e-3)]


def domed(camera: str) -> SensorGeometry:
    """A sensor whose gel is a sphere of radius GEL_M, its top at the standoff on the optical axis."""
    flat = {
        "orthographic": SensorGeometry("orthographic", 150, 200, 1e4, 1e4, 75.0, 100.0, 0.02, 1e-3),
        "pinhole": SensorGeometry("pinhole", 150, 200, 200.0, 200.0, 75.0, 100.0, 0.02, 1e-3),
    }[camera]
    x, y = np.meshgrid(*flat.pixel_slopes)
    if camera == "orthographic":
        z = flat.standoff_m - GEL_M + np.sqrt(GEL_M**2 - x**2 - y**2)
    else:  # where the ray z (x, y, 1) meets the sphere about (0, 0, c)
        a, c = x**2 + y**2 + 1, flat.standoff_m - GEL_M
        z = (c + np.sqrt(c**2 - a * (c**2 - GEL_M**2))) / a
    return dataclasses.replace(flat, relief_m=(z - flat.standoff_m).astype(np.float32))


@pytest.fixture(scope="module")
def ball() -> TriangleMesh:
    sphere = trimesh.creation.icosphere(5, radius=BALL_M)
    return TriangleMesh(np.array(sphere.vertices), np.array(sphere.faces))


@pytest.fixture(scope="module")
def block() -> TriangleMesh:
    box = trimesh.creation.box([0.05, 0.05, 0.01])
    return TriangleMesh(np.array(box.vertices), np.array(box.faces))


def touching_m(geometry: SensorGeometry, x: float, y: float) -> float:
    """Where the ball's centre is when the two spheres touch."""
    return geometry.surface_m - GEL_M + float(np.sqrt((GEL_M + BALL_M) ** 2 - x**2 - y**2))


@pytest.mark.parametrize("camera", ["orthographic", "pinhole"])
@pytest.mark.parametrize("place", PLACES)
def test_two_spheres_touch_where_they_should(ball, camera, place):
    geometry = domed(camera)
    (T,), (touching,) = bring_to_contact(ball, translation([[*place, 0.3]]), geometry)
    assert touching
    assert T[:2, 3] == pytest.approx(place)
    assert T[2, 3] == pytest.approx(touching_m(geometry, *place), abs=FACET_M)


@pytest.mark.parametrize("camera", ["orthographic", "pinhole"])
@pytest.mark.parametrize("renderer", ["heightmap", "zbuffer", "raycast"])
def test_a_balls_imprint_has_its_formula(ball, camera, renderer):
    geometry = domed(camera).pressed(PRESS_M)
    x, y = PLACES[1]
    T = translation([[x, y, touching_m(geometry, x, y) - PRESS_M]])
    drawn = registry().create("renderer", renderer, {}).render(ball, T, geometry.band)
    depth_m = contact_depth(drawn, geometry, PRESS_M)[0]
    rays = geometry.backproject(np.ones(geometry.shape)) - ([0, 0, 1] if camera == "orthographic" else 0)
    towards = np.array([0.0, 0.0, 1.0]) if camera == "orthographic" else rays
    start = rays if camera == "orthographic" else np.zeros(3)
    off = start - T[0, :3, 3]
    a, b, c = (towards**2).sum(-1), (off * towards).sum(-1), (off**2).sum(-1) - BALL_M**2
    with np.errstate(invalid="ignore"):
        z = (-b - np.sqrt(b**2 - a * c)) / a
    truth = np.clip(np.where(np.isnan(z), np.inf, z) - geometry.full_penetration_m, 0, PRESS_M)
    assert (truth < PRESS_M).sum() > 500
    assert depth_m == pytest.approx(truth, abs=4 * FACET_M)


def test_a_flat_face_touches_the_top_of_the_gel_alone(block):
    geometry = domed("orthographic")
    (T,), _ = bring_to_contact(block, translation([[0.002, -0.003, 0.1]]), geometry)
    assert T[2, 3] == pytest.approx(geometry.standoff_m + 0.005, abs=1e-7)
    pressed = geometry.pressed(PRESS_M)
    T[2, 3] -= PRESS_M
    depth_m = contact_depth(
        registry().create("renderer", "zbuffer", {}).render(block, T[None], pressed.band), pressed, 1
    )
    x, y = np.meshgrid(*geometry.pixel_slopes)
    touched = np.hypot(x, y) < np.sqrt(GEL_M**2 - (GEL_M - PRESS_M) ** 2)  # the cap that the plane cuts off
    assert ((depth_m[0] < PRESS_M) == touched).mean() > 0.999


def test_an_edge_across_the_gel_touches_between_its_ends(block):
    geometry = domed("orthographic")
    roof = np.array([[1, 0, 0], [0, 1, -1], [0, 1, 1]]) / np.array([[1], [2**0.5], [2**0.5]])
    T = translation([0.0, 0.006, 0.1])
    T[:3, :3] = roof
    (T,), _ = bring_to_contact(block, T[None], geometry)
    turned = block.vertices_m @ roof.T
    edge = turned[turned[:, 2].argmin()]
    y = edge[1] + 0.006  # where the edge lies; it touches where x = 0
    assert abs(y) < 0.01
    relief_m = np.sqrt(GEL_M**2 - y**2) - GEL_M
    assert T[2, 3] + edge[2] == pytest.approx(geometry.standoff_m + relief_m, abs=1e-6)


def test_a_flat_relief_is_a_flat_gel(ball):
    flat = dataclasses.replace(domed("pinhole"), relief_m=None)
    level = dataclasses.replace(flat, relief_m=np.zeros(flat.shape, np.float32))
    poses = translation([[*place, 0.1] for place in PLACES])
    (ours, theirs) = (bring_to_contact(ball, poses, geometry)[0] for geometry in (flat, level))
    assert ours == pytest.approx(theirs, abs=1e-8)
    assert flat.band is flat
    assert not flat.is_same_sensor(level)


def test_the_relief_seen_along_rays_is_found_upright():
    geometry = domed("pinhole")
    relief_m, (x0, y0, dx, dy) = upright_relief(geometry)
    x, y = x0 + dx * np.arange(150), y0 + dy * np.arange(200)
    inside = np.s_[20:-20, 20:-20]  # rays to the rim see gel that lies farther in
    truth = np.sqrt(GEL_M**2 - x[None] ** 2 - y[:, None] ** 2) - GEL_M
    assert relief_m[inside] == pytest.approx(truth[inside], abs=2e-6)


def test_the_cloud_of_a_touch_lies_on_the_object(ball):
    geometry = domed("orthographic").pressed(PRESS_M)
    x, y = PLACES[2]
    T = translation([[x, y, touching_m(geometry, x, y) - PRESS_M]])
    depth_m = contact_depth(
        registry().create("renderer", "zbuffer", {}).render(ball, T, geometry.band), geometry, PRESS_M
    )
    points, normals = contact_cloud(ContactShape(depth_m[0], PRESS_M), geometry, walls=False)
    off = points - T[0, :3, 3]
    assert np.linalg.norm(off, axis=1) == pytest.approx(BALL_M, abs=4 * FACET_M)
    assert (normals * off / BALL_M).sum(axis=1).min() > 0.98


def test_sizes_change_and_the_gel_stays():
    geometry = domed("orthographic")
    for other in (geometry.resized(75, 100), geometry.every(2), geometry.pressed(PRESS_M)):
        x, y = np.meshgrid(*other.pixel_slopes)
        truth = np.sqrt(GEL_M**2 - x**2 - y**2) - GEL_M
        assert other.relief_m == pytest.approx(truth, abs=2e-6)
        assert geometry.is_same_sensor(other.resized(150, 200)) or other.shape == (100, 75)
    steeper = dataclasses.replace(geometry, relief_m=1.5 * geometry.relief_m)
    assert not geometry.is_same_sensor(steeper)
    assert geometry.describe() != steeper.describe()
