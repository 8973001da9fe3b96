"""Results on disk to make reports of: one touch, an evaluation, several contacts, a sweep."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from report_helpers import UNFRIENDLY, write_contacts, write_evaluation, write_run, write_sweep

from tactile_loc.core.localizer import Localizer
from tactile_loc.core.store import StageStore


@pytest.fixture(scope="session")
def pin_localizer(store: StageStore) -> Localizer:
    return Localizer.create("pin", grid={"name": "face", "spacing_mm": 8}, store=store)


@pytest.fixture(scope="session")
def run_folder(pin_localizer: Localizer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of one simulated touch; nothing may be changed in it."""
    return write_run(tmp_path_factory.mktemp("run"), pin_localizer)


@pytest.fixture(scope="session")
def unfriendly_run(pin_localizer: Localizer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of an object and a touch with names that would be HTML."""
    obj = dataclasses.replace(pin_localizer.object, name=UNFRIENDLY, notes=(UNFRIENDLY,))
    other = Localizer(pin_localizer.config, obj, pin_localizer.store)
    return write_run(tmp_path_factory.mktemp("unfriendly"), other, touch_name=UNFRIENDLY)


@pytest.fixture(scope="session")
def evaluation_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_evaluation(tmp_path_factory.mktemp("evaluation"))


@pytest.fixture(scope="session")
def contacts_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_contacts(tmp_path_factory.mktemp("contacts"))


@pytest.fixture(scope="session")
def sweep_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sweep(tmp_path_factory.mktemp("sweep"))
