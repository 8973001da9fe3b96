"""The matcher keeps every contract of its slot, and locates with the default grid like an exact matcher."""

import numpy as np
import pytest
from tactile_loc import Localizer
from tactile_loc.plugin import registry
from tactile_loc.testing import parametrize_with_checks, parametrize_with_properties

pytest.importorskip("usearch")
from tactile_loc_usearch.matcher import UsearchMatcher

VARIANTS = [UsearchMatcher(), UsearchMatcher(UsearchMatcher.Options(top_k=50))]


@parametrize_with_checks(VARIANTS)
def test_contract(component, check):
    check(component)


@parametrize_with_properties(VARIANTS[:1])
def test_property(component, check):
    check(component)


@pytest.mark.skipif("usearch" not in registry().names("matcher"), reason="not installed")
def test_the_matcher_locates_with_the_default_grid_like_dense(tmp_path):
    few = {"store": tmp_path, "grid": {"name": "whole", "directions": 300}, "temperature": 0.05}
    ours, dense = (Localizer.create("damping_pin", matcher=name, **few) for name in ("usearch", "dense"))
    touch = dense.simulate(1, seed=2)[0]
    found, expected = (localizer.localize(touch).best.T_sensor_object for localizer in (ours, dense))
    np.testing.assert_allclose(found, expected, atol=1e-5)
