"""Identification among the parts of a library: a quick comparison chooses the parts that are located.

A quick comparison ranks all parts. The best parts are searched roughly, and so are parts of the same size as the best
of these. Without them, a part may seem to be the touched one only because its mirror image was not searched. Then the
best parts are located and weighed, as `tactile_loc.identify` does for a few objects.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from tactile_loc import Identification, KnownObject, NullEvidence, Touch, identify
from tactile_loc.plugin import ConfigError, Progress, TouchError
from tactile_loc.plugin.helpers import map_in_threads, require_sensor_poses

from tactile_loc_library.search import ExaminedPart, PartSearch, RoughFit, VoteResult
from tactile_loc_library.votes import Shortlist

# The parts that are examined, and those of them that are searched roughly. The true part may be less likely than the
# likeliest one by as many nats. About 95 of 100 clean and noisy examples of two touches are nearer. More touches differ
# by more nats. Of many parts, more have better votes, so up to the shares EXAMINED_SHARE and LOOKED_INTO_SHARE are
# examined and searched.
EXAMINED, LOOKED_INTO = Shortlist(8.0), Shortlist(6.5)
EXAMINED_SHARE, LOOKED_INTO_SHARE = 0.04, 0.02
# The parts that are located: their misfits in the rough search are at most this many nats above the least one. That of
# the touched part is at most 4 nats above it in 95 % of the noisy examples, and at most 0.5 nats in clean ones.
LOCATED = Shortlist(5.0, least=4, most=12)
MOST_OF_SAME_SIZE = 16  # parts that are searched only because one of the best has the same size
UNSEARCHED = RoughFit(np.inf, 0.0)

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Candidates:
    """The K parts of a library after the quick comparisons.

    `alike` (K,), unitless, are the mean similarities of the touches and the parts' places, or upper bounds of them for
    parts that the votes did not choose. `fits` (K,) are the parts' fits in the rough search; UNSEARCHED without one.
    """

    alike: NDArray[np.float64]
    fits: tuple[RoughFit, ...]

    @property
    def order(self) -> NDArray[np.int64]:
        """The numbers (K,) of the parts, the best first: by their misfits in the rough search, and by similarity."""
        return np.lexsort((-self.alike, np.array([fit.misfit for fit in self.fits])))

    def choose(self, located: Shortlist = LOCATED) -> list[int]:
        """Return the numbers of the parts to locate, the best first."""
        order = self.order.tolist()
        return [order[n] for n in located.choose(np.array([-self.fits[k].misfit for k in order]))]


def identify_part(
    touches: Sequence[Touch], search: PartSearch, located: int = LOCATED.most, null: NullEvidence | None = None
) -> Identification:
    """Return the probability that each part of a library was touched, and the probability of "none of these".

    If there are several touches, each needs `T_base_sensor` (4, 4), metres. The most similar parts are searched
    roughly, and those that then explain the touches nearly as well as the best one are located, at most `located`. The
    others follow them with the probability 0, the best first. Raises TactileLocError for touches of another sensor, or
    several touches without sensor poses.
    """
    if located < 1:
        raise ConfigError(f"the number of parts to locate cannot be {located}; give 1 or more")
    candidates = find_candidates(touches, search)
    chosen = candidates.choose(replace(LOCATED, least=min(LOCATED.least, located), most=located))
    with ExitStack() as stack:
        models = [stack.enter_context(search.use(k)).model for k in chosen]
        found = identify(touches, models, null)
    others = tuple(KnownObject(search.names[k], 0.0) for k in candidates.order.tolist() if k not in chosen)
    return replace(found, objects=found.objects + others)


def find_candidates(touches: Sequence[Touch], search: PartSearch) -> Candidates:
    """Compare touches with all parts, and search likely parts roughly.

    The votes choose the parts that are examined, and the examination chooses those that are searched. Parts of the same
    size as the best of these are also examined and searched.
    """
    if not touches:
        raise TouchError("there is no touch to identify; give at least one")
    if len(touches) > 1:
        require_sensor_poses([touch.T_base_sensor for touch in touches])
    examined, looked_into = choose_shortlists(len(touches), len(search))
    votes = search.compare(touches, examined)
    found = _examine(search, votes, examined.choose(votes.nats))
    numbers = list(found)
    likely = looked_into.choose(np.array([one.nats for one in found.values()]))
    rough = _search_roughly(search, votes, {numbers[n]: found[numbers[n]] for n in likely})
    numbers = list(rough)
    best = [numbers[n] for n in LOCATED.choose(np.array([-fit.misfit for fit in rough.values()]))]
    others = [k for k in search.find_same_size(best) if k not in rough]
    if len(others) > MOST_OF_SAME_SIZE:
        others = sorted(others, key=lambda k: -search.rate(k, votes))[:MOST_OF_SAME_SIZE]
    rough |= _search_roughly(search, votes, _examine(search, votes, others))
    return Candidates(votes.alike, tuple(rough.get(k, UNSEARCHED) for k in range(len(search))))


def choose_shortlists(touches: int, parts: int) -> tuple[Shortlist, Shortlist]:
    """Return the shortlists of the parts to examine, and of those to search roughly."""
    wider = max(1.0, touches / 2)
    examined, looked_into = (
        replace(one, most_behind=wider * one.most_behind, most=max(one.most, round(share * parts)))
        for one, share in ((EXAMINED, EXAMINED_SHARE), (LOOKED_INTO, LOOKED_INTO_SHARE))
    )
    return examined, looked_into


def _examine(search: PartSearch, votes: VoteResult, some: Sequence[int]) -> dict[int, ExaminedPart]:
    """Examine some parts; return what was found by number, in their order."""
    found = _map(search.progress, "examining objects", lambda k: search.examine(k, votes), some)
    return dict(zip(some, found, strict=True))


def _search_roughly(search: PartSearch, votes: VoteResult, examined: dict[int, ExaminedPart]) -> dict[int, RoughFit]:
    """Return the rough fits of examined parts, by number."""
    fits = _map(search.progress, "looking into objects", lambda k: search.look_into(k, votes, examined[k]), examined)
    return dict(zip(examined, fits, strict=True))


def _map(progress: Progress, title: str, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return what a function returns for each item, computed in threads with progress."""
    every = list(items)
    found: list[Result] = []
    if not every:
        return found
    with progress.task(title, len(every)) as advance:
        for one in map_in_threads(function, every):
            found.append(one)
            advance(1)
    return found
