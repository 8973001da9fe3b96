"""The user's folder for what can be made again."""

from __future__ import annotations

import os
from pathlib import Path


def find_user_cache() -> Path:
    """Return `$XDG_CACHE_HOME`, else `~/.cache`.

    Raises:
        RuntimeError: if the user has no home.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME", ""))  # to be ignored unless absolute, says its specification
    return cache if cache.is_absolute() else Path.home() / ".cache"
