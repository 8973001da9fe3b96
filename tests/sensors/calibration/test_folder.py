"""The calibration folder: atomic writing, and reading."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from kill_steps import killed_at_every_step
from message_helpers import missing, naming
from photo_helpers import MAPS, PX, photograph
from PIL import Image
from press_sets import TINY, ball_set, sensor, write_image

from tactile_loc.core.runtime.errors import CalibrationError, ConfigError, OutputError, TouchError, WeightsError
from tactile_loc.core.sensing.gel import RIGID
from tactile_loc.io.sensor_files import CALIBRATION, write_sensor_file
from tactile_loc.sensors.calibration import folder as module
from tactile_loc.sensors.calibration.folder import (
    BACKGROUND,
    OURS,
    PICTURE,
    SCHEMA_VERSION,
    SENSOR,
    WEIGHTS,
    read_calibration,
    require_replaceable,
    write_calibration,
)
from tactile_loc.sensors.calibration.outcome import calibrate_folder
from tactile_loc.sensors.reading.photometric import EstimatorRecipe, PhotometricEstimator
from tactile_loc.store import files
from tactile_loc.store.store import StageStore

BALLS = ball_set(1)
MASK = np.tri(64, dtype=bool)
GEOMETRY = sensor(64, rectangle_m=(-0.007, 0.006, -0.005, 0.0075), observed=MASK)
NOISE = {"noise_m": 7e-6, "presses": 12}


def untrained(seed: int = 0) -> PhotometricEstimator:
    return PhotometricEstimator(GEOMETRY, BALLS.background, {**TINY, "seed": seed})


def write(folder: Path, seed: int = 0) -> Path:
    return write_calibration(folder, untrained(seed), BALLS.background, NOISE)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(tmp_path / "sensor")


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_written_calibration_is_read_back(folder):
    assert contents(folder).keys() == OURS - {PICTURE, "sensor_surface.npy"}, "other files than the documented ones"
    assert [path.name for path in folder.parent.iterdir()] == ["sensor"]
    found = read_calibration(folder)
    assert found.camera_px == GEOMETRY.shape
    assert found.geometry.is_same_sensor(GEOMETRY)
    np.testing.assert_array_equal(found.geometry.observed, MASK)
    np.testing.assert_array_equal(found.background, BALLS.background)
    assert found.noise_m == 7e-6
    assert found.record["schema_version"] == SCHEMA_VERSION
    assert found.record["presses"] == 12
    assert found.estimator.options == untrained().options
    read, expected = (one.read(BALLS.images[0])[0] for one in (found.estimator, untrained()))
    np.testing.assert_array_equal(read, expected)


def test_an_existing_calibration_is_replaced_completely(folder):
    write_image(folder / PICTURE, BALLS.background)
    write(folder, seed=1)
    assert not (folder / PICTURE).exists()  # it belonged to the previous calibration
    assert read_calibration(folder).estimator.options.seed == 1
    assert [path.name for path in folder.parent.iterdir()] == ["sensor"]


@pytest.mark.parametrize("other", ["presses.csv", ".git", "sensor.toml.bak"])
def test_a_folder_with_other_files_is_not_changed(folder, other):
    (folder / other).write_text("mine")
    before = contents(folder)
    for refuse in (lambda: write(folder, seed=1), lambda: require_replaceable(folder)):
        with pytest.raises(OutputError, match=naming(folder, "`out`")):
            refuse()
    assert contents(folder) == before


def test_empty_folders_leftovers_of_a_killed_process_and_files_of_macos_do_not_prevent_writing(folder, tmp_path):
    (tmp_path / "new").mkdir()
    read_calibration(write(tmp_path / "new"))
    read_calibration(write(tmp_path / "deep" / "er"))
    (folder / ".tmp-new-held-out.png").mkdir()
    for name in (".DS_Store", "._sensor.toml"):  # of macOS
        (folder / name).touch()
    read_calibration(write(folder, seed=1))
    assert not [path for path in folder.iterdir() if files.is_unfinished(path)]


def test_a_file_is_not_replaced(tmp_path):
    (tmp_path / "sensor").write_text("mine")
    with pytest.raises(OutputError, match=naming(tmp_path / "sensor", "`out`")):
        write(tmp_path / "sensor")
    with pytest.raises(OutputError, match=naming(tmp_path / "sensor" / "deeper", "`out`")):
        write(tmp_path / "sensor" / "deeper")
    assert (tmp_path / "sensor").read_text() == "mine"


@pytest.mark.parametrize(
    ("place", "name", "reason", "error"),
    [
        (module, "write_sensor_file", OSError(28, "No space left on device"), OutputError),
        (PhotometricEstimator, "save", KeyboardInterrupt(), KeyboardInterrupt),
    ],
)
def test_a_full_disk_and_an_interruption_leave_the_old_calibration(folder, monkeypatch, place, name, reason, error):
    before = contents(folder)

    def stop(*_: object) -> None:
        raise reason

    monkeypatch.setattr(place, name, stop)
    with pytest.raises(error) as caught:
        write(folder, seed=1)
    assert error is KeyboardInterrupt or not missing(str(caught.value), folder, "No space left", "`out`")
    assert contents(folder) == before
    assert [path.name for path in folder.parent.iterdir()] == ["sensor"]


@pytest.mark.slow
@pytest.mark.parametrize("exchanges", [True, False])
def test_a_kill_at_any_step_leaves_the_old_or_the_new_calibration(folder, monkeypatch, exchanges):
    if not exchanges:
        monkeypatch.setattr(files, "_exchange", lambda one, other: False)
    new, seen = untrained(1), set()
    for _ in killed_at_every_step(lambda: write_calibration(folder, new, BALLS.background, NOISE)):
        found = read_calibration(folder)
        seen.add(found.estimator.options.seed)
        assert contents(folder).keys() == OURS - {PICTURE, "sensor_surface.npy"}
        write(folder)
        assert [path.name for path in folder.parent.iterdir()] == ["sensor"]
    assert seen == {0, 1}


def test_the_description_depends_only_on_the_contents(folder, tmp_path):
    described = read_calibration(folder).describe()
    shutil.copytree(folder, tmp_path / "elsewhere")
    assert read_calibration(tmp_path / "elsewhere").describe() == described
    write(tmp_path / "elsewhere", seed=1)
    assert read_calibration(tmp_path / "elsewhere").describe() != described
    assert json.loads(json.dumps(described, allow_nan=False)) == described


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(CalibrationError, match=naming(tmp_path / "none", "tactile-loc calibrate")):
        read_calibration(tmp_path / "none")
    with pytest.raises(CalibrationError, match=naming(tmp_path, "sensor.toml")):
        read_calibration(tmp_path)


@pytest.mark.parametrize("name", [SENSOR, BACKGROUND, CALIBRATION, WEIGHTS, "sensor_mask.png"])
def test_a_damaged_or_missing_file_is_refused(folder, name):
    if name != WEIGHTS:  # which are read on first use
        whole = (folder / name).read_bytes()
        (folder / name).write_bytes(whole[: len(whole) // 2])
        with pytest.raises(CalibrationError, match=naming(folder, "calibrate")):
            read_calibration(folder)
    (folder / name).unlink()
    with pytest.raises(CalibrationError, match=naming(folder, name)):
        read_calibration(folder)


def test_damaged_weights_are_refused_on_first_use(folder):
    whole = (folder / WEIGHTS).read_bytes()
    (folder / WEIGHTS).write_bytes(whole[:-50])
    with pytest.raises(WeightsError, match=naming("estimator.safetensors", "calibrate")):
        _ = read_calibration(folder).estimator


def rewrite(folder: Path, **changes: object) -> None:
    record = json.loads((folder / CALIBRATION).read_text()) | changes
    (folder / CALIBRATION).write_text(json.dumps({k: v for k, v in record.items() if v is not None}))


@pytest.mark.parametrize("text", ["[]", "3", "{}", "{"])
def test_a_record_that_is_not_a_complete_object_is_refused(folder, text):
    (folder / CALIBRATION).write_text(text)
    with pytest.raises(CalibrationError, match=naming(folder / CALIBRATION, "calibrate")):
        read_calibration(folder)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("schema_version", SCHEMA_VERSION + 1),
        ("schema_version", "1"),
        ("schema_version", None),
        ("noise_m", None),
        ("noise_m", "small"),
        ("estimator", None),
        ("estimator", "magic"),
        ("options", None),
        ("options", 3),
        ("health", {"light": "much"}),
        ("camera_px", 200),
        ("camera_px", [200]),
        ("camera_px", [200, -1]),
        ("camera_px", ["a", "b"]),
    ],
)
def test_a_record_with_a_missing_or_ill_typed_value_or_of_another_version_is_refused(folder, key, value):
    rewrite(folder, **{key: value})
    with pytest.raises(CalibrationError, match=naming("calibration.json", key.removeprefix("schema_"))):
        read_calibration(folder)


def test_a_record_with_an_unknown_option_is_refused(folder):
    rewrite(folder, options={"colour": "red"})
    with pytest.raises(ConfigError, match="'colour'"):
        _ = read_calibration(folder).estimator


def test_a_background_or_a_sensor_file_of_another_sensor_is_refused(folder):
    write_sensor_file(folder / SENSOR, sensor(32))
    with pytest.raises(CalibrationError, match=naming("background.png", "sensor.toml")):
        read_calibration(folder)
    write_sensor_file(folder / SENSOR, GEOMETRY)
    write_image(folder / BACKGROUND, BALLS.background[:40])
    with pytest.raises(CalibrationError, match=naming("background.png", "sensor.toml")):
        read_calibration(folder)
    Image.fromarray(BALLS.background).convert("L").save(folder / BACKGROUND)
    with pytest.raises(CalibrationError, match=naming("background.png", "8-bit grey")):
        read_calibration(folder)


def test_an_unfit_image_of_the_untouched_gel_is_named(folder, tmp_path):
    strange, cut = 255 - BALLS.background, BALLS.background[:50]
    for image, words in ((strange, ["calibrate again"]), (cut, ["64 x 50", "64 x 64"]), (None, ["there is no file"])):
        zero = tmp_path / "none.png" if image is None else write_image(tmp_path / "photo.png", image)
        with pytest.raises(TouchError, match=naming(zero, "`zero`", *words)):
            read_calibration(folder, zero)


@pytest.mark.slow
@pytest.mark.parametrize("name", MAPS)
def test_a_sensor_with_a_map_reads_photos_as_well_as_a_straight_one(tmp_path, name):
    photo_map, balls = MAPS[name], ball_set(20, px=PX)
    new = ball_set(4, px=PX, seed=3)
    errors = []
    for known in (None, photo_map):
        folder = balls.write(tmp_path / ("straight" if known is None else "mapped"))
        if known is not None:
            for path in folder.glob("*.png"):
                write_image(path, photograph(np.asarray(Image.open(path)), known))
            write_sensor_file(folder / "sensor.toml", balls.geometry, known)
        recipe = EstimatorRecipe({**TINY, "steps": 1000})
        outcome = calibrate_folder(folder, folder / "sensor.toml", recipe, store=StageStore(tmp_path / "store"))
        sensor = read_calibration(outcome.write(tmp_path / f"sensor-{known is None}"))
        assert sensor.photo_map == known
        photos = new.images if known is None else [photograph(image, known) for image in new.images]
        off = [sensor.read(photo, RIGID).indentation_m for photo in photos] - new.indentation_m
        errors.append(float(np.sqrt(np.mean(off**2))))
    assert errors[1] < 1.2 * errors[0] + 2e-6
    image = sensor.rectify(photos[0])
    assert image.shape == (PX, PX, 3)
    assert np.abs(image.astype(float) - new.images[0])[photo_map.seen].mean() < 2
    assert sensor.rectify(sensor.background) is sensor.background or photo_map.photo_px == (PX, PX)
    with pytest.raises(TouchError):
        sensor.read(photos[0][:50])
