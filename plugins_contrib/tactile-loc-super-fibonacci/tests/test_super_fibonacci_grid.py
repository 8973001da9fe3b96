"""The grid keeps every contract of its slot, covers the same poses as hopf, and takes any number of rotations."""

import numpy as np
import pytest
from tactile_loc.plugin import GridError, ObjectModel, SensorGeometry, TriangleMesh, registry
from tactile_loc.plugin.helpers import SymmetryGroup, bring_to_contact, is_rigid, make_transform
from tactile_loc.testing import parametrize_with_checks, parametrize_with_properties
from tactile_loc.testing.problems import CAMERAS, make_block

from tactile_loc_super_fibonacci.coverage import least_covering, spread_of
from tactile_loc_super_fibonacci.grid import SuperFibonacciGrid, spread_rotations
from tactile_loc_super_fibonacci.spirals import super_fibonacci_rotations

SENSOR = SensorGeometry("orthographic", 40, 30, 2000, 2000, 20, 15, 0.025, 0.002)  # 20 x 15 mm
CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FACES = np.array([(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
                  (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)])  # fmt: skip


def brick(symmetry: str = "none", shift_m: tuple[float, float, float] = (0, 0, 0), size_m=(0.06, 0.04, 0.03)):
    """Return a box as an object. The symmetry is not checked against the box's sides."""
    mesh = TriangleMesh(CORNERS * size_m + shift_m, FACES)
    return ObjectModel("brick", mesh, SymmetryGroup.parse(symmetry, shift_m))


@parametrize_with_checks([SuperFibonacciGrid()])
def test_contract(component, check):
    """Run one check of `tactile_loc.testing` on one component."""
    check(component)


@parametrize_with_properties([SuperFibonacciGrid()])
def test_property(component, check):
    """Run one property of `tactile_loc.testing` on one component."""
    check(component)


@pytest.mark.parametrize("count", [50, 73, 500])
def test_a_given_number_of_rotations_is_kept_and_the_spacing_sets_the_plane(count):
    sampler = SuperFibonacciGrid(SuperFibonacciGrid.Options(rotations=count))
    assert not sampler.spacing_is_mean
    assert SuperFibonacciGrid().spacing_is_mean
    T = sampler.sample(brick(), SENSOR, 0.02)
    R, first = np.unique(T[:, :3, :3].reshape(-1, 9), axis=0, return_index=True)
    assert len(R) == count
    one = T[(T[:, :3, :3] == T[first[0], :3, :3]).all(axis=(1, 2))]
    apart = np.linalg.norm(one[1:, :2, 3] - one[0, :2, 3], axis=1)
    np.testing.assert_allclose(apart.min(), 0.02)


@pytest.mark.parametrize(("symmetry", "order"), [("x2", 2), ("x2*y2", 4), ("z4*x4", 24)])
def test_a_symmetry_keeps_its_share_of_rotations_and_full_coverage(symmetry, order):
    obj, count = brick(symmetry), 5000
    R = spread_rotations(obj, count)
    assert len(R) * order == pytest.approx(count, rel=0.1)
    whole = (R[:, None] @ obj.symmetry.rotations).reshape(-1, 3, 3)
    assert spread_of(whole, asked=50_000).covering_rad < 2 * least_covering(count)


@pytest.mark.parametrize(("symmetry", "share", "most"), [("zinf", 1.0, 1.3), ("zinf*x2", 0.5, 1.8)])
def test_a_round_part_has_one_rotation_for_each_direction_of_its_axis(symmetry, share, most):
    """The largest gap between directions is below `most` radii of a cap with one direction's share of the sphere."""
    R = spread_rotations(brick(symmetry), 400)
    assert len(R) == pytest.approx(400 * share, rel=0.05)
    axes = R[:, :, 2] if share == 1 else np.concatenate([R[:, :, 2], -R[:, :, 2]])
    random = np.random.default_rng(0).normal(size=(5000, 3))
    nearest = (random / np.linalg.norm(random, axis=1, keepdims=True) @ axes.T).max(axis=1)
    assert np.arccos(nearest.min()) < most * np.sqrt(4 / 400)


def test_a_single_rotation_is_possible_for_every_symmetry():
    for symmetry in ("none", "z4*x4", "zinf*x2", "sphere"):
        R = spread_rotations(brick(symmetry), 1)
        assert R.shape == (1, 3, 3)
        assert is_rigid(make_transform(R, np.zeros(3)))


def test_the_plane_is_covered_exactly_where_boxes_overlap():
    T = SuperFibonacciGrid(SuperFibonacciGrid.Options(rotations=30)).sample(brick(), SENSOR, 0.015)
    for rotation in np.unique(T[:, :3, :3].reshape(-1, 9), axis=0).reshape(-1, 3, 3):
        c = T[(T[:, :3, :3] == rotation).all(axis=(1, 2))][:, :2, 3]
        half = np.ptp(brick().mesh.vertices_m @ rotation.T, axis=0)[:2] / 2 + [0.010, 0.0075]
        places = np.random.default_rng(0).uniform(-half, half, (200, 2))
        assert np.abs(places[:, None] - c).max(axis=-1).min(axis=1).max() <= 0.0075 + 1e-9
        assert (np.abs(c) <= half + 1e-9).all()
    assert bring_to_contact(brick().mesh, T, SENSOR)[1].mean() > 0.5


def test_random_poses_have_the_distribution_of_hopf():
    """The numbers of a pose have the same distributions as those of hopf's poses, up to chance."""
    from scipy.stats import ks_2samp

    hopf = registry().create("grid", "hopf")
    drawn = [s.random(make_block(), CAMERAS["orthographic"], 4000, np.random.default_rng(k)) for k, s in
             enumerate((SuperFibonacciGrid(), hopf))]  # fmt: skip
    a, b = (np.column_stack([T[:, :3, :3].reshape(-1, 9), T[:, :2, 3]]) for T in drawn)
    assert min(ks_2samp(a[:, k], b[:, k]).pvalue for k in range(a.shape[1])) > 1e-3


def test_too_many_poses_are_refused_before_they_are_made():
    sampler = SuperFibonacciGrid(SuperFibonacciGrid.Options(max_poses=1000))
    for spacing_m in (0.008, 1e-5):
        with pytest.raises(
            GridError, match=r"super-fibonacci grid of brick .* over the limit of 1,000; choose a larger"
        ):
            sampler.sample(brick(), SENSOR, spacing_m)
    for spacing_m in (0.0, float("nan"), 1e-7):
        with pytest.raises(GridError, match="spacing is"):
            sampler.sample(brick(), SENSOR, spacing_m)
    with pytest.raises(ValueError, match="at least one point"):
        super_fibonacci_rotations(0)
