"""Surfaces from slopes: exact for exact slopes, and free of drift where the gel is untouched."""

import dataclasses

import numpy as np
import pytest
from press_sets import BALL_M, MM, ball_indentation, contact_radius, places, sensor
from scipy.ndimage import binary_fill_holes, gaussian_filter

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.reading import surface as module
from tactile_loc.sensors.reading.surface import find_indentation, integrate

FINE = sensor(96)
UM = 1e-6


def waves(geometry: SensorGeometry) -> tuple[np.ndarray, np.ndarray]:
    """A smooth surface (H, W), metres, and its exact slopes (H, W, 2)."""
    x, y = places(geometry)
    k, m = 500.0, 300.0
    surface = MM * (np.sin(k * x) * np.cos(m * y) + 30 * x)
    across = MM * (k * np.cos(k * x) * np.cos(m * y) + 30)
    down = -MM * m * np.sin(k * x) * np.sin(m * y)
    return surface, np.stack([across, down], axis=-1)


def worst_m(geometry: SensorGeometry) -> float:
    surface, slope = waves(geometry)
    return float(np.abs(integrate(slope, geometry) - (surface - surface.mean())).max())


def slopes_of(indentation_m: np.ndarray, geometry: SensorGeometry) -> np.ndarray:
    sx, sy = geometry.scale_at_surface
    down, across = np.gradient(indentation_m.astype(float))
    return np.stack([across * sx, down * sy], axis=-1)


def punch(geometry: SensorGeometry, half_m: float, press_m: float, x_m: float = 0.0) -> np.ndarray:
    """A flat square punch in soft gel (H, W), metres."""
    x, y = places(geometry)
    flat = np.where((np.abs(x - x_m) < half_m) & (np.abs(y) < half_m), press_m, 0.0)
    return gaussian_filter(flat, 2e-4 / geometry.pixel_pitch_m)


def bent(geometry: SensorGeometry, strength: float = 0.02) -> np.ndarray:
    """Slope errors (H, W, 2): a constant, and a part that grows across the image."""
    x, y = (v / 8e-3 for v in places(geometry))
    return strength * np.stack([0.5 + x - 0.5 * x * y, -0.4 + 0.6 * y + 0.3 * x**2], axis=-1)


def test_the_integration_error_is_second_order_in_the_pixel_size():
    errors = [worst_m(sensor(px)) for px in (48, 96, 192)]
    assert errors[0] < 25 * UM
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.25)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.25)


def test_pixels_need_not_be_square():
    flat = dataclasses.replace(FINE, height_px=48, fy=3000.0, cy=20.0)
    assert worst_m(flat) < 25 * UM
    pinhole = SensorGeometry("pinhole", 96, 80, 150.0, 140.0, 47.0, 41.0, 0.025, 2e-3)
    x, y = np.meshgrid(*(s * pinhole.standoff_m for s in pinhole.pixel_slopes))
    surface = 20 * (x**2 - 2 * y**2)
    found = integrate(np.stack([40 * x, -80 * y], axis=-1), pinhole)
    np.testing.assert_allclose(found, surface - surface.mean(), atol=0.1 * UM)


def test_slopes_with_curl_give_the_nearest_surface():
    x, y = places(FINE)
    _, slope = waves(FINE)
    r2 = (x**2 + y**2) / (4e-3) ** 2
    whirl = 0.1 * np.where(r2 < 1, (1 - r2) ** 2, 0.0)[..., None] * np.stack([-y, x], axis=-1) / 4e-3
    assert np.abs(whirl).max() > 0.02
    np.testing.assert_allclose(integrate(slope + whirl, FINE), integrate(slope, FINE), atol=2 * UM)


@pytest.mark.parametrize("drift", [0.0, 0.02, -0.02])
def test_a_ball_is_recovered_without_the_drift(drift):
    true = ball_indentation(FINE, 1e-3, -1.5e-3, 6e-4)
    found = find_indentation(slopes_of(true, FINE) + bent(FINE, drift), FINE)
    assert found.dtype == np.float32
    plain = integrate(slopes_of(true, FINE) + bent(FINE, drift), FINE)
    if drift:
        assert np.ptp(plain - true) > 150 * UM  # a drift that matters
    assert float(np.abs(found - true).max()) < 40 * UM  # the largest error is at the rim, where the slope jumps
    assert np.sqrt(np.mean((found - true)[true == 0] ** 2)) < 6 * UM


def test_drift_removal_does_not_depend_on_the_pixel_size():
    found = []
    for px in (80, 240):
        geometry = sensor(px)
        true = ball_indentation(geometry, 1e-3, -1.5e-3, 6e-4)
        found.append(find_indentation(slopes_of(true, geometry) + bent(geometry), geometry))
    np.testing.assert_allclose(found[1].reshape(80, 3, 80, 3).mean((1, 3)), found[0], atol=15 * UM)


@pytest.mark.parametrize("half_m", [1e-3, 2e-3, 4e-3])
def test_the_flat_middle_of_a_punch_keeps_its_depth(half_m):
    true = punch(FINE, half_m, 5e-4)
    found = find_indentation(slopes_of(true, FINE) + bent(FINE), FINE)
    x, y = places(FINE)
    middle = np.maximum(np.abs(x), np.abs(y)) < 0.5 * half_m
    assert found[middle].mean() == pytest.approx(5e-4, abs=40 * UM)
    assert np.abs(found[true < 1e-9]).mean() < 10 * UM


@pytest.mark.parametrize("drift", [0.0, 0.005])
def test_a_light_press_of_a_flat_face_keeps_its_depth(drift):
    x, y = (v / MM for v in places(FINE))
    flat = np.where((np.abs(x) < 2.5) & (np.abs(y) < 3.5), 1.5e-4, 0.0)
    true = gaussian_filter(flat, 8e-4 / FINE.pixel_pitch_m, mode="nearest")
    slope = slopes_of(true, FINE)
    assert 0.06 < np.hypot(*np.moveaxis(slope, -1, 0)).max() < 0.08
    found = find_indentation(slope + bent(FINE, drift), FINE)
    assert found[(np.abs(x) < 0.5) & (np.abs(y) < 1)].mean() == pytest.approx(1.5e-4, abs=25 * UM)


def test_untouched_gel_stays_flat_in_spite_of_noise():
    noise = 0.05 * np.random.default_rng(0).normal(size=(96, 96, 2))
    found = find_indentation(noise + bent(FINE), FINE)
    assert np.sqrt(np.mean(found**2)) < 10 * UM
    assert np.abs(found).max() < 40 * UM
    assert not find_indentation(np.zeros((96, 96, 2)), FINE).any()


def test_noise_does_not_hide_a_press():
    noise = 0.05 * np.random.default_rng(1).normal(size=(96, 96, 2))
    true = ball_indentation(FINE, 0.0, 0.0, 5e-4)
    found = find_indentation(slopes_of(true, FINE) + bent(FINE) + noise, FINE)
    rho = np.hypot(*places(FINE))
    assert found[rho < 3e-4].mean() == pytest.approx(5e-4, abs=35 * UM)
    assert np.sqrt(np.mean(found[rho > 2 * contact_radius(5e-4)] ** 2)) < 15 * UM


@pytest.mark.parametrize(("x_m", "y_m"), [(8e-3, 0.0), (-8e-3, 1e-3), (0.0, 7.5e-3), (7.5e-3, -7.5e-3)])
def test_a_ball_at_the_image_border_keeps_its_depth(x_m, y_m):
    true = ball_indentation(FINE, x_m, y_m, 6e-4)
    found = find_indentation(slopes_of(true, FINE) + bent(FINE, 0.01), FINE)
    assert found.max() == pytest.approx(true.max(), abs=60 * UM)
    x, y = places(FINE)
    far = np.hypot(x - x_m, y - y_m) > 2 * contact_radius(6e-4, BALL_M)
    assert np.sqrt(np.mean(found[far] ** 2)) < 15 * UM


@pytest.mark.parametrize("drift", [0.0, 0.01])
@pytest.mark.parametrize("yaw_deg", [0, 45, 200])
@pytest.mark.parametrize(
    "corners_mm", [(3, 99, -3, 3), (-99, 0, -99, 99), (-99, 99, -99, -3), (2, 99, 2, 99), (-99, 4, -99, 99)]
)
def test_a_flat_face_that_crosses_the_image_border_keeps_its_depth(corners_mm, yaw_deg, drift):
    x, y = (v / MM for v in places(FINE))
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    x, y = c * x - s * y, s * x + c * y
    x0, x1, y0, y1 = corners_mm
    flat = np.where((x > x0) & (x < x1) & (y > y0) & (y < y1), 5e-4, 0.0)
    true = gaussian_filter(flat, 2e-4 / FINE.pixel_pitch_m, mode="nearest")
    found = find_indentation(slopes_of(true, FINE) + bent(FINE, drift), FINE)
    assert found[true > 0.99 * 5e-4].mean() == pytest.approx(5e-4, abs=75 * UM)
    assert np.abs(found[true < 1e-9]).mean() < 20 * UM


def test_holes_are_filled_and_images_smoothed_as_scipy_does_it():
    rng = np.random.default_rng(0)
    for _ in range(50):
        marked = gaussian_filter(rng.normal(size=rng.integers(3, 60, 2)), 1) > 0
        np.testing.assert_array_equal(module._fill_holes(marked), binary_fill_holes(marked))
    image = np.random.default_rng(0).normal(size=(60, 80))
    down, across = (module._weigh_gaussian(blocks, 9.3) for blocks in image.shape)
    expected = gaussian_filter(image, 9.3, mode="nearest", truncate=6)
    np.testing.assert_allclose(down @ image @ across.T, expected, atol=1e-12)
