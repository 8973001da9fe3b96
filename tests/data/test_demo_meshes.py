import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh

from tactile_loc.data import DEMO_OBJECTS

NAMES = list(DEMO_OBJECTS)
FLOAT32_M = 1e-7  # float32 at a few centimetres resolves some nanometres
SAME_SURFACE_M = 5e-5
SYMMETRIES = {"pin": "z2", "damping_pin": "zinf", "head": "z2", "elbow_pipe": "x2", "cotter": "none", "hook": "none"}


def shipped(name: str) -> trimesh.Trimesh:
    return trimesh.load_mesh(DEMO_OBJECTS[name].path)


@pytest.fixture(scope="module")
def demo_meshes() -> ModuleType:
    pytest.importorskip("manifold3d", reason="drawing the demo objects needs manifold3d")
    return importlib.import_module("demo_meshes")


def largest_distance_m(points_m: np.ndarray, mesh: trimesh.Trimesh) -> float:
    o3d = pytest.importorskip("open3d")
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return float(scene.compute_distance(np.ascontiguousarray(points_m, dtype=np.float32)).numpy().max())


def turned(mesh: trimesh.Trimesh, angle_rad: float, axis: np.ndarray, center_m: np.ndarray) -> np.ndarray:
    rotation = trimesh.transformations.rotation_matrix(angle_rad, axis, center_m)
    return trimesh.transform_points(mesh.vertices, rotation)


def maps_onto_itself(mesh: trimesh.Trimesh, angle_rad: float, axis: np.ndarray, center_m: np.ndarray) -> bool:
    return largest_distance_m(turned(mesh, angle_rad, axis, center_m), mesh) < SAME_SURFACE_M


def test_the_table_lists_six_objects_with_their_symmetries():
    assert {name: entry.symmetry for name, entry in DEMO_OBJECTS.items()} == SYMMETRIES
    assert all(entry.name == name and entry.description for name, entry in DEMO_OBJECTS.items())


def test_the_table_imports_no_heavy_library():
    code = "import sys, tactile_loc.data; print({'numpy', 'trimesh', 'manifold3d', 'scipy'} & set(sys.modules))"
    root = str(Path(__file__).parents[2])
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_mesh_is_one_valid_solid(name):
    mesh = shipped(name)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert 1500 <= len(mesh.faces) <= 12000
    assert mesh.area_faces.min() > 0
    assert np.isfinite(mesh.vertices).all()


@pytest.mark.parametrize(
    ("name", "extents_mm"),
    [
        ("pin", (16, 12, 31)),
        ("damping_pin", (18, 18, 39.3)),
        ("head", (28, 28, 23.8)),
        ("elbow_pipe", (35.6, 29, 67.7)),
        ("cotter", (12, 5, 63.9)),
        ("hook", (38.6, 16, 77)),
    ],
)
def test_shipped_meshes_have_their_extents(name, extents_mm):
    np.testing.assert_allclose(shipped(name).extents * 1e3, extents_mm, atol=0.1)


def test_curved_surfaces_keep_their_radius():
    elbow = shipped("elbow_pipe")
    points = elbow.triangles_center - [np.sqrt(2) * 0.020, 0, 0]  # about the centre of the bend
    angle = np.arctan2(points[:, 2], -points[:, 0])
    points = points[np.abs(angle) < np.radians(40)]
    ring = np.stack([np.hypot(points[:, 0], points[:, 2]) - 0.020, points[:, 1]], axis=1)
    radius = np.linalg.norm(ring, axis=1)
    outside = radius > 0.0089
    assert np.count_nonzero(outside) > 500
    assert np.abs(radius[outside] - 0.0100).max() < SAME_SURFACE_M
    assert np.abs(radius[~outside] - 0.0078).max() < SAME_SURFACE_M


def rotations_of(symmetry: str) -> set[tuple[str, int]]:
    """Return the orders from 2 to 6 that a single-term symmetry implies about its axis."""
    if symmetry == "none":
        return set()
    axis, order = symmetry[0], symmetry[1:]
    return {(axis, n) for n in range(2, 7) if order == "inf" or int(order) % n == 0}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("about", ["origin", "centroid"])
def test_only_the_declared_rotations_map_the_object_onto_itself(name, about):
    mesh = shipped(name)
    center = np.zeros(3) if about == "origin" else mesh.center_mass
    turns = [(letter, axis, n) for letter, axis in zip("xyz", np.eye(3), strict=True) for n in range(2, 7)]
    found = {(letter, n) for letter, axis, n in turns if maps_onto_itself(mesh, 2 * np.pi / n, axis, center)}
    assert found == rotations_of(DEMO_OBJECTS[name].symmetry)


def test_any_rotation_about_z_maps_the_damping_pin_onto_itself():
    mesh = shipped("damping_pin")
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, 8)
    assert all(maps_onto_itself(mesh, angle, np.array([0, 0, 1]), np.zeros(3)) for angle in angles)


@pytest.fixture(scope="module")
def written(tmp_path_factory, demo_meshes) -> Path:
    folder = tmp_path_factory.mktemp("objects")
    demo_meshes.write_all(folder)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_a_regenerated_mesh_equals_the_shipped_mesh(name, written):
    # Triangulations may differ between versions of manifold3d; the surface must not.
    new, old = trimesh.load_mesh(written / f"{name}.ply"), shipped(name)
    assert largest_distance_m(new.vertices, old) < FLOAT32_M
    assert largest_distance_m(old.vertices, new) < FLOAT32_M
    assert new.volume == pytest.approx(old.volume, rel=1e-6)
    assert new.area == pytest.approx(old.area, rel=1e-6)


def test_writing_meshes_twice_gives_the_same_bytes(tmp_path, demo_meshes, written):
    again = demo_meshes.write_all(tmp_path)
    assert [path.name for path in again] == [f"{name}.ply" for name in DEMO_OBJECTS]
    assert all(path.read_bytes() == (written / path.name).read_bytes() for path in again)
