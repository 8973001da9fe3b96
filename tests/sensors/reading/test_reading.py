"""Contact shapes from indentations, the checks of an image before it is read, and its health."""

import dataclasses
import logging

import numpy as np
import pytest
from message_helpers import missing, naming
from press_sets import BALL_M, MM, ball_indentation, contact_radius, places, sensor
from scipy.ndimage import gaussian_filter

from tactile_loc.core.runtime.errors import NoContactError, TouchError, note_source
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.reading.reading import (
    ABOVE_NOISE,
    LEAST_M,
    MOST_SKIRT,
    SKIRT,
    TIP_M,
    Health,
    Seen,
    extrapolate_press_m,
    find_contact_shape,
    find_gel_surface,
    find_worst,
    measure_health,
    measure_press_m,
    read_by_laws,
    recover_indentation,
    require_healthy,
    require_image,
)
from tactile_loc.sensors.reading.surface import find_indentation

GEOMETRY = sensor(128)
PITCH_M = GEOMETRY.pixel_pitch_m
PRESS_M = 6e-4
GEL = render_background(GEOMETRY, OPTICS["gelslim"])


def flat_punch(half_m: float = 3e-3, press_m: float = PRESS_M, softness_m: float = 0.0) -> np.ndarray:
    x, y = places(GEOMETRY)
    sharp = np.where(np.maximum(np.abs(x), np.abs(y)) < half_m, press_m, 0.0)
    return (gaussian_filter(sharp, softness_m / PITCH_M) if softness_m else sharp).astype(np.float32)


def within_a_lighter_press(found_m: float, press_m: float) -> bool:
    """Return whether a shape was cut at a plausible lighter press."""
    return (1 - MOST_SKIRT) * press_m * 0.999 < found_m < (1 - SKIRT) * press_m * 1.001


@pytest.mark.parametrize("hanging_m", [1e-3, 1.5e-3])
def test_a_straight_gel_skirt_at_an_edge_is_not_contact(hanging_m):
    """The contact is at most three pixels too wide. A threshold at half the press depth would include more."""
    x, y = places(GEOMETRY)
    beyond = np.maximum(np.maximum(np.abs(x), np.abs(y)) - 2e-3, 0)
    indentation = gaussian_filter(PRESS_M * np.clip(1 - beyond / hanging_m, 0, 1), 1).astype(np.float32)
    shape = find_contact_shape(indentation, GEOMETRY, 0.0)
    assert shape.contact[beyond == 0].all()
    off_corners = np.minimum(np.abs(x), np.abs(y)) < 1.5e-3  # the corners are bent
    hanging = (beyond > 3 * PITCH_M) & off_corners
    assert not shape.contact[hanging].any()
    assert (indentation > PRESS_M / 2)[hanging].any()


def test_a_gap_bridged_by_the_gel_is_not_contact():
    x, y = places(GEOMETRY)
    two = np.where((np.abs(np.abs(x) - 1.5e-3) < 1e-3) & (np.abs(y) < 2e-3), PRESS_M, 0.0)
    indentation = np.maximum(gaussian_filter(two, 3e-4 / PITCH_M), 0.45 * PRESS_M * (np.hypot(x, y) < 1e-3))
    shape = find_contact_shape(indentation.astype(np.float32), GEOMETRY, 0.0)
    assert not shape.contact[np.abs(x) < 2e-4].any()
    assert shape.contact_iou(find_contact_shape(two.astype(np.float32), GEOMETRY, 0.0), GEOMETRY.observed_mask) > 0.85


def test_a_shallow_bump_elsewhere_is_not_contact():
    x, y = places(GEOMETRY)
    bump = 0.4 * PRESS_M * np.exp(-((x - 5e-3) ** 2 + (y - 5e-3) ** 2) / (2 * (5e-4) ** 2))
    shape = find_contact_shape((flat_punch(half_m=2e-3) + bump).astype(np.float32), GEOMETRY, 0.0)
    assert not shape.contact[(x > 4e-3) & (y > 4e-3)].any()


@pytest.mark.parametrize("softness_m", [0.0, 3e-4])
def test_the_contact_of_a_flat_punch_is_exact_under_soft_gel(softness_m):
    shape = find_contact_shape(flat_punch(softness_m=softness_m), GEOMETRY, 0.0)
    x, y = places(GEOMETRY)
    inside = np.maximum(np.abs(x), np.abs(y)) < 3e-3
    corner = np.hypot(np.abs(x) - 3e-3, np.abs(y) - 3e-3) < 1.5 * softness_m  # the gel rounds the corners
    np.testing.assert_array_equal(shape.contact[~corner], inside[~corner])
    flat = np.maximum(np.abs(x), np.abs(y)) < 3e-3 - 4 * softness_m
    np.testing.assert_allclose(shape.depth_m[flat], 0, atol=1e-7)
    assert within_a_lighter_press(shape.press_depth_m, PRESS_M)
    assert shape.depth_m.dtype == np.float32


def test_a_balls_contact_shape_equals_that_of_a_lighter_press():
    shape = find_contact_shape(ball_indentation(GEOMETRY, press_m=PRESS_M), GEOMETRY, 0.0)
    tip_m = PRESS_M - measure_press_m(ball_indentation(GEOMETRY, press_m=PRESS_M), GEOMETRY)
    assert 0 <= tip_m < TIP_M**2 / (2 * np.pi * BALL_M) + 3e-6  # the ball's rise over the deepest area
    assert within_a_lighter_press(shape.press_depth_m, PRESS_M - tip_m)
    rho = np.hypot(*places(GEOMETRY))
    true_m = contact_radius(shape.press_depth_m + tip_m)
    np.testing.assert_array_equal(shape.contact, rho < true_m)
    rise = BALL_M - np.sqrt(BALL_M**2 - rho**2, where=rho < BALL_M, out=np.zeros_like(rho))
    np.testing.assert_allclose(shape.depth_m[shape.contact], np.maximum(rise - tip_m, 0)[shape.contact], atol=1e-7)
    assert shape.depth_m.min() == 0.0
    Touch(shape, GEOMETRY)  # the shape is a valid touch


def test_neither_a_single_pixel_nor_the_pixel_size_determines_the_press_depth():
    found = [measure_press_m(ball_indentation(g, press_m=PRESS_M), g) for g in (sensor(64), sensor(256))]
    assert found[0] == pytest.approx(found[1], abs=3e-6)
    indentation = flat_punch()
    indentation[5, 5] = 1.4e-3
    assert measure_press_m(indentation, GEOMETRY) == pytest.approx(PRESS_M)
    area = round((TIP_M / PITCH_M) ** 2)
    indentation[20, 20 : 20 + area] = 1e-3
    assert measure_press_m(indentation, GEOMETRY) == pytest.approx(1e-3)


def test_an_indentation_without_contact_is_refused_and_noise_raises_the_threshold():
    for depth_m in (0.0, -1e-3, 0.9 * LEAST_M):
        with pytest.raises(NoContactError, match=naming("0.05 mm")):
            find_contact_shape(np.full(GEOMETRY.shape, depth_m, np.float32), GEOMETRY, 0.0)
    light = ball_indentation(GEOMETRY, press_m=1.5e-4)
    assert find_contact_shape(light, GEOMETRY, 1e-5).contact.any()
    with pytest.raises(NoContactError, match=naming("0.2 mm") + r".*\b0\.1[45] mm"):
        find_contact_shape(light, GEOMETRY, 2e-4 / ABOVE_NOISE)


def test_a_press_no_deeper_than_the_false_press_is_refused():
    light = ball_indentation(GEOMETRY, press_m=1.5e-4)
    assert find_contact_shape(light, GEOMETRY, 0.0, false_press_m=2e-3).contact.any()
    lightest = ball_indentation(GEOMETRY, press_m=8e-5)
    assert find_contact_shape(lightest, GEOMETRY, 0.0, false_press_m=4e-5).contact.any()
    with pytest.raises(NoContactError, match=naming("0.09 mm")):
        find_contact_shape(lightest, GEOMETRY, 0.0, false_press_m=6e-5)


def test_a_press_depth_is_limited_to_the_sensors_range():
    shape = find_contact_shape(flat_punch(press_m=5 * MM), GEOMETRY, 0.0)
    assert within_a_lighter_press(shape.press_depth_m, GEOMETRY.max_depth_m)
    assert shape.contact.sum() == (flat_punch() > 0).sum()


def test_unobserved_pixels_are_neither_contact_nor_press():
    observed = np.ones(GEOMETRY.shape, bool)
    observed[:, :64] = False
    half = dataclasses.replace(GEOMETRY, observed=observed)
    indentation = flat_punch(half_m=1.5e-3)
    indentation[30:40, 10:30] = 1.2e-3
    shape = find_contact_shape(indentation, half, 0.0)
    assert within_a_lighter_press(shape.press_depth_m, PRESS_M)
    np.testing.assert_array_equal(shape.contact, (indentation > 0) & observed)


def test_a_full_size_image_is_reduced_by_averaging_pixels():
    finer = GEL.repeat(3, axis=0).repeat(3, axis=1)
    finer[::3, ::3] = np.minimum(finer[::3, ::3], 240) + 9  # a ninth of each pixel is 9 counts brighter
    finer[1::3, 1::3] -= np.minimum(finer[1::3, 1::3], 9)
    reduced = require_image(finer, GEL, (384, 384))
    assert reduced.shape == GEL.shape
    np.testing.assert_allclose(reduced.astype(int), GEL, atol=1)
    with pytest.raises(TouchError, match=naming("384 x 200", "128 x 128", "384 x 384")):
        require_image(finer[:200], GEL, (384, 384))


def test_dim_images_and_saturated_images_of_a_saturated_gel_pass():
    dim, white = (0.9 * GEL).astype(np.uint8), np.full_like(GEL, 255)
    assert require_image(dim, GEL) is dim
    assert require_image(white, white) is white


BRIGHT = GEL.copy()
BRIGHT[:80, :, 1] = 255
NO_COLOUR = [GEL[..., 0], np.dstack([GEL, GEL[..., 0]]), GEL[..., :1], GEL / 255.0, GEL.astype("u2"), GEL.astype(str)]


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (GEL[:100], ["128 x 100 px", "128 x 128"]),
        (GEL[:, :64], ["64 x 128 px"]),
        (GEL[:0], ["128 x 0 px"]),
        *((image, [str(image.dtype), str(image.shape), "8 bits"]) for image in NO_COLOUR),
        (np.zeros_like(GEL), ["black", "light"]),
        (np.full_like(GEL, 5), ["black"]),
        (np.full_like(GEL, 255), ["saturated", "exposure"]),
        (BRIGHT, ["saturated"]),
        (render_background(GEOMETRY, OPTICS["digit"]), ["sensor", "calibrate"]),
        (np.random.default_rng(0).integers(0, 250, GEL.shape).astype(np.uint8), ["sensor", "calibrate"]),
    ],
)
def test_an_image_that_this_sensor_cannot_have_taken_is_refused(image, words):
    with pytest.raises(TouchError) as caught:
        require_image(image, GEL)
    message = str(caught.value)
    assert "\n" not in message
    assert not message.endswith(".")  # the caller puts the file name before it
    assert all(word in message for word in words)


TIPS = {  # heights over the deepest point, metres, and the largest error of the extrapolated press, share of the press
    "ball": (lambda x, y: (x**2 + y**2) / 6e-3, 0.03),
    "cone": (lambda x, y: 0.5 * np.hypot(x, y), 0.12),
    "ridge": (lambda x, y: np.maximum(0.5 * np.abs(x), 10 * (np.abs(y) - 2.5e-3)), 0.08),
    "flat": (lambda x, y: np.maximum(np.hypot(x, y) - 1e-3, 0), 0.0),
}


@pytest.mark.parametrize("name", TIPS)
def test_the_press_is_extrapolated_to_sharp_tips(name):
    """A sharp tip is measured as too light; the extrapolation removes most of this error, and states the rest."""
    (shape, most), fine = TIPS[name], sensor(256)
    surface = np.maximum(PRESS_M - shape(*places(fine)), 0).astype(np.float32)
    measured_m = measure_press_m(surface, fine)
    press_m, std_m = extrapolate_press_m(surface, fine)
    assert abs(press_m - PRESS_M) <= max(most * PRESS_M, 1e-9)
    assert abs(press_m - PRESS_M) <= max(2 * std_m, 0.05 * PRESS_M)
    assert measured_m <= press_m
    assert find_gel_surface(surface, fine, 1e-6).indentation_std_m == std_m


def test_noise_of_an_untouched_elastic_gel_is_no_contact():
    """Slopes of noise add up to a false pressure, unless the integrated surface shows a contact."""
    elastic = dataclasses.replace(GEOMETRY, gel=Gel(5e-3, coating_m=3e-4))
    slopes = gaussian_filter(np.random.default_rng(0).standard_normal((*GEOMETRY.shape, 2)), (2, 2, 0))
    slopes = (0.02 * slopes / slopes.std()).astype(np.float32)
    integrated = find_indentation(slopes, elastic)
    found = recover_indentation(integrated, slopes, elastic)
    with pytest.raises(NoContactError):
        find_gel_surface(found, elastic, 5e-6)


UNTOUCHED = np.full((*GEOMETRY.shape, 3), 100, np.uint8)
USUAL = Health(light=4.0, unfit=0.2)


def bump() -> np.ndarray:
    """The slopes (H, W, 2) of a smooth hill; the steepest is 0.6."""
    x = np.linspace(-3, 3, 128)
    hill = np.exp(-(x[:, None] ** 2) - x[None] ** 2)
    down, across = np.gradient(hill)
    slopes = np.stack([across, down], axis=-1)
    return (0.6 * slopes / np.abs(slopes).max()).astype(np.float32)


def test_slopes_with_curl_fit_no_surface_and_shallow_slopes_give_no_measure():
    whirl = np.stack([-bump()[..., 1], bump()[..., 0]], axis=-1)
    assert measure_health(UNTOUCHED, UNTOUCHED, bump(), GEOMETRY).unfit < 0.05
    assert measure_health(UNTOUCHED, UNTOUCHED, whirl, GEOMETRY).unfit == pytest.approx(1.0, abs=0.05)
    assert np.isnan(measure_health(UNTOUCHED, UNTOUCHED, 0.1 * bump(), GEOMETRY).unfit)


def test_the_light_is_the_median_change_of_the_image():
    image = UNTOUCHED.copy()
    image[:20] += 90  # a press that covers less than half of the image
    assert measure_health(image, UNTOUCHED, bump(), GEOMETRY).light < 1.0
    image = UNTOUCHED.copy()
    image[..., 2] += 12
    assert measure_health(image, UNTOUCHED, bump(), GEOMETRY).light == pytest.approx(12.0)


def test_the_health_ratio_is_the_worse_of_both_measures():
    assert Health(8.0, 0.2).compare(USUAL) == pytest.approx(2.0)
    assert Health(4.0, 0.6).compare(USUAL) == pytest.approx(3.0)
    assert Health(4.0, np.nan).compare(USUAL) == pytest.approx(1.0)
    assert Health(8.0, 0.9).compare(Health(4.0, np.nan)) == pytest.approx(9.0)  # calibration without steep slopes


def test_the_worst_health_is_found_and_recorded():
    found = find_worst([Health(1.0, np.nan), Health(3.0, 0.2), Health(2.0, 0.1)])
    assert found == Health(3.0, 0.2)
    assert Health.of_record(found.record()) == found
    unknown = find_worst([Health(1.0, np.nan)])
    assert unknown.record() == {"light": 1.0, "unfit": None}
    assert np.isnan(Health.of_record(unknown.record()).unfit)


def test_poor_health_warns_and_worse_health_is_refused(caplog):
    with caplog.at_level(logging.WARNING):
        require_healthy(Health(4.0, 0.25), USUAL)
        assert not caplog.records
        with note_source("photos/a.png"):
            require_healthy(Health(8.0, 0.2), USUAL)
    assert caplog.messages[0].startswith("photos/a.png: ")
    (record,) = caplog.records
    assert not missing(record.message, 2.0, "light")
    with pytest.raises(TouchError, match=naming(3.0, "surface", "`zero`")):
        require_healthy(Health(4.0, 0.6), USUAL)


def test_a_measured_gel_is_read_by_three_laws():
    """The outline of a flat punch under a layer is where the surface is steepest."""
    layer = dataclasses.replace(GEOMETRY, gel=Gel(5e-3))
    x, y = places(GEOMETRY)
    tip = (np.abs(x) < 2e-3) & (np.abs(y) < 3e-3)
    flat = np.where(tip, 0, PRESS_M).astype(np.float32)
    shown = PRESS_M - deform_gel(flat[None], PRESS_M, layer.press(PRESS_M), 20)[0]
    shape = read_by_laws(Seen(shown, shown, None), layer, 1e-6, 0.0)
    (gel, _), (rigid_gel, rigid) = shape.otherwise
    assert gel == layer.gel
    assert rigid_gel == Gel()
    assert rigid.press_depth_m < shape.press_depth_m
    touch = Touch(shape, layer)
    by_outline, by_rigid = touch.read_otherwise()
    assert [touch.gel_law, by_outline.gel_law, by_rigid.gel_law] == ["layer", "outlined layer", "rigid"]
    contact = by_outline.touching_shape.contact
    assert (contact & tip).sum() > 0.9 * (contact | tip).sum()
    assert by_outline.thin(64)[1].contact.any()
    assert not touch.contact_shape.press_to(1e-4).otherwise
