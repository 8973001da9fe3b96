"""The test object can be printed and aligned, and no place looks the same after a turn."""

import csv

import numpy as np
import pytest
import trimesh
from tactile_loc import load_object
from tactile_loc.plugin import SensorGeometry, registry
from tactile_loc.plugin.helpers import rotation_about

from tactile_loc_test_object.picture import draw_places
from tactile_loc_test_object.scoring import find_nominal_pose
from tactile_loc_test_object.shape import (
    PLACES,
    RADIUS,
    SIDE,
    THICKNESS,
    TOP,
    make_object,
    make_solid,
    write_places,
    write_stl,
)

STEEPEST_DEG = 45.0
LEAST_TURN_DEG = 20
CAMERA = SensorGeometry("orthographic", 120, 120, 10_000, 10_000, 60, 60, 20e-3, 6e-3)


@pytest.fixture(scope="module")
def mesh(tmp_path_factory) -> trimesh.Trimesh:
    folder = tmp_path_factory.mktemp("object")
    write_stl(folder / "object.stl")
    return trimesh.load_mesh(folder / "object.stl")  # with its numbers rounded


def test_the_object_is_watertight_and_has_its_size(mesh):
    assert mesh.is_watertight
    assert mesh.body_count == 1
    half = SIDE / 2
    np.testing.assert_allclose(mesh.bounds, [[-half, -half, -THICKNESS], [half, half, TOP]], atol=1e-6)


def test_nothing_overhangs(mesh):
    below = mesh.triangles_center[:, 2] > -THICKNESS + 1e-6
    down = mesh.face_normals[:, 2] < -np.cos(np.radians(STEEPEST_DEG))
    assert mesh.area_faces[below & down].sum() == 0


def test_walls_are_at_least_a_millimetre_thick():
    """Every part of a section is left when its outline moves inwards by nearly half a millimetre."""
    for height in (0.3, 1.0, 1.3):
        section = make_solid().slice(height)
        assert len(section.offset(-0.48).decompose()) >= len(section.decompose())


def draw(place, turn_rad: float = 0.0) -> np.ndarray:
    T = find_nominal_pose(place, CAMERA, turn_rad)
    depth = registry().create("renderer", "zbuffer", {}).render(make_object().mesh, T[None], CAMERA)[0]
    y, x = np.indices(depth.shape) - 59.5
    height_mm = 1e3 * (CAMERA.surface_m - depth)
    return np.where(np.hypot(x, y) < 10 * RADIUS, np.maximum(height_mm, -1.0), -1.0)


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.name)
def test_a_place_is_at_its_centre_and_has_no_symmetry(place):
    seen = draw(place)
    assert seen.max() == pytest.approx(0, abs=0.02)  # all places are equally high
    turned = [draw(place, np.radians(deg)) for deg in range(LEAST_TURN_DEG, 360 - LEAST_TURN_DEG + 1, 10)]
    assert min(float(np.sqrt(np.mean((seen - one) ** 2))) for one in turned) > 0.03


def test_the_nominal_pose_shows_the_plate_unturned():
    T = find_nominal_pose(PLACES[0], CAMERA)
    np.testing.assert_allclose(T[:3, :3], np.diag([1, -1, -1]), atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ PLACES[0].centre_m + T[:3, 3], [0, 0, CAMERA.surface_m], atol=1e-12)
    turned = find_nominal_pose(PLACES[0], CAMERA, np.pi / 2)
    np.testing.assert_allclose(turned[:3, :3], rotation_about([0, 0, 1], np.pi / 2) @ T[:3, :3], atol=1e-12)


def test_the_files_state_the_object_in_mm(tmp_path):
    write_stl(tmp_path / "object.stl")
    read = load_object(tmp_path / "object.stl", "mm").mesh
    assert np.ptp(read.vertices_m, axis=0) == pytest.approx([0.06, 0.06, 0.006], abs=1e-6)
    write_places(tmp_path / "places.csv")
    rows = list(csv.DictReader((tmp_path / "places.csv").open()))
    assert [int(row["number"]) for row in rows] == list(range(1, 11))
    assert (float(rows[4]["x_mm"]), float(rows[4]["y_mm"])) == (PLACES[4].x, PLACES[4].y)


def test_the_drawing_names_every_place():
    texts = {text.get_text() for text in draw_places().axes[0].texts}
    assert texts == {f"{place.number} {place.name}" for place in PLACES}
