"""Points that are far apart are chosen in order."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.poses.non_maximum_suppression import choose_apart


@pytest.mark.parametrize(("radius", "count"), [(0.2, 1000), (0.2, 5), (0.0, 1000), (9.0, 1000)])
def test_the_choice_equals_a_plain_search(radius, count):
    points = np.random.default_rng(3).uniform(size=(300, 3))
    expected: list[int] = []
    for k, point in enumerate(points):
        if len(expected) < count and all(np.linalg.norm(point - points[n]) > radius for n in expected):
            expected.append(k)
    assert choose_apart(points, radius, count).tolist() == expected


def test_equal_points_are_chosen_once():
    assert choose_apart(np.zeros((4, 2)), 0.0, 9).tolist() == [0]


def test_no_points_give_no_choice():
    assert choose_apart(np.zeros((0, 12)), 1.0, 5).tolist() == []
