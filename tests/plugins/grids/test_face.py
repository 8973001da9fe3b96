import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc import ObjectModel, PoseGrid, PoseMetric, TriangleMesh
from tactile_loc.plugin import GridError
from tactile_loc.plugin.helpers import SymmetryGroup, is_rigid
from tactile_loc.plugins.grids.face import SIDES, FaceGrid, count_turns_alike, find_resting_normal


def face(side: str = "auto", **options) -> FaceGrid:
    return FaceGrid(FaceGrid.Options(face=side, **options))


def wedge_shaped(make_object, shift_m) -> ObjectModel:
    """A box whose origin is not its centroid: the nearest face depends on the centroid."""
    return make_object(trimesh.creation.box([0.03, 0.02, 0.012]).apply_translation(shift_m))


@pytest.mark.parametrize("side", SIDES)
def test_the_named_side_points_into_the_sensor(pinhole, box, side):
    normal = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}[side[1]]
    R = face(side).sample(box, pinhole, 0.01)[:, :3, :3]
    outward = R @ np.array(normal, float) * (1 if side[0] == "+" else -1)
    np.testing.assert_allclose(outward, np.broadcast_to([0, 0, -1.0], outward.shape), atol=1e-12)


@pytest.mark.parametrize("shift_m", [(0, 0, 0), (0.2, -0.1, 0.05)])
def test_auto_chooses_the_face_nearest_to_the_centroid(pinhole, make_object, shift_m):
    """For a 30 x 20 x 12 mm box, this is one of the two largest faces: the one with the greater normal."""
    obj = wedge_shaped(make_object, shift_m)
    np.testing.assert_allclose(find_resting_normal(obj.mesh), [0, 0, 1], atol=1e-9)
    assert np.array_equal(face("auto").sample(obj, pinhole, 0.01), face("+z").sample(obj, pinhole, 0.01))


def test_auto_chooses_the_side_of_a_tetrahedron_nearest_to_the_centroid():
    vertices = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.04, 0], [0, 0, 0.02]])
    normals = np.array([[0, 0, -1.0], [0, -1, 0], [-1, 0, 0], [1 / 0.05, 1 / 0.04, 1 / 0.02]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh = TriangleMesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    corner = vertices[[0, 0, 0, 1]]
    distances = np.einsum("nk,nk->n", normals, corner - mesh.centroid_m)
    assert (distances > 0).all()
    found = find_resting_normal(mesh)
    np.testing.assert_allclose(found, normals[distances.argmin()], atol=1e-9)


def test_a_flat_object_has_no_resting_face(pinhole):
    sheet = TriangleMesh(np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.02, 0.0]]), np.array([[0, 1, 2]]))
    obj = ObjectModel("sheet", sheet, SymmetryGroup.parse("none", np.zeros(3)))
    with pytest.raises(GridError, match=naming("`face`", "+z")):
        face("auto").sample(obj, pinhole, 0.01)
    assert len(face("+z").sample(obj, pinhole, 0.01)) > 0


def test_too_many_poses_are_refused_before_they_are_made(pinhole, box):
    count = len(face("+z").sample(box, pinhole, 0.01))
    assert len(face("+z", max_poses=2 * count).sample(box, pinhole, 0.01)) == count
    with pytest.raises(GridError, match=naming("box", "10 mm", count // 2, "max_poses")):
        face("+z", max_poses=count // 2).sample(box, pinhole, 0.01)
    with pytest.raises(GridError, match=naming("box", "0.001 mm", "2,000,000", "max_poses")):
        face("+z").sample(box, pinhole, 1e-6)
    for spacing_m in (1e-7, 1e-310, 0.0, -1.0, np.nan, np.inf):
        with pytest.raises(GridError, match=naming("0.001 mm")):
            face("+z").sample(box, pinhole, spacing_m)


def test_an_unknown_face_is_refused(pinhole, box):
    with pytest.raises(GridError, match=naming("'top'", "+x", "-x", "auto")):
        face("top").sample(box, pinhole, 0.01)


@pytest.mark.parametrize("spacing_m", [0.003, 0.006])
def test_neighbours_are_one_spacing_apart(pinhole, box, spacing_m):
    T = face("+z").sample(box, pinhole, spacing_m)
    spacing = PoseGrid(T, PoseMetric(box)).neighbour_spacing()
    assert spacing.mean() == pytest.approx(spacing_m, rel=0.15), "a circle must hold a whole number of yaws"
    assert spacing.max() <= spacing_m * (1 + 1e-9), "the spacing exceeds the pitch of the lattice"
    yaws = np.unique(np.arctan2(T[:, 1, 0], T[:, 0, 0]).round(9))
    lever_m = np.sqrt(np.trace(box.mesh.covariance_m2[:2, :2]))
    assert 2 * np.pi * lever_m / len(yaws) == pytest.approx(spacing_m, rel=0.15)


def test_tilts_are_about_the_sensors_axes_and_within_the_limit(pinhole, box):
    flat = face("+z").sample(box, pinhole, 0.01)
    T = face("+z", tilt_deg=8.0, tilt_steps=3).sample(box, pinhole, 0.01)
    assert is_rigid(T)
    normal = T[:, :3, :3] @ [0, 0, 1]
    # A tilt about x moves the normal along y, one about y along x: each the middle of a third of -8 to 8 degrees.
    about_y = np.degrees(np.arcsin(-normal[:, 0]))
    about_x = np.degrees(np.arctan2(normal[:, 1], -normal[:, 2]))
    assert set(about_x.round(6) + 0.0) == set(about_y.round(6) + 0.0) == {-5.333333, 0.0, 5.333333}
    assert 8 * len(flat) < len(T) < 11 * len(flat)


def test_random_tilts_are_within_the_limit_and_uniform(pinhole, box):
    T = face("+z", tilt_deg=8.0).random(box, pinhole, 4000, np.random.default_rng(0))
    normal = T[:, :3, :3] @ [0, 0, 1]
    for tilt in (np.degrees(np.arcsin(normal[:, 0])), np.degrees(np.arctan2(normal[:, 1], -normal[:, 2]))):
        assert np.abs(tilt).max() <= 8.0
        assert tilt.std() == pytest.approx(16 / np.sqrt(12), rel=0.05)


@pytest.mark.parametrize(
    ("symmetry", "normal", "turns"),
    [
        ("none", [0, 0, 1], 1),
        ("z6", [0, 0, 1], 6),
        ("z6", [0, 0, -1], 6),
        ("z6", [1, 0, 0], 1),
        ("z6*x2", [0, 0, 1], 6),
        ("z6*x2", [1, 0, 0], 2),
        ("zinf", [0, 0, 1], np.inf),
        ("zinf", [1, 0, 0], 1),
        ("zinf*x2", [0.6, 0.8, 0], 2),
        ("sphere", [0.6, 0, 0.8], np.inf),
    ],
)
def test_equivalent_rotations_about_a_normal_are_counted(symmetry, normal, turns):
    assert count_turns_alike(SymmetryGroup.parse(symmetry, np.zeros(3)), np.array(normal, float)) == turns
