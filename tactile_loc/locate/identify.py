"""Identification: which of a few objects, if any, was touched, and where it is.

Each object is located from all touches. An object's misfit is the evidence (`imprints.py`), in nats, that its best pose
lacks to explain all touches fully. The misfit does not depend on how much of the object is touched.

If the touched object is none of these, other objects still explain each touch separately, but hardly ever all touches
together. So each touch is also located separately. The least misfit of a touch is its floor: noise, which no object
explains. If the best object has a larger misfit than the floors of all touches, an unknown object was probably touched.
How probably was fitted to simulated touches: see `null_evidence.py`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from tactile_loc.bases.common_poses import require_sensor_poses
from tactile_loc.core.poses.posterior import TIE_NATS, group_ties
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.errors import ObjectError, StoreError, TactileLocError, TouchError, quote
from tactile_loc.core.sensing.scene import compare_where_seen, compute_full_evidence
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import find_seen_poses
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.probability.null_evidence import NullEvidence
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import MOSTLY_ELSEWHERE, Outcome, Verdict, judge
from tactile_loc.locate.several_touches import localize_together

Float64 = NDArray[np.float64]

LEAST_REPORTED = 0.05  # least probability of an object whose poses are reported
# If there are several touches, each is also located separately in ALONE objects. No further object is tried for a touch
# with a misfit below EXPLAINED nats.
ALONE, EXPLAINED = 2, 0.2


@dataclass(frozen=True, eq=False)
class KnownObject:
    """One of the objects that may have been touched.

    `probability`, 0 to 1, is the probability that this object was touched. `misfit`, nats, is the evidence that the
    best pose lacks to explain the touches fully; infinite without a pose. `found` is the result of locating the object;
    None if no pose explains the touches. `apart` (N,), nats, are the least misfits of each touch over all poses in
    `found`.
    """

    name: str
    probability: float
    misfit: float = math.inf
    found: Localization | None = None
    apart: tuple[float, ...] = ()


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
    def verdict(self) -> Verdict:
        """How far the first object can be trusted, in one word.

        The words are those for poses. "not found" means that "none of these" has more than half of the probability;
        otherwise, "poor fit" means that the first object's best pose does not explain the touches.
        """
        first = self.objects[0]
        if first.found is None or self.none > MOSTLY_ELSEWHERE:
            return Verdict.NOT_FOUND
        outcome = Outcome(first.probability, max(0.0, 1 - first.probability - self.none), self.none)
        return judge(outcome, sure=first.found.depths_known, poor=bool(first.found.poor_touches))


def identify(touches: Sequence[Touch], models: Sequence[Localizer], null: NullEvidence | None = None) -> Identification:
    """Return the probability that each of the models' objects was touched, and the probability of "none of these".

    If there are several touches, each needs `T_base_sensor` (4, 4), metres. Every object is located, which takes about
    a second for each. "None of these" is weighed by `null`: see `NullEvidence`. The order of the models does not
    matter. Raises TactileLocError for touches of another sensor, several touches without sensor poses, models that
    share a name, or no models.
    """
    models = _sort_models(models)
    if not touches:
        raise TouchError("there is no touch to identify; give at least one")
    for model, touch in product(models, touches):
        model.require_own(touch)
    if len(touches) > 1:
        require_sensor_poses([touch.T_base_sensor for touch in touches])
    with models[0].progress.task("locating objects", len(models)) as advance:
        known = []
        for one in map_in_threads(partial(_locate, touches=touches), models):
            known.append(one)
            advance(1)
    null, floors = null or NullEvidence(), find_floors(touches, list(zip(models, known, strict=True)))
    p, none = null.probabilities(np.array([one.misfit for one in known]), floors)
    objects = [replace(one, probability=float(share)) for one, share in zip(known, p, strict=True)]
    tied = group_ties(np.log(np.maximum(p, 1e-300)), TIE_NATS)  # equally probable objects by name, which never varies
    order = sorted(range(len(objects)), key=lambda k: (tied[k], objects[k].name))
    return Identification(tuple(objects[k] for k in order), none, tuple(floors.tolist()))


def _sort_models(models: Sequence[Localizer]) -> list[Localizer]:
    """Return the models sorted by the names of their objects."""
    if not models:
        raise ObjectError("there is no object to identify; give at least one")
    for one in models:
        if not isinstance(one, Localizer):
            raise ObjectError(f"{quote(one)} is not a Localizer; make one for each object with Localizer.create")
    ordered = sorted(models, key=lambda model: model.object.name)
    for model, following in pairwise(ordered):
        if model.object.name == following.object.name:
            raise ObjectError(f"two objects are called {model.object.name}; give each its own name")
    return ordered


def _locate(model: Localizer, touches: Sequence[Touch]) -> KnownObject:
    try:
        found = localize_together([(model, touch) for touch in touches])
    except StoreError:
        raise
    except TactileLocError:
        return KnownObject(model.object.name, 0.0)
    lacks = measure_misfits(model, found)
    order = [*found.touches, *found.left_out]
    apart = lacks.min(axis=0)[[order.index(touch) for touch in touches]]
    misfit = max(0.0, float(lacks.sum(axis=1).min()))
    return KnownObject(model.object.name, 0.0, misfit, found, tuple(apart.tolist()))


def find_floors(touches: Sequence[Touch], located: Sequence[tuple[Localizer, KnownObject]]) -> Float64:
    """Return the least misfit (N,), nats, of each of N touches separately: no located object explains it better.

    The poses that explain all touches may explain none of them as well as possible. So if there are several touches,
    each is also located separately, in the ALONE objects that explain it best.
    """
    usable = [(model, one) for model, one in located if one.apart]
    return np.array([*map_in_threads(partial(_find_floor, touches, usable), range(len(touches)))])


def _find_floor(touches: Sequence[Touch], located: Sequence[tuple[Localizer, KnownObject]], number: int) -> float:
    """Return the floor of one of the touches: see `find_floors`."""
    if not located:
        return compute_full_evidence(touches[number])
    order = sorted(located, key=lambda one: one[1].apart[number])
    floor = order[0][1].apart[number]
    for model, _ in order[:ALONE] if len(touches) > 1 else ():
        if floor < EXPLAINED:
            break
        floor = min(floor, _locate(model, [touches[number]]).misfit)
    return max(0.0, floor)


def measure_misfits(model: Localizer, found: Localization) -> Float64:
    """Return the evidence (K, N), nats, that K hypotheses lack to explain N touches fully.

    The touches that were left out come last: no hypothesis explains them.
    """
    views = model.make_views(found.touches)
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    seen = None if len(views) == 1 else find_seen_poses(views, [h.refined for h in found.hypotheses])
    evidence = compare_where_seen(views, poses, seen)[1]
    fully, left_out = (np.array([compute_full_evidence(t) for t in some]) for some in (found.touches, found.left_out))
    return np.concatenate([fully - evidence, np.broadcast_to(left_out, (len(poses), len(left_out)))], axis=1)
