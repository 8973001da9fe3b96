"""Folders of photos are labelled: the ball is found in the images, or an existing table is used unchanged."""

import numpy as np
import pytest
from photo_helpers import MAPS, photograph
from PIL import Image
from press_sets import BALL_M, MM, ball_set, write_image

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError
from tactile_loc.io.sensor_files import read_camera, read_sensor_file
from tactile_loc.sensors.calibration.labelling import label_presses
from tactile_loc.sensors.calibration.press_table import SENSOR, TABLE, read_rows
from tactile_loc.sensors.calibration.presses import read_presses
from tactile_loc.sensors.reading.rectification import StatedView

BALLS = ball_set(7, px=80)
RADIUS_MM, MM_PER_PX = BALL_M / MM, 0.2


@pytest.fixture
def photos(tmp_path):
    folder = BALLS.write(tmp_path / "photos")
    for name in (TABLE, SENSOR):
        (folder / name).unlink()
    return folder


def test_the_ball_is_found_in_each_photo(photos):
    labelled = label_presses(photos, None, RADIUS_MM, MM_PER_PX)
    found = labelled.found
    assert found is not None
    assert found.untouched_names == ("background.png",)
    centres = [(press.circle.x_px, press.circle.y_px) for press in found.used]
    np.testing.assert_allclose(centres, BALLS.circles[:, :2], atol=0.7)
    assert 1e3 * read_sensor_file(labelled.sensor).pixel_pitch_m == pytest.approx(MM_PER_PX)
    assert found.title == "7 of 7 presses are used"
    assert len(labelled.describe()) == 2
    presses = read_presses(photos, BALLS.geometry)
    assert len(presses) == 7
    np.testing.assert_array_equal(presses.background, BALLS.background)


@pytest.mark.slow
def test_an_image_of_the_untouched_gel_is_composed_and_wide_circles_are_kept(photos):
    (photos / "background.png").unlink()
    labelled = label_presses(photos, None, 1.5, MM_PER_PX)
    background, *balls = read_rows(photos / TABLE)
    assert (background.kind, background.image.name) == ("background", "untouched-gel.png")
    assert labelled.found is not None
    radii = [round(press.circle.radius_px, 2) for press in labelled.found.used]
    assert [row.read_number("radius_px") for row in balls] == radii
    assert max(radii) > 1.5 / MM_PER_PX
    presses = read_presses(photos, BALLS.geometry)
    assert len(presses) == len(radii)
    (deep,) = presses.list_facts()
    wide = [row.image.name for row in balls if row.read_number("radius_px") > 0.98 * 1.5 / MM_PER_PX]
    assert all(name in deep for name in wide) or "all presses" in deep


@pytest.mark.slow
def test_an_existing_table_is_used(photos):
    first = label_presses(photos, None, RADIUS_MM, MM_PER_PX)
    table = (photos / TABLE).read_text()
    write_image(photos / "new.png", BALLS.images[0])
    again = label_presses(photos, None, RADIUS_MM, MM_PER_PX)
    assert (again.found, again.unlisted, again.sensor) == (None, 1, first.sensor)
    assert (photos / TABLE).read_text() == table
    with pytest.raises(ConfigError):
        label_presses(photos, None, 2 * RADIUS_MM, MM_PER_PX)


@pytest.mark.parametrize(
    ("radius_mm", "mm_per_px", "error"),
    [(None, 0.2, CalibrationError), (3.0, None, CalibrationError), (0.0, 0.2, ConfigError), (3.0, np.nan, ConfigError)],
)
def test_lengths_are_needed(photos, radius_mm, mm_per_px, error):
    with pytest.raises(error):
        label_presses(photos, None, radius_mm, mm_per_px)
    assert not (photos / TABLE).exists()


def test_stretched_photos_are_evened_and_named_first(photos):
    for path in photos.glob("*.png"):
        write_image(path, photograph(np.asarray(Image.open(path)), MAPS["stretched"]))
    labelled = label_presses(photos, None, RADIUS_MM, MM_PER_PX)
    assert labelled.view is not None
    assert labelled.list_doubts() == [labelled.view.says]
    assert labelled.view.aspect == pytest.approx(1.2, rel=0.02)
    assert labelled.found is not None
    camera, photo_map = read_camera(labelled.sensor)
    assert photo_map is not None
    assert camera.shape == labelled.found.untouched.shape[:2]
    shares = np.array([camera.width_px, camera.height_px]) / 80
    centres = [(press.circle.x_px, press.circle.y_px) for press in labelled.found.used]
    np.testing.assert_allclose(centres, shares * BALLS.circles[:, :2], atol=1)
    presses = read_presses(photos, camera, photo_map=photo_map).measure_stretch()
    assert len(presses) == 7
    assert presses.stretch is not None
    assert not presses.stretch.is_clear
    again = label_presses(photos, None, RADIUS_MM, MM_PER_PX)
    assert (again.found, again.unlisted) == (None, 0)


@pytest.mark.parametrize("name", MAPS)
def test_stated_views_give_the_circles_of_straight_photos(photos, name):
    for path in photos.glob("*.png"):
        write_image(path, photograph(np.asarray(Image.open(path)), MAPS[name]))
    view = {
        "stretched": StatedView(aspect=1 / 1.2),
        "tilted": StatedView(corners_px=MAPS["tilted"].corners_px, gel_mm=(16.0, 16.0)),
        "barrel": StatedView(lens=MAPS["barrel"].lens),
    }[name]
    scale = {"stretched": MM_PER_PX / 1.2**0.5, "tilted": None, "barrel": MM_PER_PX}[name]
    labelled = label_presses(photos, None, RADIUS_MM, scale, view=view)
    assert labelled.view is None
    assert labelled.found is not None
    camera, photo_map = read_camera(labelled.sensor)
    assert photo_map is not None
    found = np.array([(press.circle.x_px, press.circle.y_px) for press in labelled.found.used])
    found_m = (found - [camera.cx, camera.cy]) * camera.pixel_pitch_m
    true_m = (BALLS.circles[:, :2] - 40) * 0.2 * MM
    np.testing.assert_allclose(found_m, true_m, atol=2e-4)
    (photos / TABLE).unlink()
    with pytest.raises(ConfigError):  # the file states the view now
        label_presses(photos, None, RADIUS_MM, None, view=view)
