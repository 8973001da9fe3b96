import re

import numpy as np
import pytest
import trimesh
from message_helpers import naming
from scipy.spatial import cKDTree

from tactile_loc import ObjectModel, PoseGrid, PoseMetric, SensorGeometry, TriangleMesh
from tactile_loc.bases.all_rotations import find_centroid_range
from tactile_loc.plugin import GridError
from tactile_loc.plugin.helpers import (
    SymmetryGroup,
    bring_to_contact,
    draw_rotations,
    is_rigid,
    make_transform,
    rotation_angle,
    rotation_to_quaternion,
)
from tactile_loc.plugins.grids.hopf import (
    HopfGrid,
    compute_pixel_angles,
    find_spin_axis,
    make_hopf_rotations,
    make_rotation_grid,
)

GEOMETRY = SensorGeometry("orthographic", 40, 30, 2000, 2000, 20, 15, 0.025, 0.002)  # 20 x 15 mm


def model(
    mesh: trimesh.Trimesh, symmetry: str = "none", shift_m: tuple[float, float, float] = (0, 0, 0)
) -> ObjectModel:
    surface = TriangleMesh(np.asarray(mesh.vertices) + shift_m, np.asarray(mesh.faces))
    return ObjectModel("part", surface, SymmetryGroup.parse(symmetry, shift_m))


def box(x: float, y: float, z: float, symmetry: str = "none", shift_m=(0, 0, 0)) -> ObjectModel:
    return model(trimesh.creation.box((x, y, z)), symmetry, shift_m)


BRICK, ROD, PLATE = box(0.06, 0.04, 0.03), box(0.08, 0.012, 0.01), box(0.05, 0.04, 0.004)


def all_rotations(nside: int, n_psi: int) -> np.ndarray:
    return make_hopf_rotations(nside, n_psi, np.arange(12 * nside**2 * n_psi))


def centroids(obj: ObjectModel, T: np.ndarray) -> np.ndarray:
    return T[:, :3, :3] @ obj.mesh.centroid_m + T[:, :3, 3]


@pytest.mark.parametrize("obj", [BRICK, ROD, PLATE, model(trimesh.creation.icosphere(2, 0.02))])
@pytest.mark.parametrize("spacing_m", [0.004, 0.005])
def test_neighbouring_rotations_are_one_spacing_apart_for_any_shape(obj, spacing_m):
    R = make_rotation_grid(obj, spacing_m).all_representatives()
    turned = PoseGrid(make_transform(R, -R @ obj.mesh.centroid_m), PoseMetric(obj))
    assert 0.85 < np.median(turned.neighbour_spacing()) / spacing_m < 1.15


def test_the_spin_axis_is_the_distinct_principal_axis():
    for obj, axis in ((ROD, [1, 0, 0]), (PLATE, [0, 0, 1])):
        found, about_m, across_m = find_spin_axis(obj)
        np.testing.assert_allclose(np.abs(found), axis, atol=1e-9)
        assert (about_m < across_m) == (obj is ROD)
    _, about_m, across_m = find_spin_axis(box(0.03, 0.03, 0.03))
    mean_square = 0.03**2 * (2 * 1 / 4 + 4 * 1 / 12) / 6  # two faces at a / 2, four uniform from -a / 2 to a / 2
    np.testing.assert_allclose([about_m, across_m], np.sqrt(2 * mean_square))


@pytest.mark.parametrize("level", [0, 1])
def test_a_level_sets_the_rotations_and_the_spacing_sets_the_plane(level):
    T = HopfGrid(HopfGrid.Options(level=level)).sample(BRICK, GEOMETRY, 0.02)
    assert len(np.unique(T[:, :3, :3].reshape(-1, 9), axis=0)) == 72 * 8**level
    at_one_rotation = centroids(BRICK, T[(T[:, :3, :3] == T[0, :3, :3]).all(axis=(1, 2))])
    apart = np.linalg.norm(at_one_rotation[1:] - at_one_rotation[0], axis=1)
    np.testing.assert_allclose(apart.min(), 0.02)


def test_poses_outside_the_range_have_no_contact_and_most_inside_have():
    R = draw_rotations(100, np.random.default_rng(3))
    low, high = find_centroid_range(BRICK, R, GEOMETRY)
    for limit_m in (low - 1e-4, high + 1e-4):
        beyond = np.concatenate([limit_m, np.zeros((100, 1))], axis=1)
        assert not bring_to_contact(BRICK.mesh, make_transform(R, beyond), GEOMETRY)[1].any()
    poses = HopfGrid().sample(BRICK, GEOMETRY, 0.015)
    assert bring_to_contact(BRICK.mesh, poses, GEOMETRY)[1].mean() > 0.5


@pytest.mark.parametrize("level", [None, 1])
@pytest.mark.parametrize(("symmetry", "share"), [("zinf", 1.0), ("zinf*x2", 0.5)])
def test_a_round_part_has_one_rotation_for_each_direction(symmetry, share, level):
    obj = model(trimesh.creation.cylinder(0.008, 0.05), symmetry)
    grid = make_rotation_grid(obj, 0.004, level)
    R = grid.all_representatives()
    assert len(R) == pytest.approx(share * 12 * grid.nside**2, rel=0.03)
    axes = R[:, :, 2]
    assert len(np.unique(axes.round(6), axis=0)) == len(R)


def test_every_pose_is_near_the_grid_or_an_equivalent():
    for obj in (box(0.06, 0.04, 0.03, "x2*y2"), model(trimesh.creation.cylinder(0.008, 0.05), "zinf*x2")):
        T = HopfGrid().sample(obj, GEOMETRY, 0.01)
        queries = HopfGrid().random(obj, GEOMETRY, 500, np.random.default_rng(0))
        queries[:, 2, 3] -= centroids(obj, queries)[:, 2]
        same = PoseMetric(obj).equivalents(queries, step_m=1e-3)
        distance = PoseGrid(T, PoseMetric(obj))._tree.query(PoseMetric(obj).embed(same))[0].min(axis=0)
        # A cell's corner is sqrt(5) / 2 = 1.1 spacings from its centre; pixels are not squares, and seams are ragged.
        assert distance.max() < 1.6 * 0.01
        assert distance.mean() < 0.8 * 0.01


def test_too_many_poses_are_refused_with_their_count_and_a_valid_spacing():
    sampler = HopfGrid(HopfGrid.Options(max_poses=20_000))
    with pytest.raises(GridError, match=naming("part", "2 mm", "20,000", "max_poses")) as refused:
        sampler.sample(BRICK, GEOMETRY, 0.002)
    enough_mm = max(float(number) for number in re.findall(r"([\d.]+) mm", str(refused.value)))
    assert 2 < enough_mm < 20
    assert 10_000 < len(sampler.sample(BRICK, GEOMETRY, enough_mm * 1e-3)) <= 20_000


@pytest.mark.parametrize(
    ("level", "spacing_m", "values"),
    [
        (8, 0.01, ("part", "10 mm", "level", "max_poses")),
        *((None, spacing_m, ("0.001 mm",)) for spacing_m in (0.0, -1.0, np.nan, np.inf, 1e-9)),
    ],
)
def test_a_level_too_high_and_an_impossible_spacing_are_refused(level, spacing_m, values):
    with pytest.raises(GridError, match=naming(*values)):
        HopfGrid(HopfGrid.Options(level=level)).sample(BRICK, GEOMETRY, spacing_m)


def test_random_poses_are_uniform_over_rotations_and_their_regions():
    T = HopfGrid().random(ROD, GEOMETRY, 20_000, np.random.default_rng(0))
    assert T.shape == (20_000, 4, 4)
    assert is_rigid(T)
    low, high = find_centroid_range(ROD, T[:, :3, :3], GEOMETRY)
    place = (centroids(ROD, T)[:, :2] - low) / (high - low)
    assert place.min() >= 0
    assert place.max() <= 1
    np.testing.assert_allclose(place.mean(axis=0), 0.5, atol=0.01)
    np.testing.assert_allclose(place.var(axis=0), 1 / 12, atol=0.003)
    # Uniform in the joint set: weighting each pose by 1 / area gives back uniform rotations, of mean angle pi/2 + 2/pi.
    weight = 1 / (high - low).prod(axis=1)
    angle = np.average(rotation_angle(T[:, :3, :3]), weights=weight)
    assert angle == pytest.approx(np.pi / 2 + 2 / np.pi, abs=0.02)
    np.testing.assert_allclose(np.einsum("n,nij->ij", weight / weight.sum(), T[:, :3, :3]), 0, atol=0.02)


def centres(nside: int) -> np.ndarray:
    z, azimuth_rad = compute_pixel_angles(nside, np.arange(12 * nside**2))
    s = np.sqrt(1 - z**2)
    return np.stack([s * np.cos(azimuth_rad), s * np.sin(azimuth_rad), z], axis=-1)


def ring_scheme(nside: int) -> np.ndarray:
    """The pixel centres by the ring formulas of Gorski et al. 2005, equations 4 to 9, written out pixel by pixel."""
    found = []
    for i in range(1, 4 * nside):
        if i < nside or i > 3 * nside:
            k = min(i, 4 * nside - i)
            z = (1 - k**2 / (3 * nside**2)) * (1 if i < nside else -1)
            azimuth = [np.pi / (2 * k) * (j - 0.5) for j in range(1, 4 * k + 1)]
        else:
            z, s = 4 / 3 - 2 * i / (3 * nside), (i - nside + 1) % 2
            azimuth = [np.pi / (2 * nside) * (j - s / 2) for j in range(1, 4 * nside + 1)]
        found += [(np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z) for a in azimuth]
    return np.array(found)


def to_nearest(R: np.ndarray, grid: np.ndarray, k: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Angle in radians to, and index of, the k-th nearest grid rotation: by quaternions, of both signs."""
    q = rotation_to_quaternion(grid)
    chord, index = cKDTree(np.concatenate([q, -q])).query(rotation_to_quaternion(R), k=[k])
    return 4 * np.arcsin(chord[:, 0] / 2), index[:, 0] % len(grid)


@pytest.mark.parametrize("nside", [1, 2, 3, 5, 8])
def test_centres_follow_the_ring_scheme_for_any_nside(nside):
    ours, theirs = centres(nside), ring_scheme(nside)
    distance, index = cKDTree(theirs).query(ours)
    assert distance.max() < 1e-12
    assert len(np.unique(index)) == len(theirs) == 12 * nside**2


@pytest.mark.parametrize("level", [0, 1, 2])
def test_rotations_are_proper_distinct_and_complete(level):
    n = 2**level
    R = all_rotations(n, 6 * n)
    assert len(R) == 72 * 8**level
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    np.testing.assert_allclose(
        R[:: 6 * n, :, 2], centres(n), atol=1e-12
    )  # the rotation maps z to the centre of the pixel


@pytest.mark.parametrize(("nside", "spacing_deg"), [(1, 60.0), (2, 30.0), (3, 20.0), (4, 15.0)])
def test_neighbours_are_at_the_published_spacing(nside, spacing_deg):
    R = all_rotations(nside, 6 * nside)
    nearest_deg = np.degrees(to_nearest(R, R, k=2)[0])
    assert 0.93 * spacing_deg < nearest_deg.mean() <= spacing_deg * (1 + 1e-9)
    assert nearest_deg.max() <= spacing_deg * (1 + 1e-9)  # the next spin is never farther away
    assert nearest_deg.min() > 0.8 * spacing_deg
