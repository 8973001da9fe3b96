from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.errors import ConfigError, GridError
from tactile_loc.core.geometry import translation
from tactile_loc.core.poses import PoseGrid, PoseMetric
from tactile_loc.core.posterior import PosePosterior
from tactile_loc.plugins.fusers.product import ProductFuser


@pytest.fixture
def posterior(box) -> PosePosterior:
    x = 0.001 * np.arange(4.0)
    grid = PoseGrid(translation(np.column_stack([x, 0 * x, 0 * x])), PoseMetric(box))
    return PosePosterior(grid, np.log([0.1, 0.2, 0.3, 0.4]))


def test_without_a_prior_the_touch_has_the_word(posterior):
    fused = ProductFuser().fuse([posterior], [None])
    np.testing.assert_allclose(fused.probabilities, [0.1, 0.2, 0.3, 0.4])


def test_a_prior_weighs_each_pose_by_where_it_is(posterior):
    weights = np.array([4.0, 3.0, 2.0, 1.0])
    fused = ProductFuser().fuse([posterior], [None], lambda T: np.log(weights[np.rint(T[:, 0, 3] / 0.001).astype(int)]))
    product = np.array([0.4, 0.6, 0.6, 0.4])
    np.testing.assert_allclose(fused.probabilities, product / product.sum())
    assert fused.grid is posterior.grid


def test_the_priors_scale_does_not_matter(posterior):
    a, b = (ProductFuser().fuse([posterior], [None], lambda T, c=c: T[:, 0, 3] * 500 + c) for c in (0.0, 1e5))
    np.testing.assert_allclose(a.probabilities, b.probabilities, rtol=1e-9)


def test_a_prior_may_exclude(posterior):
    fused = ProductFuser().fuse([posterior], [None], lambda T: np.where(T[:, 0, 3] < 0.0015, 0.0, -np.inf))
    np.testing.assert_allclose(fused.probabilities, [1 / 3, 2 / 3, 0, 0])
    with pytest.raises(GridError, match="no pose of the grid explains the touch"):
        ProductFuser().fuse([posterior], [None], lambda T: np.full(len(T), -np.inf))


@pytest.mark.parametrize("weights", [0.0, np.zeros(3), np.zeros((4, 1)), np.full(4, np.nan), [0.0, 0.0, np.inf, 0.0]])
def test_a_prior_that_is_no_log_weight_a_pose_is_refused(posterior, weights):
    with pytest.raises(ConfigError, match=r"the prior returned .* for 4 poses"):
        ProductFuser().fuse([posterior], [None], lambda T: weights)


def test_it_leaves_its_input_alone(posterior):
    before = posterior.log_p.copy()
    ProductFuser().fuse([posterior], [None], lambda T: np.arange(4.0))
    assert np.array_equal(posterior.log_p, before)


@pytest.mark.parametrize("count", [0, 2])
def test_it_is_for_one_touch(posterior, count):
    with pytest.raises(ConfigError, match=f"not {count} touches"):
        ProductFuser().fuse([posterior] * count, [None] * count)
