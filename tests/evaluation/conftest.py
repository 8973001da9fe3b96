"""One localisation on a coarse grid, for all who write or draw it."""

from __future__ import annotations

import pytest

from tactile_loc.core.localization import Localization
from tactile_loc.core.localizer import Localizer
from tactile_loc.core.store import StageStore


@pytest.fixture(scope="session")
def localizer(store: StageStore) -> Localizer:
    return Localizer.create("pin", grid={"name": "face", "spacing_mm": 8}, store=store)


@pytest.fixture(scope="session")
def localization(localizer: Localizer) -> Localization:
    return localizer.localize(localizer.simulate(1, seed=0)[0])
