"""Checks for matchers: a score must be minus half the squared distance, for any bank, queries and weights."""

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.slots.interface import WEIGHTS_CHANGE, takes_weights
from tactile_loc.slots.matcher import Matcher
from tactile_loc.testing.contract import (
    Cause,
    ContractError,
    Untouched,
    check,
    name_cause,
    require,
    require_array,
    require_close,
    require_equal,
)
from tactile_loc.testing.properties import hold, orders, whole

ROWS, QUERIES, DIMENSION = 1200, 4, 12
FEWER_ROWS = 300  # rows of the bank for properties, which build an index for each case
TOLERANCE = 1e-4  # allowed error of scores, for squared lengths near one


@check("matcher")
def check_output(matcher: Matcher) -> None:
    """`scores` returns (M, N) float32 without NaN, and all finite unless the matcher declares top_k_only."""
    scores = _score(matcher, _draw_bank(), _draw_queries())
    require_array(scores, (QUERIES, ROWS), np.float32, "the scores")
    bad = np.isnan(scores) | np.isposinf(scores)
    require(not bad.any(), "a score must be a number, or -inf for a row that was not compared")
    require(np.isfinite(scores).any(axis=1).all(), "every query must have a finite score")
    if not matcher.capabilities.top_k_only:
        require(np.isfinite(scores).all(), "every row must have a finite score; otherwise declare top_k_only=True")


@check("matcher")
def check_definition(matcher: Matcher) -> None:
    """A score is -1/2 ||query - row||^2, on which the posterior's temperature relies. The best row is found."""
    _require_defined(matcher, _draw_bank(), _draw_queries(), "a score must be -1/2 ||query - row||^2")


@check("matcher")
def check_query_order(matcher: Matcher) -> None:
    """Row j of the scores belongs to query j, and a query's scores do not depend on the other queries."""
    together = _score(matcher, _draw_bank(), _draw_queries())
    singly = np.concatenate([_take(matcher.scores(q[None]), 1, ROWS) for q in _draw_queries()[::-1]])[::-1]
    sentence = "one query's scores must not depend on the others"
    require(np.array_equal(np.isfinite(together), np.isfinite(singly)), sentence)
    _require_alike(together, singly, sentence)


@check("matcher")
def check_index_replaces(matcher: Matcher) -> None:
    """A second call of `index` replaces the bank of the first call. A bank of one row works, too."""
    queries = _draw_queries()
    for rows in (50, 1):
        matcher.index(_draw_bank(seed=7))
        matcher.scores(queries)
        bank = _draw_bank()[:rows]
        again = _score(matcher, bank, queries)
        sentence = f"a score must be -1/2 ||query - row||^2, for a new bank of {rows} rows"
        old = {"the old bank is kept": _compute_truth(_draw_bank(seed=7)[:rows], queries)}
        cause = partial(_name_mistake, again, bank, queries, others=old)
        _require_alike(again, _compute_truth(bank, queries), sentence, cause)


@check("matcher", "weights")
def check_weights(matcher: Matcher) -> None:
    """A weighted score is -1/2 sum w (query - row)^2. The best row is found, and weights of one change nothing."""
    require(takes_weights(matcher), f"scores takes no weights; {WEIGHTS_CHANGE}, or declare weights=False")
    bank, queries = _draw_bank(), _draw_queries()
    _require_defined(
        matcher, bank, queries, "with weights of one, a score must be -1/2 ||query - row||^2", np.ones_like(queries)
    )
    weights = _draw_weights()
    queries[weights == 0] += 3  # numbers with weight zero may have any value
    before = Untouched(queries=queries, weights=weights)
    _require_defined(matcher, bank, queries, "a weighted score must be -1/2 sum w (query - row)^2", weights)
    before.require()


@check("matcher")
def check_bank_and_queries_untouched(matcher: Matcher) -> None:
    """Neither the bank nor the queries are written to."""
    bank, queries = _draw_bank(), _draw_queries()
    before = Untouched(bank=bank, queries=queries)
    _score(matcher, bank, queries)
    before.require()


@check("matcher", "deterministic")
def check_deterministic(matcher: Matcher) -> None:
    """The same bank and queries give the same scores, even if the index is built again."""
    first, again = (_score(matcher, _draw_bank(), _draw_queries()) for _ in range(2))
    require_equal(first, again, "the same bank and queries must give the same scores")


@check("matcher", "property")
def property_any_space(matcher: Matcher) -> None:
    """Scores follow the definition for a bank and queries that are rotated, reordered and 2**k times as large.

    Two rows are equal, as those of symmetric poses are; they have equal scores, except for rounding.
    """

    def claim(seed: int, k: int, order: list[int]) -> None:
        rotated = np.linalg.qr(np.random.default_rng(seed).normal(size=(DIMENSION, DIMENSION)))[0] * 2.0**k
        bank, queries = ((rows @ rotated).astype(np.float32) for rows in (_draw_bank()[:FEWER_ROWS], _draw_queries()))
        bank[seed % 100] = bank[200 + seed % 100]
        scores, truth = _score(matcher, bank, queries[order]), _compute_truth(bank, queries[order])
        sentence = "scores must follow the definition in any space and order"
        cause = partial(_name_mistake, scores, bank, queries[order])
        _require_alike(scores / 4.0**k, truth / 4.0**k, sentence, cause)

    hold(claim, seed=whole(0, 999), k=whole(-6, 6), order=orders(QUERIES))


def _require_defined(
    matcher: Matcher, bank: Float32, queries: Float32, sentence: str, weights: Float32 | None = None
) -> None:
    """Raise ContractError unless scores follow their definition, and each query's best row has the highest score."""
    matcher.index(bank)
    try:
        scores = matcher.scores(queries) if weights is None else matcher.scores(queries, weights)
    except ConfigError as error:
        raise ContractError(f"scores must take weights; otherwise declare weights=False ({error})") from error
    require_array(scores, (len(queries), len(bank)), np.float32, "the scores")
    truth = _compute_truth(bank, queries, weights)
    _require_alike(scores, truth, sentence, partial(_name_mistake, scores, bank, queries, weights))
    best, right = scores.argmax(axis=1), truth.argmax(axis=1)
    require((best == right).all(), f"rows {right.tolist()} must have the highest scores, not {best.tolist()}")


def _name_mistake(
    scores: Float32,
    bank: Float32,
    queries: Float32,
    weights: Float32 | None = None,
    others: Mapping[str, NDArray[np.floating]] | None = None,
) -> str:
    """Name the mistake that gives these scores; `others` are the scores of further mistakes."""
    ones = np.ones_like(queries) if weights is None else weights
    truth, plain = _compute_truth(bank, queries, ones), _compute_truth(bank, queries)
    lengths = np.linalg.norm(queries, axis=1)[:, None] * np.linalg.norm(bank, axis=1)
    mistakes = {
        **(others or {}),
        "the factor 1/2 is missing": 2 * truth,
        "the sign is wrong; a more similar row has a higher score": -truth,
        "the sign is wrong and the factor 1/2 is missing": -2 * truth,
        "it is the negative distance; return minus half its square": -np.sqrt(-2 * truth),
        "it is the distance; return minus half its square": np.sqrt(-2 * truth),
        "it is the scalar product": (ones * queries) @ bank.T,
        "it is the cosine": queries @ bank.T / lengths,
        "it is the cosine minus one": queries @ bank.T / lengths - 1,
        "weights are ignored": plain,
        "only the queries are weighted": _compute_truth(bank, ones * queries),
        "weights are squared": _compute_truth(bank, queries, ones**2),
        "the sum is divided by the sum of the weights": truth / ones.sum(axis=1, keepdims=True),
        "the sum is divided by the mean weight": truth / ones.mean(axis=1, keepdims=True),
    }

    def explains(wrong: NDArray[np.floating]) -> bool:
        both = np.isfinite(scores) & np.isfinite(wrong)
        rounding = TOLERANCE * max(float(np.abs(truth).max()), 1e-12)
        return bool(both.any() and np.abs(scores[both] - wrong[both]).max() <= rounding)

    return name_cause(mistakes, explains)


def _require_alike(scores: NDArray[np.floating], truth: NDArray[np.floating], sentence: str, cause: Cause = "") -> None:
    """Raise ContractError if no entry is finite in both `scores` and `truth`, or if they differ at such an entry."""
    both = np.isfinite(scores) & np.isfinite(truth)
    require(both.any(), sentence)
    require_close(scores[both], truth[both], TOLERANCE, sentence, cause)


def _score(matcher: Matcher, bank: Float32, queries: Float32) -> Float32:
    matcher.index(bank)
    return _take(matcher.scores(queries), len(queries), len(bank))


def _take(scores: Float32, queries: int, rows: int) -> Float32:
    """Return scores. Raises ContractError unless they are an array (queries, rows of the bank)."""
    form = np.shape(scores)
    require(form == (queries, rows), f"the scores must have shape ({queries}, {rows}), not {form}")
    return scores


def _draw_bank(seed: int = 0) -> Float32:
    """Return rows (N, D) with different lengths near one."""
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(ROWS, DIMENSION)) / np.sqrt(DIMENSION)).astype(np.float32)


def _draw_queries() -> Float32:
    """Return queries (M, D), each near a row of the bank."""
    noise = np.random.default_rng(1).normal(scale=0.02, size=(QUERIES, DIMENSION))
    return (_draw_bank()[[5, 700, 23, 1100]] + noise).astype(np.float32)


def _draw_weights() -> Float32:
    """Return weights (M, D) of the queries. A third are zero, a third are one, and the others are in between."""
    drawn = np.random.default_rng(5).uniform(-1, 2, size=(QUERIES, DIMENSION))
    return np.clip(drawn, 0, 1).astype(np.float32)


def _compute_truth(bank: Float32, queries: Float32, weights: Float32 | None = None) -> NDArray[np.floating]:
    difference = queries[:, None].astype(float) - bank[None].astype(float)
    return -0.5 * np.einsum("md,mnd->mn", np.ones_like(queries) if weights is None else weights, difference**2)
