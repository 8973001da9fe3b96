"""Probabilities from scores, with parameters fitted to simulated touches of known pose.

A single temperature (Guo et al., ICML 2017) that suits most touches is overconfident for the few that resemble another
pose. So a share of the probability, the tail, is spread with a temperature TAIL_HEAT times as high.

Such a posterior accounts for the distance from the true pose to the nearest grid pose. A product of several posteriors
counts this common error several times. So it is overconfident, increasingly with the number of touches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.simulation.noise import make_noise

STAGE, STAGE_VERSION = "temperature", 2
TOUCHES, BATCH = 150, 25  # simulated
TOUCH_NOISE = "strong"  # real touches differ from renders at least as much
SEED = 0x5EED  # differs from those of evaluations, which must not use the same touches

TAIL_HEAT = 4.0
TAILS = (0.05, 0.1, 0.2, 0.3, 0.4)  # not less: too few touches for rarer errors
STEPS_PER_E = 6  # temperatures tried per factor of e
REACH = 12  # factors of e tried below the highest temperature
LEAST = 1e-12  # probability of the truth, so that one touch does not decide alone

FUSED_STAGE, FUSED_VERSION = "fused-temperature", 2
FUSED_TOUCHES = (2, 3, 5, 7)  # touches per example
FUSED_EXAMPLES, FUSED_SEED = 40, 0xF05ED  # for each number of touches
SEARCHED, SEARCHED_TOUCHES, SEARCHED_EXAMPLES = 45, (2, 3, 5), 15  # fewer, because a search takes longer
SEARCHED_NOISE = ("none", "mild", "strong")  # used in turn, so that the fit covers touches explained well and badly
MOST_ELSEWHERE = 0.999
AS_KNOWN = 3  # pretended touches with score 0, and as many with score 1
EXPONENTS = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class FitPlan:
    """The simulated touches to fit to: `touches` with the `noise` levels in turn, and `fused_examples` of touches
    together for each number in `fused_touches`."""

    touches: int
    noise: tuple[str, ...]
    fused_touches: tuple[int, ...]
    fused_examples: int


def plan_fit(searched: bool) -> FitPlan:
    """Return the plan for a listed grid, or a smaller one if the whole object is `searched`."""
    if searched:
        return FitPlan(SEARCHED, SEARCHED_NOISE, SEARCHED_TOUCHES, SEARCHED_EXAMPLES)
    return FitPlan(TOUCHES, (TOUCH_NOISE,), FUSED_TOUCHES, FUSED_EXAMPLES)


@dataclass(frozen=True)
class TemperatureScaling:
    """How scores become probabilities: (1 - tail) softmax(s / T) + tail softmax(s / (TAIL_HEAT T)), all unitless.

    For a search that scores only the likeliest poses, the log odds that the true pose is among them are linear in the
    best score: `found` (offset, slope), after Platt (1999). If no pose explains a touch well, its true pose was
    probably not found.
    """

    temperature: float
    tail: float = 0.0
    found: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not (self.temperature > 0 and np.isfinite(self.temperature) and 0 <= self.tail < 1):
            raise ConfigError(
                f"temperature {self.temperature} and tail {self.tail} give no probabilities; the temperature must be "
                "above 0, and the tail at least 0 and below 1"
            )

    def log_p(self, scores: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return log-probabilities (..., N) of scores (..., N), higher is more similar; -inf stays -inf."""
        from scipy.special import log_softmax  # scipy takes a while to import

        sharp = np.asarray(log_softmax(np.asarray(scores, np.float64) / self.temperature, axis=-1))
        if self.tail == 0:
            return sharp
        wide = log_softmax(np.asarray(scores, np.float64) / (TAIL_HEAT * self.temperature), axis=-1)
        return np.logaddexp(np.log1p(-self.tail) + sharp, np.log(self.tail) + wide)

    def posterior(self, grid: PoseGrid, scores: NDArray[np.floating]) -> PosePosterior:
        """Return the posterior over a grid of N poses from scores (N,). Raises GridError when all are -inf."""
        with np.errstate(invalid="ignore"):
            return PosePosterior(grid, self.log_p(scores), elsewhere=self.elsewhere(float(np.max(scores))))

    def elsewhere(self, best: float) -> float:
        """Return the probability that the true pose is near none of the scored poses; `best` is their best score."""
        return _elsewhere(self.found, best)


def fit_temperature_scaling(
    scores: Sequence[NDArray[np.floating]], truth: NDArray[np.int64], searched: bool = False
) -> TemperatureScaling:
    """Return the scaling that makes the true poses most probable, with the least mean negative log-likelihood.

    `scores` holds (N,) for each of T touches. `truth` (T,) are the indices of the poses nearest to the true ones, -1 if
    none is near. With `searched`, the probability that none is near is fitted too.
    """
    known = np.flatnonzero(truth >= 0)
    odds = _fit_found(np.array([max(row) for row in scores]), truth >= 0) if searched else None
    if len(known) == 0:
        return TemperatureScaling(1.0, TAILS[-1], odds)  # the scores do not discriminate between poses
    rows, truth = [np.asarray(scores[int(number)], np.float64) for number in known], truth[known]
    spread = float(np.median([np.ptp(row[np.isfinite(row)]) for row in rows]))
    hottest = np.log(max(spread, np.finfo(float).tiny))
    tried = [
        TemperatureScaling(float(np.exp(t)), tail, odds)
        for t in np.linspace(hottest - REACH, hottest, REACH * STEPS_PER_E + 1)
        for tail in TAILS
    ]
    losses = sum(_losses(row, int(index), tried) for row, index in zip(rows, truth, strict=True))
    return tried[int(np.argmin(losses))]


@dataclass(frozen=True)
class FusedScaling:
    """Tempering of a product of N touches' posteriors: it is raised to the power N**-exponent.

    Exponent 0 keeps the product, as if the touches' errors were independent; 1 gives the geometric mean. For touches
    of a whole object, `found` is as in TemperatureScaling, with the best pose's mean imprint IoU as the score.
    """

    exponent: float = 0.0
    found: tuple[float, float] | None = None

    def power(self, touches: int) -> float:
        """Return the power to which a product of this many touches' probabilities is raised, above 0, at most 1."""
        return float(max(1, touches) ** -self.exponent)

    def elsewhere(self, best: float) -> float:
        """Return the probability that the true pose is near no pose found; `best` is the best mean imprint IoU."""
        return _elsewhere(self.found, best)


class FusedExample(NamedTuple):
    """Several `touches` of known pose: the log-probabilities (N,) of their product, the index of the pose nearest to
    the truth (-1 if none is near), and the best pose's mean imprint IoU, 0 to 1."""

    touches: int
    log_p: NDArray[np.float64]
    truth: int
    best: float = 1.0


def fit_fused_scaling(fused: Sequence[FusedExample], searched: bool = False) -> FusedScaling:
    """Return the scaling that makes the true poses of fused examples most probable, by least negative log-likelihood.

    With `searched`, the probability that no pose is near the true one is fitted too.
    """
    known = np.array([example.truth >= 0 for example in fused], bool)
    found = _fit_found(np.array([example.best for example in fused]), known) if searched else None
    losses = np.zeros(len(EXPONENTS))
    for touches, log_p, truth, _ in (example for example in fused if example.truth >= 0):
        known = log_p[np.isfinite(log_p)]
        for k, exponent in enumerate(EXPONENTS):
            power = FusedScaling(exponent).power(touches)
            logits = power * known
            total = float(logits.max() + np.log(np.exp(logits - logits.max()).sum()))
            losses[k] -= max(power * log_p[truth] - total, np.log(LEAST))
    return FusedScaling(float(EXPONENTS[np.argmin(losses)]), found)


def batches(touches: int, levels: Sequence[str]) -> Iterator[tuple[int, int, str]]:
    """Yield seed, number and noise level of each batch of touches to fit to; all levels get equal shares."""
    share = -(-touches // len(levels))
    for number, level in enumerate(levels):
        for start in range(0, share, BATCH):
            yield SEED + number * share + start, min(BATCH, share - start), level


def describe_touches(touches: int = TOUCHES, levels: Sequence[str] = (TOUCH_NOISE,)) -> dict[str, Any]:
    """Return everything except the sampler that determines the touches of a fit, as JSON values."""
    noise = [make_noise(level).describe() for level in levels]
    return {"noise": noise, "touches": touches, "batch": BATCH, "seed": SEED}


def _losses(scores: NDArray[np.float64], index: int, tried: Sequence[TemperatureScaling]) -> NDArray[np.float64]:
    """Return the negative log-likelihood (K,), nats, of pose `index` of scores (N,) with each scaling."""
    temperatures = sorted({c.temperature for c in tried} | {TAIL_HEAT * c.temperature for c in tried})
    above = scores - scores.max()
    p = {t: np.exp(above[index] / t) / np.exp(above / t).sum() for t in temperatures}
    mixed = np.array([(1 - c.tail) * p[c.temperature] + c.tail * p[TAIL_HEAT * c.temperature] for c in tried])
    return -np.log(np.maximum(mixed, LEAST))


def _elsewhere(found: tuple[float, float] | None, best: float) -> float:
    if found is None:
        return 0.0
    offset, slope = found
    return float(min(1 / (1 + np.exp(offset + slope * best)), MOST_ELSEWHERE))


def _fit_found(best: NDArray[np.float64], found: NDArray[np.bool_]) -> tuple[float, float]:
    """Fit the line (offset, slope) of the log odds of `found` (T,) over the best scores (T,), 0 to 1.

    AS_KNOWN pretended touches with score 0 were not found, and as many with score 1 were: few real touches of either
    kind determine the slope poorly.
    """
    from scipy.optimize import minimize

    best = np.concatenate([best, np.repeat([0.0, 1.0], AS_KNOWN)])
    found = np.concatenate([found, np.repeat([False, True], AS_KNOWN)])
    right, wrong = int(found.sum()), int((~found).sum())
    wanted = np.where(found, (right + 1) / (right + 2), 1 / (wrong + 2))

    def loss(line: NDArray[np.float64]) -> float:
        odds = line[0] + line[1] * best
        return float((np.logaddexp(0, odds) - wanted * odds).sum())

    offset, slope = minimize(loss, np.zeros(2)).x
    return float(offset), float(slope)
