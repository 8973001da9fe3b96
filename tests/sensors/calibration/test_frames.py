"""Images without a table: untouched ones, dropped ones with reasons, and the chosen frames of a video."""

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest
from message_helpers import missing, naming
from PIL import Image
from press_sets import BALL_M, ball_indentation, gel_under, sensor, write_image
from scipy.ndimage import gaussian_filter

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.sensors.calibration.frames import PressImage, choose_frames, read_frames, take_frames
from tactile_loc.sensors.calibration.unlabelled import FoundPresses, find_presses
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background, render_images
from tactile_loc.view.calibration import draw_labels

GEOMETRY = sensor(80)
MM_PER_PX = 0.2
PLACES = np.array([(-3, 2), (0, 0), (3, -3), (4, 3), (-4, -3), (1, 4), (-1, -4), (4, -1)]) * 1e-3
GEL = render_background(GEOMETRY, OPTICS["gelslim"])


def pressed(*balls: tuple[float, float], press_m: float = 7e-4, seed: int = 0) -> np.ndarray:
    """A photo of balls at positions (x, y), in metres, and one press depth."""
    indentation = np.max([ball_indentation(GEOMETRY, x, y, press_m) for x, y in balls], axis=0)[None]
    return render_images(gel_under(indentation, GEOMETRY), GEOMETRY, OPTICS["gelslim"], np.random.default_rng(seed))[0]


PRESSES = [pressed(tuple(place), seed=n) for n, place in enumerate(PLACES)]


def frames(*more: np.ndarray, untouched: int = 1) -> list[PressImage]:
    """The presses, then images of the untouched gel, then more images."""
    images = [*PRESSES, *[GEL] * untouched, *more]
    return [PressImage(f"{n:02d}.png", image) for n, image in enumerate(images)]


def hand_on_gel() -> np.ndarray:
    y, x = np.mgrid[:80, :80]
    return np.clip(GEL + 40 * ((x > 30) & (y > 20 + x / 4))[..., None], 0, 255).astype(np.uint8)


BAD = {  # images by the reason for dropping them
    "two balls": pressed((-4e-3, -2e-3), (4e-3, 2e-3)),
    "cut off at the border": pressed((7.4e-3, 0.0)),
    "over-exposed": np.clip(GEL + 8 * (PRESSES[1].astype(int) - GEL), 0, 255).astype(np.uint8),
}


@pytest.fixture(scope="module")
def with_bad_ones() -> FoundPresses:
    """The presses found among presses, the untouched gel and bad images."""
    return find_presses(frames(*BAD.values(), hand_on_gel()), 1e3 * BALL_M / MM_PER_PX)


@pytest.fixture(scope="module")
def never_untouched() -> FoundPresses:
    """The presses found without an image of the untouched gel."""
    return find_presses(frames(untouched=0))


def test_the_untouched_gel_and_every_ball_are_found():
    found = find_presses(frames(untouched=2))
    assert found.untouched_names == ("08.png", "09.png")
    np.testing.assert_array_equal(found.untouched, GEL)
    assert len(found.used) == len(PRESSES)
    centres = [(press.circle.x_px, press.circle.y_px) for press in found.used]
    np.testing.assert_allclose(centres, 40 + 1e3 * PLACES / MM_PER_PX, atol=0.6)


@pytest.mark.slow
def test_the_untouched_gel_is_assembled_from_presses(never_untouched):
    found = never_untouched
    assert found.untouched_names == ()
    assert len(found.used) == len(PRESSES)
    assert np.abs(found.untouched.astype(int) - GEL).mean() < 2
    centres = [(press.circle.x_px, press.circle.y_px) for press in found.used]
    np.testing.assert_allclose(centres, 40 + 1e3 * PLACES / MM_PER_PX, atol=1.0)


def test_bad_images_are_dropped_with_the_reason(with_bad_ones):
    *reasons, of_hand = (press.dropped for press in with_bad_ones.presses[len(PRESSES) :])
    assert reasons == list(BAD)
    assert of_hand
    assert len(with_bad_ones.used) == len(PRESSES)


def test_a_ball_that_the_border_cuts_is_used_if_its_circle_is_certain():
    wide = sensor(120, 0.024)  # the gel goes on beyond the image
    places = [*PLACES.tolist(), (7.2e-3, 1e-3)]
    balls = gel_under(np.stack([ball_indentation(wide, x, y, 9e-4) for x, y in places]), wide)
    photos = render_images(balls, wide, OPTICS["gelslim"], np.random.default_rng(0))
    every = [*photos, render_background(wide, OPTICS["gelslim"])]
    cropped = [PressImage(f"{n}.png", photo[20:100, 20:100]) for n, photo in enumerate(every)]
    press = find_presses(cropped, 1e3 * BALL_M / MM_PER_PX).presses[-1]
    assert press.circle is not None
    assert press.circle.measure_overhang_px(GEOMETRY.shape) > 0.3 * press.circle.radius_px
    np.testing.assert_allclose((press.circle.x_px, press.circle.y_px), (76, 45), atol=1.0)
    assert not press.dropped


def textured(shift: int) -> np.ndarray:
    dots = 3 * gaussian_filter(np.random.default_rng(5).normal(0, 25, (100, 120, 1)), (1.5, 1.5, 0))
    return dots[10:90, 10 + shift : 90 + shift]


@pytest.mark.slow
def test_a_moved_camera_is_detected_by_the_gel_texture():
    def photo(image, by=0):
        return np.clip(image + textured(by), 0, 255).astype(np.uint8)

    still = [PressImage(f"{n}.png", photo(image)) for n, image in enumerate([*PRESSES, GEL])]
    moved = [PressImage(f"moved by {shift}.png", photo(PRESSES[0], shift)) for shift in (2, 6)]
    found = find_presses([*still, *moved])
    assert all("camera" in press.dropped for press in found.presses[-len(moved) :])
    assert len(found.used) == len(PRESSES)
    most = [PressImage(f"{n}.png", photo(image, 2 + n)) for n, image in enumerate(PRESSES)]
    with pytest.raises(CalibrationError, match=naming("camera", 10)):
        find_presses([PressImage("gel.png", photo(GEL)), PressImage("gel2.png", photo(GEL)), *most])


def test_images_without_a_ball_of_a_ball_larger_than_the_image_and_too_few_images_are_refused():
    noise = np.random.default_rng(0).integers(-2, 3, (6, *GEL.shape))
    nothing = [PressImage(f"{n}.png", np.clip(GEL + noise[n], 0, 255).astype(np.uint8)) for n in range(6)]
    large = [PressImage(f"{n}.png", pressed((0.0, 0.0), press_m=2e-3)[31:49, 31:49]) for n in range(4)]
    for images in (nothing, [*large, PressImage("gel.png", GEL[31:49, 31:49])]):
        with pytest.raises(CalibrationError, match=naming("ball", "gel")):
            find_presses(images)
    with pytest.raises(CalibrationError, match=naming(2, 30)):
        find_presses(frames()[:2])


def test_the_sheet_shows_every_press(with_bad_ones):
    figure = draw_labels(with_bad_ones)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[0].endswith("\n08.png")
    assert sum("radius" in title for title in titles) == len(PRESSES)
    assert any(not missing(title, "09.png", "two balls") for title in titles)


def test_a_folder_without_equal_colour_images_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match=naming(tmp_path, "PNG", "JPEG")):
        read_frames(tmp_path)
    write_image(tmp_path / "a.png", GEL)
    write_image(tmp_path / "labels.png", GEL)  # the sheet of an earlier run
    assert [frame.name for frame in read_frames(tmp_path)[1]] == ["a.png"]
    for name, image, words in (
        ("b.png", GEL[:40], ("a.png", "80 x 80 px", "b.png", "80 x 40 px")),
        ("b.png", GEL[..., 0], ("b.png", "colour")),
        (os.fsdecode(b"\xe4.png"), GEL, (r"\xe4.png", "Unicode")),
    ):
        write_image(tmp_path / name, image)
        with pytest.raises(CalibrationError, match=naming(*words)):
            read_frames(tmp_path)
    with pytest.raises(CalibrationError, match=naming(tmp_path / "none")):
        read_frames(tmp_path / "none")


def film() -> list[np.ndarray]:
    """The frames of three touches that deepen and fade, with the untouched gel between them."""
    touches = []
    for number in range(3):
        depths = (2e-4, 5e-4, 8e-4, 5e-4, 2e-4)
        touches += [GEL] * 6 + [pressed(tuple(PLACES[number]), press_m=d, seed=number) for d in depths]
    return [*touches, *[GEL] * 6]


def test_choose_frames_selects_the_deepest_and_untouched_frames():
    chosen = choose_frames(np.stack(film()).astype(np.float32))
    deepest = {8, 19, 30}
    assert deepest <= set(chosen)
    assert all(np.array_equal(film()[n], GEL) for n in set(chosen) - deepest)
    assert choose_frames(np.stack([GEL] * 20).astype(np.float32)) == []


@pytest.mark.skipif(importlib.util.find_spec("cv2") is None, reason="OpenCV reads the video")
def test_a_video_is_extracted_into_a_folder_only_once(tmp_path):
    pictures = [Image.fromarray(image).quantize(256, dither=Image.Dither.NONE) for image in film()]
    pictures[0].save(tmp_path / "film.gif", save_all=True, append_images=pictures[1:], duration=40)
    folder, found = read_frames(tmp_path / "film.gif")
    assert folder == tmp_path / "film-frames"
    touched = [frame for frame in found if np.abs(frame.image.astype(int) - GEL).mean() > 3]
    assert len(touched) == 3 < len(found)
    assert read_frames(tmp_path)[1][0].name.startswith("film-frames/")
    (folder / touched[0].name).unlink()
    assert take_frames(tmp_path / "film.gif") == folder
    assert not (folder / touched[0].name).exists()


def test_an_unreadable_video_is_refused(tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"no film")
    with pytest.raises(CalibrationError, match=naming("film.mp4", "MP4")):
        read_frames(tmp_path / "film.mp4")
    assert not Path(tmp_path / "film-frames").exists()
