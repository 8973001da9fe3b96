"""The fit of `NullEvidence` to touches of known parts, and of parts that were left out of the library."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tactile_loc import NullEvidence

Float64 = NDArray[np.float64]

TEMPERATURES = np.geomspace(0.3, 5, 15).round(2).tolist()  # tried in the fit, nats
LEAST = 1e-3  # least probability of the true object in the fit, so that no single touch decides
# values of `NullEvidence` that are tried in the fit
TRIED: dict[str, list[float]] = {
    "gap": np.geomspace(0.5, 12, 20).round(2).tolist(),
    "growth": [0.0, 0.05, 0.1, 0.15, 0.2],
    "blur": np.geomspace(0.2, 4, 12).round(2).tolist(),
    "noise": np.arange(3.0, 13.0).tolist(),
    "chance": [0.6, 0.7, 0.8, 0.85, 0.9, 0.95],
    "again": np.linspace(0.05, 0.8, 16).round(2).tolist(),
    "missed": [0.01, 0.02, 0.03, 0.05, 0.1],
}


class KnownAnswer(NamedTuple):
    """The result of comparing K objects with N touches of a known object.

    `misfits` (K,) belong to the objects, and `floors` (N,) to the touches, nats. `truth` is the index of the touched
    object; -1 if it was not located. `left_out` is true if it was left out of the library.
    """

    misfits: Float64
    floors: Float64
    truth: int
    left_out: bool = False


def fit_null_evidence(answers: Sequence[KnownAnswer], prior: float = NullEvidence.prior) -> NullEvidence:
    """Return the null evidence with the least negative log-likelihood, with a given `prior`.

    "None of these" is fitted to all answers. Known and left-out objects count the same, and so does each number of
    touches. The temperature is fitted to the objects that were located.
    """
    groups = [
        [answer for answer in answers if (len(answer.floors), answer.left_out) == key]
        for key in sorted({(len(answer.floors), answer.left_out) for answer in answers})
    ]

    def measure_loss(null: NullEvidence) -> float:
        losses = []
        for group in groups:
            excess = [null.measure_excess(answer.misfits, answer.floors) for answer in group]
            none = null.compute_none(np.array(excess), len(group[0].floors))
            losses.append(-np.log(none if group[0].left_out else 1 - none).mean())
        return float(np.mean(losses))

    null, loss = NullEvidence(prior=0.5), np.inf
    while (least := measure_loss(null)) < loss:
        loss = least
        tried = (replace(null, **{name: value}) for name, values in TRIED.items() for value in values)
        null = min((null, *tried), key=measure_loss)
    located = [answer for answer in answers if answer.truth >= 0]
    shares = {t: [_share(answer, replace(null, temperature=t)) for answer in located] for t in TEMPERATURES}
    temperature = min(TEMPERATURES, key=lambda t: -np.log(np.maximum(shares[t], LEAST)).sum())
    return replace(null, prior=prior, temperature=temperature)


def _share(answer: KnownAnswer, null: NullEvidence) -> float:
    """Return the share of the touched object of the probability of all objects."""
    p, none = null.probabilities(answer.misfits, answer.floors)
    return float(p[answer.truth] / (1 - none))
