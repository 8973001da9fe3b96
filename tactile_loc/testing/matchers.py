"""Checks for matchers: a score must be minus half the squared distance, in any order of rows and queries."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.slots.interface import WEIGHTS_CHANGE, takes_weights
from tactile_loc.slots.matcher import Matcher
from tactile_loc.testing.contract import (
    ContractError,
    Untouched,
    check,
    require,
    require_array,
    require_close,
    require_equal,
)
from tactile_loc.testing.properties import hold, orders, signed, whole

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
    """A score is -1/2 ||query - row||^2, on which the posterior's temperature relies."""
    scores = _score(matcher, _draw_bank(), _draw_queries())
    _require_alike(scores, _compute_truth(_draw_bank(), _draw_queries()), "a score must be -1/2 ||query - row||^2")


@check("matcher")
def check_best_row_is_found(matcher: Matcher) -> None:
    """The most similar row has the highest score, also if the matcher compares only some rows."""
    found = _score(matcher, _draw_bank(), _draw_queries()).argmax(axis=1)
    truth = _compute_truth(_draw_bank(), _draw_queries()).argmax(axis=1)
    require((found == truth).all(), f"rows {truth.tolist()} must have the highest scores, not {found.tolist()}")


@check("matcher")
def check_row_order(matcher: Matcher) -> None:
    """Column i of the scores belongs to row i of the bank, in any order of the rows."""
    order = np.random.default_rng(3).permutation(ROWS)
    plain, shuffled = (_score(matcher, bank, _draw_queries()) for bank in (_draw_bank(), _draw_bank()[order]))
    _require_alike(shuffled, plain[:, order], "scores must be in the bank's order")


@check("matcher")
def check_query_order(matcher: Matcher) -> None:
    """Row j of the scores belongs to query j, and a query's scores do not depend on the other queries."""
    together = _score(matcher, _draw_bank(), _draw_queries())
    singly = np.concatenate([matcher.scores(q[None]) for q in _draw_queries()[::-1]])[::-1]
    sentence = "one query's scores must not depend on the others"
    require(np.array_equal(np.isfinite(together), np.isfinite(singly)), sentence)
    _require_alike(together, singly, sentence)


@check("matcher")
def check_index_replaces(matcher: Matcher) -> None:
    """A second call of `index` replaces the bank of the first call."""
    matcher.index(_draw_bank(seed=7))
    matcher.scores(_draw_queries())
    again = _score(matcher, _draw_bank()[:50], _draw_queries())
    replaced = again.shape == (QUERIES, 50)
    require(replaced, f"a new bank of 50 rows must replace the old one, but scores have shape {again.shape}")
    _require_alike(again, _compute_truth(_draw_bank()[:50], _draw_queries()), "a new bank must replace the old one")


@check("matcher")
def check_single_row(matcher: Matcher) -> None:
    """A bank of one row works, and the row's score with itself is zero."""
    row = _draw_bank()[:1]
    scores = _score(matcher, row, row)
    require_array(scores, (1, 1), np.float32, "the score of one query with one row")
    require_close(scores, [[0.0]], TOLERANCE, "a row's score with itself must be zero")


@check("matcher", "weights")
def check_weights(matcher: Matcher) -> None:
    """A weighted score is -1/2 sum w (query - row)^2. The best row is found, and weights of one change nothing."""
    require(takes_weights(matcher), f"scores takes no weights; {WEIGHTS_CHANGE}, or declare weights=False")
    bank, queries = _draw_bank(), _draw_queries()
    plain = _score_weighted(matcher, bank, queries, np.ones_like(queries))
    _require_alike(plain, _compute_truth(bank, queries), "weights of one must give the plain scores")
    weights = _draw_weights()
    queries[weights == 0] += 3  # numbers with weight zero may have any value
    before = Untouched(queries=queries, weights=weights)
    found, truth = _score_weighted(matcher, bank, queries, weights), _compute_truth(bank, queries, weights)
    before.require()
    _require_alike(found, truth, "a weighted score must be -1/2 sum w (query - row)^2")
    best, right = found.argmax(axis=1), truth.argmax(axis=1)
    sentence = f"with weights, rows {right.tolist()} must have the highest scores, not {best.tolist()}"
    require((best == right).all(), sentence)


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
def property_row_order(matcher: Matcher) -> None:
    """If the rows of the bank are reordered, the scores are reordered in the same way, for rows compared both times."""
    plain = _score(matcher, _make_dense(), _draw_queries())

    def claim(seed: int) -> None:
        order = np.random.default_rng(seed).permutation(FEWER_ROWS)
        shuffled = _score(matcher, _make_dense()[order], _draw_queries())
        _require_alike(shuffled, plain[:, order], "scores must be in the bank's order")

    hold(claim, seed=whole(0, 999))


@check("matcher", "property")
def property_query_order(matcher: Matcher) -> None:
    """If the queries are reordered, the scores are reordered in the same way, except for rounding."""
    plain = _score(matcher, _make_dense(), _draw_queries())

    def claim(order: list[int]) -> None:
        _require_alike(matcher.scores(_draw_queries()[order]), plain[order], "scores must be in the queries' order")

    hold(claim, order=orders(QUERIES))


@check("matcher", "property")
def property_equal_rows(matcher: Matcher) -> None:
    """Equal rows, such as those of symmetric poses, have equal scores, except for rounding."""

    def claim(row: int, twin: int) -> None:
        bank = _make_dense()
        bank[twin] = bank[row]
        scores = _score(matcher, bank, bank[row : row + 1])
        _require_alike(scores[:, twin], scores[:, row], "equal rows must have equal scores")

    half = FEWER_ROWS // 2
    hold(claim, row=whole(0, half - 1), twin=whole(half, FEWER_ROWS - 1))


@check("matcher", "property")
def property_turned_space(matcher: Matcher) -> None:
    """If the bank and the queries are rotated together, the scores stay the same, except for rounding."""
    plain = _score(matcher, _make_dense(), _draw_queries())

    def claim(seed: int) -> None:
        Q = np.linalg.qr(np.random.default_rng(seed).normal(size=(DIMENSION, DIMENSION)))[0]
        bank, queries = ((rows @ Q).astype(np.float32) for rows in (_make_dense(), _draw_queries()))
        _require_alike(_score(matcher, bank, queries), plain, "rotated embeddings must have the same scores")

    hold(claim, seed=whole(0, 999))


@check("matcher", "property")
def property_scale(matcher: Matcher) -> None:
    """If the bank and the queries are 2**k times as large, scores are 4**k times as large, except for rounding."""
    plain = _score(matcher, _make_dense(), _draw_queries())

    def claim(k: int) -> None:
        scale = np.float32(2.0**k)
        scores = _score(matcher, _make_dense() * scale, _draw_queries() * scale) / scale**2
        _require_alike(scores, plain, "scores must scale with the square of the embeddings' unit")

    hold(claim, k=signed(6).filter(bool))


@check("matcher", "property", "weights")
def property_unknown_numbers(matcher: Matcher) -> None:
    """A query's numbers with weight zero may be wrong: they change no score, except for rounding."""
    weights = _draw_weights()
    plain = _score_weighted(matcher, _make_dense(), _draw_queries(), weights)

    def claim(seed: int) -> None:
        wrong = np.random.default_rng(seed).normal(size=weights.shape).astype(np.float32)
        queries = np.where(weights > 0, _draw_queries(), wrong)
        _require_alike(matcher.scores(queries, weights), plain, "numbers of weight zero must change nothing")

    hold(claim, seed=whole(0, 999))


def _make_dense() -> Float32:
    return _draw_bank()[:FEWER_ROWS]


def _require_alike(scores: Float32, truth: Float32, sentence: str) -> None:
    """Raise ContractError if no entry is finite in both `scores` and `truth`, or if they differ at such an entry."""
    both = np.isfinite(scores) & np.isfinite(truth)
    require(both.any(), sentence)
    require_close(scores[both], truth[both], TOLERANCE, sentence)


def _score(matcher: Matcher, bank: Float32, queries: Float32) -> Float32:
    matcher.index(bank)
    return matcher.scores(queries)


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


def _score_weighted(matcher: Matcher, bank: Float32, queries: Float32, weights: Float32) -> Float32:
    matcher.index(bank)
    try:
        scores = matcher.scores(queries, weights)
    except ConfigError as error:
        raise ContractError(f"scores must take weights; otherwise declare weights=False ({error})") from error
    require_array(scores, (len(queries), len(bank)), np.float32, "the scores of weighted queries")
    return scores


def _compute_truth(bank: Float32, queries: Float32, weights: Float32 | None = None) -> np.ndarray:
    difference = queries[:, None].astype(float) - bank[None].astype(float)
    return -0.5 * np.einsum("md,mnd->mn", np.ones_like(queries) if weights is None else weights, difference**2)
