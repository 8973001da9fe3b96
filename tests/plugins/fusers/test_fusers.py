import numpy as np
import pytest
from message_helpers import missing, naming

from tactile_loc import PoseGrid, PoseMetric, PosePosterior
from tactile_loc.plugin import ConfigError, NoPoseLeft
from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about
from tactile_loc.plugins.fusers.kinematic import KinematicFuser
from tactile_loc.plugins.fusers.product import ProductFuser


@pytest.fixture
def posterior(box) -> PosePosterior:
    x = 0.001 * np.arange(4.0)
    grid = PoseGrid(make_translation(np.column_stack([x, 0 * x, 0 * x])), PoseMetric(box))
    return PosePosterior(grid, np.log([0.1, 0.2, 0.3, 0.4]))


@pytest.mark.parametrize("weights", [0.0, np.zeros(3), np.zeros((4, 1)), np.full(4, np.nan), [0.0, 0.0, np.inf, 0.0]])
def test_a_prior_without_one_log_weight_per_pose_is_refused(posterior, weights):
    with pytest.raises(ConfigError, match=naming("prior", np.shape(weights), 4, "(N,)")):
        ProductFuser().fuse([posterior], [None], lambda T: weights)


def test_one_touch_needs_no_sensor_pose(posterior):
    for T in (None, T_BASE[1], np.full((4, 4), np.nan)):
        assert np.array_equal(ProductFuser().fuse([posterior], [T]).log_p, posterior.log_p)


STEP_M = 0.003
T_BASE = [
    make_transform(rotation_about([1, 2, 3], 0.8), [0.2, -0.1, 0.4]),
    make_transform(rotation_about([-1, 0, 2], 2.1), [0.21, -0.12, 0.39]),
    make_transform(rotation_about([0, 3, 1], -1.4), [0.19, -0.1, 0.41]),
]


def toy(box, places: list[int], weights: list[float], sensor: int = 0, trained: list[float] | None = None):
    """Poses on a line, at `places` steps of 3 mm in the first sensor's frame, as another sensor sees them."""
    x = STEP_M * np.array(places, float)
    in_first = make_translation(np.column_stack([x, 0 * x, 0 * x]))
    grid = PoseGrid(invert(T_BASE[sensor]) @ T_BASE[0] @ in_first, PoseMetric(box))
    return PosePosterior(grid, np.log(weights), None if trained is None else np.log(trained))


def toys(box, count: int) -> list[PosePosterior]:
    """Three grids in different orders: all share the places 1 and 2, and the first two also share 3."""
    first = toy(box, [0, 1, 2, 3], [0.1, 0.2, 0.3, 0.4], 0, [0.4, 0.1, 0.25, 0.25])
    second = toy(box, [3, 2, 1], [0.5, 0.3, 0.2], 1, [0.5, 0.25, 0.25])
    third = toy(box, [1, 5, 2], [0.25, 0.5, 0.25], 2)
    return [first, second, third][:count]


BY_HAND = {
    1: [0.1 / 0.4, 0.2 / 0.1, 0.3 / 0.25, 0.4 / 0.25],
    2: [0, 0.2 / 0.1 * 0.2 / 0.25, 0.3 / 0.25 * 0.3 / 0.25, 0.4 / 0.25 * 0.5 / 0.5],
    3: [0, 0.2 / 0.1 * 0.2 / 0.25 * 0.25, 0.3 / 0.25 * 0.3 / 0.25 * 0.25, 0],
}
TASK = np.array([0.5, 0.3, 0.15, 0.05])


def task(T: np.ndarray) -> np.ndarray:
    return np.log(TASK[np.rint(T[:, 0, 3] / STEP_M).astype(int)])


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("prior", [None, task])
def test_the_product_equals_the_formula_by_hand(box, count, prior):
    fused = ProductFuser(ProductFuser.Options(reach=0.4)).fuse(toys(box, count), T_BASE[:count], prior)
    product = np.array(BY_HAND[count]) * (1 if prior is None else TASK)
    np.testing.assert_allclose(fused.probabilities, product / product.sum(), rtol=0, atol=1e-9)


def test_the_kinematic_fuser_makes_all_poses_that_touch_all_sensors_equally_probable(box):
    fused = KinematicFuser(KinematicFuser.Options(reach=0.4)).fuse(toys(box, 3), T_BASE)
    np.testing.assert_allclose(fused.probabilities, [0, 0.5, 0.5, 0], atol=1e-12)


def test_a_pose_takes_the_probability_of_the_nearest_pose(box):
    """The second grid is shifted: each pose takes the nearest probability, and a pose beyond reach is dropped."""
    touches = [toy(box, [0, 1, 2], [0.2, 0.3, 0.5]), toy(box, [0.1, 1.3, 6], [0.3, 0.6, 0.1], 1)]
    fused = ProductFuser(ProductFuser.Options(reach=0.2)).fuse(touches, T_BASE[:2])
    np.testing.assert_allclose(fused.probabilities, np.array([0.06, 0.18, 0]) / 0.24, atol=1e-9)


def test_the_reach_is_measured_in_spacings_of_the_coarser_grid(box):
    every_quarter = list(np.arange(0, 4, 0.25))
    reach = ProductFuser(ProductFuser.Options(reach=0.55))
    seen = reach.fuse([toy(box, every_quarter, [1.0] * 16), toy(box, [0, 2], [0.5, 0.5], 1)], T_BASE[:2])
    assert np.isfinite(seen.log_p).sum() == 13, "the reach is 0.55 of two steps, so that poses up to 3 count"
    seen = reach.fuse([toy(box, [0, 2.9, 5.8], [1.0] * 3), toy(box, every_quarter, [1.0] * 16, 1)], T_BASE[:2])
    assert np.isfinite(seen.log_p).tolist() == [True, True, False], (
        "the reach is 0.55 of 2.9 steps, so that the last pose is too far away"
    )
    fine, half, coarse = every_quarter, every_quarter[:9], [0, 2, 4]
    each = [toy(box, places, [1.0] * len(places), k) for k, places in enumerate((fine, half, coarse))]
    assert np.isfinite(reach.fuse(each, T_BASE).log_p).sum() == 9, (
        "the reach between the first two grids is 0.55 of a quarter step, for any third grid"
    )


def test_two_touches_of_one_sensor_pose_need_no_lookup(box, monkeypatch):
    first = toy(box, [0, 1, 2], [0.2, 0.3, 0.5])
    again = PosePosterior(first.grid, np.log([0.5, 0.3, 0.2]))
    monkeypatch.setattr(PoseGrid, "nearest", lambda *_: pytest.fail("the fuser looked poses up"))
    fused = ProductFuser().fuse([first, again], [T_BASE[0]] * 2)
    np.testing.assert_allclose(fused.probabilities, np.array([0.1, 0.09, 0.1]) / 0.29, atol=1e-12)


@pytest.mark.parametrize("symmetry", ["z2", "zinf*x2"])
def test_equivalent_poses_count_as_one(make_box, cylinder, symmetry):
    """The second grid holds other equivalents of the same poses."""
    obj = cylinder if "inf" in symmetry else make_box(0.03, 0.02, 0.012, symmetry=symmetry)
    plain = toy(obj, [0, 1, 2], [0.2, 0.3, 0.5])
    seen = invert(T_BASE[1]) @ T_BASE[0] @ plain.grid.T_sensor_object @ obj.symmetry.list_elements(0.5)[[1, -1, 1]]
    second = PosePosterior(PoseGrid(seen, plain.grid.metric), np.log([0.5, 0.3, 0.2]))
    fused = ProductFuser(ProductFuser.Options(reach=0.1)).fuse([plain, second], T_BASE[:2])
    np.testing.assert_allclose(fused.probabilities, np.array([0.1, 0.09, 0.1]) / 0.29, atol=1e-9)


def test_very_small_probabilities_neither_vanish_nor_overflow(box):
    touches = [toy(box, [0, 1], [0.5, 0.5]), *(toy(box, [0, 1], [1.0, 1.0], i) for i in (1, 2))]
    sharp = [touches[0], *(PosePosterior(t.grid, np.array([0.0, -2000.0])) for t in touches[1:])]
    fused = ProductFuser().fuse(sharp, T_BASE)
    assert fused.log_p[1] == pytest.approx(-4000)


def test_doubt_takes_no_logarithm_of_zero_and_keeps_no_pose_without_contact(box):
    with np.errstate(all="raise"):
        ProductFuser().fuse(toys(box, 2), T_BASE[:2])
    fused = ProductFuser(ProductFuser.Options(reach=0.4, doubt=0.9)).fuse(toys(box, 3), T_BASE)
    assert (fused.probabilities > 0).tolist() == [False, True, True, False]


def test_contradicting_touches_leave_no_pose_or_are_doubted(box):
    one, other = toy(box, [0, 1], [1.0, 1.0]), toy(box, [0, 1], [1.0, 1.0], 1)
    yes, no = PosePosterior(one.grid, [0.0, -np.inf]), PosePosterior(other.grid, [-np.inf, 0.0])
    left = ProductFuser().fuse([yes, no], T_BASE[:2])
    assert isinstance(left, NoPoseLeft)
    assert not missing(left.reason, 2, 1, "fuser.doubt")
    certain = PosePosterior(toy(box, [0, 1], [1.0, 1.0], 2).grid, np.log([0.9, 0.1]))
    fused = ProductFuser(ProductFuser.Options(doubt=0.2)).fuse([yes, no, certain], T_BASE)
    ratio = np.array([(0.8 * 2 + 0.2) * 0.2 * (0.8 * 1.8 + 0.2), 0.2 * (0.8 * 2 + 0.2) * (0.8 * 0.2 + 0.2)])
    np.testing.assert_allclose(fused.probabilities, ratio / ratio.sum(), atol=1e-9)


@pytest.mark.parametrize(
    ("T", "values"),
    [
        ([None, np.eye(4)], ("touch 1", "T_base_sensor")),
        ([np.eye(4), None], ("touch 2", "T_base_sensor")),
        ([np.eye(4), 2 * np.eye(4)], ("touch 2", "T_base_sensor", "rigid")),
        ([np.eye(4), np.eye(3)], ("touch 2", "T_base_sensor", "rigid")),
        ([np.eye(4)], (2, 1)),
        ([np.eye(4)] * 3, (2, 3)),
    ],
)
def test_several_touches_need_the_pose_of_each_sensor(posterior, T, values):
    with pytest.raises(ConfigError, match=naming(*values)):
        ProductFuser().fuse([posterior] * 2, T)


def test_there_must_be_a_touch_and_one_object(posterior, cylinder):
    with pytest.raises(ConfigError, match=naming(0)):
        ProductFuser().fuse([], [])
    other = toy(cylinder, [0, 1], [1.0, 1.0])
    with pytest.raises(ConfigError, match=naming("touch 2", "cylinder", "touch 1", "box")):
        ProductFuser().fuse([posterior, other], T_BASE[:2])
