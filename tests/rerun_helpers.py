"""Read Rerun files with Rerun's own reader."""

from pathlib import Path
from typing import Any

import pytest


def read(path: Path) -> dict[str, dict[str, list[Any]]]:
    """The values of each component of each entity in a file, in frame order."""
    chunks = pytest.importorskip("rerun.chunk", reason="this version of rerun does not read its files")
    found: dict[str, dict[str, list[tuple[int, Any]]]] = {}
    for chunk in chunks.RrdReader(path).stream():
        rows = chunk.to_record_batch().to_pydict()
        numbers = rows.get("frame", [-1] * chunk.num_rows)
        for name, values in rows.items():
            column = found.setdefault(chunk.entity_path.lstrip("/"), {}).setdefault(name, [])
            column += [(n, v) for n, v in zip(numbers, values, strict=True) if v is not None]
    return {e: {n: [v for _, v in sorted(c, key=lambda p: p[0])] for n, c in d.items()} for e, d in found.items()}
