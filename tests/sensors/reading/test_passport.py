"""Planted faults of a sensor are found by its checks, and clean photos have none."""

from dataclasses import replace

import numpy as np
import pytest
from photo_helpers import MAPS, photograph
from PIL import Image
from press_sets import TINY, ball_set, write_image, write_table
from scipy.ndimage import gaussian_filter

from tactile_loc import EstimatorRecipe, StageStore, calibrate_folder
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.folder import CHECKED, Calibration, read_calibration
from tactile_loc.sensors.reading.passport import CHECKS, examine_photos

BALLS, NEW = ball_set(20, px=80), ball_set(9, px=80, seed=7)
PHOTOS = list(NEW.images)
GEL = BALLS.background.astype(float)


@pytest.fixture(scope="module")
def sensor(tmp_path_factory) -> Calibration:
    folder = tmp_path_factory.mktemp("checked")
    presses = BALLS.write(folder / "presses")
    recipe = EstimatorRecipe({**TINY, "steps": 500})
    outcome = calibrate_folder(presses, presses / "sensor.toml", recipe, store=StageStore(folder / "store"))
    return read_calibration(outcome.write(folder / "sensor"))


def faults(sensor: Calibration, photos) -> list[str]:
    return [one.check.name for one in examine_photos(sensor.examine(photos)) if one.is_fault]


def convert(image) -> np.ndarray:
    return np.ascontiguousarray(np.clip(np.rint(image), 0, 255).astype(np.uint8))


def stuck(photo: np.ndarray) -> np.ndarray:
    made = photo.copy()
    made[5:75:8, 11::13] = 0
    return made


def scratched(photo: np.ndarray) -> np.ndarray:
    noise = gaussian_filter(np.random.default_rng(0).normal(0, 1, (80, 80)), 1.2)
    return convert(photo + 40 * (noise / noise.std() > 1)[..., None])


EACH = {
    "order of colours and pixels": [
        lambda photo: photo[..., ::-1], lambda photo: photo[..., [1, 0, 2]], lambda photo: photo[:, ::-1],
        lambda photo: photo[::-1], lambda photo: photo[::-1, ::-1],
    ],
    "same sensor": [lambda photo: convert(255 - 0.9 * photo.astype(float))],
    "lamps": [lambda photo: convert(photo * [1, 0.4, 1])],
    "equal scales": [lambda photo: photo[:, np.clip(np.rint((np.arange(80) - 40) / 1.2 + 40), 0, 79).astype(int)]],
    "surface of the gel": [scratched],
    "dead pixels": [stuck],
    "contrast of the gel": [lambda photo: convert(GEL + 0.6 * (photo - GEL))],
}  # fmt: skip


def test_clean_photos_have_no_fault_and_the_usual_values_are_stored(sensor):
    assert faults(sensor, PHOTOS) == []
    usual = sensor.record[CHECKED]
    assert {"aspect", "curvature", "drift"} <= usual.keys()
    assert usual["curvature"] == pytest.approx(1 / 3e-3, rel=0.4)


@pytest.mark.parametrize(("name", "number"), [(name, n) for name, changes in EACH.items() for n in range(len(changes))])
def test_a_fault_of_each_photo_is_found(sensor, name, number):
    change = EACH[name][number]
    assert name in faults(sensor, [convert(change(photo)) for photo in PHOTOS])


def test_the_wrong_order_is_named_and_explains_the_rest(sensor):
    findings = examine_photos(sensor.examine([convert(photo[:, ::-1]) for photo in PHOTOS]))
    assert findings[0].says == "left and right are swapped"
    assert all(np.isnan(one.value) for one in findings[1:])


def test_drift_an_offset_and_a_touched_zero_image_are_found(sensor):
    drifting = [convert(photo * (1 + 0.02 * number)) for number, photo in enumerate(PHOTOS)]
    assert faults(sensor, drifting) == ["drift"]
    faint = 0.5 * gaussian_filter(PHOTOS[0] - GEL, (2, 2, 0))
    assert "offset without contact" in faults(sensor, [convert(photo + np.roll(faint, 30, axis=1)) for photo in PHOTOS])
    touched = replace(sensor, untouched=PHOTOS[0])
    assert "zero image" in faults(touched, PHOTOS[1:])


def test_each_fault_that_changes_slopes_returns_slopes(sensor):
    seen = sensor.examine([convert(photo * [1, 0.97, 1]) for photo in PHOTOS])
    slopes = np.random.default_rng(0).normal(0, 0.1, (80, 80, 2))
    for check in CHECKS:
        if check.distort is not None:
            read = check.distort(seen, slopes)
            assert (read.shape, np.isfinite(read).all()) == (slopes.shape, True), check.name


def test_too_few_photos_and_photos_of_another_size_are_refused(sensor):
    with pytest.raises(TouchError):
        sensor.examine(PHOTOS[:2])
    with pytest.raises(TouchError):
        sensor.examine([photo[:60] for photo in PHOTOS])


def test_photos_that_were_stretched_at_the_calibration_are_named(tmp_path):
    stretched = MAPS["stretched"]
    folder = BALLS.write(tmp_path / "presses")
    for path in folder.glob("*.png"):
        write_image(path, photograph(np.asarray(Image.open(path)), stretched))
    rows = BALLS.rows()
    for row in rows[1:]:
        row |= {"center_x_px": 1.2 * row["center_x_px"], "radius_px": 1.2**0.5 * row["radius_px"]}
    write_table(folder, rows)
    square = SensorGeometry("orthographic", 96, 80, 5e3, 5e3, 48, 40, 0.01, 1.5e-3)
    recipe = EstimatorRecipe({**TINY, "steps": 500})
    outcome = calibrate_folder(folder, square, recipe, store=StageStore(tmp_path / "store"))
    assert outcome.presses.stretch.ratio == pytest.approx(1.2, rel=0.03)
    assert outcome.presses.stretch.describe() in outcome.doubts[0]
    sensor = read_calibration(outcome.write(tmp_path / "sensor"))
    assert faults(sensor, [photograph(photo, stretched) for photo in PHOTOS]) == ["equal scales"]
