"""What is measured of an evaluation, as the columns of one row."""

from __future__ import annotations

import numpy as np

from tactile_loc.evaluation.posterior_metrics import LEVELS, PosteriorSummary
from tactile_loc.evaluation.protocol import LINES, STAGES, Evaluation

ERRORS = tuple(f"{line}_{what}" for line in LINES for what in ("median_mm", "mean_mm", "median_share"))
TRUST = (*(f"coverage_{100 * level:.0f}" for level in LEVELS), "nll_nats")
TIMES = (*(f"{stage}_ms" for stage in STAGES), "total_ms")


def measures(evaluation: Evaluation, grid_poses: int) -> dict[str, float | None]:
    """Return ERRORS (mm, and shares of a random pose's mean), TRUST and TIMES (medians, ms), to six digits.

    None stands for what is not finite: the likelihood where a matcher did not look at the true pose.
    """
    errors = []
    for line in LINES:
        metres = evaluation.errors(line)
        shares = evaluation.normalised(line)
        errors += [1e3 * np.median(metres), 1e3 * metres.mean(), np.median(shares)]
    trust = PosteriorSummary.of(evaluation.posterior_metrics, grid_poses)
    times = 1e3 * np.median(evaluation.seconds, axis=0)
    values = {
        **dict(zip(ERRORS, errors, strict=True)),
        **dict(zip(TRUST, (*trust.coverage, trust.nll), strict=True)),
        **dict(zip(TIMES, (*times, 1e3 * np.median(evaluation.seconds.sum(axis=1))), strict=True)),
    }
    rounded = {name: float(f"{value:.6g}") if np.isfinite(value) else None for name, value in values.items()}
    return {"grid_poses": grid_poses, **rounded}
