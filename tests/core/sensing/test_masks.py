"""Touches without depths, made from contact masks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import NoContactError, TouchError
from tactile_loc.core.sensing.clouds import make_interior_cloud, make_outline_cloud
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.masks import ASSUMED_PRESS, ASSUMED_STD, KNOWN_STD
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import Touch, require_depths

MM = 1e-3
SENSOR = SensorGeometry("orthographic", 60, 40, 1e4, 1e4, 30, 20, standoff_m=10 * MM, max_depth_m=1 * MM)


def disc(radius_px: float = 10.0) -> np.ndarray:
    """Return a mask (40, 60) of a disc about the middle of the image."""
    v, u = np.mgrid[:40, :60] + 0.5
    return np.hypot(u - 30, v - 20) < radius_px


@pytest.mark.parametrize("value", [True, 1, 1.0, 255])
def test_masks_of_every_kind_give_the_same_contact(value: float) -> None:
    touch = Touch.from_mask(np.where(disc(), value, 0), sensor=SENSOR, press_depth_m=0.5 * MM)
    np.testing.assert_array_equal(touch.contact_shape.contact, disc())
    assert not touch.has_depths
    assert touch.press_depth_m == 0.5 * MM
    assert touch.contact_shape.indentation_std_m == pytest.approx(KNOWN_STD * 0.5 * MM)


def test_an_unknown_press_is_assumed_with_a_large_error() -> None:
    touch = Touch.from_mask(disc(), sensor=SENSOR)
    assert touch.press_depth_m == pytest.approx(ASSUMED_PRESS * MM)
    assert touch.contact_shape.indentation_std_m == pytest.approx(ASSUMED_STD * MM)


def test_a_lighter_cut_keeps_the_mask() -> None:
    shape = Touch.from_mask(disc(), sensor=SENSOR).contact_shape
    cut = shape.press_to(0.1 * MM)
    np.testing.assert_array_equal(cut.contact, disc())
    assert not cut.depths_known
    assert cut.deepest_m == shape.deepest_m


@pytest.mark.parametrize("mask", [np.ones((40, 60)), 0.5 * disc(), 2 * disc(), disc()[None], disc()[:30], disc() * 1j])
def test_other_arrays_are_refused(mask: np.ndarray) -> None:
    with pytest.raises(TouchError):
        Touch.from_mask(mask, sensor=SENSOR)


def test_an_empty_mask_has_no_contact() -> None:
    with pytest.raises(NoContactError):
        Touch.from_mask(np.zeros((40, 60), bool), sensor=SENSOR)


@pytest.mark.parametrize("given", [{"press_depth_m": 2 * MM}, {"press_depth_m": -MM}, {"press_std_m": 0.0}])
def test_impossible_presses_are_refused(given: dict[str, float]) -> None:
    with pytest.raises(TouchError):
        Touch.from_mask(disc(), sensor=SENSOR, **given)


def test_an_elastic_gel_is_refused() -> None:
    elastic = dataclasses.replace(SENSOR, gel=Gel(4 * MM))
    with pytest.raises(TouchError, match="rigid"):
        Touch.from_mask(disc(), sensor=elastic)


def test_a_task_that_needs_depths_refuses_a_mask() -> None:
    with pytest.raises(TouchError):
        require_depths(Touch.from_mask(disc(), sensor=SENSOR), "a track")


def test_the_outline_is_on_the_undeformed_gel_and_points_outwards() -> None:
    touch = Touch.from_mask(disc(), sensor=SENSOR)
    points, normals = make_outline_cloud(touch.contact_shape, touch.geometry)
    np.testing.assert_allclose(points[:, 2], SENSOR.standoff_m)
    radii_m = np.hypot(points[:, 0], points[:, 1])
    np.testing.assert_allclose(radii_m, 10e-4, atol=0.8e-4)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    outwards = np.einsum("pi,pi->p", normals[:, :2], points[:, :2]) / radii_m
    np.testing.assert_allclose(outwards, np.sqrt(0.5), atol=0.05)
    np.testing.assert_allclose(normals[:, 2], -np.sqrt(0.5), atol=1e-6)


def test_a_mask_that_the_image_cuts_has_no_outline_at_the_border() -> None:
    half = np.arange(60)[None] < np.full((40, 1), 30)
    touch = Touch.from_mask(half, sensor=SENSOR)
    points, _ = make_outline_cloud(touch.contact_shape, touch.geometry)
    assert len(points) == 40
    np.testing.assert_allclose(points[:, 0], 0.0, atol=1e-9)


def test_points_inside_allow_every_possible_depth() -> None:
    touch = Touch.from_mask(disc(), sensor=SENSOR, press_depth_m=0.5 * MM, press_std_m=0.1 * MM)
    points, normals, slack_m = make_interior_cloud(touch.contact_shape, touch.geometry)
    assert len(points) == disc().sum()
    np.testing.assert_allclose(points[:, 2] + slack_m, SENSOR.standoff_m)
    np.testing.assert_allclose(points[:, 2] - slack_m, SENSOR.standoff_m - 0.7 * MM)
    np.testing.assert_array_equal(normals, np.tile([0.0, 0.0, -1.0], (len(points), 1)))
