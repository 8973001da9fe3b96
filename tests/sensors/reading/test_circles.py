"""A ball's visible circle in simulated images: correct in noise, in uneven light and near the border."""

import dataclasses

import numpy as np
import pytest
from press_sets import ball_indentation, gel_under, sensor, visible_radius

from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background, render_images
from tactile_loc.sensors.reading.circles import Circle, compare_colours, find_imprint, find_rim, measure_concentration

GEOMETRY = sensor(160)
SCALE = GEOMETRY.scale_at_surface[0]
PLACES = ((-3e-3, 2e-3, 5e-4), (0.0, 0.0, 9e-4), (2.5e-3, -3.1e-3, 7e-4))  # x, y, press, metres


def photos(places=PLACES, optics=OPTICS["gelslim"], seed=0, together=False) -> tuple[np.ndarray, np.ndarray]:
    """The untouched gel, and pictures (N, H, W, 3) of it under a ball; or of all balls at once."""
    balls = np.stack([ball_indentation(GEOMETRY, x, y, press) for x, y, press in places])
    balls = balls.max(axis=0, keepdims=True) if together else balls
    pictures = render_images(gel_under(balls, GEOMETRY), GEOMETRY, optics, np.random.default_rng(seed))
    return render_background(GEOMETRY, optics), pictures


def found(picture: np.ndarray, gel: np.ndarray) -> Circle:
    change = compare_colours(picture, gel)
    imprint = find_imprint(change)
    assert imprint.likeness > 0.7
    return find_rim(change, imprint.circle)


def off_px(circle: Circle, x_m: float, y_m: float) -> float:
    return float(np.hypot(circle.x_px - 80 - SCALE * x_m, circle.y_px - 80 - SCALE * y_m))


@pytest.mark.parametrize(
    ("optics", "most_px"),
    [
        (OPTICS["gelslim"].remove_noise(), 0.5),
        (OPTICS["gelslim"], 0.5),
        (OPTICS["gelsight-mini"], 0.5),
        (OPTICS["digit"], 0.7),
        (dataclasses.replace(OPTICS["gelslim"], dome=0.6, vignetting=0.6), 0.7),
    ],
    ids=["clean", "gelslim", "gelsight-mini", "digit", "uneven light"],
)
def test_circles_are_found_at_the_balls(optics, most_px):
    gel, pictures = photos(optics=optics)
    for picture, (x, y, press) in zip(pictures, PLACES, strict=True):
        circle = found(picture, gel)
        assert off_px(circle, x, y) < most_px
        contact_px = SCALE * float(visible_radius(np.array([press]))[0])
        assert 0.95 * contact_px < circle.radius_px < 1.35 * contact_px  # the visible circle includes the gel's skirt


def test_neither_strong_noise_nor_a_scratch_on_the_gel_moves_the_circles():
    noisy = dataclasses.replace(OPTICS["gelslim"], read_noise=8.0)
    gel, pictures = photos(optics=noisy)
    for picture, (x, y, _) in zip(pictures, PLACES, strict=True):
        assert off_px(found(picture, gel), x, y) < 1.0
    gel, pictures = photos()
    pictures[1, 84:87, 60:150] = 255
    assert off_px(found(pictures[1], gel), *PLACES[1][:2]) < 0.7


def test_a_circle_that_crosses_the_border_has_an_overhang():
    gel, pictures = photos([(-7.4e-3, 0.0, 8e-4)])
    circle = found(pictures[0], gel)
    assert circle.measure_overhang_px(GEOMETRY.shape) > 0.3 * circle.radius_px
    assert Circle(80, 80, 20).measure_overhang_px(GEOMETRY.shape) == -60


def test_noise_alone_contains_no_ball():
    rng = np.random.default_rng(0)
    imprint = find_imprint(rng.normal(0, 2, (*GEOMETRY.shape, 3)).astype(np.float32))
    assert imprint.likeness < 0.4
    assert not find_imprint(np.zeros((*GEOMETRY.shape, 3), np.float32)).is_ball
    assert measure_concentration(np.zeros((*GEOMETRY.shape, 3), np.float32)) == 0


def test_masking_the_first_ball_reveals_the_second():
    gel, pictures = photos([(-4e-3, 0.0, 9e-4), (4e-3, 1e-3, 6e-4)], together=True)
    change = compare_colours(pictures[0], gel)
    first = find_imprint(change)
    second = find_imprint(change, first.circle.measure_distance_px(GEOMETRY.shape) < 2.2 * first.circle.radius_px)
    xs = sorted(imprint.circle.x_px for imprint in (first, second))
    np.testing.assert_allclose(xs, [40, 120], atol=2)
    alone = compare_colours(photos(PLACES[1:2])[1][0], gel)
    assert measure_concentration(alone) > measure_concentration(change)


def test_the_change_ignores_a_uniform_brightness_shift():
    gel, pictures = photos(PLACES[:1])
    change = compare_colours(pictures[0], gel)
    brighter = compare_colours(pictures[0].astype(np.float32) + 5, gel)
    np.testing.assert_allclose(brighter, change, atol=1e-4)
    assert find_imprint(change).contrast > 10


def test_the_visible_arc_is_a_share_of_the_circle():
    for circle, share in ((Circle(40, 30, 20), 1.0), (Circle(0, 30, 20), 0.5), (Circle(0, 0, 20), 0.25)):
        assert circle.measure_visible_arc((60, 80)) == pytest.approx(share, abs=0.01)
    assert Circle(40, 30, 60).measure_visible_arc((60, 80)) == 0  # all of the image is inside
