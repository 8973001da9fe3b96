"""The test object can be printed and aligned, and no place looks the same after a turn."""

import csv
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection, Error, JoinType, Manifold, Mesh64
from tactile_loc import load_object
from tactile_loc.plugin import SensorGeometry, registry
from tactile_loc.plugin.helpers import rotation_about

from tactile_loc_test_object.picture import draw_places
from tactile_loc_test_object.scoring import find_nominal_pose
from tactile_loc_test_object.shape import (
    LINE,
    LINE_DEPTH,
    PLACES,
    RADIUS,
    SIDE,
    THICKNESS,
    TOP,
    make_object,
    write_places,
    write_stl,
)

STEEPEST_DEG = 45.0
NOZZLE, LAYER = 0.4, 0.1
CORNER_MM2 = NOZZLE**2 / 4
DEEPEST = 1.0  # a press of 0.8 mm does not reach lower parts
HOUSING = 34.0
LEAST_TURN_DEG = 20
CAMERA = SensorGeometry("orthographic", 120, 120, 10_000, 10_000, 60, 60, 20e-3, 6e-3)


@pytest.fixture(scope="module")
def mesh(tmp_path_factory) -> trimesh.Trimesh:
    folder = tmp_path_factory.mktemp("object")
    write_stl(folder / "object.stl")
    return trimesh.load_mesh(folder / "object.stl")  # with its numbers rounded


def test_the_object_is_watertight_and_has_its_size(mesh):
    assert mesh.is_volume  # watertight, and its faces look outwards
    assert mesh.body_count == 1
    half = SIDE / 2
    np.testing.assert_allclose(mesh.bounds, [[-half, -half, -THICKNESS], [half, half, TOP]], atol=1e-6)


def test_nothing_overhangs(mesh):
    below = mesh.triangles_center[:, 2] > -THICKNESS + 1e-6
    down = mesh.face_normals[:, 2] < -np.cos(np.radians(STEEPEST_DEG))
    assert mesh.area_faces[below & down].sum() == 0


@pytest.fixture(scope="module")
def printed(mesh) -> Manifold:
    """The solid that a slicer reads from the file."""
    solid = Manifold(Mesh64(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.uint64)))
    assert solid.status() == Error.NoError
    assert solid.volume() == pytest.approx(mesh.volume)
    return solid


def widen(section: CrossSection, by_mm: float) -> CrossSection:
    return section.offset(by_mm, JoinType.Round, circular_segments=32)


def find_largest_part(section: CrossSection) -> float:
    return max((part.area() for part in section.decompose()), default=0.0)


def test_each_layer_rests_on_the_one_below(printed):
    heights = np.arange(-THICKNESS + LAYER / 2, TOP, LAYER)
    layers = [printed.slice(height) for height in heights]
    assert all(layer.area() > 0 for layer in layers)
    for below, layer in pairwise(layers):
        assert (layer - widen(below, LAYER + 1e-3)).area() < 1e-6


def test_a_nozzle_can_print_all_walls_and_grooves(printed):
    """Only sharp corners of walls are narrower than the nozzle, and no groove is, where a sensor touches.

    The tips are thinner. They end at the heights 1.8 and 2 mm.
    """
    half = NOZZLE / 2 - 0.01
    for height in np.arange(LAYER / 2, TOP - 0.3, LAYER):
        layer = printed.slice(height)
        assert find_largest_part(layer - widen(widen(layer, -half), half + 2e-3)) < CORNER_MM2
        if height > DEEPEST:
            assert find_largest_part(widen(widen(layer, half), -half - 2e-3) - layer) < 1e-3


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.name)
def test_lines_beside_a_housing_mark_the_centre(printed, place):
    """Along both axes, a groove has its middle at the place's centre, and some of it is visible beside a housing."""
    plate = CrossSection.square((SIDE, SIDE), True)
    housing = CrossSection.square((HOUSING, HOUSING), True).translate((place.x, place.y))
    visible = plate - printed.slice(-LINE_DEPTH / 2) - housing

    def measure_length(axis: int, beside: float) -> float:
        """Return the visible length of the groove, at a distance from the centre line."""
        strip = CrossSection.square((0.02, 2 * SIDE)[:: 1 - 2 * axis], True)
        at = np.array([place.x, place.y]) * (axis == 0, axis == 1)
        at[axis] += beside
        return (visible ^ strip.translate(tuple(at))).area() / 0.02

    for axis in (0, 1):
        inside = [measure_length(axis, beside) for beside in (0.02 - LINE / 2, 0, LINE / 2 - 0.02)]
        outside = [measure_length(axis, beside) for beside in (-0.02 - LINE / 2, LINE / 2 + 0.02)]
        assert min(inside) > 8
        assert max(outside) < 3  # lines that cross, and the notches


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
    assert texts == {*(f"{place.number} {place.name}" for place in PLACES), "raised corner"}
