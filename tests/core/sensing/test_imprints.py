"""Scores of poses, and what they leave unexplained, for contacts of known size and depth."""

import numpy as np
import pytest

from tactile_loc.core.sensing.imprints import (
    AREA_NATS,
    DEPTH_NATS,
    FAR_OFF_M,
    IOU_NATS,
    OUTLINE_SHARE,
    compare_imprints,
    measure_residuals,
)

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


def leave(*made: np.ndarray, observed: np.ndarray = OBSERVED, seen: np.ndarray = SEEN) -> dict[str, np.ndarray]:
    """Return the residuals of contact depths by their names."""
    return measure_residuals(np.stack(made), seen, PRESS_M, observed, PITCH_M)._asdict()


def test_the_touch_itself_leaves_nothing_unexplained():
    left = leave(SEEN)
    assert left.pop("imprint_ious") == 1.0
    assert all(value == 0.0 for value in left.values())


@pytest.mark.parametrize("columns", [1, 4, 10])
def test_a_shifted_block_misses_and_adds_a_strip_on_either_side(columns):
    shifted = imprint(slice(4 + columns, 14 + columns), 0.4e-3) if columns < 10 else imprint(slice(14, 20), 0.4e-3)
    left = leave(shifted)
    added = columns if columns < 10 else 6
    assert left["missing"] == pytest.approx(columns / 10)
    assert left["extra"] == pytest.approx(added / 10)
    # two of the four sides moved by the shift, the others not at all
    assert left["outline_m"] == pytest.approx((columns + added) / 4 * PITCH_M)
    assert left["press_m"] == left["relief_m"] == left["slope"] == 0.0
    found = compare_imprints(shifted[None], SEEN, PRESS_M, OBSERVED, PITCH_M)
    assert left["imprint_ious"] == pytest.approx(found.imprint_ious)


def test_a_deeper_touch_leaves_a_press_and_a_tilted_one_a_relief_and_a_slope():
    step_m, ramp = 2e-5, np.arange(20, dtype=np.float32) - 8.5  # the middle of the block
    tilted = np.where(SEEN < PRESS_M, SEEN + step_m * ramp, PRESS_M).astype(np.float32)
    deeper, lighter, far = (imprint(slice(4, 14), indentation_m) for indentation_m in (0.5e-3, 0.3e-3, 0.95e-3))
    left = leave(deeper, lighter, far, tilted)
    assert left["press_m"] == pytest.approx([-1e-4, 1e-4, -FAR_OFF_M, 0], abs=1e-9)
    assert left["relief_m"] == pytest.approx([0, 0, 0, step_m * np.sqrt((10**2 - 1) / 12)], abs=1e-7)
    # half of the steps are along the rows, which have the slope
    assert left["slope"] == pytest.approx([0, 0, 0, step_m / PITCH_M * np.sqrt(0.5)], abs=2e-4)
    assert left["missing"].tolist() == left["extra"].tolist() == left["outline_m"].tolist() == [0.0] * 4


def test_only_observed_contact_leaves_something_unexplained():
    observed = OBSERVED.copy()
    observed[:, 9:] = False
    half, none = imprint(slice(4, 9), 0.4e-3), np.full((20, 20), PRESS_M, np.float32)
    left = leave(half, none, observed=observed)
    assert left["missing"].tolist() == [0.0, 1.0]
    assert left["extra"].tolist() == [0.0, 0.0]
    assert left["outline_m"] == pytest.approx([0.0, 50 / 20 * PITCH_M])  # the side beyond is not observed
    assert leave(half, none)["missing"].tolist() == [0.5, 1.0]
    assert all(
        value.shape == (0,)
        for value in measure_residuals(np.empty((0, 20, 20), np.float32), SEEN, PRESS_M, OBSERVED, PITCH_M)
    )
