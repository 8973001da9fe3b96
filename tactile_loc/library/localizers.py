"""Localizers of parts of a library, whose places are read from the record instead of being found again."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from tactile_loc.core.places.places import Places
from tactile_loc.core.runtime.errors import ConfigError, LibraryError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.io.config import ObjectConfig, RunConfig
from tactile_loc.library.record import PLACES_VERSION, PartRecord, choose_grid, describe_grid
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.store import StageStore


def open_localizer(
    record: PartRecord, sensor: str | dict[str, Any] = "gelslim", store: StageStore | str | Path | None = None,
    progress: Progress | None = None, **settings: Any,
) -> Localizer:  # fmt: skip
    """Return a localizer of a part for a sensor. Its places are those of the record.

    `settings` are as in `Localizer.create`, except `grid`, which is that of the record. Raises LibraryError if another
    version of tactile-loc made the record, and TactileLocError for bad settings.
    """
    if "grid" in settings:
        raise ConfigError("the grid of a part is that of its library; leave out `grid`")
    values = {"object": {"path": record.source}, "sensor": sensor, **settings}
    config = RunConfig.from_dict(values, "open_localizer")
    return make_localizer(record, config, store if isinstance(store, StageStore) else StageStore(store), progress)


def make_localizer(
    record: PartRecord, config: RunConfig, store: StageStore, progress: Progress | None = None,
    find_places: Callable[[], Places] | None = None,
) -> Localizer:  # fmt: skip
    """Return a localizer of a part with the settings of `config`, except its object and grid.

    `find_places` returns the part's places; by default, those of the record, which then stays in memory. Raises
    LibraryError if another version of tactile-loc made the record.
    """
    grid = choose_grid(record.grid)
    config = config.model_copy(update={"object": ObjectConfig(path=record.source), "grid": grid})
    find_places = find_places or partial(getattr, record, "places")
    localizer = Localizer(config, record.object, store, progress, find_places)
    if describe_grid(grid.name, localizer.sampler) != record.grid or record.places_version != PLACES_VERSION:
        raise LibraryError(f"another version of tactile-loc made the places of {record.name}; build the library again")
    return localizer
