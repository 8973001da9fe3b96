"""A library of objects, and two quick comparisons of all objects with touches.

First, each touch votes for places of each object, by descriptors that were computed once: see `votes.py`. This takes
milliseconds for each object. A rough search starts from these places. It registers a few poses roughly to all touches,
and takes a thirtieth of the time of locating the object.

The votes read only the descriptors from the store. An object's places are read when it is searched. The parts used last
stay in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.byte_cache import ByteCache
from tactile_loc.core.descriptor.descriptor import load_descriptor
from tactile_loc.core.errors import ConfigError, ObjectError, quote
from tactile_loc.core.geometry.rigid import Poses, invert, make_transform
from tactile_loc.core.sensing.rotated_patches import find_anchor
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.localizer import Localizer, make_view
from tactile_loc.locate.search import PlaceSearch, compute_rough_iou, measure_touch_excess
from tactile_loc.locate.stored_places import make_places_key
from tactile_loc.store.keys import StageKey
from tactile_loc.store.workspace import Workspace
from tactile_loc.tasks.votes import STEP_RAD, Asked, DescribedPlaces, join_votes, rate_object

STAGE, STAGE_VERSION = "descriptions", 1
DESCRIBED, WHOLE = "described", "whole"  # what is kept of an object
KEPT_BYTES = 2 * 2**30
MOST_PLACES = 3000  # per object, evenly spread
TURNS = 36
YAWS_RAD = 2 * np.pi * np.arange(TURNS) / TURNS
# of each object, for each touch: places that are compared in detail, and poses that are kept; then registered poses
COMPARED, PROPOSED, REGISTERED = 60, 300, 30
# The log-likelihood falls by EXCESS_NATS log(EXCESS_FREE + x) if the best place leaves the bounds of a touch by as much
# as x pixels of a patch at the full press. Both numbers were fitted to touches of generated and real parts.
EXCESS_NATS, EXCESS_FREE = 8.0, 0.5


@dataclass(frozen=True, eq=False)
class Comparison:
    """The votes of touches for the places of K objects. `nats` (K,) are log-likelihoods, apart from a constant."""

    touches: tuple[Touch, ...]
    asked: Asked
    nats: NDArray[np.float64]
    temperature: float

    @property
    def alike(self) -> NDArray[np.float64]:
        """The mean similarity (K,) of the touches and the most similar places of each object; at most 1, unitless."""
        return self.nats * self.temperature / len(self.touches)


@dataclass(frozen=True, eq=False)
class Examined:
    """Likely `poses` of an object for each touch, (PROPOSED, 4, 4), metres, in the touch's sensor frame.

    `nats` is the log-likelihood of the touches, apart from a constant that all objects share.
    """

    poses: tuple[Poses, ...]
    nats: float


class Library:
    """The objects that may have been touched, each with its localizer, all for one sensor.

    The order of the objects does not matter. The objects' descriptors, places and banks that were used last are kept in
    memory, up to `most_bytes` and the object in use. The rest is released, and read again from the store when it is
    used. Raises TactileLocError if there are no objects, if two objects share a name, or if a localizer does not suit
    identification.
    """

    def __init__(self, models: Sequence[Localizer], most_bytes: int = KEPT_BYTES) -> None:
        if not models:
            raise ObjectError("there is no object to identify; give at least one")
        others = [model for model in models if not isinstance(model, Localizer)]
        if others:
            raise ObjectError(f"{quote(others[0])} is not a Localizer; make one for each object with Localizer.create")
        self.models = tuple(sorted(models, key=lambda model: model.object.name))
        self.names = [model.object.name for model in self.models]
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise ObjectError(f"two objects are called {twice[0]}; give each its own name")
        listed = [model.object.name for model in self.models if not model.sampler.capabilities.places]
        if listed:
            raise ConfigError(_explain_listed(listed[0]))
        if self.models[0].encoder.capabilities.needs_training:
            raise ConfigError(
                "the encoder has to be trained on one object, so it cannot compare several; choose `encoder` pixel"
            )
        self.progress = self.models[0].progress
        self._kept: ByteCache[tuple[int, str], DescribedPlaces | Localizer] = ByteCache(
            most_bytes, _count_bytes, _release
        )

    def __len__(self) -> int:
        return len(self.models)

    @property
    def nbytes(self) -> int:
        """The memory of the objects' descriptors, places and banks that are kept, bytes."""
        return self._kept.nbytes

    @contextmanager
    def use(self, k: int) -> Iterator[Localizer]:
        """Yield the localizer of object k. Afterwards, objects used less recently are released if necessary."""
        try:
            yield self.models[k]
        finally:
            self._kept.keep((k, WHOLE), self.models[k])

    def search(self, k: int) -> PlaceSearch:
        """Return the search of object k. Its places are read from the store, or found if they are not stored."""
        with self.use(k) as model:
            return _open_search(model)

    def compare(self, touches: Sequence[Touch]) -> Comparison:
        """Compare touches with all objects. If there are several, each needs `T_base_sensor`.

        Raises TouchError for a touch of another sensor.
        """
        for model in self.models:
            for touch in touches:
                model.require_own(touch)
        descriptor = load_descriptor()
        asked = Asked.about(touches, descriptor)
        nats = np.empty(len(self))
        with self.progress.task("comparing objects", len(self)) as advance:
            for k in range(len(self)):
                nats[k] = rate_object(self.describe(k), asked, descriptor.temperature)
                advance(1)
        return Comparison(tuple(touches), asked, nats, descriptor.temperature)

    def examine(self, k: int, comparison: Comparison) -> Examined:
        """Compare the touches in detail with the places of object k for which they voted, without registration."""
        search = self.search(k)
        votes = join_votes(self.describe(k), comparison.asked, comparison.temperature)
        poses, nats = [], float(comparison.nats[k])
        for touch, numbers, likely in zip(comparison.touches, votes.numbers, votes.nats, strict=True):
            some = numbers[np.argsort(-likely, kind="stable")[:COMPARED]] * _step(search)
            proposed, excess = _rotate_places(touch, search, some)
            poses.append(proposed)
            nats -= EXCESS_NATS * np.log(EXCESS_FREE + excess.min() / touch.press_depth_m**2)
        return Examined(tuple(poses), nats)

    def look_into(self, k: int, comparison: Comparison, examined: Examined) -> float:
        """Search object k roughly, starting from the examined poses; return the best mean imprint IoU, 0 to 1."""
        with self.use(k) as model:
            first, *_ = touches = comparison.touches
            views = [make_view(first, model, touch) for touch in touches]
            poses = [invert(view.T_sensor_first) @ some for view, some in zip(views, examined.poses, strict=True)]
            return compute_rough_iou(views, _open_search(model), np.concatenate(poses), REGISTERED)

    def describe(self, k: int) -> DescribedPlaces:
        """Return the places of object k with their descriptors, stored or computed now."""

        def describe() -> DescribedPlaces:
            with self.use(k) as model:  # the places are opened if their descriptors are not stored yet
                return _load_description(model)

        return cast(DescribedPlaces, self._kept.get((k, DESCRIBED), describe))


def _count_bytes(kept: DescribedPlaces | Localizer) -> int:
    return kept.loaded_bytes if isinstance(kept, Localizer) else kept.nbytes


def _release(kept: DescribedPlaces | Localizer) -> None:
    if isinstance(kept, Localizer):
        kept.release()


def _load_description(model: Localizer) -> DescribedPlaces:
    """Return some of an object's places with their descriptors, stored or computed now."""
    key = StageKey(STAGE, STAGE_VERSION, {
        "places": make_places_key(model.sampler, model.scene).digest, "descriptor": load_descriptor().digest,
        "most": MOST_PLACES,
    }, model.object.name)  # fmt: skip
    stored = model.store.build(key, partial(_save_description, model))
    return DescribedPlaces(*(stored.load_array(name) for name in ("vectors", "at", "copies")))


def _save_description(model: Localizer, work: Workspace) -> None:
    search = _open_search(model)
    copies = model.object.symmetry.list_elements(STEP_RAD)
    described = DescribedPlaces.of(search.places, copies, load_descriptor(), slice(None, None, _step(search)))
    for name in ("vectors", "at", "copies"):
        work.save_array(name, getattr(described, name))


def _rotate_places(touch: Touch, search: PlaceSearch, numbers: NDArray[np.int64]) -> tuple[Poses, NDArray[np.float32]]:
    """Return the poses (K, 4, 4), metres, of those rotated places `numbers` that explain a touch best.

    Also returns how far they leave the bounds of the touch (K,), square metres: see `measure_touch_excess`.
    """
    anchor_m, R_sensor_gel = find_anchor(touch)
    place, yaw = (of.ravel() for of in np.meshgrid(numbers, np.arange(TURNS), indexing="ij"))
    excess = measure_touch_excess(touch, search.places, place, yaw, YAWS_RAD)
    best = np.argsort(excess, kind="stable")[:PROPOSED]
    poses = make_transform(R_sensor_gel, anchor_m) @ search.places.poses(place[best], YAWS_RAD[yaw[best]])
    return np.asarray(poses), excess[best]


def _open_search(model: Localizer) -> PlaceSearch:
    if model.search is None:
        raise ConfigError(_explain_listed(model.object.name))
    return model.search


def _explain_listed(name: str) -> str:
    return f"{name} has a grid of listed poses; to identify objects, choose the grid whole"


def _step(search: PlaceSearch) -> int:
    """Return the step between the places of an object that are described."""
    return -(-len(search.places) // MOST_PLACES)
