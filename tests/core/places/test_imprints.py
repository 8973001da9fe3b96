"""Scores of poses for contacts of known size and depth."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.places.imprints import AREA_NATS, DEPTH_NATS, IOU_NATS, OUTLINE_SHARE, compare_imprints

PRESS_M, PITCH_M = 1e-3, 0.5e-3
OBSERVED = np.ones((20, 20), bool)


def imprint(columns: slice, indentation_m: float) -> np.ndarray:
    """Return contact depths with ten rows pressed in by a given depth."""
    depth_m = np.full((20, 20), PRESS_M, np.float32)
    depth_m[5:15, columns] = PRESS_M - indentation_m
    return depth_m


SEEN = imprint(slice(4, 14), 0.4e-3)


def test_the_same_contact_has_an_iou_of_one():
    found = compare_imprints(SEEN[None], SEEN, PRESS_M, OBSERVED, PITCH_M)
    assert found.contact_ious == found.imprint_ious == 1.0
    assert found.evidence[0] == pytest.approx(IOU_NATS + AREA_NATS * np.log1p(25.0))  # 100 pixels of 0.25 mm^2


def test_ious_and_depths_contribute_as_defined():
    half, shallow = imprint(slice(9, 19), 0.4e-3), imprint(slice(4, 14), 0.3e-3)
    found = compare_imprints(np.stack([half, shallow]), SEEN, PRESS_M, OBSERVED, PITCH_M)
    assert found.contact_ious == pytest.approx([1 / 3, 1.0])
    raised = OUTLINE_SHARE + np.array([0.3, 0.4])
    assert found.imprint_ious == pytest.approx([1 / 3, raised[0] / raised[1]], abs=1e-6)
    expected = IOU_NATS * found.imprint_ious + AREA_NATS * np.log1p([12.5, 25.0]) - DEPTH_NATS * np.array([0, 0.1])
    assert found.evidence == pytest.approx(expected, abs=1e-3)


def test_unobserved_pixels_are_ignored_and_no_contact_scores_zero():
    observed = OBSERVED.copy()
    observed[:, 14:] = False
    more = imprint(slice(4, 20), 0.4e-3)
    assert compare_imprints(more[None], SEEN, PRESS_M, observed, PITCH_M).imprint_ious == 1.0
    none = compare_imprints(np.full((1, 20, 20), PRESS_M, np.float32), SEEN, PRESS_M, OBSERVED, PITCH_M)
    assert (none.contact_ious, none.imprint_ious, none.evidence) == (0.0, 0.0, 0.0)
    empty = compare_imprints(np.empty((0, 20, 20), np.float32), SEEN, PRESS_M, OBSERVED, PITCH_M)
    assert all(values.shape == (0,) for values in empty)
