"""From scores to probabilities that can be trusted: fitted to simulated touches whose pose is known.

A temperature alone (Guo et al., ICML 2017) that is right for most touches is too sure of the few that look like
another pose: their truth lies where it leaves nothing. So a share of the probability is spread TAIL_HEAT times as wide.

Such a posterior regards how far the grid's nearest pose is off the truth. A product of several regards it several
times, though it is the same pose that is off for all: what is fused is too sure, the more the more touches there are.
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
TOUCHES, BATCH = 150, 25  # simulated, of known pose
TOUCH_NOISE = "strong"  # real touches are as far from renders as that, at least
SEED = 0x5EED  # no evaluation's: its touches must not be those that were fitted

TAIL_HEAT = 4.0
TAILS = (0.05, 0.1, 0.2, 0.3, 0.4)  # no less: a hundred touches cannot exclude what one in twenty does
STEPS_PER_E = 6  # temperatures tried for each factor of e
REACH = 12  # factors of e below the widest temperature that are tried
LEAST = 1e-12  # probability of the truth, lest one touch decide alone

FUSED_STAGE, FUSED_VERSION = "fused-temperature", 2
FUSED_TOUCHES = (2, 3, 5, 7)  # of the examples that are fitted to
FUSED_EXAMPLES, FUSED_SEED = 40, 0xF05ED  # of each number of touches
SEARCHED, SEARCHED_TOUCHES, SEARCHED_EXAMPLES = 45, (2, 3, 5), 15  # of a whole object, which takes longer
SEARCHED_NOISE = ("none", "mild", "strong")  # in turn: how well a touch is explained says how far it is to be trusted
MOST_ELSEWHERE = 0.999
AS_KNOWN = 3  # touches that are explained not at all, and fully, as if they were seen
EXPONENTS = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class FitPlan:
    """What probabilities are fitted to: so many simulated `touches` of the `noise` levels in turn, and, for each of
    `fused_touches`, `fused_examples` of so many touches together."""

    touches: int
    noise: tuple[str, ...]
    fused_touches: tuple[int, ...]
    fused_examples: int


def plan_fit(searched: bool) -> FitPlan:
    """Return the plan for a listed grid, or for a whole object that is `searched`, which takes longer."""
    if searched:
        return FitPlan(SEARCHED, SEARCHED_NOISE, SEARCHED_TOUCHES, SEARCHED_EXAMPLES)
    return FitPlan(TOUCHES, (TOUCH_NOISE,), FUSED_TOUCHES, FUSED_EXAMPLES)


@dataclass(frozen=True)
class TemperatureScaling:
    """How scores become probabilities: (1 - tail) softmax(s / T) + tail softmax(s / (TAIL_HEAT T)), all unitless.

    Of a search that looks at the likeliest poses alone, the log odds that the true one is among them are a line in the
    best one's score: `found` (offset, slope), after Platt (1999). A touch that nothing explains well was not found.
    """

    temperature: float
    tail: float = 0.0
    found: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not (self.temperature > 0 and np.isfinite(self.temperature) and 0 <= self.tail < 1):
            raise ConfigError(
                f"temperature {self.temperature} and tail {self.tail} give no probabilities; the first must be "
                "positive, the second from 0 to below 1"
            )

    def log_p(self, scores: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return log-probabilities (..., N) of scores (..., N), higher is more alike; -inf stays -inf."""
        sharp = _log_softmax(np.asarray(scores, np.float64) / self.temperature)
        if self.tail == 0:
            return sharp
        wide = _log_softmax(np.asarray(scores, np.float64) / (TAIL_HEAT * self.temperature))
        return np.logaddexp(np.log1p(-self.tail) + sharp, np.log(self.tail) + wide)

    def posterior(self, grid: PoseGrid, scores: NDArray[np.floating]) -> PosePosterior:
        """Return the posterior over a grid of N poses of scores (N,). Raises GridError when all are -inf."""
        with np.errstate(invalid="ignore"):
            return PosePosterior(grid, self.log_p(scores), elsewhere=self.elsewhere(float(np.max(scores))))

    def elsewhere(self, best: float) -> float:
        """Return the probability that the true pose is near none of those that were scored, the `best` one so well."""
        return _elsewhere(self.found, best)


def fit_temperature_scaling(
    scores: Sequence[NDArray[np.floating]], truth: NDArray[np.int64], searched: bool = False
) -> TemperatureScaling:
    """Return the scaling that makes the true poses most probable: least mean negative log-likelihood.

    `scores` holds (N,) for each of T touches, `truth` (T,) the index of the pose nearest to the true one, -1 where none
    of them is, which is learned for poses that were `searched`.
    """
    known = np.flatnonzero(truth >= 0)
    odds = _fit_found(np.array([max(row) for row in scores]), truth >= 0) if searched else None
    if len(known) == 0:
        return TemperatureScaling(1.0, TAILS[-1], odds)  # nothing is told apart
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
    """How sure a product of N touches' posteriors is to be: as sure as its N**-exponent-th power.

    0: as sure as the product, as if nothing were common to the touches' errors; 1: as their geometric mean. Of touches
    of a whole object `found` is as TemperatureScaling's, in what the best pose explains of all touches on the mean.
    """

    exponent: float = 0.0
    found: tuple[float, float] | None = None

    def power(self, touches: int) -> float:
        """Return the power to which a product of so many touches' probabilities is raised, above 0, at most 1."""
        return float(max(1, touches) ** -self.exponent)

    def elsewhere(self, best: float) -> float:
        """Return the probability that the true pose is near none that was found, the `best` explaining so much."""
        return _elsewhere(self.found, best)


class FusedExample(NamedTuple):
    """What `touches` of known pose say: the log-probabilities (N,) of their product, the index of the pose nearest to
    the truth, -1 where none of them is, and what the best of them explains of the touches on the mean, 0 to 1."""

    touches: int
    log_p: NDArray[np.float64]
    truth: int
    best: float = 1.0


def fit_fused_scaling(fused: Sequence[FusedExample], searched: bool = False) -> FusedScaling:
    """Return the scaling that makes the true poses of fused examples most probable: least negative log-likelihood.

    Whether there is a true one among them is learned for poses that were `searched`.
    """
    known = np.array([example.truth >= 0 for example in fused], bool)
    found = _fit_found(np.array([example.best for example in fused]), known) if searched else None
    losses = np.zeros(len(EXPONENTS))
    for touches, log_p, truth, _ in (example for example in fused if example.truth >= 0):
        known = log_p[np.isfinite(log_p)]
        for k, exponent in enumerate(EXPONENTS):
            power = FusedScaling(exponent).power(touches)
            losses[k] -= max(power * log_p[truth] - _log_sum(power * known), np.log(LEAST))
    return FusedScaling(float(EXPONENTS[np.argmin(losses)]), found)


def batches(touches: int, levels: Sequence[str]) -> Iterator[tuple[int, int, str]]:
    """Yield seed, number and level of noise of the touches to fit to, batch by batch; of each level as many."""
    share = -(-touches // len(levels))
    for number, level in enumerate(levels):
        for start in range(0, share, BATCH):
            yield SEED + number * share + start, min(BATCH, share - start), level


def describe_touches(touches: int = TOUCHES, levels: Sequence[str] = (TOUCH_NOISE,)) -> dict[str, Any]:
    """Return what decides which touches are fitted to, but for what draws them, as JSON values."""
    noise = [make_noise(level).describe() for level in levels]
    return {"noise": noise, "touches": touches, "batch": BATCH, "seed": SEED}


def _losses(scores: NDArray[np.float64], index: int, tried: Sequence[TemperatureScaling]) -> NDArray[np.float64]:
    """Negative log-likelihood (K,) of pose `index` of scores (N,) with each scaling, nats."""
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
    """The line (offset, slope) of log odds over best scores (T,), 0 to 1, that fits which (T,) were found.

    What explains nothing counts as not found and what explains all as found, a few times each: few of either kind say
    little of the slope.
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


def _log_sum(logits: NDArray[np.float64]) -> float:
    peak = logits.max()
    return float(peak + np.log(np.exp(logits - peak).sum()))


def _log_softmax(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    above = logits - logits.max(axis=-1, keepdims=True)
    return np.asarray(above - np.log(np.exp(above).sum(axis=-1, keepdims=True)))
