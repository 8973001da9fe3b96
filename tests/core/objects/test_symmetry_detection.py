import functools
import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from message_helpers import missing, naming
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.objects.symmetry_detection import RESOLUTION_M, _find_worst, detect_symmetry, require_symmetry
from tactile_loc.core.objects.symmetry_surface import SurfaceProbe
from tactile_loc.core.runtime.errors import SymmetryError

BOLT = Path(__file__).parents[4] / "shared/data/meshes/factory/factory_bolt_m16_loose.obj"


def measure_deviation(group: SymmetryGroup, mesh: TriangleMesh, tolerance_m: float = RESOLUTION_M) -> float:
    """Return the largest gap (metres) between the surface and its image under any element of the group."""
    return _find_worst(SurfaceProbe(mesh), group, tolerance_m)[0]


def stack(outlines_mm: NDArray[np.float64], z_mm: ArrayLike) -> TriangleMesh:
    """Return the body (metres) through outlines (Z, N, 2) at heights (Z,), its two ends closed by fans about z."""
    z_mm = np.asarray(z_mm, dtype=np.float64)
    levels, count, _ = outlines_mm.shape
    rings = np.concatenate([outlines_mm, np.broadcast_to(z_mm[:, None, None], (levels, count, 1))], axis=2)
    vertices = np.concatenate([rings.reshape(-1, 3), [[0, 0, z_mm[0]], [0, 0, z_mm[-1]]]])
    here, there = np.arange(count), np.roll(np.arange(count), -1)
    faces = [np.stack([there, here, np.full(count, levels * count)], axis=1)]
    for level in range(levels - 1):
        a, b = here + level * count, there + level * count
        faces += [np.stack([a, b, b + count], axis=1), np.stack([a, b + count, a + count], axis=1)]
    top = (levels - 1) * count
    faces.append(np.stack([here + top, there + top, np.full(count, levels * count + 1)], axis=1))
    return TriangleMesh(vertices * 1e-3, np.concatenate(faces))


def circle(count: int, radius_mm: ArrayLike = 10.0, turn_rad: float = 0.0) -> NDArray[np.float64]:
    angle_rad = np.arange(count) * 2.0 * math.pi / count + turn_rad
    return np.asarray(radius_mm)[..., None] * np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)


def prism(outline_mm: ArrayLike, height_mm: float) -> TriangleMesh:
    return stack(np.stack([outline_mm, outline_mm]), (0.0, height_mm))


def rectangle(width_mm: float, depth_mm: float) -> NDArray[np.float64]:
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([width_mm, depth_mm]) / 2.0


def cylinder(count: int = 48, height_mm: float = 30.0) -> TriangleMesh:
    return prism(circle(count), height_mm)


def notched_cylinder(depth_mm: float) -> TriangleMesh:
    """Return a cylinder with a slot 2 mm wide and 6 mm long, 0.5 % of its surface, nearer to one end."""
    radius_mm = np.full((6, 96), 10.0)
    radius_mm[2:4, :4] -= depth_mm
    return stack(np.stack([circle(96, r) for r in radius_mm]), (0.0, 4.99, 5.0, 11.0, 11.01, 30.0))


def screw(taper: float) -> TriangleMesh:
    z_mm = np.linspace(-10.0, 10.0, 41)
    angle_rad = np.arange(60) * 2.0 * math.pi / 60
    radius_mm = 8.0 + np.cos(angle_rad[None] - 0.5 * z_mm[:, None]) + taper * z_mm[:, None]
    return stack(np.stack([circle(60, r) for r in radius_mm]), z_mm)


def subdivided(mesh: TriangleMesh, times: int) -> TriangleMesh:
    vertices, faces = mesh.vertices_m, mesh.faces
    for _ in range(times):
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        vertices = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3)
    return TriangleMesh(vertices, faces)


def terraced(x_mm: list[float], y_mm: list[float], height_mm: NDArray[np.float64]) -> TriangleMesh:
    """Return the body (metres) whose cells between lines x (X + 1,), y (Y + 1,) are `height_mm` (X, Y); 0 is a hole."""
    padded = np.pad(height_mm, 1)
    quads = []
    for i, j in np.ndindex(height_mm.shape):
        (x0, x1), (y0, y1), z = x_mm[i : i + 2], y_mm[j : j + 2], height_mm[i, j]
        around = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        lower = (padded[i + 1, j], padded[i + 2, j + 1], padded[i + 1, j + 2], padded[i, j + 1])
        if z > 0:
            quads += [np.column_stack([around[::step], np.full(4, level)]) for step, level in ((1, z), (-1, 0.0))]
        for a, b, other in zip(around, np.roll(around, -1, axis=0), lower, strict=True):
            if z > other:
                quads.append(np.array([(*a, other), (*b, other), (*b, z), (*a, z)]))
    corners = np.arange(4 * len(quads)).reshape(-1, 4)
    return TriangleMesh(np.concatenate(quads) * 1e-3, np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]))


def plate(
    *pockets_mm: tuple[float, float], width_mm: float = 1.5, depth_mm: float = 0.5, side_mm: float = 40
) -> TriangleMesh:
    """Return a plate 6 mm high, its depth 3/4 of its width, with square pockets at these corners (x, y)."""
    half = np.array([0.5, 0.375]) * side_mm
    x_mm, y_mm = (
        sorted({-h, h, *(c for p in pockets_mm for c in (p[k], p[k] + width_mm))}) for k, h in enumerate(half)
    )
    height_mm = np.full((len(x_mm) - 1, len(y_mm) - 1), 6.0)
    for x, y in pockets_mm:
        height_mm[x_mm.index(x), y_mm.index(y)] -= depth_mm
    return terraced(x_mm, y_mm, height_mm)


EQUAL_MOMENTS_MM = 16.73  # the height at which the moments of a cylinder of radius 10 mm nearly agree
L_SHAPE = np.array([[-5, -5], [15, -5], [15, 5], [5, 5], [5, 15], [-5, 15]], dtype=float)
BODIES: dict[str, tuple[TriangleMesh, str, float]] = {
    "box": (prism(rectangle(20, 30), 40), "x2*y2", 4),
    "square prism": (prism(rectangle(20, 20), 40), "z4*x2", 8),
    "cube": (prism(rectangle(20, 20), 20), "x4*y4", 24),
    "hexagonal prism": (prism(circle(6), 12), "z6*x2", 12),
    "slender hexagonal prism": (prism(circle(6, 2.0), 150), "z6*x2", 12),
    "pentagonal prism": (prism(circle(5), 30), "z5*x2", 10),
    "17-sided star": (prism(circle(34, np.tile([10.0, 8.0], 17)), 8), "z17*x2", 34),
    "hexagonal pyramid": (stack(np.stack([circle(6), circle(6, 4.0)]), (0, 15)), "z6", 6),
    "cylinder": (cylinder(), "zinf*x2", math.inf),
    "coarse cylinder": (cylinder(16), "zinf*x2", math.inf),
    "cylinder of equal moments": (cylinder(48, EQUAL_MOMENTS_MM), "zinf*x2", math.inf),
    "disc": (cylinder(64, 1.0), "zinf*x2", math.inf),
    "frustum": (stack(np.stack([circle(48), circle(48, 7.0)]), (0, 20)), "zinf", math.inf),
    "screw": (screw(0.0), "x2", 2),
    "tapered screw": (screw(0.1), "none", 1),
    "notched cylinder": (notched_cylinder(1.0), "none", 1),
    "shallowly notched cylinder": (notched_cylinder(0.3), "none", 1),
    "scratched cylinder": (notched_cylinder(0.02), "zinf*x2", math.inf),
    "L": (prism(L_SHAPE, 12), "axis(0.70710678,0.70710678,0)2", 2),
    "lopsided L": (prism(L_SHAPE * (1.0, 1.3), 12), "none", 1),
}


@functools.cache
def found(name: str) -> SymmetryGroup:
    return detect_symmetry(BODIES[name][0])


@pytest.mark.slow
@pytest.mark.parametrize("name", BODIES)
def test_the_symmetry_of_a_body_is_detected_and_verified(name: str) -> None:
    mesh, text, order = BODIES[name]
    group = found(name)
    assert str(group) == text
    assert group.order == order
    require_symmetry(SymmetryGroup.parse(text, group.centre_m), mesh)


def test_a_notch_leaves_only_the_flip_through_it() -> None:
    outline = circle(96)
    outline[[95, 0, 1]] *= 0.93
    assert str(detect_symmetry(prism(outline, 30))) == "x2"


@pytest.mark.parametrize("side_mm", [40.0, 80.0])
@pytest.mark.parametrize(("width_mm", "depth_mm"), [(1.5, 0.5), (1.0, 0.1), (1.5, -0.3), (1.5, 6.0)])
def test_a_small_pocket_bump_or_hole_breaks_the_symmetry_of_a_plate(
    width_mm: float, depth_mm: float, side_mm: float
) -> None:
    own_place = np.random.default_rng([int(10 * v) for v in (width_mm, abs(depth_mm), side_mm)])
    x, y = own_place.uniform(-0.35, 0.3, 2) * side_mm
    mesh = plate((x, y), width_mm=width_mm, depth_mm=depth_mm, side_mm=side_mm)
    assert detect_symmetry(mesh).is_trivial
    symmetry = SymmetryGroup.parse("x2*y2", (0, 0, 3e-3))
    assert measure_deviation(symmetry, mesh) == pytest.approx(min(1e-3 * abs(depth_mm), 3e-3), rel=0.05, abs=1e-4)
    if abs(depth_mm) > 0.2:
        with pytest.raises(SymmetryError, match=naming("x2*y2", "180 deg")):
            require_symmetry(symmetry, mesh)


def test_a_pair_of_pockets_keeps_the_rotation_that_swaps_them() -> None:
    assert str(detect_symmetry(plate((5.0, 3.0), (-6.5, -4.5)))) == "z2"


def test_a_pocket_below_sensor_resolution_is_ignored() -> None:
    assert RESOLUTION_M == 5e-5
    assert str(detect_symmetry(plate((5.0, 3.0), depth_mm=0.04))) == "x2*y2"


@pytest.mark.parametrize("count", [24, 32, 100])
def test_rings_of_facets_rotated_against_each_other_are_round(count: int) -> None:
    rings = [circle(count, 10.0, 0.37 * k * 2.0 * math.pi / count) for k in range(8)]
    assert str(detect_symmetry(stack(np.stack(rings), np.linspace(0.0, 30.0, 8)))) == "zinf*x2"


def test_a_declared_symmetry_is_accepted_for_a_rough_scan() -> None:
    """A sensor would see 0.03 mm of noise on a scanned box, but a declared symmetry is accepted."""
    fine = subdivided(BODIES["box"][0], 4)
    merged_m, index = np.unique(np.round(fine.vertices_m, 9), axis=0, return_inverse=True)
    noise_m = np.random.default_rng(0).normal(0.0, 3e-5, merged_m.shape)
    scan = TriangleMesh(merged_m + noise_m, index.reshape(-1)[fine.faces])
    assert detect_symmetry(scan).is_trivial
    require_symmetry(SymmetryGroup.parse("x2*y2", scan.centroid_m), scan)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["box", "square prism", "cube", "hexagonal prism", "cylinder", "frustum", "L", "screw"]
)
def test_detection_moves_with_the_mesh(name: str) -> None:
    mesh = BODIES[name][0]
    R, t_m = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([0.3, -0.2, 0.1])
    here, there = found(name), detect_symmetry(TriangleMesh(mesh.vertices_m @ R.T + t_m, mesh.faces))
    assert there.order == here.order
    np.testing.assert_allclose(there.centre_m, R @ here.centre_m + t_m, atol=1e-9)
    expected = R @ here.list_elements(math.radians(1.0))[:, :3, :3] @ R.T
    traces = np.einsum("aij,bij->ab", there.rotations, expected)
    assert np.all(traces.max(axis=1) > 1.0 + 2.0 * math.cos(math.radians(1.0)))
    if here.continuous_axis is not None and there.continuous_axis is not None:
        assert abs(there.continuous_axis @ R @ here.continuous_axis) > math.cos(math.radians(0.1))


ROUND = ("hexagonal prism", "cylinder", "notched cylinder")  # their detection takes longer


@pytest.mark.parametrize("name", ["box", "L", *(pytest.param(name, marks=pytest.mark.slow) for name in ROUND)])
def test_detection_does_not_depend_on_the_tessellation(name: str) -> None:
    mesh, text, _ = BODIES[name]
    assert str(detect_symmetry(subdivided(mesh, 3))) == text


def test_a_few_stray_triangles_do_not_hide_a_symmetry() -> None:
    body, stray = cylinder(), np.array([[0.004, 0, 0.01], [0.0045, 0, 0.01], [0.004, 0.0005, 0.01]])
    faces = np.concatenate([body.faces, len(body.vertices_m) + np.arange(3)[None]])
    assert str(detect_symmetry(TriangleMesh(np.concatenate([body.vertices_m, stray]), faces))) == "zinf*x2"


def test_a_wider_tolerance_ignores_larger_features() -> None:
    assert str(detect_symmetry(BODIES["notched cylinder"][0], tolerance_m=2e-3)) == "zinf*x2"
    assert str(detect_symmetry(cylinder(16), tolerance_m=2e-5)) == "zinf*x2", "facets are not features"


def test_a_sphere_is_found_and_an_ellipsoid_is_not() -> None:
    polar_rad = np.linspace(0.001, math.pi - 0.001, 40)
    ball = stack(np.stack([circle(64, 10.0 * s) for s in np.sin(polar_rad)]), -10.0 * np.cos(polar_rad))
    group = detect_symmetry(TriangleMesh(ball.vertices_m + np.array([0.02, 0, 0]), ball.faces))
    assert str(group) == "sphere"
    np.testing.assert_allclose(group.centre_m, [0.02, 0, 0], atol=1e-8)
    assert str(detect_symmetry(TriangleMesh(ball.vertices_m * [1, 1, 1.05], ball.faces))) == "zinf*x2"


def test_a_ball_may_be_hollow_but_have_no_flat_and_be_no_ellipsoid() -> None:
    ball, sphere = trimesh.creation.icosphere(4, 0.01), SymmetryGroup.parse("sphere", np.zeros(3))
    points_m, faces = np.array(ball.vertices), np.array(ball.faces)
    hollow = TriangleMesh(np.concatenate([points_m, 0.8 * points_m]), np.concatenate([faces, faces + 2562]))
    assert str(detect_symmetry(hollow)) == "sphere"
    assert str(detect_symmetry(TriangleMesh(np.minimum(points_m, [1, 1, 0.0098]), faces))) == "zinf"
    require_symmetry(sphere, TriangleMesh(points_m, faces))
    with pytest.raises(SymmetryError, match="'sphere'"):
        require_symmetry(sphere, TriangleMesh(points_m * [1, 1, 1.1], faces))


@pytest.mark.slow
def test_verification_measures_the_gap() -> None:
    mesh = prism(rectangle(20, 24), 40)
    assert measure_deviation(SymmetryGroup.parse("x2*y2", (0, 0, 0.02)), mesh, tolerance_m=0.0) < 1e-9
    assert measure_deviation(SymmetryGroup.parse("z4", (0, 0, 0.02)), mesh) == pytest.approx(2e-3, rel=1e-6)
    assert measure_deviation(SymmetryGroup.parse("z2", (1e-3, 0, 0.02)), mesh) == pytest.approx(2e-3, rel=1e-6)
    assert measure_deviation(SymmetryGroup.parse("none", (0, 0, 0)), mesh) == 0.0


def test_the_error_names_the_rotation_the_gap_and_the_place() -> None:
    with pytest.raises(SymmetryError) as caught:
        require_symmetry(SymmetryGroup.parse("z6", (0, 0, 0.02)), BODIES["square prism"][0])
    message = str(caught.value)
    assert "'z6'" in message
    assert "about z" in message
    assert re.search(r"\d mm", message)
    assert any(not missing(message, f"{angle} deg") for angle in (60, 120, 240, 300))
    assert not re.search(r"\.(\s|$)", message), "one sentence"


@pytest.mark.slow
@pytest.mark.skipif(not BOLT.exists(), reason="the mesh of the M16 bolt is missing")
def test_the_thread_of_a_bolt_breaks_the_symmetry_of_its_head() -> None:
    trimesh = pytest.importorskip("trimesh")
    bolt = trimesh.load(BOLT, force="mesh")
    mesh = TriangleMesh(np.asarray(bolt.vertices), np.asarray(bolt.faces))
    assert detect_symmetry(mesh).is_trivial
    with pytest.raises(SymmetryError, match="about z"):
        require_symmetry(SymmetryGroup.parse("z6", mesh.centroid_m), mesh)
