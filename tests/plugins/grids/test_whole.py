import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc import ObjectModel, TriangleMesh
from tactile_loc.core.places.places import BELOW, FAR, PATCH_PX, PITCH_M, STEP_M
from tactile_loc.plugin import ConfigError, GridError, Progress
from tactile_loc.plugin.helpers import SymmetryGroup
from tactile_loc.plugins.grids.whole import WholeGrid, find_distinct_directions, find_flat_directions, make_sphere
from tactile_loc.testing.problems import CAMERAS, make_block, make_box

STEP_RAD = np.sqrt(4 * np.pi / 4000)


def of(mesh: TriangleMesh, name: str = "some", symmetry: SymmetryGroup | None = None) -> ObjectModel:
    return ObjectModel(name, mesh, symmetry or SymmetryGroup(np.zeros(3)))


def places_of(obj: ObjectModel, **options):
    return WholeGrid(WholeGrid.Options(directions=200, **options)).places(obj, Progress())


@pytest.fixture(scope="module")
def ball():
    surface = trimesh.creation.icosphere(5, 0.01)
    return of(TriangleMesh(np.array(surface.vertices), np.array(surface.faces, np.int64)))


def test_directions_are_evenly_distributed():
    found = make_sphere(2000)
    assert np.linalg.norm(found, axis=1) == pytest.approx(1)
    assert np.abs(found.mean(axis=0)).max() < 1e-3
    cosine = np.sort(found @ found.T, axis=1)[:, -2]
    step_deg = np.degrees(np.arccos(cosine))
    assert step_deg.min() > 0.7 * np.degrees(np.sqrt(4 * np.pi / 2000))


def test_a_ball_has_one_place_per_direction_with_a_spherical_patch(ball):
    places = places_of(ball)
    assert len(places) == 200  # no facet has 4 mm^2
    offset_m = (np.arange(PATCH_PX) - PATCH_PX // 2) * PITCH_M
    across2 = offset_m[:, None] ** 2 + offset_m**2
    rise_m = 0.01 - np.sqrt(np.maximum(0.01**2 - across2, 0))
    inside = across2 < 0.004**2  # 0.8 mm higher than the top
    steps = places.patches[:, inside].astype(float) - BELOW
    assert (
        np.abs(steps * STEP_M - rise_m[inside]).max() < 2.5e-4
    )  # the top may be a pixel away, and the ball has facets
    assert (places.patches[:, across2 > 0.0105**2] == FAR).all()


def test_a_level_edge_has_places_along_its_length():
    long = make_box((-0.02, -0.003, -0.003), (0.02, 0.003, 0.003))
    sampler = WholeGrid(WholeGrid.Options(apart_mm=2.0))
    heights = np.full((60, 120), np.inf, np.float32)
    heights[30, 20:100] = 0.01
    pixels = sampler._find_lowest(heights)
    assert len(pixels) == 20  # 40 mm
    assert (np.diff(np.sort(pixels[:, 1])) >= 4).all()
    assert len(long.faces) == 12


def test_equivalent_directions_are_searched_once():
    obj = of(make_box((-0.01, -0.01, -0.004), (0.01, 0.01, 0.004)), symmetry=SymmetryGroup.parse("z4", np.zeros(3)))
    directions = make_sphere(4000)
    kept = find_distinct_directions(directions, obj, STEP_RAD)
    assert 0.2 < len(kept) / len(directions) < 0.35
    S = obj.symmetry.list_elements()[:, :3, :3]
    alike = np.einsum("kij,nj->nki", S, directions)
    nearest_deg = np.degrees(np.arccos(np.clip((alike @ kept.T).max(axis=(1, 2)), -1, 1)))
    assert nearest_deg.max() < 4.0  # every direction has an equivalent among the kept ones


def test_the_whole_grid_refuses_to_list_poses():
    with pytest.raises(ConfigError, match="`grid` face"):
        WholeGrid().sample(make_block(), CAMERAS["orthographic"], 0.003)


def test_an_object_of_half_a_metre_is_refused():
    with pytest.raises(GridError, match=naming("table", "663 mm", "500 mm", "`grid` face")):
        places_of(of(make_box((-0.3, -0.1, -0.1), (0.3, 0.1, 0.1)), "table"))


def test_drawn_poses_touch_with_their_lowest_point_over_the_sensor():
    camera, obj = CAMERAS["orthographic"], make_block()
    T = WholeGrid().random(obj, camera, 300, np.random.default_rng(0))
    points = obj.mesh.vertices_m @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3]
    lowest = points[np.arange(300), points[..., 2].argmin(axis=1)]
    x0, x1, y0, y1 = camera.rectangle
    assert ((lowest[:, 0] >= x0) & (lowest[:, 0] <= x1) & (lowest[:, 1] >= y0) & (lowest[:, 1] <= y1)).all()
    directions = T[:, 2, :3]
    assert np.abs(directions.mean(axis=0)).max() < 0.15


def test_more_places_than_fit_are_refused_with_a_number_that_fits():
    with pytest.raises(GridError, match=r"grid.directions=\d+") as refused:
        places_of(make_block(), max_places=100)
    fewer = int(str(refused.value).split("grid.directions=")[1].split(",")[0])
    assert fewer == 100


def test_the_directions_contain_the_normals_of_flat_faces():
    mesh = make_box((-0.01, -0.006, -0.004), (0.01, 0.006, 0.004))
    flat = find_flat_directions(mesh, 4e-6)
    assert sorted(map(tuple, np.rint(flat).astype(int).tolist())) == sorted(
        [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    )
    assert np.abs(flat).max(axis=1) == pytest.approx(1)
    assert len(find_flat_directions(mesh, 2e-4)) == 2  # the faces of 20 x 12 mm
    places = places_of(of(mesh))
    level = (places.patches[:, 18:23, 18:23] == BELOW).all(axis=(1, 2))
    assert level.sum() > 50  # places on the faces, 2 mm apart
