"""Contact with a spherical gel, compared with the formula of two spheres that touch."""

import dataclasses

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import draw_rotations, make_transform, make_translation, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.clouds import make_contact_cloud
from tactile_loc.core.sensing.contact import (
    bring_to_contact,
    find_lowest_over_relief,
    find_lowest_points,
    make_upright_relief,
)
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, compute_contact_depth
from tactile_loc.slots.registry import registry

GEL_M, BALL_M, PRESS_M = 35e-3, 4e-3, 5e-4
FACET_M = 2e-6  # of the ball
PLACES = [(0.0, 0.0), (3e-3, 5e-3), (-5e-3, 7e-3)]


def domed(camera: str) -> SensorGeometry:
    """Return a sensor with a spherical gel of radius GEL_M, its top at the standoff on the optical axis."""
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
    """Return the z of the ball's centre (metres) when the two spheres touch."""
    return geometry.surface_m - GEL_M + float(np.sqrt((GEL_M + BALL_M) ** 2 - x**2 - y**2))


@pytest.mark.parametrize("camera", ["orthographic", "pinhole"])
@pytest.mark.parametrize("place", PLACES)
def test_two_spheres_touch_at_the_calculated_height(ball, camera, place):
    geometry = domed(camera)
    (T,), (touching,) = bring_to_contact(ball, make_translation([[*place, 0.3]]), geometry)
    assert touching
    assert T[:2, 3] == pytest.approx(place)
    assert T[2, 3] == pytest.approx(touching_m(geometry, *place), abs=FACET_M)


@pytest.mark.parametrize("camera", ["orthographic", "pinhole"])
@pytest.mark.parametrize("renderer", ["heightmap", "zbuffer", "raycast"])
def test_the_imprint_of_a_ball_follows_its_formula(ball, camera, renderer):
    if renderer == "raycast":
        pytest.importorskip("open3d")
    geometry = domed(camera).press(PRESS_M)
    x, y = PLACES[1]
    T = make_translation([[x, y, touching_m(geometry, x, y) - PRESS_M]])
    drawn = registry().create("renderer", renderer, {}).render(ball, T, geometry.band)
    depth_m = compute_contact_depth(drawn, geometry, PRESS_M)[0]
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


def test_an_edge_across_the_gel_touches_between_its_ends(block):
    geometry = domed("orthographic")
    roof = np.array([[1, 0, 0], [0, 1, -1], [0, 1, 1]]) / np.array([[1], [2**0.5], [2**0.5]])
    T = make_translation([0.0, 0.006, 0.1])
    T[:3, :3] = roof
    (T,), _ = bring_to_contact(block, T[None], geometry)
    turned = block.vertices_m @ roof.T
    edge = turned[turned[:, 2].argmin()]
    y = edge[1] + 0.006  # where the edge lies; it touches where x = 0
    assert abs(y) < 0.01
    relief_m = np.sqrt(GEL_M**2 - y**2) - GEL_M
    assert T[2, 3] + edge[2] == pytest.approx(geometry.standoff_m + relief_m, abs=1e-6)


def test_a_flat_relief_equals_a_flat_gel(ball):
    flat = dataclasses.replace(domed("pinhole"), relief_m=None)
    level = dataclasses.replace(flat, relief_m=np.zeros(flat.shape, np.float32))
    poses = make_translation([[*place, 0.1] for place in PLACES])
    (ours, theirs) = (bring_to_contact(ball, poses, geometry)[0] for geometry in (flat, level))
    assert ours == pytest.approx(theirs, abs=1e-8)
    assert flat.band is flat
    assert not flat.is_same_sensor(level)


def tilted(slope_x: float, slope_y: float, **more) -> SensorGeometry:
    """Return a sensor whose gel is a plane of the given slopes through the middle of its surface."""
    flat = SensorGeometry("orthographic", 40, 30, 2500.0, 2000.0, 18.0, 16.0, 0.02, 1e-3)
    x, y = np.meshgrid(*flat.pixel_slopes)
    return dataclasses.replace(flat, relief_m=slope_x * x + slope_y * y, **more)


def splinter() -> TriangleMesh:
    corners = np.array([[-0.009, 0, 0.001], [0.008, 0.002, -0.001], [0.001, 0.005, 0.002], [0, -0.001, 0.004]])
    return TriangleMesh(corners, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))


def egg() -> TriangleMesh:
    """Return an egg with several blocks of triangles."""
    solid = trimesh.creation.icosphere(1, radius=0.004)
    return TriangleMesh(np.array(solid.vertices) * [0.7, 2.5, 0.5], np.array(solid.faces))


@pytest.mark.parametrize(("mesh", "count"), [(splinter(), 24), (egg(), 8)], ids=["splinter", "egg"])
def test_a_tilted_gel_gives_the_lowest_points_of_the_sheared_object(mesh, count):
    """Heights above a plane equal heights of a sheared surface, whose lowest point over a flat gel is exact."""
    rng = np.random.default_rng(0)
    T = make_transform(draw_rotations(count, rng), rng.uniform(-0.01, 0.01, (count, 3)))
    geometry = tilted(0.3, -0.2, rectangle_m=(-0.004, 0.005, -0.005, 0.003))
    found = find_lowest_over_relief(mesh, T, geometry)
    sheared = [transform_points(pose, mesh.vertices_m) @ [[1, 0, -0.3], [0, 1, 0.2], [0, 0, 1.0]] for pose in T]
    flat = [TriangleMesh(points, mesh.faces) for points in sheared]
    truth = [find_lowest_points(one, np.eye(4)[None], geometry.rectangle)[0] for one in flat]
    assert 3 < np.isfinite(truth).sum() < count
    np.testing.assert_allclose(found, truth, atol=1e-12)


@pytest.mark.parametrize("turns", range(3))
@pytest.mark.parametrize("sensor", [tilted(0.0, 0.0), dataclasses.replace(tilted(0.0, 0.0), relief_m=None)])
def test_the_order_of_triangle_corners_does_not_affect_contact(sensor, turns):
    """A ceiling covers the gel, and a splinter with one lower corner enters over each side."""
    x0, x1, y0, y1 = sensor.rectangle
    x, y, far = (x0 + x1) / 2, (y0 + y1) / 2, 0.02
    ceiling = [[x - far, y - far, 0.0], [x + far, y - far, 0], [x, y + 3 * far, 0]]
    for across, up in ((far, 0.0), (-far, 0.0), (0.0, far), (0.0, -far)):
        outside = [[x + across + side * up, y + up + side * across, 0.008] for side in (-0.05, 0.05)]
        corners = np.roll([[x, y, -0.001], *outside], turns, axis=0)
        mesh = TriangleMesh(np.array([*ceiling, *corners]), np.array([[0, 1, 2], [3, 4, 5]]))
        moved, _ = bring_to_contact(mesh, np.eye(4)[None], sensor)
        assert moved[0, 2, 3] == pytest.approx(sensor.standoff_m + 0.001, abs=1e-12)


@pytest.mark.parametrize("top", [(3e-3, 2e-3), (-3e-3, 2e-3), (3e-3, -2e-3), (-3e-3, -2e-3)])
def test_a_face_over_the_top_of_the_gel_is_found(top):
    """A level triangle a few millimetres wide is above a bump on the gel."""
    flat = SensorGeometry("orthographic", 40, 30, 2500.0, 2000.0, 18.0, 16.0, 0.02, 1e-3)
    x, y = np.meshgrid(flat.pixel_slopes[0] - top[0], flat.pixel_slopes[1] - top[1])
    bump = dataclasses.replace(flat, relief_m=-(x**2 + y**2) / (2 * GEL_M))
    face = TriangleMesh(np.array([[-2e-3, -2e-3, 0], [2e-3, -1e-3, 0], [0, 3e-3, 0]]), np.array([[0, 1, 2]]))
    assert find_lowest_over_relief(face, make_translation([[*top, 0.01]]), bump)[0] == pytest.approx(0.01, abs=3e-6)


def test_the_relief_is_constant_beyond_the_last_pixels():
    geometry = tilted(0.3, -0.2)
    x, y = geometry.pixel_slopes
    x0, x1, y0, y1 = geometry.rectangle
    needle = TriangleMesh(np.array([[0, 0, 0], [1e-6, 0, 0.01], [0, 1e-6, 0.01]]), np.array([[0, 1, 2]]))
    beyond = [[x0, y[9], 0.0], [x1 - 1e-6, y[9], 0], [x[7], y0, 0], [x[7], y1 - 1e-6, 0], [x[7], y[9], 0]]
    last = np.array([[x[0], y[9]], [x[-1], y[9]], [x[7], y[0]], [x[7], y[-1]], [x[7], y[9]]])
    found = find_lowest_over_relief(needle, make_translation(beyond), geometry)
    np.testing.assert_allclose(found, -(last @ [0.3, -0.2]), atol=1e-9)


def test_the_relief_is_bilinear_between_pixels():
    relief_m = 1e-3 * np.random.default_rng(1).normal(size=(3, 4))
    geometry = SensorGeometry("orthographic", 4, 3, 500.0, 400.0, 2.0, 1.5, 0.02, 1e-3, relief_m=relief_m)
    x, y = geometry.pixel_slopes
    needle = TriangleMesh(np.array([[0, 0, 0], [0, 0, 0.01], [1e-9, 0, 0.01]]), np.array([[0, 1, 2]]))
    cells = [(row, column) for row in range(2) for column in range(3)]
    at = [[0.3 * x[j] + 0.7 * x[j + 1], 0.4 * y[i] + 0.6 * y[i + 1], 0.0] for i, j in cells]
    expected = [[0.4, 0.6] @ relief_m[i : i + 2, j : j + 2] @ [0.3, 0.7] for i, j in cells]
    assert find_lowest_over_relief(needle, make_translation(at), geometry) == pytest.approx(
        -np.array(expected), abs=1e-9
    )


def test_the_upright_relief_is_found_from_pinhole_rays():
    geometry = domed("pinhole")
    relief_m, (x0, y0, dx, dy) = make_upright_relief(geometry)
    x, y = x0 + dx * np.arange(150), y0 + dy * np.arange(200)
    inside = np.s_[20:-20, 20:-20]  # rays to the rim meet the gel nearer to the axis
    truth = np.sqrt(GEL_M**2 - x[None] ** 2 - y[:, None] ** 2) - GEL_M
    assert relief_m[inside] == pytest.approx(truth[inside], abs=2e-6)


def test_the_contact_cloud_lies_on_the_object(ball):
    geometry = domed("orthographic").press(PRESS_M)
    x, y = PLACES[2]
    T = make_translation([[x, y, touching_m(geometry, x, y) - PRESS_M]])
    depth_m = compute_contact_depth(
        registry().create("renderer", "zbuffer", {}).render(ball, T, geometry.band), geometry, PRESS_M
    )
    points, normals = make_contact_cloud(ContactShape(depth_m[0], PRESS_M), geometry, walls=False)
    off = points - T[0, :3, 3]
    assert np.linalg.norm(off, axis=1) == pytest.approx(BALL_M, abs=4 * FACET_M)
    assert (normals * off / BALL_M).sum(axis=1).min() > 0.98


def test_image_size_does_not_change_the_gel():
    geometry = domed("orthographic")
    for other in (geometry.resize(75, 100), geometry.subsample(2), geometry.press(PRESS_M)):
        x, y = np.meshgrid(*other.pixel_slopes)
        truth = np.sqrt(GEL_M**2 - x**2 - y**2) - GEL_M
        assert other.relief_m == pytest.approx(truth, abs=2e-6)
        assert geometry.is_same_sensor(other.resize(150, 200)) or other.shape == (100, 75)
    steeper = dataclasses.replace(geometry, relief_m=1.5 * geometry.relief_m)
    assert not geometry.is_same_sensor(steeper)
    assert geometry.describe() != steeper.describe()
