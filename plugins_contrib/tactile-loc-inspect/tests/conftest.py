"""Touches of a clean plate, and a result that is not certain."""

import pytest
from inspect_helpers import make_plate, press
from tactile_loc import Localization, Localizer, StageStore
from tactile_loc.plugin import View


@pytest.fixture(scope="session")
def clean_views() -> list[View]:
    """Touches of a part that is as the model."""
    return press(make_plate())


@pytest.fixture(scope="session")
def located_uncertain(store: StageStore) -> Localization:
    """A result of one touch whose pose is not known within the tolerance of 0.01 mm."""
    localizer = Localizer.create("pin", store=store, tolerance="0.01mm", grid={"name": "whole", "directions": 300})
    return localizer.localize(localizer.simulate(1, seed=3, noise="mild"))
