"""A camera's view of the gel: as it is stated, and as photos show it."""

import numpy as np
import pytest
from photo_helpers import MAPS, draw, lattice, photograph
from press_sets import ball_set, sensor

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.photo_map import UNIT, Lens, PhotoMap, to_corners
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.reading.circles import Circle
from tactile_loc.sensors.reading.markers import find_dots
from tactile_loc.sensors.reading.rectification import StatedView, Stretch, fit_lattice, measure_scales, measure_stretch

BALLS = ball_set(8, px=120)
GEL = render_background(sensor(160), OPTICS["gelslim"])
LENS = Lens(160.0, 160.0, 80.0, 80.0, (-0.2,))
VIEWS = {
    "stretched": PhotoMap((200, 160), (160, 160), to_corners(UNIT * [200, 160])),
    "half again": PhotoMap((240, 160), (160, 160), to_corners(UNIT * [240, 160])),
    "tilted": PhotoMap((160, 160), (160, 160), ((12.0, 4.0), (148.0, 4.0), (160.0, 160.0), (0.0, 160.0))),
    "barrel": PhotoMap((160, 160), (160, 160), to_corners(160 * UNIT, LENS), LENS),
}


def press(number: int, ratio: float) -> tuple[np.ndarray, Circle]:
    """A photo of a ball, stretched along x, and a circle of about the imprint's area."""
    x, y, radius = BALLS.circles[number]
    return stretch(BALLS.images[number], ratio), Circle(x * ratio, y, radius * ratio**0.5)


def stretch(image: np.ndarray, ratio: float) -> np.ndarray:
    height, width = image.shape[0], round(image.shape[1] * ratio)
    corners = to_corners(UNIT * [width, height])
    return photograph(image, PhotoMap((width, height), image.shape[1::-1], corners))


@pytest.mark.parametrize("ratio", [0.8, 1.0, 1.2, 1.5])
def test_balls_show_the_stretch_of_their_photos(ratio):
    found = measure_stretch([press(n, ratio) for n in range(8)], stretch(BALLS.background, ratio))
    assert found is not None
    assert found.ratio == pytest.approx(ratio, rel=0.02)
    assert found.is_clear == (ratio != 1)
    assert measure_stretch([press(n, ratio) for n in range(2)], stretch(BALLS.background, ratio)) is None


def test_an_uncertain_stretch_is_not_clear():
    assert Stretch(1.15, 0.01).is_clear
    assert Stretch(0.87, 0.01).is_clear
    assert not Stretch(1.15, 0.06).is_clear
    assert not Stretch(1.05, 0.001).is_clear


@pytest.mark.parametrize("name", VIEWS)
def test_a_square_lattice_shows_the_view(name):
    view = VIEWS[name]
    photo = photograph(draw(GEL, lattice(16, turn=0.05), 4), view)
    dots = find_dots(photo)
    assert dots is not None
    found = fit_lattice(dots, view.photo_px)
    assert found is not None
    framed = found.frame(view.photo_px)
    assert measure_scales(framed)[0] == pytest.approx(measure_scales(view)[0], rel=0.02)
    # Up to one scale, the distances in the framed image are those on the gel.
    places = np.random.default_rng(0).uniform(15, 145, (30, 2))
    seen = framed.locate_in_image(view.locate(places))
    true, measured = (np.linalg.norm(p[:15] - p[15:], axis=1) for p in (places, seen))
    assert np.std(measured / true) / np.mean(measured / true) < 0.015


def test_irregular_dots_are_no_lattice():
    places = lattice(16) + np.random.default_rng(0).normal(0, 2.5, lattice(16).shape)
    dots = find_dots(draw(GEL, places, 4))
    assert dots is None or fit_lattice(dots, (160, 160)) is None


def test_corners_give_scale_and_map():
    view = StatedView(corners_px=MAPS["tilted"].corners_px, gel_mm=(16.0, 16.0))
    camera, photo_map = view.make_camera((80, 80), None)
    assert photo_map is not None
    assert photo_map.corners_px == MAPS["tilted"].corners_px
    assert camera.shape == photo_map.image_px[::-1]
    x0, x1, y0, y1 = camera.view
    assert (x1 - x0, y1 - y0) == pytest.approx((16e-3, 16e-3))


def test_a_lens_gives_the_map_and_the_scale_is_that_in_the_middle():
    lens = Lens(72.0, 60.0, 40.0, 40.0, (-0.2,))
    camera, photo_map = StatedView(lens=lens).make_camera((80, 80), 0.2)
    assert photo_map is not None
    assert camera.pixel_pitch_m == pytest.approx(0.2e-3)
    assert measure_scales(photo_map)[0] == pytest.approx(1.2, rel=1e-3)
    assert photo_map.image_px[0] < photo_map.image_px[1]


def test_an_aspect_gives_even_pixels_of_the_same_area():
    camera, photo_map = StatedView(aspect=1 / 1.2).make_camera((80, 96), 0.2 / 1.2**0.5)
    assert photo_map is not None
    assert photo_map.photo_px == (96, 80)
    assert camera.view[1] - camera.view[0] == pytest.approx(16e-3)
    assert camera.view[3] - camera.view[2] == pytest.approx(16e-3)
    assert StatedView().make_camera((80, 96), 0.2)[1] is None


@pytest.mark.parametrize(
    ("view", "mm_per_px"),
    [
        (StatedView(corners_px=MAPS["tilted"].corners_px), 0.2),
        (StatedView(gel_mm=(16.0, 16.0)), None),
        (StatedView(corners_px=MAPS["tilted"].corners_px, gel_mm=(16.0, 16.0)), 0.2),
        (StatedView(corners_px=MAPS["tilted"].corners_px, gel_mm=(-16.0, 16.0)), None),
        (StatedView(corners_px=((np.nan, 0.0), (9.0, 0.0), (9.0, 9.0), (0.0, 9.0)), gel_mm=(16.0, 16.0)), None),
        (StatedView(lens=Lens(700.0, 700.0, 320.0, 240.0)), 0.2),
        (StatedView(), None),
    ],
)
def test_incomplete_views_are_refused(view, mm_per_px):
    with pytest.raises(ConfigError):
        view.make_camera((80, 80), mm_per_px)
