"""Localizers that the sessions of a page share. The model of a localizer is built only once."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Lock

from tactile_loc.core.runtime.progress import Progress
from tactile_loc.io.config import ObjectConfig, RunConfig, SlotConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.stored_object import load_stored_object
from tactile_loc.store.store import StageStore


class SharedLocalizers:
    """Localizers by object and sensor, for several sessions, whose files are kept in own folders in `folder`.

    Sessions with the same object and sensor get the same localizer. `use` lets only one of them work at a time, so a
    model is built only once.
    """

    def __init__(self, folder: Path, store: StageStore | None = None) -> None:
        self.folder, self.store = folder, store or StageStore()
        self._known: dict[str, Localizer] = {}
        self._in_use: defaultdict[int, Lock] = defaultdict(Lock)
        self._lock = Lock()

    def get(self, chosen: ObjectConfig, sensor: SlotConfig) -> Localizer:
        """Return the localizer of an object and a sensor, with the default components.

        Raises TactileLocError if the object or the sensor cannot be used.
        """
        obj = load_stored_object(chosen.path, chosen.units, chosen.symmetry, self.store)
        if Path(chosen.path).is_relative_to(self.folder):  # an upload, whose folder means nothing to people
            obj = replace(obj, source=Path(chosen.path).name)
        settings = {"object": chosen.model_dump(), "sensor": sensor.model_dump()}
        key = json.dumps([obj.describe(), settings], sort_keys=True)
        with self._lock:
            if key not in self._known:
                config = RunConfig.from_dict(settings, "the page")
                self._known[key] = Localizer(config, obj, self.store, Progress())
            return self._known[key]

    @contextmanager
    def use(self, localizer: Localizer) -> Iterator[None]:
        """Wait until no other session works with the localizer, and reserve it for the block."""
        with self._lock:
            own = self._in_use[id(localizer)]
        with own:
            yield

    def forget(self, folder: Path) -> None:
        """Forget the localizers whose object or sensor lies in a folder, which is removed afterwards."""
        with self._lock:
            for key, localizer in list(self._known.items()):
                config = localizer.config
                files = (config.object.path, str(config.sensor.options.get("path", "")))
                if any(Path(file).is_relative_to(folder) for file in files):
                    del self._known[key]
                    self._in_use.pop(id(localizer), None)
