from pathlib import Path
from typing import Any

import numpy as np
import pytest
from message_helpers import missing, naming
from numpy.typing import NDArray
from PIL import Image

from tactile_loc import ContactShape, SensorGeometry, Touch, read_touch, write_touch
from tactile_loc.core.runtime.errors import NoContactError, OutputError, TouchError
from tactile_loc.core.sensing.gel import RIGID, Gel
from tactile_loc.plugin import DepthFiles, SensorModel
from tactile_loc.plugin.helpers import make_transform, rotation_about

MM = 1e-3
MAX_DEPTH_M = 2 * MM
PRESS_DEPTH_M = 1.5 * MM
T_SENSOR_OBJECT = make_transform(rotation_about([1, 2, 3], 0.7), [0.001, -0.002, 0.03])
T_BASE_SENSOR = make_transform(rotation_about([0, 1, 0], 2.0), [0.4, 0.1, 0.2])
NOT_RIGID = [np.eye(3), 2 * np.eye(4), np.diag([1.0, 1, -1, 1]), np.full((4, 4), np.nan)]


class Sensor(SensorModel):
    """A sensor of 12 x 9 pixels; `calibrated` for images of one brightness per depth."""

    def __init__(
        self, calibrated: bool = False, gel: Gel = RIGID, max_m: float = MAX_DEPTH_M, size: tuple[int, int] = (12, 9)
    ) -> None:
        super().__init__()
        self.calibrated, self.gel, self.max_m, self.size = calibrated, gel, max_m, size

    @property
    def geometry(self) -> SensorGeometry:
        return SensorGeometry("orthographic", *self.size, 1e4, 1e4, 6, 4.5, 0.1, self.max_m, gel=self.gel)

    def contact_shape(self, image: NDArray[Any]) -> ContactShape:
        if not self.calibrated:
            raise TouchError("the sensor has no calibration for images")
        return ContactShape(image[..., 0].astype(np.float32) * np.float32(MAX_DEPTH_M / 255), MAX_DEPTH_M)


SENSOR = Sensor()


@pytest.fixture
def depth_m() -> NDArray[np.float64]:
    """Depths of a ball, cut at the press depth, in whole micrometres."""
    v, u = np.mgrid[:9, :12]
    ball = 0.05 * ((u - 5) ** 2 + (v - 4) ** 2)
    return np.round(np.minimum(ball, 1.5), 3) * MM


@pytest.fixture
def touch(depth_m: NDArray[np.float64]) -> Touch:
    shape = ContactShape(depth_m.astype(np.float32), PRESS_DEPTH_M)
    return Touch(shape, SENSOR.geometry, "a", T_BASE_SENSOR, T_SENSOR_OBJECT)


def save_png(path: Path, values: NDArray[Any], mode: str | None = None) -> Path:
    image = Image.fromarray(values)
    (image if mode is None else image.convert(mode)).save(path)
    return path


def save_npy(path: Path, values: Any, **kwargs: Any) -> Path:
    np.save(path, values, **kwargs)
    return path


def save_npz(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


def test_a_written_touch_is_read_back_bit_for_bit(tmp_path, touch):
    back = read_touch(write_touch(tmp_path / "a.npz", touch), SENSOR)
    np.testing.assert_array_equal(back.contact_shape.depth_m, touch.contact_shape.depth_m)
    np.testing.assert_array_equal(back.contact_shape.contact, touch.contact_shape.contact)
    assert back.press_depth_m == PRESS_DEPTH_M
    np.testing.assert_array_equal(back.T_sensor_object, T_SENSOR_OBJECT)
    np.testing.assert_array_equal(back.T_base_sensor, T_BASE_SENSOR)
    assert back.name == "a.npz"
    bare = read_touch(write_touch(tmp_path / "bare.npz", Touch(touch.contact_shape, touch.geometry)), SENSOR)
    assert bare.T_sensor_object is bare.T_base_sensor is None


@pytest.mark.parametrize("read_with", [RIGID, Gel(4 * MM)], ids=["rigid", "layer"])
@pytest.mark.parametrize("taken_with", [RIGID, Gel(4 * MM), Gel(2 * MM)], ids=["rigid", "layer", "thin layer"])
def test_another_kind_of_gel_is_reported(tmp_path, touch, taken_with, read_with, caplog):
    taken = Touch(touch.contact_shape, Sensor(gel=taken_with).geometry)
    read_touch(write_touch(tmp_path / "a.npz", taken), Sensor(gel=read_with))
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == (taken_with.kind != read_with.kind)
    assert all(taken_with.kind in message and "a.npz" in message for message in said)


def test_a_file_without_a_gel_is_read_with_any_gel(tmp_path, depth_m, caplog):
    for gel in (RIGID, Gel(4 * MM)):
        read_touch(save_npz(tmp_path / "a.npz", depth=depth_m, unit="m"), Sensor(gel=gel))
    assert not caplog.records


@pytest.mark.parametrize(
    "store", [np.str_, np.bytes_, lambda one: [one], lambda one: [[one]], lambda one: [one.encode()]]
)
def test_texts_and_numbers_may_be_bytes_or_arrays_of_one_element(tmp_path, depth_m, store):
    texts = {"unit": store("mm"), "kind": store("distance"), "gel": store("rigid")}
    press = np.reshape(1e3 * PRESS_DEPTH_M, np.shape(texts["unit"]))
    path = save_npz(tmp_path / "a.npz", touched=1e3 * depth_m, press_depth=press, **texts)
    found = read_touch(path, SENSOR)
    assert found.press_depth_m == pytest.approx(PRESS_DEPTH_M)
    np.testing.assert_allclose(found.contact_shape.depth_m, depth_m, atol=1e-9)


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ({"unit": ["m", "mm"]}, ["unit"]),
        ({"unit": 3.0}, ["unit"]),
        ({"press_depth": np.zeros(10**4)}, ["press_depth", "save a number"]),
        ({"unit": np.bytes_(b"\xb5m")}, ["unit"]),
        ({"unit": "furlong"}, ["furlong"]),
        ({"kind": "depth"}, ["'depth'", "indentation"]),
        ({"gel": "jelly"}, ["'jelly'", "rigid", "layer"]),
        *(({name: T}, [name]) for name in ("T_sensor_object", "T_base_sensor") for T in NOT_RIGID),
    ],
)
def test_an_unknown_text_and_a_pose_that_is_not_rigid_are_refused(tmp_path, depth_m, stated, words):
    refused(save_npz(tmp_path / "a.npz", **{"depth": depth_m, "unit": "m", **stated}), *words, unit=None)


def test_writing_the_same_touch_gives_the_same_bytes_in_one_file(tmp_path, touch):
    one, other = (write_touch(tmp_path / name, touch) for name in ("a.npz", "b.npz"))
    write_touch(one, touch)
    assert one.read_bytes() == other.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_a_failed_write_keeps_the_old_touch(tmp_path, touch, monkeypatch):
    path = write_touch(tmp_path / "a.npz", touch)
    before = path.read_bytes()

    def fail(file: Any, **_: Any) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OutputError, match=naming("a.npz", "No space left")):
        write_touch(path, touch)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("name", ["missing/a.npz", "a.txt", "file/a.npz", "folder.npz"])
def test_unwritable_paths_are_refused(tmp_path, touch, name):
    (tmp_path / "file").touch()
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(OutputError, match=Path(name).name):
        write_touch(tmp_path / name, touch)


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("mm", 1e3), ("um", 1e6)])
@pytest.mark.parametrize("kind", ["npy", "npz", "npz stating its unit"])
def test_every_unit_gives_the_same_shape(tmp_path, depth_m, kind, unit, scale):
    values = depth_m * scale
    stated = {"depth": values, "press_depth": PRESS_DEPTH_M * scale, "unit": unit}
    arrays = stated if "stating" in kind else {"height": values}
    path = save_npy(tmp_path / "a.npy", values) if kind == "npy" else save_npz(tmp_path / "a.npz", **arrays)
    shape = read_touch(path, SENSOR, None if "stating" in kind else unit).contact_shape
    np.testing.assert_allclose(shape.depth_m, depth_m, rtol=1e-6, atol=1e-10)
    assert shape.press_depth_m == pytest.approx(PRESS_DEPTH_M)
    np.testing.assert_array_equal(shape.contact, depth_m < PRESS_DEPTH_M)


@pytest.mark.parametrize(("unit", "unit_m"), [("um", 1e-6), ("mm", 1e-3)])
def test_a_png_keeps_depths_to_half_a_unit(tmp_path, unit, unit_m):
    true_m = np.random.default_rng(0).uniform(0, 40 * unit_m, (9, 12))
    values = np.round(true_m / unit_m).astype(np.uint16)
    values[0] = 65535
    path = save_png(tmp_path / "a.png", values)
    shape = read_touch(path, Sensor(max_m=60 * unit_m), unit, press_depth_m=50 * unit_m).contact_shape
    assert np.abs(shape.depth_m[1:] - true_m[1:]).max() <= 0.5001 * unit_m
    assert not shape.contact[0].any()
    assert shape.contact[1:].all()


def test_the_largest_16_bit_number_is_no_contact_in_any_byte_order(tmp_path):
    values = np.array([[0, 700], [1300, 65535]], np.uint16)
    shape = read_touch(save_png(tmp_path / "a.png", values), Sensor(size=(2, 2)), "um").contact_shape
    assert shape.press_depth_m == pytest.approx(1.3 * MM, rel=1e-3)  # the deepest step
    np.testing.assert_array_equal(shape.contact, [[True, True], [True, False]])
    values = np.array([[0, 150, 65535]], ">u2")
    path = save_npy(tmp_path / "a.npy", values)
    shape = read_touch(path, Sensor(size=(3, 1)), "mm", press_depth_m=1 * MM).contact_shape
    np.testing.assert_array_equal(shape.contact, [[True, False, False]])
    path = save_png(tmp_path / "a.png", np.array([[1500, 700], [0, 65535]], np.uint16))
    shape = read_touch(path, Sensor(size=(2, 2)), "um", kind="indentation").contact_shape
    np.testing.assert_array_equal(shape.contact, [[True, True], [False, False]])


def test_a_touch_can_be_read_at_a_lighter_press(tmp_path, touch):
    path = write_touch(tmp_path / "a.npz", touch)
    light = read_touch(path, SENSOR, press_depth_m=0.5 * MM)
    assert light.press_depth_m == 0.5 * MM
    np.testing.assert_array_equal(light.contact_shape.contact, touch.contact_shape.depth_m < np.float32(0.5 * MM))


@pytest.mark.parametrize("press_depth_m", [1.6 * MM, 0.0, -1.0, float("nan")])
def test_a_deeper_or_impossible_press_is_refused(tmp_path, touch, press_depth_m):
    path = write_touch(tmp_path / "a.npz", touch)
    with pytest.raises(TouchError, match=naming("a.npz", "1.5 mm", f"{1e3 * press_depth_m:.3g} mm")):
        read_touch(path, SENSOR, press_depth_m=press_depth_m)


def test_a_calibrated_sensor_reads_colour_images(tmp_path):
    image = np.full((9, 12, 3), 255, np.uint8)
    image[2:5, 3:7] = 51
    np.save(tmp_path / "a.npy", image)
    for path in (save_png(tmp_path / "a.png", image), tmp_path / "a.npy"):
        touch = read_touch(path, Sensor(calibrated=True))
        np.testing.assert_array_equal(touch.image, image)
        assert touch.contact_shape.contact.sum() == 12
        assert touch.contact_shape.depth_m.min() == pytest.approx(MAX_DEPTH_M / 5)


def refused(path: Path, *words: str, unit: str | None = "mm") -> None:
    """Check that a file is refused in one sentence that names it."""
    with pytest.raises(TouchError) as caught:
        read_touch(path, SENSOR, unit)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    for word in words:
        assert word in message


def test_folders_and_unknown_extensions_are_refused(tmp_path):
    (tmp_path / "a.npz").mkdir()
    refused(tmp_path / "a.npz", "folder")
    (tmp_path / "a.csv").write_text("0,1")
    refused(tmp_path / "a.csv", ".npz")


def test_other_array_shapes_and_types_are_refused(tmp_path):
    refused(save_npy(tmp_path / "a.npy", np.zeros((9, 12, 3))), "(9, 12, 3)")
    refused(save_npz(tmp_path / "b.npz", depth=np.zeros((9, 12, 3))), "(9, 12, 3)")
    refused(save_npy(tmp_path / "c.npy", np.zeros((9, 12), bool)), "bool")
    refused(save_npy(tmp_path / "d.npy", np.array(["1", "2"])), "(2,)")
    refused(save_npz(tmp_path / "e.npz", one=np.zeros((9, 12)), two=np.zeros((9, 12))), "one", "two", "depth")
    refused(save_npz(tmp_path / "f.npz"), "nothing")
    refused(save_npz(tmp_path / "g.npz", depth=np.zeros((9, 12)), press_depth=np.zeros(3)), "press_depth")
    refused(save_npz(tmp_path / "h.npz", depth=np.zeros((9, 12)), press_depth="deep"), "press_depth")


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float32])
def test_a_unit_is_never_guessed(tmp_path, dtype):
    values = np.arange(108).reshape(9, 12).astype(dtype)
    refused(save_npy(tmp_path / "a.npy", values), "`touch_unit`", unit=None)
    refused(save_npz(tmp_path / "a.npz", depth=values), "`touch_unit`", unit=None)
    if dtype == np.uint16:
        refused(save_png(tmp_path / "a.png", values), "`touch_unit`", unit=None)


@pytest.fixture
def declaring() -> Sensor:
    """A sensor whose software writes indentations in micrometres."""
    sensor = Sensor()
    sensor.depth_files = DepthFiles("um", "indentation")
    return sensor


@pytest.mark.parametrize("save", [save_png, save_npy, lambda path, values: save_npz(path, depth=values)])
def test_a_sensor_declares_the_unit_and_the_kind_of_its_files(tmp_path, depth_m, declaring, caplog, save):
    path = tmp_path / {save_png: "a.png", save_npy: "a.npy"}.get(save, "a.npz")
    save(path, np.round((PRESS_DEPTH_M - depth_m) * 1e6).astype(np.uint16))
    found = read_touch(path, declaring)
    wanted = read_touch(path, SENSOR, "um", kind="indentation")
    np.testing.assert_array_equal(found.contact_shape.depth_m, wanted.contact_shape.depth_m)
    assert found.press_depth_m == pytest.approx(PRESS_DEPTH_M)
    assert read_touch(path, declaring, "um", kind="indentation").press_depth_m == found.press_depth_m
    assert caplog.messages == []


def test_what_the_caller_states_wins_over_the_sensor_s_declaration_with_a_warning(tmp_path, depth_m, declaring, caplog):
    path = save_npy(tmp_path / "a.npy", depth_m * 1e3)
    found = read_touch(path, declaring, "mm", kind="distance")
    assert found.press_depth_m == pytest.approx(PRESS_DEPTH_M)
    assert len(caplog.messages) == 2
    assert not missing(caplog.messages[0], "a.npy", "unit mm", "declares um", "`touch_unit`")
    assert not missing(caplog.messages[1], "kind distance", "declares indentation", "`touch_kind`")


def test_what_a_file_states_wins_over_the_sensor_s_declaration(tmp_path, touch, declaring, caplog):
    found = read_touch(write_touch(tmp_path / "a.npz", touch), declaring)
    np.testing.assert_array_equal(found.contact_shape.depth_m, touch.contact_shape.depth_m)
    assert caplog.messages == []


def test_contradicting_units_are_refused(tmp_path, touch):
    refused(write_touch(tmp_path / "a.npz", touch), " m", " mm")
    refused(save_npy(tmp_path / "a.npy", np.zeros((9, 12))), "inch", unit="inch")
    assert read_touch(tmp_path / "a.npz", SENSOR, "m").press_depth_m == PRESS_DEPTH_M


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "grey.png"])
def test_images_need_a_calibrated_sensor(tmp_path, name):
    image = np.zeros((9, 12) if name == "grey.png" else (9, 12, 3), np.uint8)
    path = save_png(tmp_path / name, image)
    with pytest.raises(TouchError, match=naming(name, "calibrat")):
        read_touch(path, SENSOR, "mm")


def test_negative_depths_wrong_units_and_inverted_files_are_refused_with_the_remedy(tmp_path, depth_m):
    refused(save_npy(tmp_path / "a.npy", depth_m * 1e3 - 0.5), "negative")
    refused(save_npy(tmp_path / "b.npy", depth_m * 1e3), "unit", unit="m")
    refused(save_npy(tmp_path / "c.npy", depth_m * 1e6), "unit", unit="mm")
    v, u = np.mgrid[:9, :12]
    inverted = np.maximum(1.5 - 0.2 * ((u - 5) ** 2 + (v - 4) ** 2), 0.0)
    refused(save_npy(tmp_path / "d.npy", inverted), "indentations", "`touch_kind` indentation")
    refused(save_npy(tmp_path / "e.npy", -inverted), "negative", "`touch_kind` height")


@pytest.mark.parametrize(
    ("values", "error", "value"),
    [
        (np.full((9, 12), np.nan), NoContactError, "0.5 mm"),
        (np.full((9, 12), 3.0), NoContactError, "0.5 mm"),
        (np.zeros((9, 12)), TouchError, "flat"),
        (np.full((9, 12), 1.3), TouchError, "flat"),
        (np.linspace(0, 1, 12 * 9).reshape(12, 9), TouchError, "12 x 9"),
    ],
)
def test_touches_without_contact_or_of_another_size_are_refused(tmp_path, values, error, value):
    path = save_npy(tmp_path / "a.npy", values)
    with pytest.raises(error, match=naming("a.npy", value)):
        read_touch(path, SENSOR, "mm")


def make_maps(depth_m: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return one map in mm for each kind."""
    return {"distance": 1e3 * depth_m, "indentation": 1.5 - 1e3 * depth_m, "height": 1e3 * depth_m - 1.5}


@pytest.mark.parametrize("kind", ["distance", "indentation", "height"])
@pytest.mark.parametrize("stated", [True, False])
def test_files_of_every_kind_give_the_same_touch(tmp_path, depth_m, kind, stated):
    values = make_maps(depth_m)[kind]
    path = save_npz(tmp_path / "a.npz", depth=values, unit="mm", **({"kind": kind} if stated else {}))
    touch = read_touch(path, SENSOR, kind=None if stated else kind)
    assert touch.press_depth_m == pytest.approx(PRESS_DEPTH_M)
    np.testing.assert_allclose(touch.contact_shape.depth_m, depth_m, rtol=1e-6, atol=1e-9)


def test_the_kind_that_a_file_states_is_believed(tmp_path, touch):
    values = make_maps(touch.contact_shape.depth_m)["indentation"]
    path = save_npz(tmp_path / "a.npz", depth=values, unit="mm", kind="distance")
    assert read_touch(path, SENSOR).contact_shape.depth_m.min() == 0
    with np.load(write_touch(tmp_path / "b.npz", touch)) as written:
        assert str(written["kind"]) == "distance"
    with pytest.raises(TouchError, match=naming("b.npz", "distance", "`touch_kind` is height")):
        read_touch(tmp_path / "b.npz", SENSOR, kind="height")


def make_mask() -> NDArray[np.bool_]:
    v, u = np.mgrid[:9, :12]
    return np.asarray((u - 5) ** 2 + (v - 4) ** 2 < 9)


def test_a_written_mask_is_read_back(tmp_path):
    touch = Touch.from_mask(
        make_mask(), sensor=SENSOR, press_depth_m=1 * MM, press_std_m=0.2 * MM, T_base_sensor=T_BASE_SENSOR
    )
    read = read_touch(write_touch(tmp_path / "a.npz", touch), SENSOR)
    assert not read.has_depths
    np.testing.assert_array_equal(read.contact_shape.contact, make_mask())
    assert (read.press_depth_m, read.contact_shape.indentation_std_m) == (1 * MM, 0.2 * MM)
    np.testing.assert_array_equal(np.asarray(read.T_base_sensor), T_BASE_SENSOR)


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA"])
def test_a_mask_is_read_from_a_picture(tmp_path, mode):
    """The palette has white at the index 0, and black at 1."""
    path = tmp_path / "a.png"
    image = Image.fromarray(np.where(make_mask(), 255, 0).astype(np.uint8))
    if mode == "P":
        image = Image.fromarray(np.where(make_mask(), 0, 1).astype(np.uint8))
        image.putpalette([255, 255, 255, 0, 0, 0])
    image.convert(mode).save(path)
    touch = read_touch(path, SENSOR, press_depth_m=1 * MM, kind="mask")
    assert not touch.has_depths
    assert touch.press_depth_m == 1 * MM
    np.testing.assert_array_equal(touch.contact_shape.contact, make_mask())


@pytest.mark.parametrize("name", ["mask", "depth", "mine"])
def test_a_mask_is_read_from_arrays_of_any_name(tmp_path, name):
    touch = read_touch(save_npz(tmp_path / "a.npz", **{name: make_mask()}), SENSOR, kind="mask")
    np.testing.assert_array_equal(touch.contact_shape.contact, make_mask())


def test_grey_pictures_photos_and_depths_are_no_masks(tmp_path, depth_m):
    grey = save_png(tmp_path / "grey.png", np.arange(108, dtype=np.uint8).reshape(9, 12))
    photo = save_png(tmp_path / "photo.png", np.zeros((9, 12, 3), np.uint8))
    depths = save_npz(tmp_path / "depths.npz", depth=depth_m, unit="m", kind="distance")
    for path in (grey, photo, depths):
        with pytest.raises(TouchError, match=naming(path.name)):
            read_touch(path, SENSOR, kind="mask")
    mask = save_npz(tmp_path / "mask.npz", mask=make_mask(), kind="mask")
    with pytest.raises(TouchError, match=naming("mask.npz")):
        read_touch(mask, SENSOR, kind="height")
