"""Localizers of parts of a library locate touches as localizers of the mesh do."""

from __future__ import annotations

import dataclasses
import pickle

import pytest

from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.errors import ConfigError, LibraryError
from tactile_loc.library.localizers import open_localizer
from tactile_loc.locate.localizer import Localizer
from tactile_loc.plugins.grids.whole import WholeGrid

SETTINGS = {"shape_px": 32, "temperature": 0.02}


@pytest.fixture(scope="module")
def record(built):
    from tactile_loc.library.folder import LibraryFolder

    return LibraryFolder.open(built).read("part-3")


def test_a_touch_is_located_as_with_the_mesh(record, meshes, store, monkeypatch):
    grid = {"name": "whole", "directions": 100}
    plain = Localizer.create(
        meshes / "part-3.stl", units="mm", symmetry="none", grid=grid, store=store, sensor="digit", **SETTINGS
    )
    (touch,) = plain.simulate(1, seed=3)
    wanted = plain.localize(touch)
    monkeypatch.setattr(WholeGrid, "places", None)  # the places are not drawn again
    found = open_localizer(record, "digit", store, **SETTINGS).localize(touch)
    assert found.verdict == wanted.verdict
    assert found.best.imprint_iou == pytest.approx(wanted.best.imprint_iou, abs=0.01)
    metric = PoseMetric(record.object)
    for T in (wanted.best.T_sensor_object, touch.T_sensor_object):
        assert metric.symmetric_distance(T, found.best.T_sensor_object) < 3e-4


def test_released_and_pickled_localizers_read_the_places_again(record, store, monkeypatch):
    monkeypatch.setattr(WholeGrid, "places", None)
    localizer = open_localizer(record, "digit", store, **SETTINGS)
    count = len(localizer.source.places)
    localizer.release()
    assert len(localizer.source.places) == count == len(record.places)
    assert len(pickle.loads(pickle.dumps(localizer)).source.places) == count


def test_the_grid_is_that_of_the_record(record, store):
    with pytest.raises(ConfigError, match="leave out `grid`"):
        open_localizer(record, "digit", store, grid="whole")
    assert open_localizer(record, "digit", store).sampler.options.directions == 100


def test_a_record_of_another_version_is_refused(record, store):
    newer = dataclasses.replace(record, places_version=99)
    with pytest.raises(LibraryError, match="another version"):
        open_localizer(newer, "digit", store)
