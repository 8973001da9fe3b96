"""The job that evaluates one combination of a sweep."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.evaluation.metrics import LEVELS, PosteriorSummary
from tactile_loc.evaluation.protocol import LINES, STAGES, Evaluation, evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.store import StageStore
from tactile_loc.sweeps.combination import describe_components, make_combination_key

ERRORS = tuple(f"{line}_{what}" for line in LINES for what in ("median_mm", "mean_mm", "median_share"))
COVERAGES = tuple(f"coverage_{100 * level:.0f}" for level in LEVELS)
TIMES = (*(f"{stage}_ms" for stage in STAGES), "total_ms")


@dataclass(frozen=True)
class CombinationJob:
    """A combination for a worker, evaluated on `count` touches."""

    key: str
    config: RunConfig
    count: int
    store: Path

    def measure(self, obj: ObjectModel, store: StageStore) -> dict[str, Any]:
        """Return the summary of the evaluation. Raises ConfigError if this machine has other software or files."""
        config = self.config
        if make_combination_key(config, obj, self.count, describe_components(config)) != self.key:
            raise ConfigError(
                "the worker's tactile-loc, plugins or sensor file differ from those of the machine that started the "
                "sweep; install the same versions there"
            )
        localizer = Localizer(config, obj, store)
        start_s = time.perf_counter()
        localizer.describe_scores()  # builds the grid and its shapes, and trains the encoder
        _ = localizer.probabilities.temperature_scaling
        model_s = time.perf_counter() - start_s if store.built else 0.0
        evaluation = evaluate(localizer, self.count, SimulatedTouches(config.touch.noise, config.seed, images=False))
        return {**summarise(evaluation, localizer.model.size), "model_s": round(model_s, 3)}


def summarise(evaluation: Evaluation, grid_poses: int) -> dict[str, float | None]:
    """Return ERRORS (mm, and shares of a random pose's mean error), COVERAGES, nll_nats and TIMES (medians, ms).

    Numbers have six digits. A number that is not finite becomes None, such as the likelihood if a matcher did not score
    the true pose.
    """
    errors = []
    for line in LINES:
        metres = evaluation.select_errors(line)
        errors += [1e3 * np.median(metres), 1e3 * metres.mean(), np.median(evaluation.normalise_errors(line))]
    posterior = PosteriorSummary.of(evaluation.posterior_metrics, grid_poses)
    times = 1e3 * np.median(evaluation.seconds, axis=0)
    values = {
        **dict(zip(ERRORS, errors, strict=True)),
        **dict(zip(COVERAGES, posterior.coverage, strict=True)), "nll_nats": posterior.nll,
        **dict(zip(TIMES, (*times, 1e3 * np.median(evaluation.seconds.sum(axis=1))), strict=True)),
    }  # fmt: skip
    rounded = {name: float(f"{value:.6g}") if np.isfinite(value) else None for name, value in values.items()}
    return {"grid_poses": grid_poses, **rounded}
