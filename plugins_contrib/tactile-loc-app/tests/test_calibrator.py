"""A visitor calibrates a sensor from uploaded photos of a ball, and locates with photos of this sensor."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from press_sets import BALL_M, MM, TINY, ball_set
from tactile_loc import RunConfig, StageStore, TactileLocError
from tactile_loc.io.images import encode_png
from tactile_loc.sensors.calibration.folder import read_calibration
from test_uploads import pack

from tactile_loc_app.calibrator import Calibrator
from tactile_loc_app.errors import AppError
from tactile_loc_app.page.task_progress import TaskProgress
from tactile_loc_app.session import Session
from tactile_loc_app.shared_localizers import SharedLocalizers

BALLS = ball_set(7, px=80)
RADIUS_MM, MM_PER_PX = BALL_M / MM, 0.2
UNTOUCHED = "untouched.png"


def list_photos() -> dict[str, bytes]:
    return {f"ball-{n}.png": encode_png(image) for n, image in enumerate(BALLS.images)}


@pytest.fixture
def calibrator(tmp_path) -> Calibrator:
    return Calibrator(tmp_path / "own", StageStore(tmp_path / "store"), TINY)


@pytest.fixture
def filled(calibrator) -> Calibrator:
    calibrator.set_reference(UNTOUCHED, encode_png(BALLS.background))
    calibrator.add_photos("photos.zip", pack({f"some/{name}": data for name, data in list_photos().items()}))
    return calibrator


def test_photos_come_one_by_one_or_in_an_archive(filled):
    assert (filled.reference, filled.names) == (UNTOUCHED, sorted(list_photos()))
    filled.add_photos("one.png", encode_png(BALLS.images[0]))
    assert len(filled.names) == 8
    filled.set_reference("newer.png", encode_png(BALLS.background))
    assert (filled.reference, len(filled.names)) == ("newer.png", 8)
    filled.remove_photo("one.png")
    assert filled.names == sorted(list_photos())
    filled.remove_photo("newer.png")
    assert (filled.reference, len(filled.names)) == (None, 7)
    with pytest.raises(AppError):
        filled.remove_photo("../other.png")
    filled.clear()
    assert (filled.reference, filled.names) == (None, [])


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("notes.txt", b"no photo"),
        ("photo.png", b"no photo"),
        ("grey.png", encode_png(np.zeros((9, 9), np.uint8))),
        (UNTOUCHED, encode_png(BALLS.background)),
        ("presses.csv", b"image,kind\n/etc/hostname,background\n"),
        ("presses.csv", b"image,kind\n../a.png,ball\n"),
        ("some.zip", pack({"bad.png": b"no photo", "notes.txt": b"no photo"})),
        ("some.zip", pack({"a/1.png": encode_png(BALLS.images[0]), "b/1.png": encode_png(BALLS.images[1])})),
    ],
)
def test_a_file_that_cannot_be_used_changes_nothing(filled, name, content):
    before = filled.names
    with pytest.raises(TactileLocError):
        filled.add_photos(name, content)
    assert filled.names == before


def test_good_photos_of_an_archive_are_kept_without_the_bad_ones(filled, caplog):
    good = encode_png(BALLS.images[0])
    assert filled.add_photos("some.zip", pack({"good.png": good, "notes.txt": b"", "bad.png": b""})) == ["good.png"]
    assert set(filled.names) == {*list_photos(), "good.png"}
    (record,) = caplog.records
    assert record.name.startswith("tactile_loc")
    assert "some.zip: 2" in record.getMessage()


def test_the_photo_without_contact_has_an_own_name(filled):
    with pytest.raises(AppError):
        filled.set_reference("ball-0.png", encode_png(BALLS.background))
    with pytest.raises(AppError):
        filled.set_reference("other.png", b"no photo")
    assert filled.reference == UNTOUCHED


@pytest.mark.parametrize(
    ("name", "radius_mm", "scale"),
    [
        *((name, 3.0, 0.2) for name in ("", "../mine", ".hidden", "a\0b")),
        *(("mine", *lengths) for lengths in ((0.0, 0.2), (3.0, -1.0), (0.4, 0.2))),
    ],
)
def test_impossible_names_and_lengths_are_refused(filled, name, radius_mm, scale):
    with pytest.raises(TactileLocError):
        filled.calibrate(name, radius_mm, scale)
    assert filled.made is None


@pytest.mark.slow
def test_a_photo_without_contact_that_shows_a_press_is_refused(calibrator):
    photos = list_photos()
    calibrator.set_reference("press.png", photos.pop("ball-0.png"))
    calibrator.add_photos("rest.zip", pack({**photos, "gel.png": encode_png(BALLS.background)}))
    with pytest.raises(AppError, match=r"press\.png"):
        calibrator.calibrate("mine", RADIUS_MM, MM_PER_PX)


def test_a_calibration_needs_photos_and_ends_when_its_visitor_leaves(filled, tmp_path):
    empty = Calibrator(tmp_path / "empty", StageStore(tmp_path / "store"), TINY)
    filled.stop()
    for one in (empty, filled):
        with pytest.raises(AppError):
            one.calibrate("mine", RADIUS_MM, MM_PER_PX)


def test_progress_is_shown_as_a_share():
    shown = []
    progress = TaskProgress(lambda task, share: shown.append((task, share)), lambda: True)
    with progress.task("looking", 4) as advance:
        advance(1)
        advance(1)  # too soon to be shown
    assert shown == [("looking", 0.25)]


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_photos_become_a_sensor_that_locates_photos(tmp_path, store):
    pytest.importorskip("torch")
    (tmp_path / "visitors").mkdir()
    session = Session(SharedLocalizers(tmp_path / "visitors", store), RunConfig.from_dict({"object": {"path": "pin"}}))
    calibrator = session.calibrator
    calibrator.options = TINY
    calibrator.set_reference(UNTOUCHED, encode_png(BALLS.background))
    calibrator.add_photos("photos.zip", pack(list_photos()))
    tasks: set[str] = set()
    made = calibrator.calibrate("mine", RADIUS_MM, MM_PER_PX, lambda task, _: tasks.add(task))
    assert "learning slope from colour" in tasks
    assert calibrator.made is made
    assert made.labelled.found is not None
    assert len(made.labelled.found.used) == 7
    assert any("indentation in the contact" in line for line in made.describe())
    with zipfile.ZipFile(io.BytesIO(made.pack())) as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path / "unpacked")
    assert {"mine/held-out.png", "mine-labels/labels.png", "mine-labels/presses.csv"} <= names
    assert read_calibration(tmp_path / "unpacked" / "mine").record == read_calibration(made.folder).record

    session.choose_sensor(str(made.folder))
    (touch,) = session.read_touch_file("photo.png", list_photos()["ball-3.png"])
    assert touch.image is not None
    assert 1e-4 < touch.press_depth_m < 1.5e-3
    frames = tmp_path / "camera"
    frames.mkdir()
    (frames / "frame.png").write_bytes(list_photos()["ball-4.png"])
    assert session.take_camera_touch(str(frames)).name == "frame.png"
    assert len(session.touches) == 2

    again = calibrator.calibrate("mine", RADIUS_MM, MM_PER_PX)
    assert again.folder != made.folder
    calibrator.add_photos("presses.csv", (made.labelled.folder / "presses.csv").read_bytes())
    assert calibrator.calibrate("mine", RADIUS_MM, MM_PER_PX).labelled.found is None
    session.close()
    assert list(Path(tmp_path / "visitors").iterdir()) == []
