"""Which stages were built for a combination, also by a process that was killed before it could say so."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from tactile_loc.store.keys import StageKey


class BuildJournal(list[StageKey]):
    """The keys that a store's instance builds, noted in a file as well, until the combination is finished.

    A file that cannot be written is no reason to fail: only what a killed process has built is then forgotten.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._earlier: list[str] = []
        with suppress(OSError, UnicodeDecodeError):
            self._earlier = path.read_text(encoding="utf-8").splitlines()

    def append(self, key: StageKey) -> None:
        """Note that a stage was built."""
        super().append(key)
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(f"{key}\n")

    def finish(self) -> tuple[str, ...]:
        """Return the names of all stages, "stage digest", those of killed processes first, and remove the file."""
        with suppress(OSError):
            self._path.unlink(missing_ok=True)
        return tuple(dict.fromkeys([*self._earlier, *map(str, self)]))
