import numpy as np
import pytest

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.plugins.encoders.pixel import PixelEncoder

PRESS_M = 0.002


def sensor(width_px: int, height_px: int) -> SensorGeometry:
    return SensorGeometry("orthographic", width_px, height_px, 2000, 2000, width_px / 2, height_px / 2, 0.01, PRESS_M)


def pixel(cells: int, signal: str = "binary") -> PixelEncoder:
    return PixelEncoder(PixelEncoder.Options(cells=cells, signal=signal))


def random_shapes(count: int, geometry: SensorGeometry, seed: int = 0) -> np.ndarray:
    depth = np.random.default_rng(seed).uniform(0, 2 * PRESS_M, (count, *geometry.shape))
    return np.minimum(depth, PRESS_M).astype(np.float32)


def binary(shapes: np.ndarray) -> np.ndarray:
    return (shapes < np.float32(PRESS_M)).astype(float)


@pytest.mark.parametrize(("width", "height"), [(47, 33), (33, 47), (40, 40), (80, 20)])
@pytest.mark.parametrize("cells", [7, 20, 33])
def test_averaging_conserves_area_for_any_ratio(width, height, cells):
    """The mean over cells is the share of the image in contact, even if a pixel lies in several cells."""
    geometry = sensor(width, height)
    shapes = random_shapes(5, geometry)
    vectors = pixel(cells).encode(shapes, PRESS_M, geometry)
    assert vectors.dtype == np.float32
    assert len(vectors) == 5
    # A vector is the cells' shares over the root of their number.
    np.testing.assert_allclose(
        vectors.sum(axis=1) / np.sqrt(vectors.shape[1]), binary(shapes).mean(axis=(1, 2)), rtol=1e-5
    )


def test_a_cell_is_the_mean_of_its_pixels():
    geometry = sensor(12, 8)
    shapes = random_shapes(3, geometry)
    expected = binary(shapes).reshape(3, 4, 2, 6, 2).mean(axis=(2, 4)).reshape(3, -1)
    np.testing.assert_allclose(pixel(6).encode(shapes, PRESS_M, geometry) * np.sqrt(24), expected, atol=1e-6)


def test_a_pixel_between_two_cells_is_shared_by_them():
    """Three pixels in two cells: the middle one counts half in each."""
    geometry = sensor(6, 6)
    shape = np.full((1, 6, 6), PRESS_M, np.float32)
    shape[0, :, 1] = 0.0
    cells = (pixel(4).encode(shape, PRESS_M, geometry) * 4).reshape(4, 4)
    np.testing.assert_allclose(cells, np.tile([1 / 3, 1 / 3, 0, 0], (4, 1)), atol=1e-6)


@pytest.mark.parametrize("signal", ["binary", "depth"])
def test_squared_distance_is_the_mean_squared_difference(signal):
    geometry = sensor(24, 16)
    shapes = random_shapes(2, geometry)
    values = binary(shapes) if signal == "binary" else 1 - shapes / PRESS_M
    a, b = pixel(24, signal).encode(shapes, PRESS_M, geometry)
    assert ((a - b) ** 2).sum() == pytest.approx(((values[0] - values[1]) ** 2).mean(), rel=1e-5)


def test_binary_cells_hold_the_outline_and_depth_cells_the_penetration():
    geometry = sensor(20, 20)
    shallow = np.full((1, 20, 20), PRESS_M, np.float32)
    shallow[0, 5:15, 5:15] = 0.5 * PRESS_M
    deep = np.where(shallow < PRESS_M, np.float32(0), shallow)
    assert np.array_equal(*(pixel(10).encode(s, PRESS_M, geometry) for s in (shallow, deep)))
    half, full = (pixel(10, "depth").encode(s, PRESS_M, geometry) for s in (shallow, deep))
    np.testing.assert_allclose(full, 2 * half, atol=1e-6)


@pytest.mark.parametrize(("width", "height"), [(470, 470), (320, 240), (240, 320), (298, 201), (640, 333)])
@pytest.mark.parametrize("cells", [4, 20, 90])
@pytest.mark.parametrize("long_side", [16, 60, 80, 128])
def test_touch_and_bank_have_the_same_cells_at_any_resolution(width, height, cells, long_side):
    fine = sensor(width, height)
    coarse = fine.resize_long_side(long_side)
    dimensions = {pixel(cells).encode(np.zeros((1, *g.shape), np.float32), PRESS_M, g).shape for g in (fine, coarse)}
    assert len(dimensions) == 1
