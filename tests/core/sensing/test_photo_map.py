"""Maps of photos: their geometry, what they do to images, and their records."""

import numpy as np
import pytest
from photo_helpers import BARREL, MAPS, PX, photograph

from tactile_loc.core.runtime.errors import SensorError, TouchError
from tactile_loc.core.sensing.photo_map import UNIT, Lens, PhotoMap, even_scales, frame_view, to_corners
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

PLACES = np.random.default_rng(0).uniform(2, PX - 2, (40, 2))


@pytest.mark.parametrize("name", MAPS)
def test_places_are_mapped_there_and_back(name):
    photo_map = MAPS[name]
    np.testing.assert_allclose(photo_map.locate_in_image(photo_map.locate(PLACES)), PLACES, atol=1e-6)
    np.testing.assert_allclose(photo_map.locate(PX * UNIT), photo_map.corners_px, atol=1e-6)


@pytest.mark.parametrize("name", MAPS)
def test_a_rectified_photo_is_the_image(name):
    y, x = np.mgrid[:PX, :PX]
    image = np.stack([128 + 100 * np.sin(x / 9), 128 + 100 * np.cos(y / 8), 60 + x + y], axis=-1).astype(np.uint8)
    photo_map = MAPS[name]
    found = photo_map.rectify(photograph(image, photo_map))
    off = np.abs(found.astype(float) - image)[photo_map.seen]
    assert off[..., :].mean() < 1
    assert np.quantile(off, 0.99) < 4


def test_the_trivial_map_changes_nothing():
    photo = np.random.default_rng(1).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    trivial = PhotoMap((30, 20), (30, 20), to_corners(UNIT * [30, 20]))
    np.testing.assert_array_equal(trivial.rectify(photo), photo)
    with pytest.raises(TouchError):
        trivial.rectify(photo[:10])


def test_a_lens_distorts_as_opencv_says():
    lens = Lens(100.0, 120.0, 40.0, 30.0, (-0.2, 0.05, 0.01, -0.02, 0.003))
    x, y, r2 = 0.3, -0.2, 0.13
    radial = 1 - 0.2 * r2 + 0.05 * r2**2 + 0.003 * r2**3
    expected = [
        40 + 100 * (x * radial + 0.02 * x * y - 0.02 * (r2 + 2 * x**2)),
        30 + 120 * (y * radial + 0.01 * (r2 + 2 * y**2) - 0.04 * x * y),
    ]
    np.testing.assert_allclose(lens.distort(np.array([[40 + 100 * x, 30 + 120 * y]])), [expected])


def test_pixels_beyond_the_photo_are_not_observed():
    sensor = SensorGeometry("orthographic", PX, PX, 5e3, 5e3, PX / 2, PX / 2, 0.01, 1e-3)
    outside = PhotoMap((PX, PX), (PX, PX), ((-8.0, 0.0), (80.0, 0.0), (80.0, 80.0), (-8.0, 80.0)))
    seen = outside.hide_unseen(sensor).observed_mask
    assert not seen[:, :7].any()
    assert seen[:, 8:].all()
    assert MAPS["tilted"].hide_unseen(sensor) is sensor


@pytest.mark.parametrize("corners", [((0, 0), (0, 9), (9, 9), (9, 0)), ((0, 0), (9, 9), (9, 0), (0, 9)), ((0, 0),) * 4])
def test_corners_in_another_order_are_refused(corners):
    with pytest.raises(SensorError):
        PhotoMap((9, 9), (9, 9), corners)


def test_a_lens_that_does_not_show_the_corners_is_refused():
    strong = Lens(30.0, 30.0, 40.0, 40.0, (-0.5,))
    with pytest.raises(SensorError):
        PhotoMap((80, 80), (80, 80), to_corners(80 * UNIT), strong).locate(PLACES)


def test_a_lens_that_folds_the_view_beyond_the_corners_is_undone():
    folding = Lens(40.0, 40.0, 40.0, 40.0, (0.64, -0.44))  # real gels with dots look like this
    inside = 40 + 40 * np.random.default_rng(0).uniform(-0.7, 0.7, (30, 2))
    np.testing.assert_allclose(folding.undistort(folding.distort(inside)), inside, atol=1e-6)


@pytest.mark.parametrize("name", MAPS)
def test_a_map_is_read_back_from_its_record(name):
    assert PhotoMap.of_record(MAPS[name].record(), (PX, PX)) == MAPS[name]


def test_uneven_scales_are_evened():
    camera = SensorGeometry("orthographic", 96, 80, 6e3, 5e3, 48, 40, 0.01, 1e-3)
    even, photo_map = even_scales(camera)
    assert even.fx == pytest.approx(even.fy, rel=0.01)
    np.testing.assert_allclose(even.view, camera.view)
    assert (photo_map.photo_px, photo_map.image_px) == ((96, 80), (even.width_px, even.height_px))


def test_the_view_of_a_lens_keeps_the_scale_in_the_middle():
    photo_map = frame_view((PX, PX), np.eye(3), BARREL)
    middle = np.array(photo_map.image_px) / 2
    step = photo_map.locate(middle + np.array([[0.5, 0], [0, 0.5]])) - photo_map.locate(middle[None])
    np.testing.assert_allclose(2 * step, np.eye(2), atol=1e-3)
    assert min(photo_map.image_px) > PX


def test_a_circle_keeps_its_area():
    x, y, radius = MAPS["stretched"].move_circle((48.0, 40.0, 12.0))
    assert (x, y) == pytest.approx((40, 40))
    assert radius == pytest.approx(12 / 1.2**0.5)
