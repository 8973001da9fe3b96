"""The search of a library for the parts that touches may be of: two quick comparisons, before parts are located.

First, each touch votes for places of each part, by descriptors that were computed once: see `votes.py`. The best
similarities of its places bound the votes of a part, so that the votes of most parts need not be joined. A rough search
starts from the places of the votes. It registers a few poses roughly to all touches, which takes much less time than
locating the part.

The votes read only the descriptors, which are mapped from the disk. A part's record is read when the part is searched.
The parts used last stay in memory.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tactile_loc import Localizer, RunConfig, StageStore
from tactile_loc.plugin import ConfigError, Poses, Progress, Touch
from tactile_loc.plugin.helpers import ByteCache, SymmetryGroup, TouchBounds, bound_touch, compute_full_evidence, invert

from tactile_loc_library.descriptor import load_descriptor
from tactile_loc_library.library import Library
from tactile_loc_library.record import PLACES_VERSION, LibraryError, PartRecord, PlaceGrid
from tactile_loc_library.similarity import find_most_similar
from tactile_loc_library.votes import (
    STEP_RAD,
    DescribedPlaces,
    DescribedTouches,
    Shortlist,
    join_votes,
    rate_alone,
    rate_object,
)

KEPT_BYTES = 768 * 2**20
TURNS = 36
YAWS_RAD = 2 * np.pi * np.arange(TURNS) / TURNS
# of each part, for each touch: places that are compared in detail, and poses that are kept; then registered poses
COMPARED, PROPOSED, REGISTERED = 60, 300, 30
# The log-likelihood falls by EXCESS_NATS log(EXCESS_FREE + x) if the best place leaves the bounds of a touch by as much
# as x pixels of a patch at the full press. Both numbers were fitted to touches of generated and real parts.
EXCESS_NATS, EXCESS_FREE = 3.0, 0.5
SAME_SIZE_M = 1e-4  # parts whose boxes differ less may resemble each other: mirror images, or parts with a hole more
SOFTER = 2.0  # factor on the temperature of the training: similarities of wrong places have heavy tails


@dataclass(frozen=True, eq=False)
class VoteResult:
    """The votes of touches for the places of K parts. `nats` (K,) are log-likelihoods, apart from a constant.

    Those of parts that the votes do not choose may be upper bounds: see `PartSearch.compare`. `bounds` are those of
    each touch at YAWS_RAD.
    """

    touches: tuple[Touch, ...]
    described: DescribedTouches
    bounds: tuple[TouchBounds, ...]
    nats: NDArray[np.float64]
    temperature: float

    @property
    def alike(self) -> NDArray[np.float64]:
        """The mean similarity (K,) of the touches and the most similar places of each part; at most 1, unitless.

        The less the places are related as the touches are, the lower it is. It is an upper bound where `nats` are.
        """
        return self.nats * self.temperature / len(self.touches)

    @cached_property
    def full_evidence(self) -> float:
        """The evidence of all touches, nats, for a pose that explains them fully."""
        return sum(map(compute_full_evidence, self.touches))


@dataclass(frozen=True, eq=False)
class ExaminedPart:
    """Likely `poses` of a part for each touch, (PROPOSED, 4, 4), metres, in the touch's sensor frame.

    `nats` is the log-likelihood of the touches, apart from a constant that all parts share. It is an upper bound if
    that of the votes is one: see `VoteResult`.
    """

    poses: tuple[Poses, ...]
    nats: float


class RoughFit(NamedTuple):
    """How well the best pose of a rough search explains the touches.

    `misfit`, nats, is the evidence that it lacks to explain them fully. `iou`, 0 to 1, is its mean imprint IoU.
    """

    misfit: float
    iou: float


class OpenPart(NamedTuple):
    """A part that has been read from the disk, with its localizer."""

    record: PartRecord
    model: Localizer

    @property
    def nbytes(self) -> int:
        """The memory of the part, bytes."""
        return self.record.patches.nbytes + self.record.vectors.nbytes + self.model.loaded_bytes


class PartSearch:
    """The parts of a library that may have been touched, for the sensor and the other settings of `config`.

    The parts that were used last are kept in memory, up to `most_bytes` and the part in use. Raises ConfigError if the
    settings do not suit identification, and LibraryError if the library is empty or of another version.
    """

    def __init__(
        self,
        library: Library,
        config: RunConfig,
        store: StageStore | None = None,
        progress: Progress | None = None,
        most_bytes: int = KEPT_BYTES,
    ) -> None:
        if not len(library):
            raise LibraryError(f"the library {library.path} has no part; add one with `tactile-loc library add`")
        if library.manifest.descriptor != load_descriptor().digest:
            raise LibraryError(
                f"another version of tactile-loc computed the vectors of {library.path}; build the library again"
            )
        if config.grid != RunConfig().grid:
            raise ConfigError(f"the grid of the library {library.path} is fixed; leave out the options of `grid`")
        self.library, self.config, self.store = library, config, store or StageStore()
        self.names, self.progress = library.names, progress or Progress()
        self._rows = list(library.rows.values())
        self._kept: ByteCache[int, OpenPart] = ByteCache(most_bytes, lambda part: part.nbytes)
        self._described: dict[int, DescribedPlaces] = {}
        if self._first.encoder.capabilities.needs_training:
            raise ConfigError(
                "the encoder has to be trained on one object, so it cannot compare several; choose `encoder` pixel"
            )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def nbytes(self) -> int:
        """The memory of the parts that are kept, bytes."""
        return self._kept.nbytes

    @contextmanager
    def use(self, k: int) -> Iterator[OpenPart]:
        """Yield part k, read from the disk if it is not kept. Afterwards, parts used less recently may be dropped."""
        part = self._kept.get(k, partial(self._open, k))
        try:
            yield part
        finally:
            self._kept.keep(k, part)

    def _open(self, k: int) -> OpenPart:
        record = self.library.read(self.names[k])
        return OpenPart(record, make_localizer(record, self.config, self.store, self.progress))

    def find_same_size(self, some: Sequence[int]) -> list[int]:
        """Return the parts, except `some`, with the same size as one of `some`.

        The edges of their boxes differ by less than SAME_SIZE_M, in any order of the axes.
        """
        sizes_m = np.sort([(1e-3 * row.x_mm, 1e-3 * row.y_mm, 1e-3 * row.z_mm) for row in self._rows], axis=1)
        near = [np.abs(sizes_m - sizes_m[k]).max(axis=1) < SAME_SIZE_M for k in some]
        same = np.flatnonzero(np.any(near, axis=0))
        return [int(k) for k in same if k not in some]

    def compare(self, touches: Sequence[Touch], shortlist: Shortlist | None = None) -> VoteResult:
        """Compare touches with all parts. If there are several, each needs `T_base_sensor`.

        With a `shortlist`, the log-likelihoods of parts that it does not choose may be upper bounds. They are found
        sooner, and the shortlist chooses the same parts. Raises TouchError for a touch of another sensor.
        """
        for touch in touches:
            self._first.require_own(touch)
        descriptor = load_descriptor()
        described, temperature = DescribedTouches.of(touches, descriptor), SOFTER * descriptor.temperature
        with self.progress.task("comparing objects", len(self)) as advance:
            similar = self.find_most_similar(described.rounded, advance)
        nats = rate_alone(similar, temperature).sum(axis=0)
        if len(touches) > 1:
            rate = partial(self._rate, described, temperature)
            nats = np.array([*map(rate, range(len(self)))]) if shortlist is None else shortlist.rate(nats, rate)
        bounds = tuple(bound_touch(touch, YAWS_RAD) for touch in touches)
        return VoteResult(tuple(touches), described, bounds, nats, temperature)

    def find_most_similar(self, touches: NDArray[np.int16], advance: Callable[[int], Any]) -> NDArray[np.int32]:
        """Return the greatest similarities (T, K), in 1 / UNIT, of rounded touches (T, D) and the places of each part.

        They are found in one pass through the shards. Calls `advance` with the number of parts just compared.
        """
        found = np.empty((len(touches), len(self)), np.int32)
        for shard, (numbers, first, places) in zip(self.library.shards, self._extents, strict=True):
            found[:, numbers] = find_most_similar(shard.vectors, touches, first, places)
            advance(len(numbers))
        return found

    def _rate(self, touches: DescribedTouches, temperature: float, k: int, least: float = -np.inf) -> float:
        return rate_object(self.describe(k), touches, temperature, least)

    def rate(self, k: int, votes: VoteResult) -> float:
        """Return the log-likelihood of part k by the votes: see `VoteResult`. It is no upper bound."""
        return self._rate(votes.described, votes.temperature, k)

    def examine(self, k: int, votes: VoteResult) -> ExaminedPart:
        """Compare the touches in detail with the places of part k for which they voted, without registration."""
        joined = join_votes(self.describe(k), votes.described, votes.temperature)
        poses, nats = [], float(votes.nats[k])
        with self.use(k) as part:
            places = part.record.places
        for touch, bounds, numbers, likely in zip(
            votes.touches, votes.bounds, joined.numbers, joined.nats, strict=True
        ):
            some = numbers[np.argsort(-likely, kind="stable")[:COMPARED]]
            place, yaw = (of.ravel() for of in np.meshgrid(some, np.arange(TURNS), indexing="ij"))
            excess = bounds.measure_excess(places, place, yaw)
            best = np.argsort(excess, kind="stable")[:PROPOSED]
            poses.append(bounds.T_sensor_anchor @ places.poses(place[best], YAWS_RAD[yaw[best]]))
            nats -= EXCESS_NATS * np.log(EXCESS_FREE + excess.min() / touch.press_depth_m**2)
        return ExaminedPart(tuple(poses), nats)

    def look_into(self, k: int, votes: VoteResult, examined: ExaminedPart) -> RoughFit:
        """Search part k roughly, starting from the examined poses."""
        with self.use(k) as part:
            views = part.model.make_views(votes.touches)
            poses = [invert(view.T_sensor_first) @ some for view, some in zip(views, examined.poses, strict=True)]
            evidence, iou = part.model.source.searched.fit_roughly(views, np.concatenate(poses), REGISTERED)
        return RoughFit(votes.full_evidence - evidence, iou)

    def describe(self, k: int) -> DescribedPlaces:
        """Return the places of part k with their descriptors, mapped from the disk."""
        if k not in self._described:
            row = self._rows[k]
            vectors, placements = self.library.map_arrays(row)
            symmetry = SymmetryGroup.parse(row.symmetry, (row.centre_x_m, row.centre_y_m, row.centre_z_m))
            self._described[k] = DescribedPlaces(vectors, placements, symmetry.list_elements(STEP_RAD))
        return self._described[k]

    @cached_property
    def _extents(self) -> list[NDArray[np.int64]]:
        """The numbers (3, K) of each shard's parts, with their first rows and their numbers of places."""
        number = {name: k for k, name in enumerate(self.names)}
        return [
            np.array([(number[row.name], row.first, row.places) for row in shard.parts], int).reshape(-1, 3).T
            for shard in self.library.shards
        ]

    @cached_property
    def _first(self) -> Localizer:
        return self._open(0).model


def open_localizer(
    record: PartRecord,
    sensor: str | dict[str, Any] = "gelslim",
    store: StageStore | str | Path | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Localizer:
    """Return a localizer of a part for a sensor. Its places are those of the record.

    `settings` are as in `Localizer.create`, except `grid`, which is that of the record. Raises LibraryError if another
    version of tactile-loc made the record, and TactileLocError for bad settings.
    """
    if "grid" in settings:
        raise ConfigError("the grid of a part is that of its library; leave out `grid`")
    config = RunConfig.from_dict({"sensor": sensor, **settings}, "open_localizer")
    return make_localizer(record, config, store if isinstance(store, StageStore) else StageStore(store), progress)


def make_localizer(
    record: PartRecord, config: RunConfig, store: StageStore, progress: Progress | None = None
) -> Localizer:
    """Return a localizer of a part with the settings of `config`, except its object and grid.

    Its places are those of the record. Raises LibraryError if another version of tactile-loc made the record.
    """
    grid = PlaceGrid(record.grid["name"], record.grid["options"])
    chosen = RunConfig.from_dict({"object": {"path": record.source}, "grid": {"name": grid.name, **grid.options}})
    config = config.model_copy(update={"object": chosen.object, "grid": chosen.grid})
    if grid.describe() != record.grid or record.places_version != PLACES_VERSION:
        raise LibraryError(f"another version of tactile-loc made the places of {record.name}; build the library again")
    return Localizer(config, record.object, store, progress, partial(getattr, record, "places"))
