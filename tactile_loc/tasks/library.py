"""A library of objects, and two quick comparisons of all objects with touches.

First, each touch votes for places of each object, by descriptors that were computed once: see `votes.py`. The best
similarities of its places bound the votes of an object, so that the votes of most objects need not be joined. A rough
search starts from the places of the votes. It registers a few poses roughly to all touches, which takes much less time
than locating the object.

The votes read only the descriptors from the store. An object's places are read when it is searched. The parts used last
stay in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.descriptor.descriptor import load_descriptor
from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.places.imprints import compare_imprints
from tactile_loc.core.runtime.caches import ByteCache
from tactile_loc.core.sensing.scene import IOU_PX
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.sources.place_search import PlaceSearch, TouchBounds, bound_touch
from tactile_loc.tasks.library_parts import GivenParts, Parts, open_search
from tactile_loc.tasks.shortlist import Shortlist
from tactile_loc.tasks.votes import Asked, DescribedPlaces, join_votes, rate_alone, rate_object

DESCRIBED, WHOLE = "described", "whole"  # what is kept of an object
KEPT_BYTES = 768 * 2**20
TURNS = 36
YAWS_RAD = 2 * np.pi * np.arange(TURNS) / TURNS
# of each object, for each touch: places that are compared in detail, and poses that are kept; then registered poses
COMPARED, PROPOSED, REGISTERED = 60, 300, 30
# The log-likelihood falls by EXCESS_NATS log(EXCESS_FREE + x) if the best place leaves the bounds of a touch by as much
# as x pixels of a patch at the full press. Both numbers were fitted to touches of generated and real parts.
EXCESS_NATS, EXCESS_FREE = 3.0, 0.5
SAME_SIZE_M = 1e-4  # parts whose boxes differ less may resemble each other: mirror images, or parts with a hole more
SOFTER = 2.0  # factor on the temperature of the training: similarities of wrong places have heavy tails


@dataclass(frozen=True, eq=False)
class Comparison:
    """The votes of touches for the places of K objects. `nats` (K,) are log-likelihoods, apart from a constant.

    Those of objects that the votes do not choose may be upper bounds: see `Library.compare`. `bounds` are those of each
    touch at YAWS_RAD.
    """

    touches: tuple[Touch, ...]
    asked: Asked
    bounds: tuple[TouchBounds, ...]
    nats: NDArray[np.float64]
    temperature: float

    @property
    def alike(self) -> NDArray[np.float64]:
        """The mean similarity (K,) of the touches and the most similar places of each object; at most 1, unitless.

        The less the places are related as the touches are, the lower it is. It is an upper bound where `nats` are.
        """
        return self.nats * self.temperature / len(self.touches)

    @cached_property
    def full_evidence(self) -> float:
        """The evidence of all touches, nats, for a pose that explains them fully."""
        return sum(map(compute_full_evidence, self.touches))


@dataclass(frozen=True, eq=False)
class Examined:
    """Likely `poses` of an object for each touch, (PROPOSED, 4, 4), metres, in the touch's sensor frame.

    `nats` is the log-likelihood of the touches, apart from a constant that all objects share. It is an upper bound if
    that of the votes is one: see `Comparison`.
    """

    poses: tuple[Poses, ...]
    nats: float


class RoughFit(NamedTuple):
    """How well the best pose of a rough search explains the touches.

    `misfit`, nats, is the evidence that it lacks to explain them fully. `iou`, 0 to 1, is its mean imprint IoU.
    """

    misfit: float
    iou: float


class Library:
    """The objects that may have been touched, each with its localizer, all for one sensor.

    The order of the objects does not matter. The objects' places and banks that were used last are kept in
    memory, up to `most_bytes` and the object in use. The rest is released, and read again from the store when it is
    used. `models` are localizers, or the parts of a library on disk: see `library_parts.py`. Raises TactileLocError if
    there are no objects, if two objects share a name, or if a localizer does not suit identification.
    """

    def __init__(self, models: Sequence[Localizer], most_bytes: int = KEPT_BYTES) -> None:
        self.models: Parts = models if isinstance(models, Parts) else GivenParts(models)
        self.names = self.models.names
        self.progress = self.models.progress
        self._kept: ByteCache[tuple[int, str], DescribedPlaces | Localizer] = ByteCache(
            most_bytes, _count_bytes, _release
        )

    def __len__(self) -> int:
        return len(self.models)

    @property
    def nbytes(self) -> int:
        """The memory of what is kept of the objects, bytes, except mapped descriptors."""
        return self._kept.nbytes

    @contextmanager
    def use(self, k: int) -> Iterator[Localizer]:
        """Yield the localizer of object k. Afterwards, objects used less recently are released if necessary."""
        model = cast(Localizer, self._kept.get((k, WHOLE), lambda: self.models[k]))
        try:
            yield model
        finally:
            self._kept.keep((k, WHOLE), model)

    def find_same_size(self, some: Sequence[int]) -> list[int]:
        """Return the objects, except `some`, with the same size as one of `some`.

        The edges of their boxes differ by less than SAME_SIZE_M, in any order of the axes.
        """
        sizes_m = np.sort(self.models.extents_m, axis=1)
        near = [np.abs(sizes_m - sizes_m[k]).max(axis=1) < SAME_SIZE_M for k in some]
        same = np.flatnonzero(np.any(near, axis=0))
        return same[~np.isin(same, some)].tolist()

    def search(self, k: int) -> PlaceSearch:
        """Return the search of object k. Its places are read from the store, or found if they are not stored."""
        with self.use(k) as model:
            return open_search(model)

    def compare(self, touches: Sequence[Touch], shortlist: Shortlist | None = None) -> Comparison:
        """Compare touches with all objects. If there are several, each needs `T_base_sensor`.

        With a `shortlist`, the log-likelihoods of objects that it does not choose may be upper bounds. They are found
        sooner, and the shortlist chooses the same objects. Raises TouchError for a touch of another sensor.
        """
        for touch in touches:
            self.models.require_own(touch)
        descriptor = load_descriptor()
        asked, temperature = Asked.about(touches, descriptor), SOFTER * descriptor.temperature
        with self.progress.task("comparing objects", len(self)) as advance:
            similar = self.models.find_most_similar(asked.rounded, self.describe, advance)
        nats = rate_alone(similar, temperature).sum(axis=0)
        if len(touches) > 1:
            rate = partial(self._rate, asked, temperature)
            nats = np.array([*map(rate, range(len(self)))]) if shortlist is None else shortlist.rate(nats, rate)
        bounds = tuple(bound_touch(touch, YAWS_RAD) for touch in touches)
        return Comparison(tuple(touches), asked, bounds, nats, temperature)

    def _rate(self, asked: Asked, temperature: float, k: int, least: float = -np.inf) -> float:
        return rate_object(self.describe(k), asked, temperature, least)

    def rate(self, k: int, comparison: Comparison) -> float:
        """Return the log-likelihood of object k by the votes: see `Comparison`. It is no upper bound."""
        return self._rate(comparison.asked, comparison.temperature, k)

    def examine(self, k: int, comparison: Comparison) -> Examined:
        """Compare the touches in detail with the places of object k for which they voted, without registration."""
        search, described = self.search(k), self.describe(k)
        votes = join_votes(described, comparison.asked, comparison.temperature)
        poses, nats = [], float(comparison.nats[k])
        for touch, bounds, numbers, likely in zip(
            comparison.touches, comparison.bounds, votes.numbers, votes.nats, strict=True
        ):
            some = numbers[np.argsort(-likely, kind="stable")[:COMPARED]] * described.step
            proposed, excess = _rotate_places(bounds, search, some)
            poses.append(proposed)
            nats -= EXCESS_NATS * np.log(EXCESS_FREE + excess.min() / touch.press_depth_m**2)
        return Examined(tuple(poses), nats)

    def look_into(self, k: int, comparison: Comparison, examined: Examined) -> RoughFit:
        """Search object k roughly, starting from the examined poses."""
        with self.use(k) as model:
            views = model.make_views(comparison.touches)
            poses = [invert(view.T_sensor_first) @ some for view, some in zip(views, examined.poses, strict=True)]
            evidence, iou = model.source.fit_roughly(views, np.concatenate(poses), REGISTERED)
            return RoughFit(comparison.full_evidence - evidence, iou)

    def describe(self, k: int) -> DescribedPlaces:
        """Return the places of object k with their descriptors, stored or computed now."""

        described = self._kept.get((k, DESCRIBED), lambda: self.models.describe(k, partial(self.use, k)))
        return cast(DescribedPlaces, described)


def compute_full_evidence(touch: Touch) -> float:
    """Return the evidence, nats, for a pose whose contact is exactly the touch's contact."""
    geometry, shape = touch.thin(IOU_PX)
    seen = shape.depth_m
    fully = compare_imprints(seen[None], seen, shape.press_depth_m, geometry.observed_mask, geometry.pixel_pitch_m)
    return float(fully.evidence[0])


def _count_bytes(kept: DescribedPlaces | Localizer) -> int:
    return kept.loaded_bytes if isinstance(kept, Localizer) else kept.nbytes


def _release(kept: DescribedPlaces | Localizer) -> None:
    if isinstance(kept, Localizer):
        kept.release()


def _rotate_places(
    bounds: TouchBounds, search: PlaceSearch, numbers: NDArray[np.int64]
) -> tuple[Poses, NDArray[np.float32]]:
    """Return the poses (K, 4, 4), metres, of those rotated places `numbers` that explain a touch best.

    Also returns how far they leave the bounds of the touch (K,), square metres: see `TouchBounds`.
    """
    place, yaw = (of.ravel() for of in np.meshgrid(numbers, np.arange(TURNS), indexing="ij"))
    excess = bounds.measure_excess(search.places, place, yaw)
    best = np.argsort(excess, kind="stable")[:PROPOSED]
    poses = bounds.T_sensor_anchor @ search.places.poses(place[best], YAWS_RAD[yaw[best]])
    return np.asarray(poses), excess[best]
