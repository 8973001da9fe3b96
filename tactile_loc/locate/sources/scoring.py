"""Scores of a grid's poses: a touch and the poses' contact shapes are encoded, then matched."""

from collections.abc import Callable
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.places.places import PRESS_STEP_M
from tactile_loc.core.runtime.caches import ByteCache
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.slots.encoder import Encoder
from tactile_loc.slots.matcher import Matcher

Scores = NDArray[np.float32]
NewMatcher = Callable[[], Matcher]

# The FEWEST_MATCHERS matchers used last are kept in memory, and more as long as their banks need at most KEPT_BYTES.
FEWEST_MATCHERS, KEPT_BYTES = 8, 128 * 2**20


class BankMatcher(NamedTuple):
    """A matcher of a bank, and the bytes of this bank."""

    matcher: Matcher
    nbytes: int


class LiftedMatcher(Matcher):
    """Computes weighted scores of the rows that a matcher without weights finds.

    Let rows b and queries q with weights w be relative to the bank's mean. The matcher compares [w q, -w/2, 0] with
    [b, b^2, c], where c gives all rows the same length. For such rows, -1/2 of the squared distance is the weighted
    score, except for rounding and a constant of each query. So the nearest rows are those with the highest scores.
    """

    def __init__(self, matcher: Matcher) -> None:
        super().__init__()
        self._matcher = matcher

    def index(self, bank: Scores) -> None:
        """Give the matcher the lifted bank (N, 2 D + 1)."""
        self._mean = np.mean(bank, axis=0, dtype=np.float64).astype(np.float32)
        self._centred = bank - self._mean
        lifted = np.hstack([self._centred, self._centred**2, np.zeros((len(bank), 1), np.float32)])
        squares = np.einsum("nd,nd->n", lifted, lifted)
        lifted[:, -1] = np.sqrt(squares.max() - squares)
        self._matcher.index(lifted)

    def scores(self, queries: Scores, weights: Scores | None = None) -> Scores:
        """Return weighted scores (M, N) of queries (M, D); -inf for rows that the matcher does not find."""
        q = queries - self._mean
        w = np.ones_like(q) if weights is None else np.asarray(weights, np.float32)
        scores = self._matcher.scores(np.hstack([w * q, -0.5 * w, np.zeros((len(q), 1), np.float32)]))
        for k in range(len(q)):
            rows = np.flatnonzero(scores[k] > -np.inf)
            scores[k, rows] = -0.5 * ((q[k] - self._centred[rows]) ** 2 @ w[k])
        return scores


def index_bank(matcher: Matcher, bank: Any) -> BankMatcher:
    """Give a matcher its bank (N, D)."""
    matcher.index(bank)
    return BankMatcher(matcher, bank.nbytes)


class GridScores:
    """Scores touches against the banks of a grid; each press depth has its own bank.

    `bank` returns the bank (N, D) of a press depth in metres. `new_matcher` returns an empty matcher. `max_depth_m` is
    the sensor's maximal depth. With `follow`, touches are compared at their own press depth, whatever the encoder, and
    matchers take weights.
    """

    def __init__(
        self,
        encoder: Encoder,
        new_matcher: NewMatcher,
        bank: Callable[[float], Any],
        max_depth_m: float,
        follow: bool = False,
    ) -> None:
        self.weighted, self.follow = follow, follow or encoder.capabilities.follows_press_depth
        self.encoder, self.new_matcher, self.bank, self.max_depth_m = encoder, new_matcher, bank, max_depth_m
        self._matchers: ByteCache[float, BankMatcher] = ByteCache(
            KEPT_BYTES, lambda kept: kept.nbytes, fewest=FEWEST_MATCHERS
        )
        self._choosing = Lock()

    def score(self, touch: Touch, times: StageTimes) -> Scores:
        """Return the similarity (N,) of a touch to each pose of the grid, unitless; higher is more similar.

        Adds the durations of encoding and matching to `times`, but not that of building banks.
        """
        pressed_m = self.bank_press_m(touch.press_depth_m * touch.geometry.gel.compared_share)
        matcher = self.matcher(pressed_m)
        with times.stage("encode"):
            query = self._encode(touch, pressed_m)
        with times.stage("match"):
            scores: Scores = matcher.scores(query)[0]
        return scores

    def matcher(self, press_depth_m: float) -> Matcher:
        """Return the matcher whose bank is cut at this press depth (metres), built at first use."""
        press_m = self.bank_press_m(press_depth_m)
        with self._choosing:  # each bank is built once
            return self._matchers.get(press_m, lambda: index_bank(self._make_matcher(), self.bank(press_m))).matcher

    def _make_matcher(self) -> Matcher:
        matcher = self.new_matcher()
        return LiftedMatcher(matcher) if self.weighted and not matcher.capabilities.weights else matcher

    @property
    def nbytes(self) -> int:
        """The memory of the banks of all kept matchers, bytes."""
        return self._matchers.nbytes

    def bank_press_m(self, press_depth_m: float) -> float:
        """Return the press depth, metres, at which a touch and the bank are compared.

        This is the maximal depth, or with `follow` the touch's press depth, rounded down to a multiple of PRESS_STEP_M.
        """
        if not self.follow:
            return self.max_depth_m
        return round(max(1, int(press_depth_m / PRESS_STEP_M + 1e-6)) * PRESS_STEP_M, 9)

    def _encode(self, touch: Touch, press_depth_m: float) -> Scores:
        """Return the embedding (1, D) of a touch, compared with a bank for presses of `press_depth_m` metres."""
        shape = touch.touching_shape.press_to(press_depth_m)
        # The shape of a lighter touch stays cut at its own press depth, which the encoder needs to find the contact.
        press_m = shape.press_depth_m
        embedding: Scores = self.encoder.encode(shape.depth_m[None], press_m, touch.geometry)
        return embedding
