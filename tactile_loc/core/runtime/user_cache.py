"""The user's cache folder."""

from __future__ import annotations

import os
from pathlib import Path


def find_user_cache() -> Path:
    """Return `$XDG_CACHE_HOME`, else `~/.cache`. Raises RuntimeError if the user has no home."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", ""))  # the XDG specification says: ignore relative paths
    return cache if cache.is_absolute() else Path.home() / ".cache"
