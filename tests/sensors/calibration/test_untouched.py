"""The photo of the untouched gel from another time is found by its name, and corrected for its drift."""

import numpy as np
import pytest
from press_sets import ball_set
from scipy.ndimage import gaussian_filter

from tactile_loc.sensors.calibration.frames import PressImage
from tactile_loc.sensors.calibration.unlabelled import find_presses
from tactile_loc.sensors.calibration.untouched import is_named_untouched, measure_shift

BALLS = ball_set(9, px=80)
GEL = BALLS.background.astype(float)
TEXTURE = 3 * gaussian_filter(np.random.default_rng(5).normal(0, 25, (100, 100, 1)), (1.5, 1.5, 0))


def frames(name: str, gel: np.ndarray, texture: float = 0.0) -> list[PressImage]:
    """The presses on a gel with a texture, and a photo of the gel with this name."""
    images = [image + texture * TEXTURE[10:90, 10:90] for image in BALLS.images]
    shown = {f"{n}.png": image for n, image in enumerate(images)} | {name: gel}
    return [PressImage(n, np.clip(np.rint(image), 0, 255).astype(np.uint8)) for n, image in shown.items()]


def dimmed(share: float) -> np.ndarray:
    """The factor (H, W, 1) of a lamp that became darker on the right."""
    return 1 - share * np.linspace(0, 1, 80)[None, :, None]


@pytest.mark.parametrize("name", ["background.png", "bg.jpg", "ref_2.png", "F0.png", "no_contact.png", "a/blank.png"])
def test_names_of_the_untouched_gel(name):
    assert is_named_untouched(name)


@pytest.mark.parametrize("name", ["0003.png", "press_12.png", "bgr.png", "preference.png", "background/press.png"])
def test_other_names(name):
    assert not is_named_untouched(name)


def test_a_photo_in_another_light_is_corrected_if_its_name_says_that_it_is_untouched():
    found = find_presses(frames("background.png", GEL * dimmed(0.3)))
    assert found.untouched_names == ("background.png",)
    assert len(found.used) == len(BALLS)
    assert found.drift is not None
    assert 20 < found.drift.light < 60
    assert np.abs(found.untouched - GEL).mean() < 2  # it was up to 40 counts darker
    assert "background.png" not in [press.name for press in found.presses]


def test_a_moved_photo_is_moved_back():
    found = find_presses(frames("ref.png", GEL + TEXTURE[10:90, 7:87], texture=1.0))
    assert found.untouched_names == ("ref.png",)
    assert found.drift is not None
    assert np.hypot(*found.drift.shift_px) == pytest.approx(3, abs=0.5)
    inside = (found.untouched - GEL - TEXTURE[10:90, 10:90])[5:-5, 5:-5]
    assert np.abs(inside).mean() < 0.4 * np.abs(TEXTURE[10:90, 10:90] - TEXTURE[10:90, 7:87]).mean()


def test_a_photo_of_today_is_used_unchanged():
    found = find_presses(frames("background.png", GEL))
    assert (found.untouched_names, found.drift) == (("background.png",), None)
    np.testing.assert_array_equal(found.untouched, BALLS.background)


def test_a_name_alone_does_not_make_a_press_the_untouched_gel():
    found = find_presses([*frames("background.png", BALLS.images[0] * dimmed(0.1))])
    assert found.untouched_names == ()
    assert "touched" in {press.name: press.dropped for press in found.presses}["background.png"]
    assert len(found.used) == len(BALLS)


def test_an_older_photo_is_set_aside_if_another_one_fits_better():
    found = find_presses([*frames("bg.png", GEL * dimmed(0.3)), PressImage("new.png", BALLS.background)])
    assert (found.untouched_names, found.drift) == (("new.png",), None)
    assert "another time" in {press.name: press.dropped for press in found.presses}["bg.png"]


@pytest.mark.parametrize("shift", [(1, 0), (0, -1), (4, -6)])
def test_the_shift_of_a_texture_has_its_direction(shift):
    x, y = shift
    gel = (100 + TEXTURE[10:90, 10:90] * np.ones(3)).astype(np.float32)
    moved = (100 + TEXTURE[10 - y : 90 - y, 10 - x : 90 - x] * np.ones(3)).astype(np.float32)
    assert measure_shift(moved - gel, gel, np.zeros((80, 80), bool)) == pytest.approx(shift, abs=0.4)
