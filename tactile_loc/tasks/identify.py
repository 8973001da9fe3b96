"""Identification: which of several objects, if any, was touched, and where it is.

A quick comparison ranks all objects. The best objects are searched roughly, and so are objects of the same size as the
best of these. Without them, an object may seem to be the touched one only because its mirror image was not searched.
Then the best objects are located, each from all touches. An object's misfit is the evidence (`imprints.py`), in nats,
that its best pose lacks to explain all touches fully. The misfit does not depend on how much of the object is touched.

To find the misfits, objects are located with TYPICAL scalings of probabilities. They hardly affect the poses, and need
no fit to the object, which takes seconds. Only the objects that are probable in the end are located with their own.

If the touched object is not in the library, other objects still explain each touch separately, but hardly ever all
touches together. So each touch is also located separately. The least misfit of a touch is its floor: noise, which no
object explains. If the best object has a larger misfit than the floors of all touches, an unknown object was probably
touched. How probably was fitted to simulated touches of objects that were left out of the library.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tactile_loc.bases.common_poses import require_sensor_poses
from tactile_loc.core.poses.posterior import TIE_NATS, group_ties
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.errors import ConfigError, StoreError, TactileLocError, TouchError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import compare_where_seen, find_seen_poses
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.locate.probability.probabilities import FusedScaling, Scalings, TemperatureScaling
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import MOSTLY_ELSEWHERE, Verdict, judge
from tactile_loc.tasks.library import Comparison, Examined, Library, RoughFit, compute_full_evidence
from tactile_loc.tasks.null_evidence import NullEvidence
from tactile_loc.tasks.shortlist import Shortlist
from tactile_loc.tracking.pose_modes import PoseModes, join_modes

Float64 = NDArray[np.float64]

# The objects that are examined, and those of them that are searched roughly. The true object may be less likely than
# the likeliest one by as many nats. About 95 of 100 clean and noisy examples of two touches are nearer. More touches
# differ by more nats. Of many objects, more have better votes, so up to the shares EXAMINED_SHARE and LOOKED_INTO_SHARE
# are examined and searched.
EXAMINED, LOOKED_INTO = Shortlist(8.0), Shortlist(6.5)
EXAMINED_SHARE, LOOKED_INTO_SHARE = 0.04, 0.02
# The objects that are located: their misfits in the rough search are at most this many nats above the least one. That
# of the touched object is at most 4 nats above it in 95 % of the noisy examples, and at most 0.5 nats in clean ones.
LOCATED = Shortlist(5.0, least=4, most=12)
MOST_OF_SAME_SIZE = 16  # objects that are searched only because one of the best has the same size
UNSEARCHED = RoughFit(np.inf, 0.0)
LEAST_REPORTED = 0.05  # least probability of an object whose poses' probabilities are fitted and reported
# The medians of 60 fits of temperatures and 82 fits of the tempering, to various objects and sensors.
TYPICAL = Scalings(TemperatureScaling(0.021, 0.4, (-6.4, 7.8)), FusedScaling(0.4, (-2.0, 2.3)))
# If there are several touches, each is also located separately in ALONE objects. No further object is tried for a touch
# with a misfit below EXPLAINED nats.
ALONE, EXPLAINED = 2, 0.2


@dataclass(frozen=True, eq=False)
class KnownObject:
    """One object of the library, and the result of comparing it with touches.

    `alike`, unitless, is the mean similarity of the touches and the object's places in the quick comparison, or an
    upper bound of it if the votes did not choose the object. `rough_misfit`, nats, is the least misfit in the
    rough search, and `rough_iou`, 0 to 1, is the mean imprint IoU of that pose. They are infinite and 0 if the object
    was not searched. `found` is the result of locating the object; None if this was not tried or failed. `misfit`,
    nats, is the evidence that the best pose lacks to explain the touches fully; infinite without a pose. `apart` (N,),
    nats, are the least misfits of each touch over all poses in `found`. `probability`, 0 to 1, is the probability that
    this object was touched. If the object is improbable, `fitted` is False: the probabilities of the poses in `found`
    come from TYPICAL scalings, not from a fit to this object. They are rough, and files leave them out.
    """

    name: str
    probability: float
    alike: float
    rough_iou: float
    misfit: float
    found: Localization | None
    fitted: bool = True
    apart: tuple[float, ...] = ()
    rough_misfit: float = math.inf


@dataclass(frozen=True, eq=False)
class Identification:
    """The objects, the most probable first, and the probability that `none` of them was touched.

    `floors` (N,), nats, are the least misfits of the touches, each explained separately. `KnownObject.found` has the
    distribution of an object's pose, assuming that this object was touched.
    """

    objects: tuple[KnownObject, ...]
    none: float
    floors: tuple[float, ...] = ()

    @property
    def best(self) -> KnownObject | None:
        """The most probable object; None if "none of these" is more probable."""
        first = self.objects[0]
        return first if first.probability > self.none else None

    @property
    def modes(self) -> PoseModes | None:
        """The pairs of an object and its pose that are still possible, which the next touch has to distinguish.

        They are those of objects with a probability of at least LEAST_REPORTED; None if there is no such object.
        """
        probable = [one for one in self.objects if one.probability >= LEAST_REPORTED]
        known = [(PoseModes.of(one.found), one.probability) for one in probable if one.found is not None]
        return join_modes(*zip(*known, strict=True)) if known else None

    @property
    def verdict(self) -> Verdict:
        """How far the first object can be trusted, in one word.

        The words are those for poses. "not found" means that "none of these" has more than half of the probability;
        otherwise, "poor fit" means that the first object's best pose does not explain the touches.
        """
        first = self.objects[0]
        if first.found is None or self.none > MOSTLY_ELSEWHERE:
            return Verdict.NOT_FOUND
        best = first.found.best
        iou = best.imprint_iou if best.is_refined else math.nan
        return judge(first.probability, iou, depths_known=first.found.depths_known)


def identify(
    touches: Sequence[Touch], models: Library | Sequence[Localizer], located: int | Shortlist = LOCATED,
    null: NullEvidence | None = None,
) -> Identification:  # fmt: skip
    """Return the probability that each of the models' objects was touched, and the probability of "none of these".

    If there are several touches, each needs `T_base_sensor` (4, 4), metres. The most similar objects are searched
    roughly, and those that then explain the touches nearly as well as the best one are located, at most `located`. A
    `Shortlist` chooses them by their misfits, nats, in the rough search. The probabilities of poses are fitted only
    to objects with a probability of at least LEAST_REPORTED. "None of these" is weighed by `null`: see `NullEvidence`.
    The order of the models does not matter. Raises TactileLocError for touches of another sensor, several touches
    without sensor poses, models that share a name, or no models.
    """
    library = models if isinstance(models, Library) else Library(models)
    if not touches:
        raise TouchError("there is no touch to identify; give at least one")
    if not isinstance(located, Shortlist):
        if located < 1:
            raise ConfigError(f"the number of objects to locate cannot be {located}; give 1 or more")
        located = replace(LOCATED, least=min(LOCATED.least, located), most=located)
    if len(touches) > 1:
        require_sensor_poses([touch.T_base_sensor for touch in touches])
    examined, looked_into = choose_shortlists(len(touches), len(library))
    comparison = library.compare(touches, examined)
    alike = comparison.alike
    rough = _look_into(library, comparison, examined, looked_into)
    fits = [rough.get(k, UNSEARCHED) for k in range(len(library))]
    misfits = np.array([fit.misfit for fit in fits])
    order = np.lexsort((-alike, misfits))
    chosen = order[located.choose(-misfits[order])]
    tried = _Tried(library, touches)
    with library.progress.task("locating objects", len(chosen)) as advance:
        for _ in map_in_threads(partial(tried.locate, fitted=False), map(int, chosen)):
            advance(1)
    null, floors = null or NullEvidence(), find_floors(library, touches, tried.apart)
    p, none = null.probabilities(tried.misfits, floors)
    while probable := [k for k in sorted(tried.unfitted) if p[k] >= LEAST_REPORTED]:
        for k in probable:
            tried.locate(k)
        p, none = null.probabilities(tried.misfits, floors)
    objects = [
        KnownObject(
            name, float(p[k]), float(alike[k]), fits[k].iou, float(tried.misfits[k]), tried.found.get(k),
            k not in tried.unfitted, tuple(tried.apart[k].tolist()) if k in tried.apart else (), fits[k].misfit,
        )
        for k, name in enumerate(library.names)
    ]  # fmt: skip
    return Identification(tuple(objects[k] for k in _rank(objects)), none, tuple(floors.tolist()))


def _rank(objects: Sequence[KnownObject]) -> list[int]:
    """Return the numbers of the objects, the most probable first; equally probable ones by name, which never varies.

    Objects without probability follow by their fit in the rough search and by their similarity.
    """
    p = np.array([one.probability for one in objects])
    tied = group_ties(np.log(np.maximum(p, 1e-300)), TIE_NATS)
    rest = [(one.rough_misfit, -one.alike) if one.probability == 0 else (0.0, 0.0) for one in objects]
    return sorted(range(len(objects)), key=lambda k: (tied[k], *rest[k], objects[k].name))


class _Tried:
    """The located objects of a library.

    `found` are their locations, and `misfits` (K,), nats, are those of all objects, infinite if an object was not
    found. `apart` (N,), nats, are the misfits of each touch: see `KnownObject`. `unfitted` are the numbers of the
    objects that were located without a fit of their probabilities.
    """

    def __init__(self, library: Library, touches: Sequence[Touch]) -> None:
        self.library, self.touches = library, touches
        self.found: dict[int, Localization] = {}
        self.apart: dict[int, Float64] = {}
        self.misfits = np.full(len(library), np.inf)
        self.unfitted: set[int] = set()

    def locate(self, k: int, fitted: bool = True) -> None:
        """Locate object k. Unless `fitted`, the probabilities of its poses are rough: see `KnownObject`."""
        with self.library.use(k) as model:
            scalings = None if fitted else _choose_scalings(model)
            answer = _locate(model, self.touches, scalings)
            lacks = None if answer is None else compare_fully(model, answer)
        self.found.pop(k, None)
        self.apart.pop(k, None)
        self.unfitted.discard(k)
        self.misfits[k] = np.inf if lacks is None else _sum_best(lacks)
        if answer is not None and lacks is not None:
            self.found[k] = answer
            order = [*answer.touches, *answer.left_out]
            self.apart[k] = lacks.min(axis=0)[[order.index(touch) for touch in self.touches]]
            if scalings is not None:
                self.unfitted.add(k)


def find_floors(library: Library, touches: Sequence[Touch], apart: Mapping[int, Float64]) -> Float64:
    """Return the least misfit (N,), nats, of each of N touches separately: no object explains the touch better.

    `apart` are the least misfits (N,) of the touches over the poses of each located object of the library. But poses
    that explain all touches may explain none of them as well as possible. So if there are several touches, each is also
    located separately, in the ALONE objects that explain it best.
    """
    find = partial(_find_floor, library, touches, apart)
    return np.array([*map_in_threads(find, range(len(touches)))])


def _find_floor(library: Library, touches: Sequence[Touch], apart: Mapping[int, Float64], number: int) -> float:
    """Return the floor of one of the touches: see `find_floors`."""
    if not apart:
        return compute_full_evidence(touches[number])
    order = sorted(apart, key=lambda k: apart[k][number])
    floor = float(apart[order[0]][number])
    for k in order[:ALONE] if len(touches) > 1 else ():
        if floor < EXPLAINED:
            break
        with library.use(k) as model:
            answer = _locate(model, [touches[number]], _choose_scalings(model))
            floor = min(floor, np.inf if answer is None else measure_misfit(model, answer))
    return max(0.0, floor)


def measure_misfit(model: Localizer, found: Localization) -> float:
    """Return the evidence, nats, that the best hypothesis lacks to explain the touches fully."""
    return _sum_best(compare_fully(model, found))


def compare_fully(model: Localizer, found: Localization) -> Float64:
    """Return the evidence (K, N), nats, that K hypotheses lack to explain N touches fully.

    The touches that were left out come last: no hypothesis explains them.
    """
    views = model.make_views(found.touches)
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    seen = None if len(views) == 1 else find_seen_poses(views, [h.refined for h in found.hypotheses])
    evidence = compare_where_seen(views, poses, seen)[1]
    fully, left_out = (np.array([compute_full_evidence(t) for t in some]) for some in (found.touches, found.left_out))
    return np.concatenate([fully - evidence, np.broadcast_to(left_out, (len(poses), len(left_out)))], axis=1)


def _sum_best(lacks: Float64) -> float:
    return max(0.0, float(lacks.sum(axis=1).min()))


def choose_shortlists(touches: int, objects: int) -> tuple[Shortlist, Shortlist]:
    """Return the shortlists of the objects to examine, and of those to search roughly."""
    wider = max(1.0, touches / 2)
    examined, looked_into = (
        replace(one, most_behind=wider * one.most_behind, most=max(one.most, round(share * objects)))
        for one, share in ((EXAMINED, EXAMINED_SHARE), (LOOKED_INTO, LOOKED_INTO_SHARE))
    )
    return examined, looked_into


def _look_into(
    library: Library, comparison: Comparison, examined: Shortlist, looked_into: Shortlist
) -> dict[int, RoughFit]:
    """Search likely objects roughly; return their fits by number.

    The votes choose the objects that are `examined`, and the examination chooses those that are `looked_into`. Objects
    of the same size as the best of these are also examined and searched.
    """
    chosen = examined.choose(comparison.nats)
    found = _examine(library, comparison, chosen)
    searched = looked_into.choose(np.array([one.nats for one in found]))
    rough = _search_roughly(library, comparison, {chosen[n]: found[n] for n in searched})
    numbers = list(rough)
    best = [numbers[n] for n in LOCATED.choose(np.array([-rough[k].misfit for k in numbers]))]
    others = [k for k in library.find_same_size(best) if k not in rough]
    if len(others) > MOST_OF_SAME_SIZE:
        others = sorted(others, key=lambda k: -library.rate(k, comparison))[:MOST_OF_SAME_SIZE]
    if others:
        examinations = _examine(library, comparison, others)
        rough |= _search_roughly(library, comparison, dict(zip(others, examinations, strict=True)))
    return rough


def _examine(library: Library, comparison: Comparison, some: Sequence[int]) -> list[Examined]:
    """Examine some objects, in their order."""
    found = []
    with library.progress.task("examining objects", len(some)) as advance:
        for one in map_in_threads(partial(library.examine, comparison=comparison), some):
            found.append(one)
            advance(1)
    return found


def _search_roughly(library: Library, comparison: Comparison, some: Mapping[int, Examined]) -> dict[int, RoughFit]:
    """Return the rough fits of examined objects, by number."""
    rough = {}
    with library.progress.task("looking into objects", len(some)) as advance:
        fits = map_in_threads(lambda k: library.look_into(k, comparison, some[k]), list(some))
        for k, fit in zip(some, fits, strict=True):
            rough[k] = fit
            advance(1)
    return rough


def _choose_scalings(model: Localizer) -> Scalings | None:
    """Return TYPICAL scalings, which need no fit; None if the user gave a temperature."""
    return TYPICAL if model.config.temperature is None else None


def _locate(model: Localizer, touches: Sequence[Touch], scalings: Scalings | None) -> Localization | None:
    """Locate an object; return None if none of its poses explains the touches."""
    try:
        return localize_together([(model, touch) for touch in touches], scalings=scalings)
    except StoreError:
        raise
    except TactileLocError:
        return None
