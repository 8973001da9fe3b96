"""How much of the differences between combinations each slot explains: a decomposition of the variance of log errors.

For a block, one object with one noise, m is the mean over its touches of the natural logarithm of the error, less the
block's mean over all combinations. The effect of a term, a slot or a pair, is the mean of m over all other axes, less
the effects of the parts of the term. In a full product these effects are orthogonal (analysis of variance, Fisher 1925;
Sobol 1993), so the mean squares of all terms add up to the variance of m.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.evaluation.sweep.uncertainty import LEAST_TOUCHES, RESAMPLED, SEED, Estimate, find_interval

LEAST_MM = 1e-3  # smaller errors count as this; their logarithms would rule the variance
ROUNDING = 1e-6  # smaller shares come from rounding
LEAST_TOLD = 0.01  # smaller interactions are left out of the sentence
PAIR, REST = " x ", "the rest"


@dataclass(frozen=True)
class Decomposition:
    """The shares, 0 to 1, of the variance between combinations that terms explain.

    A term is a slot, a pair "slot x slot", or "slot x object" if the effect differs between objects. REST is all
    other terms. The variance that chance alone adds, by the bootstrap, is subtracted. `ratios` has, for each slot, the
    error with its worst choice divided by that with its best choice, as geometric means. `touches` is the least number
    of touches of a block. Both are empty if all combinations have the same errors.
    """

    shares: Mapping[str, Estimate]
    ratios: Mapping[str, Estimate]
    touches: int

    def explains(self, term: str) -> bool:
        """Return whether the interval of a term's share excludes zero."""
        return self.shares[term].low > ROUNDING


def decompose(errors_mm: Sequence[Floats], slots: Sequence[str], block: str) -> Decomposition:
    """Decompose the variance between combinations of `slots`; see the module.

    `errors_mm` has the errors (K1, ..., Kn, T) of each block, by the choices of each slot and the touches. `block`
    says in what blocks differ, such as "object".
    """
    means = np.stack([_average_logs(some) for some in errors_mm], axis=1)
    m = means - means.mean(axis=tuple(range(2, means.ndim)), keepdims=True)
    squares = _find_mean_squares(m, (block, *slots))
    touches = min(some.shape[-1] for some in errors_mm)
    if not sum(some[0] for some in squares.values()) > 1e-12:
        return Decomposition({}, {}, touches)
    chance = {term: some[1:].mean() - some[0] for term, some in squares.items()}
    samples = {
        term: np.maximum(np.concatenate([some[:1] - chance[term], some[1:] - 2 * chance[term]]), 0)
        for term, some in squares.items()
    }
    total = np.maximum(np.sum(list(samples.values()), axis=0), 1e-300)
    ratios = {slot: np.exp(np.ptp(_find_margin(m, (axis,)), axis=axis)) for axis, slot in enumerate(slots, start=2)}
    return Decomposition(
        {term: _estimate(some / total, touches) for term, some in samples.items()},
        {slot: _estimate(some.ravel(), touches) for slot, some in ratios.items()},
        touches,
    )


def _average_logs(errors_mm: Floats) -> Floats:
    """Return mean logarithms (1 + R, K1, ..., Kn) of errors (K1, ..., Kn, T): of all touches, then of each sample."""
    count = errors_mm.shape[-1]
    logs, rng = np.log(np.maximum(errors_mm, LEAST_MM)), np.random.default_rng(SEED)
    drawn = (rng.multinomial(count, np.full(count, 1 / count)) for _ in range(RESAMPLED))
    return np.stack([logs.mean(axis=-1), *(logs @ weights / count for weights in drawn)])


def _find_margin(m: Floats, kept: Sequence[int]) -> Floats:
    """Return the mean of m (1 + R, ...) over all axes but the first and those that are kept."""
    return np.asarray(m.mean(axis=tuple(axis for axis in range(1, m.ndim) if axis not in kept), keepdims=True))


def _find_mean_squares(m: Floats, names: Sequence[str]) -> dict[str, Floats]:
    """Return the mean squares (1 + R,) of each term of m (1 + R, B, K1, ..., Kn), and of REST; `names` are of axes."""
    axes = [axis for axis in range(1, m.ndim) if m.shape[axis] > 1]
    effects: dict[tuple[int, ...], Floats] = {(axis,): _find_margin(m, (axis,)) for axis in axes}
    for pair in itertools.combinations(axes, 2):
        effects[pair] = _find_margin(m, pair) - sum(effects[axis,] for axis in pair)
    over = tuple(range(1, m.ndim))
    squares = {
        PAIR.join(names[axis - 1] for axis in sorted(term, key=lambda axis: axis == 1)): np.mean(effect**2, axis=over)
        for term, effect in effects.items()
        if term != (1,)  # zero, since the mean of each block is subtracted
    }
    rest = np.mean(m**2, axis=over) - np.sum(list(squares.values()), axis=0)
    return {**squares, REST: np.maximum(rest, 0)}


def _estimate(values: Floats, touches: int) -> Estimate:
    """Return the first of values (1 + R,) with the interval of the others."""
    return Estimate(float(values[0]), *find_interval(values[1:], touches))


def write_sentence(found: Decomposition | None, slots: Sequence[str]) -> str:
    """Say in words what `slots`, which vary, explain. `found` is None if a combination of every block failed."""
    if not slots:
        return ""
    if found is None:
        return "The effect of each slot is unknown, because a combination failed for each object."
    if found.touches < LEAST_TOUCHES:
        return f"The effect of each slot needs at least {LEAST_TOUCHES} touches; there are {found.touches}."
    if not found.shares:
        return "All combinations have the same errors."
    known = [slot for slot in slots if found.explains(slot)]
    if len(slots) == 1 and known:
        ratio = found.ratios[slots[0]]
        span = f"{ratio.value:.3g} (95 % interval {ratio.low:.3g} to {ratio.high:.3g})"
        return f"Only {slots[0]} varies: the error with its worst choice is {span} times that with its best choice."
    others = [term for term, share in found.shares.items() if term not in slots and share.value >= LEAST_TOLD]
    terms = sorted([*known, *filter(found.explains, others)], key=lambda term: -found.shares[term].value)
    if not terms:
        return f"{found.touches} touches show no effect of {_join(slots, 'or')}."
    told = [_write_share(term, found.shares[term], " of the variance" * (term == terms[0])) for term in terms]
    unknown = [slot for slot in slots if slot not in known]
    told += [f"{_join(unknown, 'and')} nothing that {found.touches} touches show"] if unknown else []
    return f"{'; '.join(told)}."


def _join(words: Sequence[str], last: str) -> str:
    return f" {last} ".join([*([", ".join(words[:-1])] if words[1:] else []), words[-1]])


def _write_share(term: str, share: Estimate, of: str) -> str:
    name = f"the interaction {term}" if PAIR in term else term
    if share.value < LEAST_TOLD:
        return f"{name} explains less than {100 * LEAST_TOLD:.0f} %{of}"
    return f"{name} explains {100 * share.value:.0f} %{of} ({100 * share.low:.0f} to {100 * share.high:.0f} %)"
