"""Localizers and uploaded files that the sessions of a page share. The model of a localizer is built only once."""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from threading import Lock

from tactile_loc.core.errors import OutputError
from tactile_loc.core.progress import Progress
from tactile_loc.io.config import ObjectConfig, RunConfig, SlotConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.stored_object import load_stored_object
from tactile_loc.store.files import write_atomically
from tactile_loc.store.store import StageStore


class SharedLocalizers:
    """Localizers by object and sensor, for several sessions. Uploaded files are kept in `folder`.

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

    def keep_upload(self, name: str, content: bytes) -> Path:
        """Write an uploaded file to a folder of its own content, and return its path. Raises OutputError."""
        return write_upload(self.folder / hashlib.sha256(content).hexdigest()[:16], name, content)


def write_upload(folder: Path, name: str, content: bytes) -> Path:
    """Write an uploaded file into a folder, and return its path. Only the last part of its name is used.

    Raises OutputError if the name is empty, or if the file cannot be written.
    """
    plain = PurePath(name.replace("\\", "/")).name
    if not plain or plain == "..":
        raise OutputError(f"a file cannot be called {name!r}; give it another name")
    return write_atomically(folder / plain, lambda temporary: temporary.write_bytes(content))
