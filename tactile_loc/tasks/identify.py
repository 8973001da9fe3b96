"""Identification: which of several objects, if any, was touched, and where it is.

A quick comparison ranks all objects. The best objects are searched roughly, and the best of these are located, each
from all touches. An object's misfit is the evidence (`imprints.py`), in nats, that its best pose lacks to explain all
touches fully. The misfit does not depend on how much of the object is touched.

To find the misfits, objects are located with TYPICAL scalings of probabilities. They hardly affect the poses, and need
no fit to the object, which takes seconds. Only the objects that are probable in the end are located with their own.

If the touched object is not in the library, the best other object still explains the touches to some extent, by chance.
So "none of these" has a misfit, too. It was fitted to simulated touches of objects that were left out of the library.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.compiled import map_in_threads
from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.errors import ConfigError, StoreError, TactileLocError, TouchError
from tactile_loc.core.sensing.imprints import compare_imprints
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.common_poses import require_sensor_poses
from tactile_loc.core.slots.scene import IOU_PX
from tactile_loc.locate.hypotheses import compare_where_seen, find_seen_poses
from tactile_loc.locate.localizer import Localizer, localize_together, make_view
from tactile_loc.locate.probabilities import FusedScaling, Scalings, TemperatureScaling
from tactile_loc.locate.results.localization import Localization
from tactile_loc.locate.results.verdict import Verdict, judge
from tactile_loc.tasks.library import Comparison, Library
from tactile_loc.tasks.shortlist import Shortlist

Float64 = NDArray[np.float64]

# The objects that are examined, and those of them that are searched roughly. The true object may be less likely than
# the likeliest one by as many nats. About 98 of 100 clean and noisy examples are nearer.
EXAMINED, LOOKED_INTO = Shortlist(13.0), Shortlist(6.5)
LOCATED = 8  # objects that are located: the ones that explain the touches best in the rough search
LEAST_REPORTED = 0.05  # least probability of an object whose poses' probabilities are fitted and reported
# The medians of 60 fits of temperatures and 82 fits of the tempering, to various objects and sensors.
TYPICAL = Scalings(TemperatureScaling(0.021, 0.4, (-6.4, 7.8)), FusedScaling(0.4, (-2.0, 2.3)))
MISFITS = np.geomspace(0.3, 20, 30).round(2).tolist()  # tried in the fit, nats
TEMPERATURES = np.geomspace(0.3, 5, 15).round(2).tolist()
LEAST = 1e-3  # least probability of the true object in the fit, so that no single touch decides


@keep_old_names(shortfall="measure_misfit")
@dataclass(frozen=True)
class NullEvidence:
    """The misfit of "none of these", and the `temperature`, both in nats.

    An object becomes e times as probable if its misfit decreases by `temperature`. The misfit of "none of these" is
    `alone` for one touch, and `together` for each of several touches. They differ because many objects have a feature
    in common, but few have several features at the same distances. Raises ConfigError unless all numbers are positive.
    """

    alone: float = 1.97
    together: float = 6.28
    temperature: float = 0.45

    def __post_init__(self) -> None:
        if not min(self.alone, self.together, self.temperature) > 0:
            raise ConfigError(f"{self} cannot weigh objects; give numbers above 0")

    def measure_misfit(self, touches: int) -> float:
        """Return the misfit of "none of these" with this number of touches, nats."""
        return self.alone if touches == 1 else touches * self.together

    def probabilities(self, misfits: Float64, touches: int) -> tuple[Float64, float]:
        """Return the probabilities (K,) of K objects, and the probability of "none of these".

        `misfits` (K,), nats, are the objects' misfits; an infinite misfit gives probability 0.
        """
        logits = -np.append(misfits, self.measure_misfit(touches)) / self.temperature
        weights = np.exp(logits - logits.max())
        p = weights / weights.sum()
        return p[:-1], float(p[-1])

    def loss(self, answers: Sequence[KnownAnswer]) -> float:
        """Return the negative log-likelihood of the true objects, nats, summed over the answers."""
        said = [(*self.probabilities(answer.misfits, answer.touches), answer.truth) for answer in answers]
        return -float(np.sum([np.log(max(none if k < 0 else p[k], LEAST)) for p, none, k in said]))


class KnownAnswer(NamedTuple):
    """The result of comparing K objects with touches of a known object.

    `misfits` (K,), nats, belong to the K objects. `truth` is the index of the touched object; -1 if it was left out.
    `touches` is the number of touches.
    """

    misfits: Float64
    truth: int
    touches: int


def fit_null_evidence(answers: Sequence[KnownAnswer]) -> NullEvidence:
    """Return the null evidence with the least negative log-likelihood of the true objects."""
    single = [answer for answer in answers if answer.touches == 1]
    several = [answer for answer in answers if answer.touches > 1]

    def best_of(temperature: float) -> tuple[float, NullEvidence]:
        tried = [NullEvidence(nats, nats, temperature) for nats in MISFITS]
        alone, together = (min(tried, key=lambda null: null.loss(some)) for some in (single, several))
        null = NullEvidence(alone.alone, together.together, temperature)
        return null.loss(answers), null

    return min(map(best_of, TEMPERATURES), key=lambda pair: pair[0])[1]


@keep_old_names(shortfall="misfit")
@dataclass(frozen=True, eq=False)
class KnownObject:
    """One object of the library, and the result of comparing it with touches.

    `alike`, unitless, is the mean similarity of the touches and the object's places in the quick comparison, or an
    upper bound of it if the object is too improbable to be examined.
    `rough_iou`, 0 to 1, is the best mean imprint IoU in the rough search; 0 if the object was not searched. `found` is
    the result of locating the object; None if this was not tried or failed. `misfit`, nats, is the evidence that the
    best pose lacks to explain the touches fully; infinite without a pose. `probability`, 0 to 1, is the probability
    that this object was touched. If the object is improbable, `fitted` is False: the probabilities of the poses in
    `found` come from TYPICAL scalings, not from a fit to this object. They are rough, and files leave them out.
    """

    name: str
    probability: float
    alike: float
    rough_iou: float
    misfit: float
    found: Localization | None
    fitted: bool = True


@dataclass(frozen=True, eq=False)
class Identification:
    """The objects, the most probable first, and the probability that `none` of them was touched.

    `KnownObject.found` has the distribution of an object's pose, assuming that this object was touched.
    """

    objects: tuple[KnownObject, ...]
    none: float

    @property
    def best(self) -> KnownObject | None:
        """The most probable object; None if "none of these" is more probable."""
        first = self.objects[0]
        return first if first.probability > self.none else None

    @property
    def verdict(self) -> Verdict:
        """How far the first object can be trusted, in one word.

        The words are those for poses. "not found" means that "none of these" has more than half of the probability;
        "poor fit" means that the first object's best pose does not explain the touches.
        """
        first = self.objects[0]
        if first.found is None:
            return judge(None)
        best = first.found.best
        iou = best.imprint_iou if best.is_refined else math.nan
        return judge(first.probability, iou, self.none, depths_known=first.found.depths_known)


def identify(
    touches: Sequence[Touch], models: Library | Sequence[Localizer], located: int = LOCATED,
    null: NullEvidence | None = None,
) -> Identification:  # fmt: skip
    """Return the probability that each of the models' objects was touched, and the probability of "none of these".

    If there are several touches, each needs `T_base_sensor` (4, 4), metres. The most similar objects are searched
    roughly, and the best `located` of them are located. The probabilities of poses are fitted only to objects
    with a probability of at least LEAST_REPORTED. The order of the models does not matter. Raises TactileLocError for
    touches of another sensor, several touches without sensor poses, models that share a name, or no models.
    """
    library = models if isinstance(models, Library) else Library(models)
    if not touches:
        raise TouchError("there is no touch to identify; give at least one")
    if located < 1:
        raise ConfigError(f"the number of objects to locate cannot be {located}; give 1 or more")
    if len(touches) > 1:
        require_sensor_poses([touch.T_base_sensor for touch in touches])
    comparison = library.compare(touches, EXAMINED)
    alike = comparison.alike
    rough = _look_into(library, comparison)
    chosen = np.lexsort((-alike, -rough))[:located]
    tried = _Tried(library, touches)
    with library.progress.task("locating objects", len(chosen)) as advance:
        for _ in map_in_threads(partial(tried.locate, scalings=TYPICAL), map(int, chosen)):
            advance(1)
    null = null or NullEvidence()
    p, none = null.probabilities(tried.misfits, len(touches))
    while probable := [k for k in sorted(tried.unfitted) if p[k] >= LEAST_REPORTED]:
        for k in probable:
            tried.locate(k)
        p, none = null.probabilities(tried.misfits, len(touches))
    objects = [
        KnownObject(
            name, float(p[k]), float(alike[k]), float(rough[k]), float(tried.misfits[k]), tried.found.get(k),
            k not in tried.unfitted,
        )
        for k, name in enumerate(library.names)
    ]  # fmt: skip
    return Identification(tuple(objects[k] for k in np.lexsort((-alike, -rough, -p))), none)


class _Tried:
    """The located objects of a library.

    `found` are their locations, and `misfits` (K,), nats, are those of all objects, infinite if an object was not
    found. `unfitted` are the numbers of the objects that were located without a fit of their probabilities.
    """

    def __init__(self, library: Library, touches: Sequence[Touch]) -> None:
        self.library, self.touches = library, touches
        self.found: dict[int, Localization] = {}
        self.misfits = np.full(len(library), np.inf)
        self.unfitted: set[int] = set()

    def locate(self, k: int, scalings: Scalings | None = None) -> None:
        """Locate object k, with `scalings` instead of a fit, unless the user gave a temperature."""
        with self.library.use(k) as model:
            scalings = scalings if model.config.temperature is None else None
            answer = _locate(model, self.touches, scalings)
            self.misfits[k] = np.inf if answer is None else measure_misfit(model, answer)
        self.found.pop(k, None)
        self.unfitted.discard(k)
        if answer is not None:
            self.found[k] = answer
            if scalings is not None:
                self.unfitted.add(k)


def measure_misfit(model: Localizer, found: Localization) -> float:
    """Return the evidence, nats, that the best hypothesis lacks to explain the touches fully."""
    views = [make_view(found.touch, model, touch) for touch in found.touches]
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    seen = None if len(views) == 1 else find_seen_poses(views, [h.refined for h in found.hypotheses])
    evidence = compare_where_seen(views, poses, seen)[1].sum(axis=1)
    fully = sum(map(_compute_full_evidence, (*found.touches, *found.left_out)))  # no pose explains the left-out ones
    return max(0.0, fully - float(evidence.max()))


def _look_into(library: Library, comparison: Comparison) -> Float64:
    """Search likely objects roughly; return the mean imprint IoUs (K,) of all objects, 0 for those not searched.

    The votes choose the objects that are examined, and the examination chooses those that are searched.
    """
    chosen = EXAMINED.choose(comparison.nats)
    with library.progress.task("examining objects", len(chosen)) as advance:
        examined = []
        for one in map_in_threads(partial(library.examine, comparison=comparison), chosen):
            examined.append(one)
            advance(1)
    searched = LOOKED_INTO.choose(np.array([one.nats for one in examined]))
    rough = np.zeros(len(library))
    with library.progress.task("looking into objects", len(searched)) as advance:
        ious = map_in_threads(lambda n: library.look_into(chosen[n], comparison, examined[n]), searched)
        for n, iou in zip(searched, ious, strict=True):
            rough[chosen[n]] = iou
            advance(1)
    return rough


def _locate(model: Localizer, touches: Sequence[Touch], scalings: Scalings | None) -> Localization | None:
    """Locate an object; return None if none of its poses explains the touches."""
    try:
        return localize_together([(model, touch) for touch in touches], scalings=scalings)
    except StoreError:
        raise
    except TactileLocError:
        return None


def _compute_full_evidence(touch: Touch) -> float:
    """Return the evidence, nats, of a pose whose contact is exactly the touch's contact."""
    geometry, shape = touch.thin(IOU_PX)
    seen = shape.depth_m
    fully = compare_imprints(seen[None], seen, shape.press_depth_m, geometry.observed_mask, geometry.pixel_pitch_m)
    return float(fully.evidence[0])
