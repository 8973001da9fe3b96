"""A cache that keeps as many values as fit into a number of bytes, and the user's cache folder."""

import os
from collections.abc import Callable, Hashable
from pathlib import Path
from threading import Lock
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class ByteCache(Generic[K, V]):
    """Keeps the values used last, as long as they need at most `most_bytes` bytes together.

    `measure` returns the bytes of a value. If they change, call `keep` again. The `fewest` values used last are kept
    even if they need more than `most_bytes`. Several threads may use a cache.
    """

    def __init__(self, most_bytes: int, measure: Callable[[V], int], fewest: int = 1) -> None:
        self.most_bytes, self.measure, self.fewest = most_bytes, measure, fewest
        self._kept: dict[K, tuple[V, int]] = {}  # values with their bytes; the last used comes last
        self._total = 0
        self._choosing = Lock()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def nbytes(self) -> int:
        """The bytes of all kept values, measured when they were last used."""
        return self._total

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Return the value of this key; make it if it is not kept. Other values are dropped if necessary."""
        kept = self._kept.get(key)
        value = make() if kept is None else kept[0]
        self.keep(key, value)
        return value

    def keep(self, key: K, value: V) -> None:
        """Keep a value that has just been used, and drop the values used least recently until the others fit."""
        size = self.measure(value)
        with self._choosing:
            self._total += size - self._kept.pop(key, (value, 0))[1]
            self._kept[key] = value, size
            while self._total > self.most_bytes and len(self._kept) > self.fewest:
                self._total -= self._kept.pop(next(iter(self._kept)))[1]


def find_user_cache() -> Path:
    """Return `$XDG_CACHE_HOME`, else `~/.cache`. Raises RuntimeError if the user has no home."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", ""))  # the XDG specification says: ignore relative paths
    return cache if cache.is_absolute() else Path.home() / ".cache"
