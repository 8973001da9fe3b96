from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import demo_meshes
import numpy as np
import pytest
import trimesh
from demo_meshes import COTTER, DAMPING_PIN, ELBOW_PIPE, HEAD, HOOK, PIN, Dimensions
from message_helpers import naming

from tactile_loc.core.errors import MissingLibraryError, OutputError
from tactile_loc.data import DEMO_OBJECTS

NAMES = list(DEMO_OBJECTS)
FLOAT32_M = 1e-7  # float32 at a few centimetres resolves some nanometres
SAME_SURFACE_M = 5e-5
SYMMETRIES = {"pin": "z2", "damping_pin": "zinf", "head": "z2", "elbow_pipe": "x2", "cotter": "none", "hook": "none"}


def shipped(name: str) -> trimesh.Trimesh:
    return trimesh.load_mesh(DEMO_OBJECTS[name].path)


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
    assert set(demo_meshes.BUILDERS) == set(DEMO_OBJECTS)


def test_the_table_imports_nothing_heavy():
    code = "import sys, tactile_loc.data; print({'numpy', 'trimesh', 'manifold3d', 'scipy'} & set(sys.modules))"
    root = str(Path(__file__).parents[2])
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("name", NAMES)
def test_shipped_mesh_is_one_sound_solid(name):
    mesh = shipped(name)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert 1500 <= len(mesh.faces) <= 12000
    assert mesh.area_faces.min() > 0
    assert np.isfinite(mesh.vertices).all()


@pytest.mark.parametrize("name", NAMES)
def test_normals_point_outwards(name):
    mesh = shipped(name)
    large = mesh.area_faces > 1e-8
    just_outside = mesh.triangles_center[large] + 2e-5 * mesh.face_normals[large]
    just_inside = mesh.triangles_center[large] - 2e-5 * mesh.face_normals[large]
    o3d = pytest.importorskip("open3d")
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    assert not scene.compute_occupancy(just_outside.astype(np.float32)).numpy().any()
    assert scene.compute_occupancy(just_inside.astype(np.float32)).numpy().all()


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
def test_extents(name, extents_mm):
    np.testing.assert_allclose(shipped(name).extents * 1e3, extents_mm, atol=0.1)


def rod(radius_m: float, length_m: float) -> float:
    return np.pi * radius_m**2 * length_m


def pin_volume() -> tuple[float, float]:
    d = PIN
    low = rod(d.groove_radius_m, d.shank_length_m - d.tip_length_m) + rod(d.body_radius_m, 0.6 * d.body_length_m)
    high = rod(d.shank_radius_m, d.shank_length_m) + rod(d.body_radius_m, d.body_length_m)
    return low, high + 2 * d.head_radius_m * d.across_flats_m * d.head_height_m


def damping_pin_volume() -> tuple[float, float]:
    d = DAMPING_PIN
    bulb = 4 / 3 * np.pi * d.bulb_radius_m**3
    flange = rod(d.flange_radius_m, d.flange_height_m)
    low = 0.85 * bulb + 0.85 * flange + rod(d.stem_radius_m, d.stem_length_m - d.tip_length_m)
    return low, bulb + flange + rod(d.barb_radius_m, d.stem_length_m) + rod(d.neck_radius_m, d.neck_length_m)


def head_volume() -> tuple[float, float]:
    d = HEAD
    hexagon = np.sqrt(3) / 2 * d.across_flats_m**2 * d.hex_top_m
    shaft = rod(d.shaft_radius_m, d.shaft_length_m)
    rim, dome = rod(d.flange_radius_m, d.flange_height_m), rod(d.dome_radius_m, 1.2 * d.dome_height_m)
    return 0.9 * (shaft + hexagon), shaft + hexagon + rim + dome


def elbow_volume() -> tuple[float, float]:
    d = ELBOW_PIPE
    length = d.bend_radius_m * np.pi / 2 + 2 * d.leg_length_m  # Pappus: a bend is as large as a straight tube
    tube = rod(d.outer_radius_m, length) - rod(d.bore_radius_m, length)
    rims = 2 * (rod(d.flange_radius_m, d.flange_height_m) - rod(d.outer_radius_m, d.flange_height_m))
    beads = 2 * np.pi * d.bead_radius_m**2 * np.pi * (d.outer_radius_m + d.bead_radius_m)
    return 0.98 * (tube + 0.9 * rims), tube + rims + beads


def cotter_volume() -> tuple[float, float]:
    d = COTTER
    opening = np.arccos((d.gap_m / 2 + d.neck_radius_m) / (d.eye_radius_m + d.neck_radius_m))
    centroid = 4 * d.wire_radius_m / (3 * np.pi)
    eye = (np.pi + 2 * opening) * (d.eye_radius_m + centroid)
    necks = 2 * opening * (d.neck_radius_m - centroid)
    exact = np.pi / 2 * d.wire_radius_m**2 * (d.long_leg_m + d.short_leg_m + eye + necks)
    return 0.98 * exact, exact


def hook_volume() -> tuple[float, float]:
    d = HOOK
    wire = rod(d.wire_radius_m, d.straight_length_m + d.bend_radius_m * d.bend_rad + d.mouth_length_m)
    collar = np.sqrt(3) / 2 * d.collar_across_flats_m**2 * d.collar_height_m
    core = rod(d.shank_radius_m - d.ring_depth_m, d.shank_length_m)
    return 0.98 * (wire + collar + core), wire + rod(d.wire_radius_m, d.wire_radius_m) + collar + 1.7 * core


@pytest.mark.parametrize(
    ("name", "bounds"),
    [
        ("pin", pin_volume()),
        ("damping_pin", damping_pin_volume()),
        ("head", head_volume()),
        ("elbow_pipe", elbow_volume()),
        ("cotter", cotter_volume()),
        ("hook", hook_volume()),
    ],
)
def test_volume_lies_between_analytic_bounds(name, bounds):
    low, high = bounds
    assert low < shipped(name).volume < high


def test_curved_surfaces_keep_their_radius():
    elbow = shipped("elbow_pipe")
    points = elbow.triangles_center - [np.sqrt(2) * ELBOW_PIPE.bend_radius_m, 0, 0]  # about the centre of the bend
    angle = np.arctan2(points[:, 2], -points[:, 0])
    points = points[np.abs(angle) < np.radians(40)]
    ring = np.stack([np.hypot(points[:, 0], points[:, 2]) - ELBOW_PIPE.bend_radius_m, points[:, 1]], axis=1)
    radius = np.linalg.norm(ring, axis=1)
    outside = radius > (ELBOW_PIPE.outer_radius_m + ELBOW_PIPE.bore_radius_m) / 2
    assert np.count_nonzero(outside) > 500
    assert np.abs(radius[outside] - ELBOW_PIPE.outer_radius_m).max() < SAME_SURFACE_M
    assert np.abs(radius[~outside] - ELBOW_PIPE.bore_radius_m).max() < SAME_SURFACE_M


def rotations_of(symmetry: str) -> set[tuple[str, int]]:
    """The orders from 2 to 6 that a single-term symmetry implies for rotations about its axis."""
    if symmetry == "none":
        return set()
    axis, order = symmetry[0], symmetry[1:]
    return {(axis, n) for n in range(2, 7) if order == "inf" or int(order) % n == 0}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("about", ["origin", "centroid"])
def test_exactly_the_declared_rotations_map_the_object_onto_itself(name, about):
    mesh = shipped(name)
    center = np.zeros(3) if about == "origin" else mesh.center_mass
    turns = [(letter, axis, n) for letter, axis in zip("xyz", np.eye(3), strict=True) for n in range(2, 7)]
    found = {(letter, n) for letter, axis, n in turns if maps_onto_itself(mesh, 2 * np.pi / n, axis, center)}
    assert found == rotations_of(DEMO_OBJECTS[name].symmetry)


@pytest.mark.parametrize("name", NAMES)
def test_no_half_turn_beyond_the_declared_one_about_any_axis(name):
    # A rotation onto itself has its axis along a principal axis of inertia through the centroid. Where the principal
    # moments differ the only candidates are half turns about those three axes; where two agree, as for
    # the damping pin, the rotations about z are tested elsewhere and any further axis would lie across z.
    mesh = shipped(name)
    moments, axes = np.linalg.eigh(mesh.moment_inertia)
    gaps = np.diff(moments) / moments.max()
    found = [axis for axis in axes.T if maps_onto_itself(mesh, np.pi, axis, mesh.center_mass)]
    assert len(found) == (0 if DEMO_OBJECTS[name].symmetry == "none" else 1)
    assert np.count_nonzero(gaps < 1e-4) == (1 if name == "damping_pin" else 0)


def test_the_damping_pin_turns_by_any_angle_onto_itself():
    mesh = shipped("damping_pin")
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, 8)
    assert all(maps_onto_itself(mesh, angle, np.array([0, 0, 1]), np.zeros(3)) for angle in angles)


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    pytest.importorskip("manifold3d", reason="drawing the demo objects needs manifold3d")
    folder = tmp_path_factory.mktemp("objects")
    demo_meshes.write_all(folder)
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_regenerated_mesh_equals_the_shipped_one(name, written):
    # Triangulations may differ between versions of manifold3d; the surface may not.
    new, old = trimesh.load_mesh(written / f"{name}.ply"), shipped(name)
    assert largest_distance_m(new.vertices, old) < FLOAT32_M
    assert largest_distance_m(old.vertices, new) < FLOAT32_M
    assert new.volume == pytest.approx(old.volume, rel=1e-6)
    assert new.area == pytest.approx(old.area, rel=1e-6)


def test_writing_twice_gives_the_same_bytes(tmp_path, written):
    again = demo_meshes.write_all(tmp_path)
    assert [path.name for path in again] == [f"{name}.ply" for name in demo_meshes.BUILDERS]
    assert all(path.read_bytes() == (written / path.name).read_bytes() for path in again)


def test_dimensions_shape_the_object():
    even = demo_meshes.cotter(Dimensions(**{**vars(COTTER), "long_leg_m": 0.030, "short_leg_m": 0.030}))
    assert even.bounds[0, 2] == pytest.approx(-0.030)
    assert maps_onto_itself(even, np.pi, np.array([0, 0, 1]), np.zeros(3))


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    pytest.importorskip("manifold3d", reason="drawing the demo objects needs manifold3d")
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(OutputError, match=naming("file/objects/pin.ply")):
        demo_meshes.write_all(blocked / "objects")


def test_without_manifold3d_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(MissingLibraryError, match=naming("pip install manifold3d")):
        demo_meshes.pin()
