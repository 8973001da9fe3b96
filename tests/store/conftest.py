"""An empty store for each test."""

from pathlib import Path

import pytest

from tactile_loc.store.store import StageStore


@pytest.fixture
def store(tmp_path: Path) -> StageStore:
    return StageStore(tmp_path / "store")
