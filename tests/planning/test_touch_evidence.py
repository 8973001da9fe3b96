"""Expected evidence equals that of contacts, and that of an elastic gel only where it touches."""

import dataclasses

import numpy as np
import pytest
from planning_helpers import GEL, PRESS_M

from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel, find_touching, mark_touching
from tactile_loc.core.sensing.imprints import compare_imprints
from tactile_loc.planning.touch_evidence import compare_contacts, compare_elastic_contacts


def test_distances_in_nats_equal_differences_of_evidence():
    rng = np.random.default_rng(0)
    depths = (rng.random((4, 9, 12)) * 4e-4).astype(np.float32)  # small differences, which the evidence does not cap
    depths[rng.random(depths.shape) < 0.5] = PRESS_M
    observed = rng.random((9, 12)) < 0.9
    nats = compare_contacts(depths, PRESS_M, observed, 1e-3)
    for i, seen in enumerate(depths):
        evidence = compare_imprints(depths, seen, PRESS_M, observed, 1e-3).evidence
        assert nats[i] == pytest.approx(evidence[i] - evidence, abs=1e-3)


SOFT = dataclasses.replace(GEL, gel=Gel(4e-3))


def press_bumps(*gaps_m: float) -> np.ndarray:
    """Return the contact depths in a rigid gel, (K, 60, 80), metres, of a ball beside one that is `gaps_m` higher."""
    y, x = np.mgrid[:60, :80] / 4 - np.array([7.5, 10.0])[:, None, None]
    balls = [(x**2 + y**2) / 8, (x - 1.5) ** 2 / 8 + y**2 / 8]
    depths = [np.minimum(balls[0], balls[1] + 1e3 * gap_m) for gap_m in gaps_m]
    return np.minimum(1e-3 * np.stack(depths), PRESS_M).astype(np.float32)


def test_what_an_elastic_gel_does_not_touch_gives_no_evidence():
    # beside a sphere, an elastic gel is displaced but touches nothing, so a lower bump there stays unseen
    depths = press_bumps(2e-4, 4e-4)
    pressed = SOFT.press(PRESS_M)
    shown = deform_gel(depths, PRESS_M, pressed)
    rigid = compare_contacts(depths, PRESS_M, np.ones((60, 80), bool), 2.5e-4)
    elastic = compare_elastic_contacts(depths, shown, PRESS_M, np.ones((60, 80), bool), 2.5e-4)
    assert np.diag(elastic) == pytest.approx([0.0, 0.0])
    assert 0 <= elastic[1, 0] < rigid[1, 0]
    same = compare_elastic_contacts(depths[[0, 0]], shown[[0, 0]], PRESS_M, np.ones((60, 80), bool), 2.5e-4)
    assert same == pytest.approx(np.zeros((2, 2)))


def test_the_marked_contact_is_the_one_that_the_gel_surface_shows():
    depths = press_bumps(2e-4, 1e-2)
    pressed = SOFT.press(PRESS_M)
    shown = deform_gel(depths, PRESS_M, pressed, iterations=30)
    for marked, surface, depth in zip(mark_touching(depths, shown, PRESS_M), shown, depths, strict=True):
        found = find_touching(surface, PRESS_M, pressed)
        assert np.count_nonzero(marked & found) > 0.8 * np.count_nonzero(marked | found)
        assert np.count_nonzero(marked) < 0.8 * np.count_nonzero(depth < PRESS_M)
