import dataclasses

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh, check_surface
from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.plugin.helpers import SymmetryGroup

SIDES = np.array([0.030, 0.020, 0.012])
SHIFT = np.array([0.1, -0.2, 0.05])


@pytest.fixture
def box_mesh() -> TriangleMesh:
    solid = trimesh.creation.box(SIDES)
    return TriangleMesh(np.array(solid.vertices) + SHIFT, np.array(solid.faces, np.int64))


def box_variance(a: float, b: float, c: float) -> float:
    """Return the variance along `a` of a box's surface: two faces at +-a/2, four faces spread evenly along `a`."""
    return (2 * b * c * a**2 / 4 + 2 * a * (b + c) * a**2 / 12) / (2 * (a * b + b * c + c * a))


def test_box_surface_moments_equal_the_analytic_values(box_mesh):
    a, b, c = SIDES
    np.testing.assert_allclose(box_mesh.face_areas.sum(), 2 * (a * b + b * c + c * a))
    np.testing.assert_allclose(box_mesh.centroid_m, SHIFT, atol=1e-15)
    np.testing.assert_allclose(box_mesh.extents_m, SIDES)
    expected = np.diag([box_variance(a, b, c), box_variance(b, c, a), box_variance(c, a, b)])
    np.testing.assert_allclose(box_mesh.covariance_m2, expected, atol=1e-15)


def test_moments_do_not_depend_on_the_tessellation(box_mesh):
    fine = trimesh.Trimesh(box_mesh.vertices_m, box_mesh.faces[:7], process=False).subdivide()
    faces = np.concatenate([fine.faces, box_mesh.faces[7:] + len(fine.vertices)])
    mesh = TriangleMesh(np.concatenate([fine.vertices, box_mesh.vertices_m]), faces)
    np.testing.assert_allclose(mesh.centroid_m, box_mesh.centroid_m, atol=1e-12)
    np.testing.assert_allclose(mesh.covariance_m2, box_mesh.covariance_m2, atol=1e-12)


def test_samples_lie_on_the_surface_and_have_its_moments(box_mesh):
    points = box_mesh.sample(200_000, np.random.default_rng(0))
    outside = np.abs(points - SHIFT) / (SIDES / 2)
    np.testing.assert_allclose(outside.max(axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(points.mean(axis=0), box_mesh.centroid_m, atol=1e-4)
    np.testing.assert_allclose(np.cov(points.T), box_mesh.covariance_m2, atol=0.01 * box_mesh.covariance_m2.max())


def test_samples_lie_on_their_faces_whose_normals_point_outwards(box_mesh):
    points, faces = box_mesh.sample_faces(500, np.random.default_rng(0))
    outwards = (np.abs(points - SHIFT) / (SIDES / 2)).argmax(axis=1)
    expected = np.sign(points - SHIFT) * np.eye(3)[outwards]
    np.testing.assert_allclose(box_mesh.face_normals[faces], expected, atol=1e-12)


def test_the_digest_changes_only_with_the_surface(box_mesh):
    same = TriangleMesh(np.asfortranarray(box_mesh.vertices_m), box_mesh.faces.astype(np.int32))
    assert same.digest == box_mesh.digest
    assert TriangleMesh(box_mesh.vertices_m + 1e-9, box_mesh.faces).digest != box_mesh.digest
    assert TriangleMesh(box_mesh.vertices_m, box_mesh.faces[:, ::-1]).digest != box_mesh.digest


def test_the_description_depends_on_symmetry_and_not_on_the_name(box_mesh):
    def describe(name: str, symmetry: str) -> dict[str, object]:
        return ObjectModel(name, box_mesh, SymmetryGroup.parse(symmetry, SHIFT)).describe()

    assert describe("a", "none") == describe("b", "none")
    assert describe("a", "none") != describe("a", "x2")


def with_vertices(mesh: TriangleMesh, change) -> TriangleMesh:
    return dataclasses.replace(mesh, vertices_m=change(mesh.vertices_m.copy()))


def poison(vertices: np.ndarray) -> np.ndarray:
    vertices[2, 1] = np.nan
    vertices[5, 0] = np.inf
    return vertices


@pytest.mark.parametrize(
    ("change", "values"),
    [
        (poison, (2, "NaN")),
        (lambda v: v * 0, ("extent",)),
        (lambda v: v * [1, 0, 0], ("extent",)),
        (lambda v: v * 100, ("3000 mm", "1 mm", "1 m", "`units`")),
        (lambda v: v * 0.01, ("0.3 mm", "`units`")),
    ],
)
def test_impossible_surfaces_are_refused(box_mesh, change, values):
    with pytest.raises(ObjectError, match=naming("part", *values)):
        check_surface(with_vertices(box_mesh, change), "part")


def test_empty_surfaces_are_refused(box_mesh):
    for empty in (
        TriangleMesh(box_mesh.vertices_m, np.zeros((0, 3), int)),
        TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), int)),
    ):
        with pytest.raises(ObjectError, match=naming("part", "empty")):
            check_surface(empty, "part")


@pytest.mark.parametrize("size_m", [0.001, 1.0])
def test_sizes_at_the_limits_are_accepted(box_mesh, size_m):
    check_surface(with_vertices(box_mesh, lambda v: (v - SHIFT) * (size_m / 0.030)), "part")
