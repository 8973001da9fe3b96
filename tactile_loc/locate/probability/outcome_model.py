"""The probability that a result's first pose is right, from its evidence.

An ensemble of regression trees (gradient boosting; Friedman, *Annals of Statistics* 2001) was fitted once, to touches
of many parts by several sensors, and is shipped. It has three outcomes: the first pose is right, another pose found is,
or none is. A second, linear model (quantile regression; Koenker and Bassett 1978) states how much of a touch a right
pose leaves unexplained at most, given the noise that the touch shows. `benchmarks/outcomes.py` fits both again.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Floats
from tactile_loc.locate.probability.evidence import FEATURES, SURFACE, Evidence
from tactile_loc.locate.result.hypothesis import Hypothesis
from tactile_loc.locate.result.verdict import Outcome

FILE, VERSION = "outcomes.npz", 1
FIT_FEATURES = ("touches", *SURFACE)
MOST_POWER, POWER_STEPS = 16.0, 40  # of the hypotheses' probabilities, and halvings to find it
LEAST = 1e-3  # a smaller probability is not known to be right, and neither is a greater one than 1 - LEAST
TINY = 1e-300  # instead of a weight of zero


@dataclass(frozen=True, eq=False)
class Trees:
    """Regression trees with C outputs, the logits of outcomes: the sums of `base` (C,) and the trees' values.

    Tree t adds to output `outputs[t]`, and its root is node `roots[t]`. A node sends a value of its `feature` up to the
    `threshold` to `left`, and others to `right`; a leaf sends all values to itself, and has a `value`.
    """

    base: Floats
    roots: NDArray[np.int32]
    outputs: NDArray[np.int32]
    feature: NDArray[np.int32]
    threshold: Floats
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    value: Floats

    def predict(self, x: Floats) -> Floats:
        """Return the probabilities (C,) for features x (F,)."""
        nodes, before = self.roots, None
        while before is None or not np.array_equal(nodes, before):
            before = nodes
            nodes = np.where(x[self.feature[nodes]] <= self.threshold[nodes], self.left[nodes], self.right[nodes])
        logits = self.base + np.bincount(self.outputs, self.value[nodes], len(self.base))
        p = np.exp(logits - logits.max())
        return np.asarray(p / p.sum())


@dataclass(frozen=True, eq=False)
class OutcomeModel:
    """The fitted models, and what was fitted to what (`about`, JSON values).

    `limits` (1 + len(FIT_FEATURES),) are the weights of the linear model. `scores` (n,), 0 to 1, are those of examples
    of other parts, for conformal sets.
    """

    trees: Trees
    limits: Floats
    scores: Floats
    about: Mapping[str, Any]

    def predict(self, evidence: Evidence) -> Outcome:
        """Return the probabilities of the outcomes of a result: see `settle`."""
        right, another, missed = np.clip(self.trees.predict(evidence.values), LEAST, 1 - LEAST).tolist()
        return settle(right, another, missed, evidence.near, evidence.ties)

    def measure_excess(self, evidence: Evidence) -> Floats:
        """Return how much more of each of N touches the first pose leaves unexplained than right poses, (N,).

        The values are differences of logarithms. Of the right poses, few have a positive value.
        """
        count = np.full(len(evidence.fits), len(evidence.fits))
        most = np.column_stack([np.ones(len(count)), count, evidence.fits[:, 1:]]) @ self.limits
        return np.asarray(evidence.fits[:, 0] - most)


def settle(right: float, another: float, missed: float, near: Bools, ties: int) -> Outcome:
    """Return the outcome of a result with these probabilities, whose hypotheses are `near` (K,) the first one or not.

    The first pose is not more probable than the `ties`, the poses that explain the touches as well. If all hypotheses
    are near, none of them can be another right pose.
    """
    if near.all():
        return Outcome(right, 0.0, 1 - right)
    shared = min(right, (1 - missed) / (1 + ties))
    return Outcome(shared, another + right - shared, missed)


def spread_outcome(
    hypotheses: Sequence[Hypothesis], near: Bools, outcome: Outcome
) -> tuple[tuple[Hypothesis, ...], float]:
    """Return K hypotheses with the probabilities (K,) of `share_outcome`, and the probability that none is right."""
    p, missed = share_outcome(np.array([h.probability for h in hypotheses]), near, outcome)
    return tuple(replace(h, probability=share) for h, share in zip(hypotheses, p.tolist(), strict=True)), missed


def share_outcome(weights: Floats, near: Bools, outcome: Outcome) -> tuple[Floats, float]:
    """Return the probabilities (K,) of poses that agree with an outcome, and the probability that none is right.

    The poses that are `near` (K,) the first one share the probability that it is right. To this end, all `weights` (K,)
    are raised to one power, which keeps their order. If the first pose would then be less probable than another one,
    all are equally probable.
    """
    missed, wanted = outcome.missed, outcome.right / max(outcome.right + outcome.another, TINY)
    nats = np.log(np.maximum(weights, TINY))
    nats -= nats.max()
    low, high = (1.0, 1.0) if near.all() else (0.0, MOST_POWER)
    for _ in range(POWER_STEPS):
        powered = np.exp((low + high) / 2 * nats)
        low, high = (
            ((low + high) / 2, high) if powered[near].sum() < wanted * powered.sum() else (low, (low + high) / 2)
        )
    p = np.exp((low + high) / 2 * nats)
    return p * (1 - missed) / p.sum(), missed


@cache
def load_outcome_model() -> OutcomeModel:
    """Return the shipped model."""
    with (files("tactile_loc.data") / FILE).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        about = json.loads(str(arrays["about"]))
        trees = Trees(**{name: arrays[name] for name in Trees.__dataclass_fields__})
        limits, scores = arrays["limits"], arrays["scores"]
    assert about["features"] == list(FEATURES), "the shipped model was fitted to other features: fit it again"
    return OutcomeModel(trees, limits, scores, about)
