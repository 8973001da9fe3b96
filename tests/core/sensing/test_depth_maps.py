"""Depth maps of each kind give the same touch, and only maps with the opposite meaning are refused."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from message_helpers import naming
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import NoContactError, TouchError
from tactile_loc.core.sensing.clouds import make_interior_cloud, make_outline_cloud
from tactile_loc.core.sensing.depth_maps import (
    ASSUMED_PRESS,
    ASSUMED_STD,
    KNOWN_STD,
    METRES_PER_UNIT,
    OPPOSITE,
    DepthKind,
    DepthUnit,
)
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import Touch, require_depths
from tactile_loc.plugins.sensors.presets import CurvedDigit, Digit, GelSightMini, GelSlim

MM = 1e-3
PRESS_M = 0.8 * MM
FLAT = SensorGeometry("orthographic", 60, 48, 4e3, 4e3, 30, 24, 0.01, 1 * MM)
ELASTIC = dataclasses.replace(FLAT, gel=Gel(4 * MM))
PRESETS = (GelSlim, GelSightMini, Digit, CurvedDigit)


def find_radius(geometry: SensorGeometry, x_m: float = 0.0, y_m: float = 0.0) -> NDArray[np.float64]:
    """Return the distance (H, W), metres, of each pixel on the gel from a point on the gel."""
    kx, ky = geometry.scale_at_surface
    x = (np.arange(geometry.width_px) + 0.5 - geometry.cx) / kx - x_m
    y = (np.arange(geometry.height_px) + 0.5 - geometry.cy) / ky - y_m
    return np.hypot(x[None], y[:, None])


def press_ball(geometry: SensorGeometry, x_m: float = 0.0, y_m: float = 0.0, radius_m: float = 4 * MM) -> NDArray:
    """Return the contact depths (H, W), metres, of a ball pressed in by PRESS_M, with its tip on a pixel's centre."""
    r = find_radius(geometry, x_m, y_m)
    r = np.where(r == r.min(), 0.0, r)
    depth = radius_m - np.sqrt(np.maximum(radius_m**2 - r**2, 0.0))
    rigid = np.minimum(depth, PRESS_M).astype(np.float32)
    return deform_gel(rigid[None], PRESS_M, geometry)[0].astype(np.float64)


@pytest.mark.parametrize("geometry", [FLAT, ELASTIC], ids=["rigid", "elastic"])
@pytest.mark.parametrize("unit", METRES_PER_UNIT)
def test_all_kinds_of_one_map_give_the_same_touch(geometry: SensorGeometry, unit: DepthUnit) -> None:
    depth_m = press_ball(geometry)
    maps: dict[DepthKind, NDArray[np.float64]] = {
        "distance": depth_m,
        "indentation": PRESS_M - depth_m,
        "height": depth_m - PRESS_M,
    }
    for kind, values in maps.items():
        given_m = PRESS_M if kind == "distance" else None
        touch = Touch.from_depth(
            values / METRES_PER_UNIT[unit], kind=kind, unit=unit, sensor=geometry, press_depth_m=given_m
        )
        assert touch.press_depth_m == pytest.approx(PRESS_M, abs=1e-9)
        assert touch.indentation_m == pytest.approx(PRESS_M, abs=1e-9)
        np.testing.assert_allclose(touch.contact_shape.depth_m, depth_m, atol=2e-9)
        np.testing.assert_array_equal(touch.contact_shape.contact, depth_m < PRESS_M * (1 - 1e-6))


@pytest.mark.parametrize("kind", ["indentation", "height"])
def test_nan_and_noise_around_zero_are_no_contact(kind: DepthKind) -> None:
    indentation = PRESS_M - press_ball(FLAT)
    noise = np.random.default_rng(3).uniform(-1e-5, 1e-5, indentation.shape)
    noisy = np.where(indentation > 1e-9, indentation, noise)
    noisy[:, 0] = np.nan
    touch = Touch.from_depth(noisy if kind == "indentation" else -noisy, kind=kind, sensor=FLAT)
    least = -np.nanmin(noisy)
    np.testing.assert_array_equal(touch.contact_shape.contact, noisy > least)
    assert not touch.contact_shape.contact[:, 0].any()
    assert np.count_nonzero(touch.contact_shape.contact & (indentation < 1e-9)) < 0.01 * indentation.size


def test_unobserved_pixels_do_not_count() -> None:
    observed = np.ones(FLAT.shape, bool)
    observed[:, :5] = False
    indentation = PRESS_M - press_ball(FLAT)
    indentation[:, :5] = 5.0
    masked = dataclasses.replace(FLAT, observed=observed)
    touch = Touch.from_depth(indentation, kind="indentation", sensor=masked)
    assert touch.press_depth_m == pytest.approx(PRESS_M)


def test_a_given_press_depth_is_that_of_a_tip_between_pixels_or_cuts_the_shape() -> None:
    indentation = PRESS_M - press_ball(FLAT)
    deeper = Touch.from_depth(indentation, kind="indentation", sensor=FLAT, press_depth_m=0.9 * MM)
    assert deeper.press_depth_m == pytest.approx(0.9 * MM)
    assert deeper.contact_shape.depth_m.min() == pytest.approx(0.1 * MM, rel=1e-5)
    lighter = Touch.from_depth(indentation, kind="indentation", sensor=FLAT, press_depth_m=0.5 * MM)
    assert (lighter.press_depth_m, lighter.indentation_m) == pytest.approx((0.5 * MM, PRESS_M))
    np.testing.assert_array_equal(lighter.contact_shape.contact, indentation > 0.3 * MM)


@pytest.mark.parametrize(
    ("values", "words", "wrong"),
    [
        (np.zeros(FLAT.shape), {"kind": "indentation"}, ("shows no contact", "positive")),
        (np.full(FLAT.shape, -1 * MM), {"kind": "indentation"}, ("shows no contact", "positive")),
        (PRESS_M - press_ball(FLAT), {"kind": "height"}, ("shows no contact", "negative")),
        (PRESS_M - press_ball(FLAT), {"kind": "indentation", "unit": "um"}, ("shows no contact", "unit")),
        (1e3 * (PRESS_M - press_ball(FLAT)), {"kind": "indentation"}, ("0.8 m", "its unit")),
        (2 * (PRESS_M - press_ball(FLAT)), {"kind": "indentation"}, ("1.6 mm", "1 mm")),
        (press_ball(FLAT) - PRESS_M, {"kind": "distance"}, ("negative", 'kind="height"')),
        (press_ball(FLAT), {"kind": "depth"}, ("'depth'", "distance, indentation or height")),
        (press_ball(FLAT), {"kind": "distance", "unit": "cm"}, ("'cm'", "mm")),
        (PRESS_M - press_ball(FLAT)[1:], {"kind": "indentation"}, ("47 x 60",)),
        (press_ball(FLAT).astype(bool), {"kind": "height"}, ("bool",)),
    ],
)
def test_bad_maps_are_refused(values: NDArray, words: dict[str, Any], wrong: tuple[str, ...]) -> None:
    with pytest.raises(TouchError, match=naming(*wrong)) as caught:
        Touch.from_depth(values, sensor=FLAT, **words)
    assert "--" not in str(caught.value)


@pytest.mark.parametrize("press_depth_m", [None, PRESS_M])
@pytest.mark.parametrize("place", [(0.0, 0.0), (4 * MM, 0.0), (5 * MM, 4 * MM)], ids=["middle", "side", "corner"])
@pytest.mark.parametrize("geometry", [FLAT, ELASTIC], ids=["rigid", "elastic"])
def test_maps_with_the_opposite_meaning_are_refused(
    geometry: SensorGeometry, place: tuple[float, float], press_depth_m: float | None
) -> None:
    depth_m = press_ball(geometry, *place)
    maps: dict[DepthKind, NDArray[np.float64]] = {"distance": PRESS_M - depth_m, "indentation": depth_m}
    for kind, values in maps.items():
        with pytest.raises(TouchError, match=naming(f'use kind="{OPPOSITE[kind]}"')):
            Touch.from_depth(values, kind=kind, sensor=geometry, press_depth_m=press_depth_m)


def test_a_map_that_is_flat_twice_has_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    """A face with a hole and a flat tip in a map with the opposite meaning are the same map."""
    hole = np.where(find_radius(FLAT) < 2 * MM, PRESS_M, 0.0)
    touch = Touch.from_depth(hole, kind="distance", sensor=FLAT)
    np.testing.assert_array_equal(touch.contact_shape.contact, hole == 0)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert 'use kind="indentation"' in caplog.text


def test_a_given_press_depth_settles_that_a_flat_face_has_a_dimple() -> None:
    dimple = np.where(find_radius(FLAT) < 2 * MM, 0.3 * MM - find_radius(FLAT) ** 2 / (12 * MM), 0.0)
    dimple = np.maximum(dimple, 0.0)
    with pytest.raises(TouchError, match="press depth"):
        Touch.from_depth(dimple, kind="distance", sensor=FLAT)
    assert Touch.from_depth(dimple, kind="distance", sensor=FLAT, press_depth_m=PRESS_M).contact_shape.contact.all()


def draw_real_maps(geometry: SensorGeometry, rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
    """Return contact depths (H, W), metres, of difficult touches: large flat faces, tilted or at the border."""
    x0, x1, _, _ = geometry.view
    across = (np.arange(geometry.width_px) + 0.5) / geometry.width_px + np.zeros((geometry.height_px, 1))
    r = find_radius(geometry)
    steps_m = rng.uniform(0.2, 0.9, 4) * (x1 - x0)
    maps = {
        "a tilted face that fills the image": 0.5 * MM * across,
        "a slightly tilted face": np.where(across < 0.9, 0.05 * MM * across, PRESS_M),
        "a face up to an edge": np.where(across < 0.8, 0.0, PRESS_M),
        "a large ball": np.minimum(r**2 / (2 * 0.1), PRESS_M),
        "a ring": np.where(np.abs(r - 3 * MM) < 1 * MM, 0.0, PRESS_M),
        "a face with a countersunk hole": np.clip(3 * MM - r, 0.0, PRESS_M),
        "a rounded edge": np.clip((across - 0.6) * 6 * MM, 0.0, PRESS_M),
        "a rounded corner": np.clip((np.maximum(across, across[:, ::-1]) - 0.7) * 6 * MM, 0.0, PRESS_M),
    }
    balls = {f"a ball at {x:.4f}": press_ball(geometry, x - (x1 - x0) / 2) for x in steps_m}
    return maps | balls


@pytest.mark.parametrize("sensor", PRESETS)
def test_difficult_real_touches_are_not_refused(sensor: type[GelSlim]) -> None:
    geometry = sensor().geometry
    for name, depth_m in draw_real_maps(geometry, np.random.default_rng(5)).items():
        for press_depth_m in (None, PRESS_M):
            Touch.from_depth(depth_m, kind="distance", sensor=geometry, press_depth_m=press_depth_m, name=name)
        if depth_m.max() >= PRESS_M:
            Touch.from_depth(PRESS_M - depth_m, kind="indentation", sensor=geometry, name=name)


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
