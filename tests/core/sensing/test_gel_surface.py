"""What an elastic gel shows, and where it touches the object."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tactile_loc.core.sensing import gel_surface
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel, find_touching
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.plugins.sensors.presets import GelSightMini, GelSlim

PRESS_M = 6e-4
LAYER = Gel(4e-3, 0.48)
SENSORS = {"parallel rays": GelSightMini(), "pinhole": GelSlim()}


@pytest.fixture(params=SENSORS)
def geometry(request) -> SensorGeometry:
    return dataclasses.replace(SENSORS[request.param].geometry.press(PRESS_M), gel=LAYER)


def draw(name: str, geometry: SensorGeometry) -> np.ndarray:
    """The contact depths (1, H, W), metres, of an object in a rigid gel."""
    k = geometry.surface_m if geometry.is_pinhole else 1.0
    x, y = np.meshgrid(*(slopes * k for slopes in geometry.pixel_slopes))
    block = (np.abs(x) < 3e-3) & (np.abs(y) < 2e-3)
    height_m = {
        "sphere": 3e-3 - np.sqrt(np.maximum(9e-6 - x**2 - y**2, 0)),
        "cone": np.hypot(x, y),
        "block": np.where(block, (x + 3e-3) * math.tan(math.radians(8)), 1.0),
    }[name]
    return np.minimum(height_m, PRESS_M)[None].astype(np.float32)


def resolve_fully(monkeypatch) -> None:
    """Solve contacts at every pixel of the whole image."""
    monkeypatch.setattr(gel_surface, "PITCH_M", 1e-5)
    monkeypatch.setattr(gel_surface, "MARGIN", math.inf)


@pytest.mark.parametrize("name", ["sphere", "cone", "block"])
def test_the_solved_pixels_change_the_surface_little(name, geometry, monkeypatch):
    """The window and its coarse pixels cost at most a tenth of what elasticity changes."""
    rigid = draw(name, geometry)
    found = deform_gel(rigid, PRESS_M, geometry)
    resolve_fully(monkeypatch)
    exact = deform_gel(rigid, PRESS_M, geometry, 30)
    off_m, elastic_m = (np.sqrt(np.mean((shown - exact) ** 2)) for shown in (found, rigid))
    assert off_m < 0.2 * elastic_m
    assert off_m < 7e-6


def test_a_gel_is_displaced_wherever_the_object_is(geometry):
    rigid = draw("block", geometry)
    shown = deform_gel(rigid, PRESS_M, geometry)
    assert (shown <= rigid + 1e-9).all()
    assert np.count_nonzero(shown < 0.9 * PRESS_M) > 1.3 * np.count_nonzero(rigid < 0.9 * PRESS_M)


def test_there_is_no_gel_beyond_the_rectangle(geometry):
    x0, x1, y0, y1 = geometry.rectangle
    half = dataclasses.replace(geometry, rectangle_m=(x0, (x0 + x1) / 2, y0, y1))
    shown = deform_gel(draw("sphere", geometry), PRESS_M, half)
    assert (shown[:, ~half.on_rectangle] == np.float32(PRESS_M)).all()
    assert (shown[:, half.on_rectangle] < PRESS_M).any()


def test_a_rigid_gel_shows_the_object_itself(geometry):
    rigid = draw("sphere", geometry)
    assert deform_gel(rigid, PRESS_M, dataclasses.replace(geometry, gel=Gel())) is rigid


def test_presses_of_a_batch_may_differ(geometry):
    rigid = np.concatenate([draw("sphere", geometry)] * 2)
    presses_m = np.array([2e-4, PRESS_M])
    both = deform_gel(np.minimum(rigid, presses_m[:, None, None].astype(np.float32)), presses_m, geometry)
    for shown, press_m in zip(both, presses_m, strict=True):
        alone = deform_gel(np.minimum(rigid[:1], np.float32(press_m)), press_m, geometry)
        assert np.abs(shown - alone[0]).max() < 0.02 * press_m


@pytest.mark.parametrize("name", ["sphere", "cone", "block"])
def test_touching_pixels_are_found_from_the_surface_alone(name, geometry, monkeypatch):
    """They agree with the pixels under pressure, and exclude most of the gel that is displaced beside the contact."""
    resolve_fully(monkeypatch)
    rigid = draw(name, geometry)
    shown = deform_gel(rigid, PRESS_M, geometry, 30)[0]
    touching = np.abs(shown - rigid[0]) < 1e-8
    touching &= rigid[0] < PRESS_M
    monkeypatch.undo()
    found = find_touching(shown, PRESS_M, geometry)
    assert np.count_nonzero(found & touching) > 0.6 * np.count_nonzero(touching)
    assert np.count_nonzero(found & ~touching) < 0.02 * np.count_nonzero(shown < PRESS_M)


def test_errors_of_the_surface_hardly_change_the_touching_pixels(geometry):
    """Smooth errors of 10 um, which is what a good sensor has."""
    from scipy.ndimage import gaussian_filter

    shown = deform_gel(draw("block", geometry), PRESS_M, geometry)[0]
    error = gaussian_filter(np.random.default_rng(0).standard_normal(shown.shape), 3)
    noisy = np.clip(shown + 1e-5 * error / error.std(), 0, PRESS_M).astype(np.float32)
    clean, found = (find_touching(surface, PRESS_M, geometry) for surface in (shown, noisy))
    assert np.count_nonzero(clean & found) > 0.8 * np.count_nonzero(clean | found)


def test_a_touch_separates_what_touches_from_what_it_shows(geometry):
    depth = deform_gel(draw("sphere", geometry), PRESS_M, geometry)[0]
    elastic = Touch(ContactShape(depth, PRESS_M), geometry)
    rigid = Touch(ContactShape(depth, PRESS_M), dataclasses.replace(geometry, gel=Gel()))
    assert rigid.touching_shape is rigid.contact_shape
    touching, shown = elastic.touching_shape.contact, elastic.contact_shape.contact
    assert 0 < np.count_nonzero(touching) < 0.4 * np.count_nonzero(shown)
    assert not (touching & ~shown).any()
    np.testing.assert_array_equal(elastic.touching_shape.depth_m[touching], depth[touching])


def test_the_gel_beside_the_contact_shows_nothing_of_the_object(geometry):
    """A pixel is known if it touches, or if the gel there is deeper than the cut."""
    depth = deform_gel(draw("sphere", geometry), PRESS_M, geometry)[0]
    touch = Touch(ContactShape(depth, PRESS_M), geometry)
    known = touch.find_known(0.9 * PRESS_M)
    beside = ~touch.touching_shape.contact & (depth < 0.9 * PRESS_M)
    assert beside.any()
    np.testing.assert_array_equal(known, ~beside & geometry.observed_mask)
