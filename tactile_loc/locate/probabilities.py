"""How sure a match makes us: from scores to probabilities that can be trusted, fitted on simulated touches.

A temperature alone (Guo et al., ICML 2017) that is right for most touches is too sure of the few that look like
another pose: their truth lies where it leaves nothing. So a share of the probability is spread TAIL_HEAT times as wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.noise import noise
from tactile_loc.core.poses import PoseGrid
from tactile_loc.core.posterior import PosePosterior
from tactile_loc.core.sensing import Touch
from tactile_loc.store.keys import StageKey
from tactile_loc.store.workspace import Workspace

if TYPE_CHECKING:
    from tactile_loc.locate.localizer import Localizer

STAGE_VERSION = 2
FIT = "confidence"
TOUCHES, BATCH = 150, 25
NOISE = "strong"  # real touches are as far from renders as that, at least
SEED = 0x5EED  # no evaluation's: its touches must not be those that were fitted

TAIL_HEAT = 4.0
TAILS = (0.05, 0.1, 0.2, 0.3, 0.4)  # no less: a hundred touches cannot exclude what one in twenty does
STEPS_PER_E = 6  # temperatures tried for each factor of e
REACH = 12  # factors of e below the widest temperature that are tried
LEAST = 1e-12  # probability of the truth, lest one touch decide alone


@dataclass(frozen=True)
class Confidence:
    """How scores become probabilities: (1 - tail) softmax(s / T) + tail softmax(s / (TAIL_HEAT T)), all unitless."""

    temperature: float
    tail: float = 0.0

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
            return PosePosterior(grid, self.log_p(scores))


def fit_confidence(scores: Sequence[NDArray[np.floating]], truth: NDArray[np.int64]) -> Confidence:
    """Return the confidence that makes the true poses most probable: least mean negative log-likelihood.

    `scores` holds (N,) for each of T touches, `truth` (T,) the index of the pose nearest to the true one.
    """
    rows = [np.asarray(row, np.float64) for row in scores]
    spread = float(np.median([np.ptp(row[np.isfinite(row)]) for row in rows]))
    hottest = np.log(max(spread, np.finfo(float).tiny))
    tried = [
        Confidence(float(np.exp(t)), tail)
        for t in np.linspace(hottest - REACH, hottest, REACH * STEPS_PER_E + 1)
        for tail in TAILS
    ]
    losses = sum(_losses(row, int(index), tried) for row, index in zip(rows, truth, strict=True))
    return tried[int(np.argmin(losses))]


def learn_confidence(localizer: Localizer) -> Confidence:
    """Fit the confidence to TOUCHES simulated touches of a localizer's object, or find what was: a stage of its store.

    Raises TouchError or GridError when no touch of the object can be simulated.
    """

    def learn(work: Workspace) -> None:
        exact = localizer.with_matcher("dense")
        scores: list[NDArray[np.float32]] = []
        truth: list[int] = []
        with localizer.progress.task("learning how sure to be", TOUCHES) as advance:
            for start in range(0, TOUCHES, BATCH):
                for touch in localizer.simulate(min(BATCH, TOUCHES - start), SEED + start, noise=NOISE):
                    scores.append(exact.scores(touch))
                    truth.append(_nearest(localizer.model.grid, touch))
                    advance(1)
        work.save_json(FIT, asdict(fit_confidence(scores, np.array(truth))))

    return Confidence(**localizer.store.build(confidence_key(localizer), learn).json(FIT))


def confidence_key(localizer: Localizer) -> StageKey:
    """Return the key under which a localizer's confidence is stored: everything that decides it."""
    return StageKey(FIT, STAGE_VERSION, {
        **localizer.describe_scores(), "sampler": localizer.sampler.describe(),
        "noise": noise(NOISE).describe(), "touches": TOUCHES, "batch": BATCH, "seed": SEED,
    })  # fmt: skip


def _nearest(grid: PoseGrid, touch: Touch) -> int:
    """The index of the pose nearest to a simulated touch's true one."""
    return int(grid.nearest(np.asarray(touch.T_sensor_object)[None])[1][0])


def _losses(scores: NDArray[np.float64], index: int, tried: Sequence[Confidence]) -> NDArray[np.float64]:
    """Negative log-likelihood (K,) of pose `index` of scores (N,) with each confidence, nats."""
    temperatures = sorted({c.temperature for c in tried} | {TAIL_HEAT * c.temperature for c in tried})
    above = scores - scores.max()
    p = {t: np.exp(above[index] / t) / np.exp(above / t).sum() for t in temperatures}
    mixed = np.array([(1 - c.tail) * p[c.temperature] + c.tail * p[TAIL_HEAT * c.temperature] for c in tried])
    return -np.log(np.maximum(mixed, LEAST))


def _log_softmax(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    above = logits - logits.max(axis=-1, keepdims=True)
    return np.asarray(above - np.log(np.exp(above).sum(axis=-1, keepdims=True)))
