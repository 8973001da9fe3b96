"""The parts of a library: localizers that are given, or records of a library on disk, which are opened when needed."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.descriptor.descriptor import load_descriptor
from tactile_loc.core.descriptor.similarity import find_most_similar
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.places.places import Places
from tactile_loc.core.runtime.errors import ConfigError, LibraryError, ObjectError, quote
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import WHOLE, RunConfig
from tactile_loc.library.folder import LibraryFolder
from tactile_loc.library.localizers import make_localizer
from tactile_loc.library.record import PartRecord
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.sources.place_search import PlaceSearch
from tactile_loc.locate.sources.stored_places import make_places_key
from tactile_loc.locate.sources.whole_object import WholeObjectSource
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace
from tactile_loc.tasks.votes import STEP_RAD, DescribedPlaces

STAGE, STAGE_VERSION = "descriptions", 1
MOST_PLACES = 3000  # of a given localizer's object, evenly spread

Use = Callable[[], AbstractContextManager[Localizer]]
Describe = Callable[[int], DescribedPlaces]
Advance = Callable[[int], None]


class Parts(Sequence[Localizer]):
    """The localizers of the parts, all for one sensor, sorted by name."""

    names: Sequence[str]
    progress: Progress

    def __len__(self) -> int:
        return len(self.names)

    @property
    @abstractmethod
    def extents_m(self) -> NDArray[np.float64]:
        """The sizes (K, 3) of the boxes around the parts, along the axes of their object frames, metres."""

    @abstractmethod
    def describe(self, k: int, use: Use) -> DescribedPlaces:
        """Return places of part k with their descriptors. `use` opens its localizer, if necessary."""

    def find_most_similar(self, touches: NDArray[np.int16], describe: Describe, advance: Advance) -> NDArray[np.int32]:
        """Return the greatest similarities (T, K), in 1 / UNIT, of rounded touches (T, D) and the places of each part.

        `describe` returns the places of a part. Calls `advance` with the number of parts just compared.
        """
        found = np.empty((len(touches), len(self)), np.int32)
        for k in range(len(self)):
            vectors = describe(k).vectors
            found[:, [k]] = find_most_similar(vectors, touches, np.zeros(1, int), np.array([len(vectors)]))
            advance(1)
        return found

    @abstractmethod
    def require_own(self, touch: Touch) -> None:
        """Raise TouchError if a touch is of another sensor."""


class GivenParts(Parts):
    """Localizers that are given. Their descriptors are stored, or computed when they are first used."""

    def __init__(self, models: Sequence[Localizer]) -> None:
        if not models:
            raise ObjectError("there is no object to identify; give at least one")
        others = [model for model in models if not isinstance(model, Localizer)]
        if others:
            raise ObjectError(f"{quote(others[0])} is not a Localizer; make one for each object with Localizer.create")
        self._models = tuple(sorted(models, key=lambda model: model.object.name))
        self.names = [model.object.name for model in self._models]
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise ObjectError(f"two objects are called {twice[0]}; give each its own name")
        listed = [model.object.name for model in self._models if not model.sampler.capabilities.places]
        if listed:
            raise ConfigError(_explain_listed(listed[0]))
        _require_untrained(self._models[0])
        self.progress = self._models[0].progress

    def __getitem__(self, k: Any) -> Any:
        return self._models[k]

    @cached_property
    def extents_m(self) -> NDArray[np.float64]:
        """The sizes (K, 3) of the boxes around the objects, along the axes of their frames, metres."""
        return np.stack([model.object.mesh.extents_m for model in self._models])

    def describe(self, k: int, use: Use) -> DescribedPlaces:
        """Return some places of part k with their descriptors, stored or computed now."""
        with use() as model:  # the places are opened if their descriptors are not stored yet
            key = StageKey(STAGE, STAGE_VERSION, {
                "places": make_places_key(model.sampler, model.scene).digest,
                "descriptor": load_descriptor().digest, "most": MOST_PLACES,
            }, model.object.name)  # fmt: skip
            stored = model.store.build(key, partial(_save_description, model))
            vectors, at, copies, step = (stored.load_array(name) for name in ("vectors", "at", "copies", "step"))
            return DescribedPlaces(vectors, at, copies, int(step))

    def require_own(self, touch: Touch) -> None:
        """Raise TouchError if a touch is of another sensor than a localizer."""
        for model in self._models:
            model.require_own(touch)


class StoredParts(Parts):
    """The parts of a library on disk, for the sensor and the other settings of `config`.

    Localizers are opened one by one, when they are used. The descriptors are mapped from the disk. Raises ConfigError
    if the settings do not suit identification, and LibraryError if the library is empty or of another version.
    """

    def __init__(
        self, folder: LibraryFolder, config: RunConfig, store: StageStore | None = None,
        progress: Progress | None = None,
    ) -> None:  # fmt: skip
        if not len(folder):
            raise LibraryError(f"the library {folder.path} has no part; add one with `tactile-loc library add`")
        if folder.manifest.descriptor != load_descriptor().digest:
            raise LibraryError(
                f"another version of tactile-loc computed the vectors of {folder.path}; build the library again"
            )
        if config.grid != WHOLE:
            raise ConfigError(f"the grid of the library {folder.path} is fixed; leave out the options of `grid`")
        self.folder, self.config, self.store = folder, config, store or StageStore()
        self.names, self.progress = folder.names, progress or Progress()
        self._rows = list(folder.rows.values())
        _require_untrained(self._first)

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[one] for one in range(len(self))[k]]
        record = self.folder.read(self.names[k])
        reread = _PlacesOf(self.folder, record)
        return make_localizer(record, self.config, self.store, self.progress, reread)

    @cached_property
    def extents_m(self) -> NDArray[np.float64]:
        """The sizes (K, 3) of the boxes around the parts, from the library's table, metres."""
        return 1e-3 * np.array([(row.x_mm, row.y_mm, row.z_mm) for row in self._rows])

    def describe(self, k: int, use: Use) -> DescribedPlaces:
        """Return the places of part k with their descriptors, mapped from the disk."""
        row = self._rows[k]
        vectors, placements = self.folder.map_arrays(row)
        symmetry = SymmetryGroup.parse(row.symmetry, (row.centre_x_m, row.centre_y_m, row.centre_z_m))
        return DescribedPlaces(vectors, placements, symmetry.list_elements(STEP_RAD))

    def find_most_similar(self, touches: NDArray[np.int16], describe: Describe, advance: Advance) -> NDArray[np.int32]:
        """Return the greatest similarities (T, K) as `Parts.find_most_similar`, from one pass through the shards."""
        found = np.empty((len(touches), len(self)), np.int32)
        for shard, (numbers, first, places) in zip(self.folder.shards, self._extents, strict=True):
            found[:, numbers] = find_most_similar(shard.vectors, touches, first, places)
            advance(len(numbers))
        return found

    def require_own(self, touch: Touch) -> None:
        """Raise TouchError if a touch is of another sensor than the library is used with."""
        self._first.require_own(touch)

    @cached_property
    def _extents(self) -> list[NDArray[np.int64]]:
        """The numbers (3, K) of each shard's parts, with their first rows and their numbers of places."""
        number = {name: k for k, name in enumerate(self.names)}
        return [
            np.array([(number[row.name], row.first, row.places) for row in shard.parts], int).reshape(-1, 3).T
            for shard in self.folder.shards
        ]

    @cached_property
    def _first(self) -> Localizer:
        first: Localizer = self[0]
        return first


class _PlacesOf:
    """Returns the places of a part. The record is kept until the first call only, and read again for later calls."""

    def __init__(self, folder: LibraryFolder, record: PartRecord) -> None:
        self.folder, self.name, self._record = folder, record.name, [record]

    def __call__(self) -> Places:
        record = self._record.pop() if self._record else self.folder.read(self.name)
        return record.places


def open_search(model: Localizer) -> PlaceSearch:
    """Return the search of a localizer. Raises ConfigError if its grid lists poses."""
    if not isinstance(model.source, WholeObjectSource):
        raise ConfigError(_explain_listed(model.object.name))
    return model.source.place_search


def _save_description(model: Localizer, work: Workspace) -> None:
    places = open_search(model).places
    step = -(-len(places) // MOST_PLACES)
    copies = model.object.symmetry.list_elements(STEP_RAD)
    described = DescribedPlaces.of(places, copies, load_descriptor(), step)
    for name in ("vectors", "at", "copies"):
        work.save_array(name, getattr(described, name))
    work.save_array("step", np.array(step))


def _explain_listed(name: str) -> str:
    return f"{name} has a grid of listed poses; to identify objects, choose the grid whole"


def _require_untrained(model: Localizer) -> None:
    if model.encoder.capabilities.needs_training:
        raise ConfigError(
            "the encoder has to be trained on one object, so it cannot compare several; choose `encoder` pixel"
        )
