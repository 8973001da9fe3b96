"""What long programs keep of a seed, in a JSON file from which the same command goes on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tactile_loc.store.files import write_json


def kept_of(path: Path, seed: int) -> dict[str, Any]:
    """Return what was kept of a seed; nothing, if nothing was, or of another."""
    try:
        kept: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return kept if kept["seed"] == seed else {}


def write_kept(path: Path, seed: int, **values: Any) -> None:
    """Write what is kept of a seed, whole. Raises OutputError."""
    write_json(path, {"seed": seed, **values})
