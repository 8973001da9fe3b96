"""Marker dots are found in untouched and touched images, and filled in."""

import json
from pathlib import Path

import numpy as np
import pytest
from photo_helpers import draw, lattice
from PIL import Image
from press_sets import MM, TINY, ball_indentation, ball_set, photographed, sensor, write_image
from scipy.ndimage import gaussian_filter

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.sensors.calibration.folder import read_calibration, write_calibration
from tactile_loc.sensors.calibration.frames import PressImage
from tactile_loc.sensors.calibration.outcome import calibrate
from tactile_loc.sensors.calibration.presses import read_presses
from tactile_loc.sensors.calibration.unlabelled import find_presses
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.reading.markers import UntouchedGel, continue_values, find_dots, mark_dots, match_dots
from tactile_loc.sensors.reading.photometric import EstimatorRecipe

PX = 160
GEOMETRY = sensor(PX)
PITCH_M = GEOMETRY.pixel_pitch_m
GEL = render_background(GEOMETRY, OPTICS["gelslim"])


def move(places: np.ndarray, indentation_m: np.ndarray, shift_px: float) -> np.ndarray:
    """The places (N, 2) after the gel under them moved down the slope, by `shift_px` where it is steepest."""
    down, across = np.gradient(gaussian_filter(indentation_m, 4))
    rows, columns = (np.clip(places[:, i].astype(int), 0, PX - 1) for i in (1, 0))
    slope = np.stack([across[rows, columns], down[rows, columns]], axis=1)
    return places - shift_px * slope / max(np.hypot(across, down).max(), 1e-9)


@pytest.mark.parametrize("hexagonal", [False, True])
@pytest.mark.parametrize(("spacing_px", "diameter_px"), [(10, 3), (10, 5), (15, 4), (20, 3), (20, 5)])
def test_dots_at_known_places_are_found(spacing_px, diameter_px, hexagonal):
    places = lattice(spacing_px, hexagonal=hexagonal)
    dots = find_dots(draw(GEL, places, diameter_px))
    assert dots is not None
    assert dots.spacing_px == pytest.approx(spacing_px, rel=0.03)
    assert diameter_px / 2 <= dots.radius_px < diameter_px / 2 + 2
    whole = ((places > 3) & (places < PX - 3)).all(axis=1)
    off = np.linalg.norm(places[:, None] - dots.centres_px, axis=2)
    assert off[whole].min(axis=1).max() < 0.6
    inside = ((dots.centres_px > 0) & (dots.centres_px < PX)).all(axis=1)
    assert off.min(axis=0)[inside].max() < 2.5  # no dot is found elsewhere
    assert len(dots) < 1.2 * len(places)  # with the dots beyond the border


def test_a_gel_without_dots_is_unchanged():
    gel = UntouchedGel.of(GEL)
    assert gel.dots is None
    assert gel.record(PITCH_M) == {"count": 0}
    assert gel.clear is GEL
    touch = photographed(ball_indentation(GEOMETRY)[None], GEOMETRY)[0]
    assert gel.clear_image(touch) is touch
    float_image = touch.astype(np.float32)
    assert gel.add_dots(float_image) is float_image


@pytest.mark.parametrize("seed", range(8))
def test_dirt_is_not_taken_for_dots(seed):
    rng = np.random.default_rng(seed)
    image = GEL
    for places in np.array_split(rng.uniform(0, PX, (int(rng.integers(5, 150)), 2)), 4):
        image = draw(image, places, float(rng.uniform(2, 5)), float(rng.uniform(0.3, 0.9)))
    assert find_dots(image) is None
    assert UntouchedGel.of(image).clear is image


def test_dots_are_found_among_dirt_but_not_in_a_single_row_of_specks():
    row = np.stack([np.arange(10, 150, 10), np.full(14, 80)], axis=1)
    assert find_dots(draw(GEL, row, 4)) is None
    places = lattice(15)
    dirt = np.random.default_rng(0).uniform(0, PX, (12, 2))
    dots = find_dots(draw(draw(GEL, places, 4), dirt, 2.5, 0.5))
    assert dots is not None
    assert dots.spacing_px == pytest.approx(15, rel=0.03)


@pytest.mark.parametrize(("spacing_px", "diameter_px"), [(10, 5), (15, 4), (20, 3)])
def test_the_filled_untouched_gel_is_near_the_gel_without_dots(spacing_px, diameter_px):
    gel = UntouchedGel.of(draw(GEL, lattice(spacing_px), diameter_px))
    off = gel.clear.astype(float) - GEL
    assert np.sqrt((off**2).mean()) < 3.5  # the gel's grain cannot be filled in
    assert np.quantile(np.abs(off), 0.999) < 14
    np.testing.assert_allclose(gel.add_dots(gel.clear.astype(np.float32)), gel.image, atol=2)


def test_moved_dots_are_found():
    places = lattice(15)
    ball = ball_indentation(GEOMETRY, press_m=0.8e-3)
    dots = find_dots(draw(GEL, places, 4))
    moved = move(places, ball, 4.0)
    assert np.linalg.norm(moved - places, axis=1).max() > 3
    touch = draw(photographed(ball[None], GEOMETRY)[0], moved, 4)
    found = match_dots(touch, dots)
    assert found.shape == dots.centres_px.shape
    whole = ((moved > 3) & (moved < PX - 3)).all(axis=1)
    off = np.linalg.norm(moved[whole][:, None] - found, axis=2).min(axis=1)
    assert off.max() < 1
    still = np.linalg.norm(moved[whole][:, None] - dots.centres_px, axis=2).min(axis=1)
    assert still.max() > 2.5  # the untouched places miss the moved dots
    hidden = mark_dots(touch, dots)
    assert hidden[tuple(moved[whole].astype(int).T[::-1])].all()
    np.testing.assert_array_equal(match_dots(GEL, dots), dots.centres_px)  # hidden dots count as unmoved


@pytest.mark.parametrize("shift_px", [0.0, 3.0])
def test_a_filled_touch_is_near_the_touch_without_dots(shift_px):
    places, ball = lattice(15), ball_indentation(GEOMETRY, press_m=0.8e-3)
    gel = UntouchedGel.of(draw(GEL, places, 4))
    touch = photographed(ball[None], GEOMETRY)[0]
    dotted = draw(touch, move(places, ball, shift_px), 4)
    filled = gel.clear_image(dotted)
    inside = ball > 0
    off, dots = (np.sqrt(((image.astype(float) - touch)[inside] ** 2).mean()) for image in (filled, dotted))
    assert off < 5
    assert off < 0.2 * dots


@pytest.mark.parametrize("diameter_px", [7, 8])
def test_too_many_dots_are_refused(diameter_px):
    with pytest.raises(CalibrationError, match=r"marker dots cover \d+ % of the untouched gel's image"):
        UntouchedGel.of(draw(GEL, lattice(10), diameter_px))


@pytest.mark.slow
def test_large_images_are_filled_at_their_own_size():
    shape = (480, 640)
    y, x = np.mgrid[: shape[0], : shape[1]]
    plain = np.stack([80 + x / 8, 160 - y / 8, 60 + (x + y) / 16], axis=-1).astype(np.uint8)
    gel = UntouchedGel.of(draw(plain, lattice(50, shape), 14))
    assert gel.clear.shape == plain.shape
    assert np.abs(gel.clear.astype(int) - plain).max() <= 3
    untouched = np.abs(gel.clear_image(gel.image).astype(int) - plain)
    assert untouched.max() <= 3
    record = gel.record(1e-4)
    assert record["spacing_m"] == pytest.approx(5e-3, rel=0.02)
    assert 1.4e-3 < record["diameter_m"] < 2.4e-3
    assert record["count"] == len(gel.dots)
    assert 0 < record["covered"] < 0.2


def test_linear_values_are_continued_exactly():
    y, x = np.mgrid[:30, :40].astype(np.float32)
    values = np.stack([2 * x - y, 3 + y], axis=-1)
    hidden = np.hypot(x - 20, y - 14) < 5
    for bent in (True, False):
        done = continue_values(np.where(hidden[..., None], np.float32(99), values), hidden, bent)
        np.testing.assert_allclose(done, values, atol=1e-3)
    np.testing.assert_array_equal(continue_values(values, np.zeros_like(hidden)), values)
    assert not continue_values(values, np.ones_like(hidden)).any()


@pytest.fixture(scope="module")
def dotted(tmp_path_factory):
    """A folder of presses on a gel with dots, the presses without dots, and the places of the dots."""
    balls = ball_set(10, PX)
    places = lattice(15)
    folder = balls.write(tmp_path_factory.mktemp("dotted"))
    write_image(folder / "background.png", draw(balls.background, places, 4))
    for number, image in enumerate(balls.images):
        write_image(folder / f"{number:04d}.png", draw(image, move(places, balls.indentation_m[number], 2.5), 4))
    return folder, balls, places


def test_labelled_presses_are_read_without_their_dots(dotted):
    folder, balls, places = dotted
    presses = read_presses(folder, balls.geometry)
    assert np.sqrt(((presses.background.astype(float) - balls.background) ** 2).mean()) < 2
    for number, image in enumerate(balls.images):
        assert np.sqrt(((presses.images[number].astype(float) - image) ** 2).mean()) < 2
    np.testing.assert_array_equal(presses.gel.image, draw(balls.background, places, 4))
    assert np.abs(presses.gel.clear_image(presses.gel.image).astype(int) - presses.gel.clear).max() <= 1


@pytest.mark.slow
def test_a_calibrated_sensor_reads_images_with_dots(dotted, tmp_path):
    folder, balls, places = dotted
    presses = read_presses(folder, balls.geometry)
    recipe = EstimatorRecipe(TINY)
    plain = calibrate(balls, recipe)
    made = calibrate(presses, recipe)
    record = {**made.record, **presses.record()}
    known = read_calibration(write_calibration(tmp_path / "sensor", made.estimator, presses.gel.image, record))
    assert len(known.gel.dots) == json.loads((tmp_path / "sensor" / "calibration.json").read_text())["dots"]["count"]
    ball = ball_indentation(GEOMETRY, 1e-3, -1e-3, 0.6e-3)
    touch = photographed(ball[None], GEOMETRY)[0]
    wanted = plain.estimator.read(touch)[0]
    found = known.read(draw(touch, move(places, ball, 2.5), 4)).indentation_m
    assert np.sqrt(((found - wanted) ** 2).mean()) < 0.03 * MM
    turned = draw(balls.background, lattice(15, turn=0.3), 4)
    write_image(tmp_path / "zero.png", turned)
    newer = read_calibration(tmp_path / "sensor", tmp_path / "zero.png")
    assert np.abs(newer.read(turned).indentation_m).max() < 0.05 * MM
    assert np.abs(newer.estimator.untouched.astype(int) - balls.background).max() < 16
    np.testing.assert_array_equal(newer.untouched, turned)


def read_frames(folder: Path, count: int) -> list[PressImage]:
    names = [f"{number:04d}.png" for number in range(count)]
    return [PressImage(name, np.asarray(Image.open(folder / name))) for name in names]


@pytest.mark.slow
def test_circles_are_found_under_dots(dotted):
    folder, balls, places = dotted
    frames = read_frames(folder, len(balls))
    gel = PressImage("background.png", draw(balls.background, places, 4))
    for given in ([gel, *frames], frames):
        found = find_presses(given)
        assert len(found.used) >= 8
        for press in found.used:
            x, y, _ = balls.circles[int(press.name[:4])]
            assert np.hypot(press.circle.x_px - x, press.circle.y_px - y) < 2
        dots = find_dots(found.untouched)
        assert dots is not None  # the composed gel has the dots, too
        assert len(dots) == pytest.approx(len(places), rel=0.1)


@pytest.mark.slow
def test_dots_show_that_the_camera_moved(dotted):
    folder, balls, places = dotted
    frames = read_frames(folder, len(balls))
    frames[3] = PressImage(frames[3].name, np.roll(frames[3].image, 3, axis=1))
    gel = PressImage("background.png", draw(balls.background, places, 4))
    found = find_presses([gel, *frames])
    assert {press.name for press in found.presses if press.dropped.startswith("camera moved")} == {"0003.png"}
