import re
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from PIL import Image

from tactile_loc.io.sensor_files import _Orthographic, _Pinhole, read_camera, read_sensor_file
from tactile_loc.plugin import SensorError, registry
from tactile_loc.plugins.sensors.file import FileSensor

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "my_sensor.toml"
MM = 1e-3

PINHOLE = {
    "camera": '"pinhole"',
    "image_size_px": "[470, 470]",
    "fx": "291.5",
    "fy": "289",
    "standoff_mm": "25",
    "max_depth_mm": "2",
}
ORTHOGRAPHIC = {"camera": '"orthographic"', "image_size_px": "[320, 240]", "mm_per_px": "0.0634", "max_depth_mm": "1.0"}


def write(folder: Path, values: dict[str, str], **changes: str | None) -> Path:
    merged = {k: v for k, v in {**values, **changes}.items() if v is not None}
    path = folder / "sensor.toml"
    path.write_text("".join(f"{key} = {value}\n" for key, value in merged.items()))
    return path


def test_the_example_has_its_documented_values() -> None:
    sensor = registry().create("sensor", "file", {"path": str(EXAMPLE)})
    geometry = sensor.geometry
    assert (geometry.camera, geometry.shape) == ("pinhole", (240, 320))
    assert (geometry.fx, geometry.fy, geometry.cx, geometry.cy) == (310.0, 309.0, 161.5, 119.0)
    assert (geometry.standoff_m, geometry.max_depth_m) == pytest.approx((20 * MM, 1.5 * MM))
    np.testing.assert_allclose(geometry.rectangle, np.array([-9.5, 9.5, -7.0, 7.0]) * MM)
    assert 0 < geometry.observed_mask.sum() < geometry.observed_mask.size


def test_the_example_and_the_reference_name_every_key() -> None:
    reference = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    example = EXAMPLE.read_text(encoding="utf-8")
    for key in {**_Pinhole.model_fields, **_Orthographic.model_fields}:
        assert f"`{key}`" in reference, key
        assert re.search(rf"^(# )?{key} = ", example, re.MULTILINE), key


def test_the_commented_lines_of_the_example_work(tmp_path: Path) -> None:
    Image.fromarray(np.full((240, 320), 255, np.uint8)).save(tmp_path / "my_sensor_mask.png")
    text = EXAMPLE.read_text()
    curved = tmp_path / "curved.toml"
    curved.write_text(text.replace("# surface =", "surface ="))
    np.save(tmp_path / "my_sensor_surface.npy", np.full((240, 320), -1e-4))
    assert read_sensor_file(curved).relief_m is not None
    tilted = tmp_path / "tilted.toml"
    tilted.write_text(text.replace("# photo =", "photo ="))
    assert read_camera(tilted)[1] is not None
    masked = tmp_path / "masked.toml"
    masked.write_text(text.replace("# mask =", "mask ="))
    assert read_sensor_file(masked).observed is not None
    flat = tmp_path / "flat.toml"
    flat.write_text(
        re.sub(r"(?m)^(fx|fy) = .*$", "", text).replace("# mm_per", "mm_per").replace('"pinhole"\n', '"orthographic"\n')
    )
    assert read_sensor_file(flat).pixel_pitch_m == pytest.approx(0.0634 * MM)


def test_pixels_need_not_be_square_and_lengths_are_in_metres(tmp_path: Path) -> None:
    geometry = read_sensor_file(write(tmp_path, ORTHOGRAPHIC, mm_per_px="[0.05, 0.1]", standoff_mm="7"))
    x0, x1, y0, y1 = geometry.rectangle
    assert (x1 - x0, y1 - y0) == pytest.approx((16 * MM, 24 * MM))
    assert geometry.standoff_m == pytest.approx(7 * MM)
    geometry = read_sensor_file(write(tmp_path, PINHOLE, sensing_rectangle_mm="[-1, 2, -3, 4.5]"))
    assert geometry.rectangle_m == pytest.approx((-1 * MM, 2 * MM, -3 * MM, 4.5 * MM))


def test_a_mask_is_found_beside_the_sensor_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "sensors"
    (folder / "masks").mkdir(parents=True)
    mask = np.zeros((240, 320, 3), np.uint8)
    mask[100:, :50] = 255
    Image.fromarray(mask).save(folder / "masks" / "m.png")
    write(folder, ORTHOGRAPHIC, mask='"masks/m.png"')
    monkeypatch.chdir(tmp_path)
    geometry = FileSensor(FileSensor.Options(path="sensors/sensor.toml")).geometry
    np.testing.assert_array_equal(geometry.observed_mask, mask[..., 0] == 255)


def test_the_description_depends_on_the_content_of_the_file(tmp_path: Path) -> None:
    def describe(folder: str, **changes: str) -> dict:
        (tmp_path / folder).mkdir(exist_ok=True)
        path = write(tmp_path / folder, PINHOLE, **changes)
        return FileSensor(FileSensor.Options(path=str(path))).describe()

    assert describe("a") == describe("b")
    assert describe("a") != describe("a", standoff_mm="26")


@pytest.mark.parametrize(
    ("values", "changes", "words"),
    [
        *((PINHOLE, {key: None}, [key]) for key in PINHOLE),
        (ORTHOGRAPHIC, {"mm_per_px": None}, ["mm_per_px"]),
        (PINHOLE, {"standof_mm": "1"}, ["'standof_mm'", "'standoff_mm'", "camera", "image_size_px"]),
        (PINHOLE, {"mm_per_px": "1"}, ["'mm_per_px'", "pinhole"]),
        (ORTHOGRAPHIC, {"fx": "1"}, ["'fx'", "orthographic"]),
        (PINHOLE, {"max_depth_mm": None, "max_dept_mm": "2"}, ["'max_dept_mm'", "'max_depth_mm'"]),
        (PINHOLE, {"camera": '"fisheye"'}, ["camera", "fisheye"]),
        (PINHOLE, {"camera": "1"}, ["camera", 1]),
        (PINHOLE, {"image_size_px": "470"}, ["image_size_px", 470]),
        (PINHOLE, {"image_size_px": "[470]"}, ["image_size_px", "[470]"]),
        (PINHOLE, {"image_size_px": "[470.5, 470]"}, ["image_size_px", "[470.5, 470]"]),
        (PINHOLE, {"image_size_px": "[0, 470]"}, ["image_size_px", "[0, 470]"]),
        (PINHOLE, {"fx": '"291"'}, ["fx", 291]),
        (PINHOLE, {"fx": "-291"}, ["fx", -291]),
        (PINHOLE, {"fy": "true"}, ["fy", "True"]),
        (PINHOLE, {"cx": "nan"}, ["cx", "nan"]),
        (PINHOLE, {"standoff_mm": "inf"}, ["standoff_mm", "inf"]),
        (PINHOLE, {"max_depth_mm": "0"}, ["max_depth_mm", 0]),
        (PINHOLE, {"sensing_rectangle_mm": "[1, 2, 3]"}, ["sensing_rectangle_mm", "[1, 2, 3]"]),
        (PINHOLE, {"sensing_rectangle_mm": "[5, -5, -5, 5]"}, ["rectangle", "-0.005"]),
        (PINHOLE, {"mask": "1"}, ["mask", 1]),
        (ORTHOGRAPHIC, {"mm_per_px": "-0.06"}, ["mm_per_px", "-0.06"]),
        (ORTHOGRAPHIC, {"mm_per_px": "[0.06, 0.06, 0.06]"}, ["mm_per_px", "[0.06, 0.06, 0.06]"]),
        (PINHOLE, {"camera": "pinhole"}, ["TOML", "line 1"]),
    ],
)
def test_missing_unknown_and_wrong_keys_are_named(tmp_path: Path, values: dict, changes: dict, words: list) -> None:
    with pytest.raises(SensorError, match=naming("sensor.toml", *words)):
        read_sensor_file(write(tmp_path, values, **changes))


def test_bad_masks_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, ORTHOGRAPHIC, mask='"mask.png"')
    with pytest.raises(SensorError, match=naming("sensor.toml", "mask.png", "No such file")):
        read_sensor_file(path)
    (tmp_path / "mask.png").write_text("no image")
    with pytest.raises(SensorError, match=naming("sensor.toml", "mask.png")):
        read_sensor_file(path)
    Image.fromarray(np.full((320, 240), 255, np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(SensorError, match=naming("sensor.toml", "(320, 240)", "(240, 320)")):
        read_sensor_file(path)
    Image.fromarray(np.zeros((240, 320), np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(SensorError, match=naming("sensor.toml", "rectangle")):
        read_sensor_file(path)
