"""Probabilities of a grid's poses from their scores: a softmax with a temperature.

A single temperature (Guo et al., ICML 2017) that suits most touches is overconfident for the few touches that resemble
another pose. So a share of the probability, the tail, is spread with a temperature TAIL_HEAT times as high.

The temperature allows for the distance from the true pose to the nearest grid pose. Posteriors of several touches have
this error in common, but their product counts the error once per touch. So the product of N posteriors is raised to the
power N**-SHARED. The poses that are found are compared with the touches in another way: see `evidence`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Ints
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.noise import make_noise

STAGE, STAGE_VERSION = "temperature", 4
TOUCHES, BATCH = 150, 25  # simulated touches of a fit in total, and at once
TOUCH_NOISE = make_noise("strong")  # real touches differ from renders at least as much
SEED = 0x5EED  # differs from the seeds of evaluations, which must not use the same touches

TAIL_HEAT = 4.0
TAILS = (0.05, 0.1, 0.2, 0.3, 0.4)  # smaller tails cannot be fitted to so few touches
STEPS_PER_E = 6  # temperatures tried per factor of e
REACH = 12  # factors of e tried below the highest temperature
LEAST = 1e-12  # least probability of a true pose in the fit, so that no single touch decides
SHARED = 0.4  # the median of 82 fits to various objects and sensors; 0 would take the errors as independent


@dataclass(frozen=True)
class TemperatureScaling:
    """Scaling of scores s to probabilities: (1 - tail) softmax(s / T) + tail softmax(s / (TAIL_HEAT T)), all unitless.

    T is the `temperature`. Raises ConfigError if it is not positive, or if the tail is not a share.
    """

    temperature: float
    tail: float = 0.0

    def __post_init__(self) -> None:
        if not (self.temperature > 0 and np.isfinite(self.temperature) and 0 <= self.tail < 1):
            raise ConfigError(
                f"temperature {self.temperature} and tail {self.tail} give no probabilities; the temperature must be "
                "above 0, and the tail at least 0 and below 1"
            )

    def log_p(self, scores: NDArray[np.floating]) -> Floats:
        """Return log-probabilities (..., N) of scores (..., N).

        A higher score means more similar. A score of -inf gives -inf.
        """
        sharp = _log_softmax(np.asarray(scores, np.float64) / self.temperature)
        if self.tail == 0:
            return sharp
        wide = _log_softmax(np.asarray(scores, np.float64) / (TAIL_HEAT * self.temperature))
        return np.logaddexp(np.log1p(-self.tail) + sharp, np.log(self.tail) + wide)

    def posterior(self, grid: PoseGrid, scores: NDArray[np.floating]) -> PosePosterior:
        """Return the posterior over a grid of N poses from scores (N,). Raises GridError if all scores are -inf."""
        with np.errstate(invalid="ignore"):
            return PosePosterior(grid, self.log_p(scores))


SEARCHED = TemperatureScaling(0.021, 0.4)  # of imprint IoUs: the median of 60 fits to various objects and sensors


def fit_temperature_scaling(scores: Sequence[NDArray[np.floating]], truth: Ints) -> TemperatureScaling:
    """Return the scaling with the least negative log-likelihood of the true poses of T touches.

    `scores` has an array (N,) for each touch. `truth` (T,) are the indices of the poses nearest to the true poses.
    """
    spreads = np.array([np.ptp(row[np.isfinite(row)]) for row in (np.asarray(row, np.float64) for row in scores)])
    known = np.flatnonzero(spreads > 0)
    if len(known) == 0:  # all poses are alike, as for a sphere, so there is nothing to fit
        return TemperatureScaling(1.0, TAILS[-1])
    rows, truth = [np.asarray(scores[int(number)], np.float64) for number in known], truth[known]
    hottest = np.log(np.median(spreads[known]))
    tried = [
        TemperatureScaling(float(np.exp(t)), tail)
        for t in np.linspace(hottest - REACH, hottest, REACH * STEPS_PER_E + 1)
        for tail in TAILS
    ]
    losses = sum(_losses(row, int(index), tried) for row, index in zip(rows, truth, strict=True))
    return tried[int(np.argmin(losses))]


def list_batches() -> Iterator[tuple[int, int]]:
    """Yield the seed and the number of touches of each batch to fit to."""
    for start in range(0, TOUCHES, BATCH):
        yield SEED + start, min(BATCH, TOUCHES - start)


def _losses(scores: Floats, index: int, tried: Sequence[TemperatureScaling]) -> Floats:
    """Return the negative log-likelihood (K,), nats, of pose `index`, given scores (N,), with each of K scalings."""
    temperatures = sorted({c.temperature for c in tried} | {TAIL_HEAT * c.temperature for c in tried})
    above = scores - scores.max()
    p = {t: np.exp(above[index] / t) / np.exp(above / t).sum() for t in temperatures}
    mixed = np.array([(1 - c.tail) * p[c.temperature] + c.tail * p[TAIL_HEAT * c.temperature] for c in tried])
    return -np.log(np.maximum(mixed, LEAST))


def _log_softmax(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithms of the softmax (..., N) of x (..., N). scipy's function would take a while to import."""
    below = x - x.max(axis=-1, keepdims=True)
    return np.asarray(below - np.log(np.exp(below).sum(axis=-1, keepdims=True)))
