"""Which of several objects touches are of, or none of these, and where it is.

A glance at all objects says which are worth looking into, and a rough search of those which few are worth locating.
These are located, each by all touches, and weighed by the evidence by which hypotheses are weighed
(`imprints.py`). What counts is by how many nats the best pose of an object falls short of one that would explain
all touches fully: that does not depend on how much the touches show. An object that nobody has told of explains touches
about as well as the best of the others does, by chance; how well that is, "none of these", was fitted to simulated
touches of objects that were left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.errors import ConfigError, StoreError, TactileLocError, TouchError
from tactile_loc.core.sensing.imprints import compare_imprints
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.scene import IOU_PX, View
from tactile_loc.locate.hypotheses import compare_where_seen
from tactile_loc.locate.localizer import Localizer, localize_together, make_view
from tactile_loc.locate.results.localization import Localization
from tactile_loc.tasks.library import Glance, Library

Float64 = NDArray[np.float64]

LOOKED_INTO = 64  # objects that are, the most alike at a glance
LOCATED = 8  # of those, the ones that explain the touches best
SHORTFALLS = np.geomspace(0.3, 20, 30).round(2).tolist()  # that are tried, nats
TEMPERATURES = np.geomspace(0.3, 5, 15).round(2).tolist()
LEAST = 1e-3  # probability of the truth, lest one touch decide alone


@keep_old_names(shortfall="measure_misfit")
@dataclass(frozen=True)
class NullEvidence:
    """How well "none of these" explains touches, and by how many nats evidence has to differ to be believed e times as
    much, `temperature`.

    A single touch by `alone` nats less than fully, several by `together` nats each: what one touch shows many objects
    have somewhere, what several show at known distances few. Raises ConfigError unless all are positive.
    """

    alone: float = 1.97
    together: float = 6.28
    temperature: float = 0.45

    def __post_init__(self) -> None:
        if not min(self.alone, self.together, self.temperature) > 0:
            raise ConfigError(f"{self} cannot weigh objects; its numbers must be positive")

    def measure_misfit(self, touches: int) -> float:
        """Return by how many nats "none of these" falls short of explaining so many touches."""
        return self.alone if touches == 1 else touches * self.together

    def probabilities(self, misfits: Float64, touches: int) -> tuple[Float64, float]:
        """Return the probabilities (K,) of objects that fall short by nats (K,), infinite: impossible; and of none."""
        logits = -np.append(misfits, self.measure_misfit(touches)) / self.temperature
        weights = np.exp(logits - logits.max())
        p = weights / weights.sum()
        return p[:-1], float(p[-1])

    def loss(self, answers: Sequence[KnownAnswer]) -> float:
        """Return how improbable the truth of answers is, nats: the sum of negative log-likelihoods."""
        said = [(*self.probabilities(answer.misfits, answer.touches), answer.truth) for answer in answers]
        return -float(np.sum([np.log(max(none if k < 0 else p[k], LEAST)) for p, none, k in said]))


class KnownAnswer(NamedTuple):
    """What touches of a known object came to: by how many nats each of K objects falls short of explaining them, which
    of these it was, -1 if it was left out, and how many touches there were."""

    misfits: Float64
    truth: int
    touches: int


def fit_null_evidence(answers: Sequence[KnownAnswer]) -> NullEvidence:
    """Return the null evidence that makes the truth most probable: least mean negative log-likelihood."""
    single = [answer for answer in answers if answer.touches == 1]
    several = [answer for answer in answers if answer.touches > 1]

    def best_of(temperature: float) -> tuple[float, NullEvidence]:
        tried = [NullEvidence(nats, nats, temperature) for nats in SHORTFALLS]
        alone, together = (min(tried, key=lambda null: null.loss(some)) for some in (single, several))
        null = NullEvidence(alone.alone, together.together, temperature)
        return null.loss(answers), null

    return min(map(best_of, TEMPERATURES), key=lambda pair: pair[0])[1]


@keep_old_names(shortfall="misfit")
@dataclass(frozen=True, eq=False)
class KnownObject:
    """One object of the library, and what touches say of it.

    `alike` is how alike the touches and its places are at a glance, their mean, unitless. The most alike are looked
    into: `rough_iou` is how well a rough search explains the touches, imprint IoU, their mean, 0 for the others. The
    best of these are located: `found` is where it would be, None if it was not worth it or cannot be; `misfit` by
    how many nats its best pose explains the touches less than fully, infinite where there is none; `probability` that
    it is this one, 0 to 1.
    """

    name: str
    probability: float
    alike: float
    rough_iou: float
    misfit: float
    found: Localization | None


@dataclass(frozen=True, eq=False)
class Identification:
    """The objects, the most probable first, and the probability that the touches are of `none` of these.

    An object's pose is distributed as `KnownObject.found` says, given that it is the one.
    """

    objects: tuple[KnownObject, ...]
    none: float

    @property
    def best(self) -> KnownObject | None:
        """The object that the touches are of; None if none of these is more probable than each."""
        first = self.objects[0]
        return first if first.probability > self.none else None


def identify(
    touches: Sequence[Touch], models: Library | Sequence[Localizer], located: int = LOCATED,
    null: NullEvidence | None = None,
) -> Identification:  # fmt: skip
    """Return how probable it is that touches of one object are of each of the models' objects, or of none.

    Several touches each know `T_base_sensor`. The `located` objects are located that explain them best, roughly, of the
    LOOKED_INTO that are most alike at a glance. In which order models are given changes nothing. Raises TactileLocError
    for touches of another sensor, several of unknown sensor poses, models of one name, or none.
    """
    library = models if isinstance(models, Library) else Library(models)
    if not touches:
        raise TouchError("there is no touch to identify; give one at least")
    if located < 1:
        raise ConfigError(f"{located} objects cannot be located; it must be 1 or more")
    _require_poses(touches)
    glances = [library.glance(touch) for touch in touches]
    alike = np.mean([glance.alike for glance in glances], axis=0)
    rough = _look_into(library, glances, np.argsort(-alike, kind="stable")[:LOOKED_INTO])
    chosen = np.lexsort((-alike, -rough))[:located]
    misfits = np.full(len(library), np.inf)
    found: dict[int, Localization] = {}
    with library.progress.task("locating objects", len(chosen)) as advance:
        for k in chosen:
            answer = _locate(library.models[k], touches)
            if answer is not None:
                found[int(k)], misfits[k] = answer, measure_misfit(library.models[k], answer)
            advance(1)
    p, none = (null or NullEvidence()).probabilities(misfits, len(touches))
    objects = [
        KnownObject(name, float(p[k]), float(alike[k]), float(rough[k]), float(misfits[k]), found.get(k))
        for k, name in enumerate(library.names)
    ]
    return Identification(tuple(objects[k] for k in np.lexsort((-alike, -rough, -p))), none)


def measure_misfit(model: Localizer, found: Localization) -> float:
    """Return by how many nats the best hypothesis explains the touches less than a pose that explains them fully."""
    views = [make_view(found.touch, model, touch) for touch in found.touches]
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    seen = None if len(views) == 1 else _find_seen_poses(views, found)
    evidence = compare_where_seen(views, poses, seen)[1].sum(axis=1)
    fully = sum(
        _compute_full_evidence(touch) for touch in (*found.touches, *found.left_out)
    )  # of these nothing is explained
    return max(0.0, fully - float(evidence.max()))


def _look_into(library: Library, glances: Sequence[Glance], chosen: NDArray[np.int64]) -> Float64:
    """How well each object explains the touches, roughly (K,): imprint IoU; 0 for those that were not chosen."""
    rough = np.zeros(len(library))
    with library.progress.task("looking into objects", len(chosen)) as advance:
        for k in chosen:
            rough[k] = library.look_into(int(k), glances)
            advance(1)
    return rough


def _locate(model: Localizer, touches: Sequence[Touch]) -> Localization | None:
    """Where an object would be; None where no pose of it makes these touches."""
    try:
        return localize_together([(model, touch) for touch in touches])
    except StoreError:
        raise
    except TactileLocError:
        return None


def _require_poses(touches: Sequence[Touch]) -> None:
    from tactile_loc.core.slots.common_poses import require_sensor_poses

    if len(touches) > 1:
        require_sensor_poses([touch.T_base_sensor for touch in touches])


def _find_seen_poses(views: Sequence[View], found: Localization) -> Float64:
    """Where each of N sensors sees each of K hypotheses, (K, N, 4, 4), metres: as refined, or as said."""
    return np.stack([
        np.stack([view.T_sensor_first @ h.T_sensor_object for view in views])
        if h.refined.T_sensors_object is None or len(h.refined.T_sensors_object) != len(views)
        else h.refined.T_sensors_object
        for h in found.hypotheses
    ])  # fmt: skip


def _compute_full_evidence(touch: Touch) -> float:
    """The evidence, nats, of a pose whose contact is just what the touch shows."""
    geometry, shape = touch.thin(IOU_PX)
    seen = shape.depth_m
    fully = compare_imprints(seen[None], seen, touch.press_depth_m, geometry.observed_mask, geometry.pixel_pitch_m)
    return float(fully.evidence[0])
