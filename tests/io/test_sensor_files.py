"""Written sensor files are read as the same sensor; the tests of the `file` sensor read files written by hand."""

import dataclasses
import tomllib

import numpy as np
import pytest
from message_helpers import naming
from photo_helpers import MAPS, PX

from tactile_loc.core.runtime.errors import SensorError
from tactile_loc.core.sensing.photo_map import Lens
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.sensor_files import read_camera, read_lens, read_sensor_file, write_sensor_file
from tactile_loc.plugins.sensors.presets import CurvedDigit, Digit, GelSightMini, GelSlim

MASK = np.random.default_rng(0).random((48, 64)) > 0.3
GEOMETRIES = {
    "gelslim": GelSlim().geometry,
    "native gelslim": GelSlim.native,
    "gelsight-mini": GelSightMini().geometry,
    "digit": Digit().geometry,
    "digit-curved": CurvedDigit().geometry,
    "oblong pixels": SensorGeometry("orthographic", 64, 48, 1e3 / 0.3, 7001.3, 30.2, 25.7, 0.0123, 7.7e-4),
    "rectangle": dataclasses.replace(GelSlim().geometry, rectangle_m=(-0.0101, 0.009, -1e-5, 0.0123)),
    "mask": SensorGeometry("pinhole", 64, 48, 42.0, 40.0, 31.0, 25.0, 0.025, 0.002, observed=MASK),
    "both": SensorGeometry(
        "orthographic", 64, 48, 3000.0, 3000.0, 32.0, 24.0, 0.01, 1e-3, (-0.01, 0.005, -0.006, 0.007), MASK
    ),
}


def numbers(geometry: SensorGeometry) -> list[float]:
    fields = [getattr(geometry, f.name) for f in dataclasses.fields(geometry)]
    return [*filter(lambda v: isinstance(v, int | float), fields), *geometry.rectangle]


@pytest.mark.parametrize("name", GEOMETRIES)
def test_a_sensor_is_read_back_from_its_file(tmp_path, name):
    geometry = GEOMETRIES[name]
    path = write_sensor_file(tmp_path / "sensor.toml", geometry)
    assert path == tmp_path / "sensor.toml"
    found = read_sensor_file(path)
    assert numbers(found) == pytest.approx(numbers(geometry), rel=1e-14, abs=0)
    assert len(numbers(found)) == 13
    for key in ("camera", "observed", "relief_m"):
        assert found.describe().get(key) == geometry.describe().get(key)
    assert (found.rectangle_m is None) == (geometry.rectangle_m is None)
    np.testing.assert_array_equal(found.observed_mask, geometry.observed_mask)
    assert found.is_same_sensor(geometry)


def test_the_file_gives_lengths_in_mm(tmp_path):
    path = write_sensor_file(tmp_path / "sensor.toml", GEOMETRIES["both"])
    values = tomllib.loads(path.read_text())
    assert values["image_size_px"] == [64, 48]
    assert values["mm_per_px"] == pytest.approx(1 / 3)
    assert (values["standoff_mm"], values["max_depth_mm"]) == pytest.approx((10, 1))
    assert values["sensing_rectangle_mm"] == pytest.approx([-10, 5, -6, 7])
    assert values["mask"] == "sensor_mask.png"
    assert not values.keys() & {"fx", "fy"}


def test_a_sensor_without_a_mask_is_one_file(tmp_path):
    write_sensor_file(tmp_path / "sensor.toml", GEOMETRIES["gelslim"])
    assert [path.name for path in tmp_path.iterdir()] == ["sensor.toml"]
    with pytest.raises(FileNotFoundError, match="none"):
        write_sensor_file(tmp_path / "none" / "sensor.toml", GEOMETRIES["gelslim"])


@pytest.mark.parametrize(
    ("surface", "value"),
    [
        (None, "No such file"),
        (np.zeros((48, 64, 3)), "(48, 64, 3)"),
        (np.zeros((48, 64), int), "int64"),
        (np.zeros((64, 48)), "(64, 48)"),
        (np.full((48, 64), np.nan), "(48, 64)"),
        (np.full((48, 64), -1.0), "1e+03 mm"),
    ],
)
def test_an_invalid_gel_surface_is_refused_by_file(tmp_path, surface, value):
    path = write_sensor_file(tmp_path / "sensor.toml", GEOMETRIES["both"])
    path.write_text(path.read_text() + 'surface = "gel.npy"\n')
    if surface is not None:
        np.save(tmp_path / "gel.npy", surface)
    with pytest.raises(SensorError, match=naming("sensor.toml", value)):
        read_sensor_file(path)


@pytest.mark.parametrize("mm_per_px", [63.4, 6.34e-4])
def test_a_gel_of_impossible_size_is_refused(tmp_path, mm_per_px):
    path = write_sensor_file(tmp_path / "s.toml", GEOMETRIES["both"])
    text = path.read_text().replace(f"{1 / 3}", str(mm_per_px))
    path.write_text("\n".join(line for line in text.splitlines() if "rectangle" not in line))
    assert str(mm_per_px) in path.read_text()
    with pytest.raises(SensorError, match=naming("s.toml", "mm_per_px")):
        read_sensor_file(path)


@pytest.mark.parametrize("name", MAPS)
def test_the_map_of_photos_is_read_back(tmp_path, name):
    geometry = SensorGeometry("orthographic", PX, PX, 5e3, 5e3, PX / 2, PX / 2, 0.01, 1e-3)
    path = write_sensor_file(tmp_path / "sensor.toml", geometry, MAPS[name])
    found, photo_map = read_camera(path)
    assert photo_map == MAPS[name]
    assert found.is_same_sensor(geometry)
    np.testing.assert_array_equal(found.observed_mask, MAPS[name].seen)
    assert read_sensor_file(path).observed is None


def test_photos_with_uneven_scales_are_evened(tmp_path):
    path = write_sensor_file(tmp_path / "sensor.toml", GEOMETRIES["oblong pixels"])
    even, photo_map = read_camera(path)
    assert photo_map is not None
    assert photo_map.photo_px == (64, 48)
    assert even.fx == pytest.approx(even.fy, rel=0.02)
    assert read_camera(write_sensor_file(tmp_path / "even.toml", GEOMETRIES["both"]))[1] is None


LENSES = {
    "ros.yaml": "image_width: 320\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [250.5, 0, 160, 0, 251, 1.2e2, 0, 0, 1]\n"
    "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.2, 0.01, 0.0, 1e-3, 0]\n",
    "opencv.yml": "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n"
    "   data: [ 250.5, 0., 160., 0., 251., 120.,\n"
    "       0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   data: [ -0.2, .01, 0., 1.0e-03, 0. ]\n",
    "own.json": '{"camera_matrix": [[250.5, 0, 160], [0, 251, 120], [0, 0, 1]], '
    '"dist_coeffs": [[-0.2, 0.01, 0, 0.001, 0]]}',
    "own.toml": "K = [[250.5, 0, 160], [0, 251, 120], [0, 0, 1]]\nD = [-0.2, 0.01, 0, 0.001, 0]\n",
}


@pytest.mark.parametrize("name", LENSES)
def test_a_lens_is_read_from_files_of_other_tools(tmp_path, name):
    (tmp_path / name).write_text(LENSES[name])
    assert read_lens(tmp_path / name) == Lens(250.5, 251.0, 160.0, 120.0, (-0.2, 0.01, 0.0, 0.001, 0.0))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "camera_matrix: [1, 2, 3]",
        "K = [0, 0, 0, 0, 0, 0, 0, 0, 0]",
        LENSES["ros.yaml"].replace("plumb_bob", "equidistant"),
        "K = [250, 0, 160, 0, 250, 120, 0, 0, 1]\nD = [1, 2, 3, 4, 5, 6]",
    ],
)
def test_files_without_a_known_lens_are_refused(tmp_path, text):
    (tmp_path / "lens.yaml").write_text(text)
    with pytest.raises(SensorError):
        read_lens(tmp_path / "lens.yaml")
