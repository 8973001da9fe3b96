"""Numbers beside points."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.sweeps.labels import DIGIT, LINE, in_ranges, place_labels


@pytest.mark.parametrize(
    ("numbers", "text"), [([3], "3"), ([2, 1], "1, 2"), ([5, 3, 4, 9], "3-5, 9"), ([1, 3], "1, 3")]
)
def test_numbers_are_written_in_ranges(numbers, text):
    assert in_ranges(numbers) == text


def test_points_that_coincide_share_a_label():
    labels = place_labels(np.array([[0, 0], [200, 5], [1.0, 1.0]]), [4, 5, 6])
    assert [(one.text, one.members) for one in labels] == [("4, 6", (0, 2)), ("5", (1,))]


def test_labels_do_not_cover_one_another():
    places = np.array([[10.0 * i, 0.0] for i in range(4)])
    boxes = []
    for label in place_labels(places, [11, 12, 13, 14]):
        dx, dy = label.offset_pt
        width = DIGIT * len(label.text)
        left = {"left": 0.0, "right": -width, "center": -width / 2}[label.alignment]
        boxes.append(places[label.members[0]] + [dx + left, dy])
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            assert abs(a[0] - b[0]) >= 2 * DIGIT or abs(a[1] - b[1]) >= LINE
