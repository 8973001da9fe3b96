import dataclasses

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import NoContactError, TouchError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Meaning, Touch, compute_contact_depth, contact_shape_from_array

MM = 1e-3
PINHOLE = SensorGeometry("pinhole", 8, 6, fx=40.0, fy=50.0, cx=3.7, cy=3.1, standoff_m=20 * MM, max_depth_m=2 * MM)


def slope() -> np.ndarray:
    """Return a contact shape that rises to the right from 0, without contact in the last columns."""
    row = np.linspace(0.0, 1.2 * PINHOLE.max_depth_m, PINHOLE.width_px)
    return np.tile(row, (PINHOLE.height_px, 1))


def test_contact_depth_is_clipped_between_the_surface_and_the_press_depth() -> None:
    z = np.array([[19.0, 20.0, 20.5, 21.5, 25.0, np.inf]]) * MM
    depth = compute_contact_depth(z, PINHOLE, 1 * MM)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, np.array([[0.0, 0.0, 0.5, 1.0, 1.0, 1.0]]) * MM, atol=5e-9)
    np.testing.assert_array_equal(ContactShape(depth, 1 * MM).contact, [[True, True, True, False, False, False]])


def test_a_lighter_press_cuts_the_depths() -> None:
    shape = ContactShape(np.array([[0.0, 0.4, 0.8, 2.0]], np.float32) * np.float32(MM), 2 * MM)
    light = shape.press_to(0.5 * MM)
    assert light.press_depth_m == 0.5 * MM
    np.testing.assert_allclose(light.depth_m, np.array([[0.0, 0.4, 0.5, 0.5]]) * MM, rtol=1e-6)
    np.testing.assert_array_equal(light.contact, [[True, True, False, False]])
    assert light.press_to(2 * MM).press_depth_m == 0.5 * MM, "a deeper press does not change the shape"


@pytest.mark.parametrize("marker", [np.nan, np.inf, 2 * MM, 50 * MM])
def test_the_press_depth_is_the_deepest_step_in_contact(marker: float) -> None:
    shape = contact_shape_from_array([[0.0, 0.7 * MM, 1.3 * MM, marker]], 2 * MM)
    assert shape.press_depth_m == pytest.approx(1.3 * MM, rel=1e-3)
    np.testing.assert_array_equal(shape.contact, [[True, True, True, False]])
    np.testing.assert_allclose(shape.depth_m, np.array([[0.0, 0.7, 1.3, 1.3]]) * MM, rtol=1e-3)


@pytest.mark.parametrize(
    ("values_mm", "given_mm", "press_mm", "contact"),
    [
        ([0.0, 0.7, 1.5, 1.5], None, 1.5, [1, 1, 0, 0]),  # without markers, the largest depth is the press depth
        ([0.0, 0.7, 1.3, np.nan], 1.0, 1.0, [1, 1, 0, 0]),
        ([0.0, 0.01, np.nan], None, 0.5, [1, 1, 0]),  # a flat imprint: a quarter of the range
        ([0.0, 1.0 * (1 - 1e-7)], 1.0, 1.0, [1, 0]),  # a rounding error is no contact
    ],
)
def test_the_press_depth_decides_what_is_in_contact(
    values_mm: list[float], given_mm: float | None, press_mm: float, contact: list[int]
) -> None:
    shape = contact_shape_from_array(np.array([values_mm]) * MM, 2 * MM, given_mm and given_mm * MM)
    assert shape.press_depth_m == pytest.approx(press_mm * MM)
    np.testing.assert_array_equal(shape.contact, [np.array(contact, bool)])


@pytest.mark.parametrize(
    ("values", "press_depth_m", "wrong"),
    [
        (np.zeros((2, 3, 3)), None, "(2, 3, 3)"),
        (np.zeros((0, 3)), None, "(0, 3)"),
        (np.zeros((2, 3), bool), None, "bool"),
        (np.array([["a", "b"]]), None, "<U1"),
        ([[-0.1 * MM, 1 * MM]], None, "-0.0001 m"),
        ([[0.1, 1.5]], None, "`touch_unit`"),
        ([[0.0, 1 * MM]], 3 * MM, "3 mm"),
        ([[0.0, 1 * MM]], 0.0, "0 mm"),
        ([[0.0, 1 * MM]], float("nan"), "nan mm"),
    ],
)
def test_bad_arrays_are_refused(values: object, press_depth_m: float | None, wrong: str) -> None:
    with pytest.raises(TouchError, match=naming(wrong)):
        contact_shape_from_array(values, 2 * MM, press_depth_m)


@pytest.mark.parametrize("name", ["T_base_sensor", "T_sensor_object"])
@pytest.mark.parametrize("T", [np.diag([-1.0, 1, 1, 1]), 2 * np.eye(4), np.eye(3), np.full((4, 4), np.nan)])
def test_an_invalid_pose_of_a_touch_is_refused(name: str, T: np.ndarray) -> None:
    shape = ContactShape(np.full(PINHOLE.shape, 2 * MM, np.float32), 2 * MM)
    shape.depth_m[2:4, 2:5] = 0
    with pytest.raises(TouchError, match=naming(name, "press 3", "rigid")):
        Touch(shape, PINHOLE, "press 3", **{name: T})


def test_a_touch_must_fit_its_sensor() -> None:
    shape = contact_shape_from_array(slope(), 2 * MM)
    assert Touch(shape, PINHOLE).press_depth_m == shape.press_depth_m
    with pytest.raises(TouchError, match=naming("6 x 8", "12 x 16", "image_size_px")):
        Touch(shape, PINHOLE.resize(16, 12))


def test_contact_must_lie_on_observed_pixels() -> None:
    shape = contact_shape_from_array(slope(), 2 * MM)
    blind = np.zeros((6, 8), bool)
    blind[:, -1] = True
    with pytest.raises(NoContactError, match=naming("1.71 mm")):
        Touch(shape, dataclasses.replace(PINHOLE, observed=blind))


def test_flat_contact_everywhere_is_refused() -> None:
    shape = contact_shape_from_array(np.zeros((6, 8)), 2 * MM)
    with pytest.raises(TouchError, match="flat"):
        Touch(shape, PINHOLE)
    tilted = np.tile(np.linspace(0, 1 * MM, 8), (6, 1))
    assert Touch(contact_shape_from_array(tilted, 2 * MM, 1.5 * MM), PINHOLE).contact_shape.contact.all()


def test_depths_in_too_small_a_unit_are_refused_with_advice_about_the_unit() -> None:
    in_mm = np.tile(np.linspace(0, 1.0, 8), (6, 1))
    with pytest.raises(TouchError, match=naming("0.001 mm", "`touch_unit` mm")):
        Touch(contact_shape_from_array(in_mm * 1e-6, 2 * MM), PINHOLE)


@pytest.mark.parametrize(("press_m", "shown"), [(1e-6, "0.001 mm"), (2 * MM * 1.0004, "2.0008 mm")])
def test_a_press_depth_that_no_gel_shows_is_refused_and_shown_with_enough_digits(press_m, shown) -> None:
    depth_m = np.tile(np.linspace(0, 2 * press_m, 8), (6, 1))
    with pytest.raises(TouchError, match=naming(shown, "unit")):
        contact_shape_from_array(depth_m, 2 * MM, press_m)


def test_advice_on_far_too_large_depths_depends_on_who_states_the_unit() -> None:
    with pytest.raises(TouchError, match="`touch_unit`"):
        contact_shape_from_array(np.full((6, 8), 3.0), 2 * MM)
    with pytest.raises(TouchError, match="max_depth_mm") as caught:
        contact_shape_from_array(np.full((6, 8), 3.0), 2 * MM, meaning=Meaning(states_unit=True))
    assert "`touch_unit`" not in str(caught.value)
