"""Readings from images: their heights may be scaled and bent, and the outline of a contact is not exact."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from inspect_helpers import TOP_M, make_burr, make_dome, make_plate, misplace, press
from scipy.ndimage import binary_dilation
from tactile_loc import ContactShape
from tactile_loc.plugin import View

from tactile_loc_inspect.comparison import OUTLINE_M, compare_touches
from tactile_loc_inspect.inspection import inspect_part


def read_wrongly(view: View, scale: float = 1.0, bend_m: float = 0.0, grow_m: float = 0.0) -> View:
    """Return a view with an image whose reading is wrong.

    Heights are scaled, and bent by `bend_m` metres at 2 mm from the middle along x. The contact is wider by `grow_m`.
    """
    touch = view.touch
    shape, geometry = touch.contact_shape, touch.geometry
    x_m = geometry.backproject(np.full(geometry.shape, geometry.surface_m))[..., 0]
    press_m, grown_px = scale * shape.press_depth_m, round(grow_m / geometry.pixel_pitch_m)
    read_m = np.where(shape.contact, scale * shape.depth_m + bend_m * (x_m / 2e-3) ** 2, press_m)
    if grown_px:
        read_m = np.where(binary_dilation(shape.contact, iterations=grown_px) & ~shape.contact, 0.75 * press_m, read_m)
    read = ContactShape(np.clip(read_m, 0, press_m).astype(np.float32), press_m)
    return replace(view, touch=replace(touch, contact_shape=read, image=np.zeros((*geometry.shape, 3), np.uint8)))


def drop_images(views: Sequence[View]) -> list[View]:
    """Return the same contact shapes as depth maps."""
    return [replace(view, touch=replace(view.touch, image=None)) for view in views]


@pytest.mark.parametrize("wrong", [{"scale": 1.1}, {"scale": 0.9}, {"bend_m": 2.5e-5}])
def test_a_scaled_or_bent_reading_fits_the_model(wrong):
    dome = make_plate(make_dome())
    views = [read_wrongly(view, **wrong) for view in press(dome, model=dome)]
    assert inspect_part(views, misplace(views)).differences == ()
    fitted, plain = (
        [one.misfit_m for one in compare_touches(some, misplace(views))] for some in (views, drop_images(views))
    )
    assert max(fitted) < 0.5 * min(plain)


def test_a_wider_contact_is_no_difference():
    views = [read_wrongly(view, grow_m=0.7 * OUTLINE_M) for view in press(make_plate())]
    by_image, by_depth = (compare_touches(some, misplace(views)) for some in (views, drop_images(views)))
    assert not any(one.differences.extra.any() for one in by_image)
    assert all(one.differences.extra.any() for one in by_depth)


def test_a_burr_is_found_in_scaled_readings():
    views = [read_wrongly(view, 1.1) for view in press(make_plate(make_burr(0.3)), count=3)]
    first = inspect_part(views, misplace(views)).differences[0]
    assert 1e-4 < first.height_m < 5e-4
    assert np.linalg.norm(first.point_m - TOP_M) < 1e-3


def test_images_state_a_larger_height():
    views = [read_wrongly(view) for view in press(make_plate())]
    by_image, by_depth = (inspect_part(some, misplace(views)) for some in (views, drop_images(views)))
    assert by_image.verdict == by_depth.verdict == "as the model"
    assert by_image.detectable_m > 4 * by_depth.detectable_m


def test_light_presses_of_one_place_are_told_from_a_single_touch():
    views = [read_wrongly(view) for view in press(make_plate(), press_m=1e-4)]
    light, alone = (inspect_part(some, misplace(some)) for some in (views, views[:1]))
    assert light.verdict == alone.verdict == "not enough touches"
    assert light.map.touches.max() == 2
    assert light.describe() != alone.describe()
