"""Localizers that the sessions of a page share. The model of a localizer is built only once."""

import json
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

from tactile_loc import Localizer, RunConfig, StageStore

from tactile_loc_app.page.task_progress import ShowProgress, TaskProgress


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

    def get(self, config: RunConfig) -> Localizer:
        """Return the localizer of the object and the sensor that `config` names, with the default components.

        Raises TactileLocError if the object or the sensor cannot be used.
        """
        chosen, sensor = config.object, config.sensor.model_dump()
        parts: dict[str, Any] = {"units": chosen.units, "symmetry": chosen.symmetry, "sensor": sensor}
        made = Localizer.create(chosen.path, store=self.store, **parts)
        obj = made.object
        if Path(chosen.path).is_relative_to(self.folder):  # an upload, whose folder means nothing to people
            obj = replace(obj, source=Path(chosen.path).name)
        key = json.dumps([obj.describe(), chosen.path, parts], sort_keys=True)
        with self._lock:
            if key not in self._known:
                self._known[key] = Localizer(made.config, obj, self.store, TaskProgress())
            return self._known[key]

    @contextmanager
    def use(self, localizer: Localizer, show: ShowProgress | None = None) -> Iterator[None]:
        """Wait until no other session works with the localizer, and reserve it for the block.

        `show` gets the progress of the block's work.
        """
        with self._lock:
            own = self._in_use[id(localizer)]
        progress = localizer.progress
        assert isinstance(progress, TaskProgress)
        with own:
            progress.show = show
            try:
                yield
            finally:
                progress.show = None

    def forget(self, folder: Path) -> None:
        """Forget the localizers whose object or sensor lies in a folder, which is removed afterwards."""
        with self._lock:
            for key, localizer in list(self._known.items()):
                config = localizer.config
                files = (config.object.path, str(config.sensor.options.get("path", "")))
                if any(Path(file).is_relative_to(folder) for file in files):
                    del self._known[key]
                    self._in_use.pop(id(localizer), None)
