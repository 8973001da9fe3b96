"""Probabilities from scores, with parameters fitted to simulated touches of known pose.

A single temperature (Guo et al., ICML 2017) that suits most touches is overconfident for the few touches that resemble
another pose. So a share of the probability, the tail, is spread with a temperature TAIL_HEAT times as high.

The fitted temperature allows for the distance from the true pose to the nearest grid pose. Posteriors of several
touches have this error in common, but their product counts the error once per touch. So the product is overconfident,
increasingly with the number of touches; `FusedScaling` corrects this.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.noise import TouchNoise, make_noise

STAGE, STAGE_VERSION = "temperature", 3
TOUCHES, BATCH = 150, 25  # simulated touches in total, and at once
TOUCH_NOISE = make_noise("strong")  # real touches differ from renders at least as much
SEED = 0x5EED  # differs from the seeds of evaluations, which must not use the same touches

TAIL_HEAT = 4.0
TAILS = (0.05, 0.1, 0.2, 0.3, 0.4)  # smaller tails cannot be fitted to so few touches
STEPS_PER_E = 6  # temperatures tried per factor of e
REACH = 12  # factors of e tried below the highest temperature
LEAST = 1e-12  # least probability of a true pose in the fit, so that no single touch decides

FUSED_STAGE, FUSED_VERSION = "fused-temperature", 3
FUSED_TOUCHES = (2, 3, 5, 7)  # touches per example
FUSED_EXAMPLES, FUSED_SEED = 40, 0xF05ED  # for each number of touches
SEARCHED, SEARCHED_TOUCHES, SEARCHED_EXAMPLES = 45, (2, 3, 5), 15  # fewer touches to fit searches, which take longer
# The noise levels are used in turn, so that the fit covers touches explained well and badly. So do the presses.
SEARCHED_NOISE = tuple(replace(make_noise(level), press_share=(0.3, 1.0)) for level in ("none", "mild", "strong"))
MOST_ELSEWHERE = 0.999
AS_KNOWN = 3  # invented touches with score 0, and as many that are explained fully
EXPONENTS = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class FitPlan:
    """The simulated touches of a fit.

    There are `touches` single touches, shared equally among the levels of `noise`. For each number in `fused_touches`,
    there are `fused_examples` examples of that many touches. `misses` states whether the probability that the true pose
    is among none of the scored poses is fitted, too.
    """

    touches: int
    noise: tuple[TouchNoise, ...]
    fused_touches: tuple[int, ...]
    fused_examples: int
    misses: bool


def plan_listed_fit() -> FitPlan:
    """Return the plan for a listed grid."""
    return FitPlan(TOUCHES, (TOUCH_NOISE,), FUSED_TOUCHES, FUSED_EXAMPLES, misses=False)


def plan_search_fit() -> FitPlan:
    """Return the smaller plan for a search of the whole object, which takes longer and may miss the true pose."""
    return FitPlan(SEARCHED, SEARCHED_NOISE, SEARCHED_TOUCHES, SEARCHED_EXAMPLES, misses=True)


@dataclass(frozen=True)
class TemperatureScaling:
    """Scaling of scores s to probabilities: (1 - tail) softmax(s / T) + tail softmax(s / (TAIL_HEAT T)), all unitless.

    T is the `temperature`. A search scores only the likeliest poses, so it may miss the true pose, above all if no pose
    explains the touch well. The log odds that the search found the true pose are offset + slope * best score, with
    `found` = (offset, slope), after Platt (1999).
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
        """Return log-probabilities (..., N) of scores (..., N).

        A higher score means more similar. A score of -inf gives -inf.
        """
        from scipy.special import log_softmax  # scipy takes a while to import

        sharp = np.asarray(log_softmax(np.asarray(scores, np.float64) / self.temperature, axis=-1))
        if self.tail == 0:
            return sharp
        wide = log_softmax(np.asarray(scores, np.float64) / (TAIL_HEAT * self.temperature), axis=-1)
        return np.logaddexp(np.log1p(-self.tail) + sharp, np.log(self.tail) + wide)

    def posterior(self, grid: PoseGrid, scores: NDArray[np.floating]) -> PosePosterior:
        """Return the posterior over a grid of N poses from scores (N,). Raises GridError if all scores are -inf."""
        with np.errstate(invalid="ignore"):
            return PosePosterior(grid, self.log_p(scores), elsewhere=self.elsewhere(float(np.max(scores))))

    def elsewhere(self, best: float) -> float:
        """Return the probability that the true pose is near none of the scored poses; `best` is the highest score."""
        return _elsewhere(self.found, best)


def fit_temperature_scaling(
    scores: Sequence[NDArray[np.floating]], truth: NDArray[np.int64], misses: bool = False
) -> TemperatureScaling:
    """Return the scaling with the least negative log-likelihood of the true poses of T touches.

    `scores` has an array (N,) for each touch. `truth` (T,) are the indices of the poses nearest to the true poses, -1
    if none is near. With `misses`, the probability that the search misses the true pose is fitted, too.
    """
    odds = _fit_found(np.array([max(row) for row in scores]), truth >= 0) if misses else None
    spreads = np.array([np.ptp(row[np.isfinite(row)]) for row in (np.asarray(row, np.float64) for row in scores)])
    known = np.flatnonzero((truth >= 0) & (spreads > 0))
    if len(known) == 0:  # no true pose was found, or each alone, as for a sphere, so there is nothing to fit
        return TemperatureScaling(1.0, TAILS[-1], odds)
    rows, truth = [np.asarray(scores[int(number)], np.float64) for number in known], truth[known]
    hottest = np.log(np.median(spreads[known]))
    tried = [
        TemperatureScaling(float(np.exp(t)), tail, odds)
        for t in np.linspace(hottest - REACH, hottest, REACH * STEPS_PER_E + 1)
        for tail in TAILS
    ]
    losses = sum(_losses(row, int(index), tried) for row, index in zip(rows, truth, strict=True))
    return tried[int(np.argmin(losses))]


@dataclass(frozen=True)
class FusedScaling:
    """Tempering of a product of N touches' posteriors: the product is raised to the power N**-exponent.

    Exponent 0 keeps the product, as if the touches' errors were independent. Exponent 1 gives the geometric mean. For
    searches of a whole object, `found` is as in TemperatureScaling, with the sum of the best pose's imprint IoUs as the
    score. So the more touches a pose explains, the less well it has to explain each.
    """

    exponent: float = 0.0
    found: tuple[float, float] | None = None

    def power(self, touches: int) -> float:
        """Return the power, above 0 and at most 1, to which a product of this many touches' posteriors is raised."""
        return float(max(1, touches) ** -self.exponent)

    def elsewhere(self, best: float, touches: int) -> float:
        """Return the probability that the true pose is near no pose found; `best` is the best mean imprint IoU."""
        return _elsewhere(self.found, touches * best)


@dataclass(frozen=True)
class Scalings:
    """The scaling of each touch's scores, and the tempering of several touches, which need no fit."""

    temperature_scaling: TemperatureScaling
    fused_scaling: FusedScaling


class AnyScalings(Protocol):
    """`Scalings`, or `FittedProbabilities`, which are fitted when they are first used."""

    @property
    def temperature_scaling(self) -> TemperatureScaling:
        """The scaling of each touch's scores."""

    @property
    def fused_scaling(self) -> FusedScaling:
        """The tempering of several touches."""


class FusedExample(NamedTuple):
    """Several `touches` of known pose, fused.

    `log_p` (N,) are the log-probabilities of the product of posteriors. `truth` is the index of the pose nearest to the
    true pose; -1 if none is near. `best`, 0 to 1, is the best pose's mean imprint IoU.
    """

    touches: int
    log_p: NDArray[np.float64]
    truth: int
    best: float = 1.0


def fit_fused_scaling(fused: Sequence[FusedExample], misses: bool = False) -> FusedScaling:
    """Return the scaling with the least negative log-likelihood of the true poses of fused examples.

    With `misses`, the probability that the search misses the true pose is fitted, too.
    """
    known = np.array([example.truth >= 0 for example in fused], bool)
    found = None
    if misses:
        explained = np.array([example.touches * example.best for example in fused])
        found = _fit_found(explained, known, min((example.touches for example in fused), default=1))
    losses = np.zeros(len(EXPONENTS))
    for touches, log_p, truth, _ in (example for example in fused if example.truth >= 0):
        known = log_p[np.isfinite(log_p)]
        for k, exponent in enumerate(EXPONENTS):
            power = FusedScaling(exponent).power(touches)
            logits = power * known
            total = float(logits.max() + np.log(np.exp(logits - logits.max()).sum()))
            losses[k] -= max(power * log_p[truth] - total, np.log(LEAST))
    return FusedScaling(float(EXPONENTS[np.argmin(losses)]), found)


def batches(touches: int, levels: Sequence[TouchNoise]) -> Iterator[tuple[int, int, TouchNoise]]:
    """Yield the seed, the number of touches and the noise level of each batch to fit to.

    All noise levels have equally many touches.
    """
    share = -(-touches // len(levels))
    for number, level in enumerate(levels):
        for start in range(0, share, BATCH):
            yield SEED + number * share + start, min(BATCH, share - start), level


def describe_touches(touches: int, levels: Sequence[TouchNoise]) -> dict[str, Any]:
    """Return all inputs of a fit's touches except the sampler, as JSON values."""
    noise = [level.describe() for level in levels]
    return {"noise": noise, "touches": touches, "batch": BATCH, "seed": SEED}


def _losses(scores: NDArray[np.float64], index: int, tried: Sequence[TemperatureScaling]) -> NDArray[np.float64]:
    """Return the negative log-likelihood (K,), nats, of pose `index`, given scores (N,), with each of K scalings."""
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


def _fit_found(best: NDArray[np.float64], found: NDArray[np.bool_], perfect: float = 1.0) -> tuple[float, float]:
    """Fit the log odds of `found` (T,) by a line (offset, slope) over the best scores (T,).

    AS_KNOWN invented touches with score 0 count as not found. As many with the score `perfect` count as found. Without
    these touches, the slope would be unreliable if almost all or almost no real touches were found.
    """
    from scipy.optimize import minimize

    best = np.concatenate([best, np.repeat([0.0, perfect], AS_KNOWN)])
    found = np.concatenate([found, np.repeat([False, True], AS_KNOWN)])
    right, wrong = int(found.sum()), int((~found).sum())
    wanted = np.where(found, (right + 1) / (right + 2), 1 / (wrong + 2))

    def loss(line: NDArray[np.float64]) -> float:
        odds = line[0] + line[1] * best
        return float((np.logaddexp(0, odds) - wanted * odds).sum())

    offset, slope = minimize(loss, np.zeros(2)).x
    return float(offset), float(slope)
