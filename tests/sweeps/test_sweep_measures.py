"""What is measured of an evaluation whose numbers are known."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.evaluation.posterior_metrics import POSTERIOR_METRICS
from tactile_loc.evaluation.protocol import LINES, METRICS, STAGES, Evaluation
from tactile_loc.sweeps.measures import ERRORS, TIMES, TRUST, measures


def evaluation(**posterior_metrics: float) -> Evaluation:
    """Three touches: line l is l + 1 mm off, twice and four times as much; random poses 20 mm on average."""
    errors_m = 1e-3 * np.arange(1, len(LINES) + 1)[None, :, None] * np.array([1, 2, 4])[:, None, None]
    errors_m = np.repeat(errors_m, len(METRICS), axis=2)
    errors_m[:, LINES.index("random")] = np.array([10e-3, 20e-3, 30e-3])[:, None]
    seconds = np.array([[1, 2, 3, 4], [1, 2, 3, 40], [9, 2, 3, 5]]) * 1e-3
    rows = [[posterior_metrics.get(name, 0.4) for name in POSTERIOR_METRICS]] * 3
    return Evaluation(errors_m, np.zeros((3, len(LINES), 4, 4)), seconds, np.array(rows))


def test_errors_in_mm_and_as_shares_and_times_in_ms():
    found = measures(evaluation(), 7)
    assert set(found) == {"grid_poses", *ERRORS, *TRUST, *TIMES}
    line = LINES.index("reg-1") + 1
    assert found["reg-1_median_mm"] == pytest.approx(2 * line)
    assert found["reg-1_mean_mm"] == pytest.approx(7 / 3 * line, rel=1e-5)
    assert found["reg-1_median_share"] == pytest.approx(2 * line / 20)
    assert (found["random_median_mm"], found["random_mean_mm"]) == (20, 20)
    assert [found[f"{stage}_ms"] for stage in STAGES] == [1, 2, 3, 5]
    assert found["total_ms"] == 19  # the median of 10, 46 and 19, not the sum of medians
    assert [found[f"coverage_{level}"] for level in (50, 80, 95)] == [1, 1, 1]
    assert (found["nll_nats"], found["grid_poses"]) == (0.4, 7)


def test_what_is_not_finite_has_no_value():
    found = measures(evaluation(nll=np.inf, level=0.9), 7)
    assert found["nll_nats"] is None
    assert [found[f"coverage_{level}"] for level in (50, 80, 95)] == [0, 0, 1]
