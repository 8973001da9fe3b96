"""The TOML and CSV files in docs/files.md can be read."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import is_rigid
from tactile_loc.io.labelled_touches import read_labelled_touches
from tactile_loc.io.prior_files import read_prior
from tactile_loc.io.touch_lists import read_touch_list
from tactile_loc.io.touches import write_touch
from tactile_loc.locate.localizer import Localizer
from tactile_loc.plugins.sensors.presets import Preset
from tactile_loc.slots.registry import registry

PAGE = Path(__file__).parents[1] / "docs" / "files.md"


def block(first: str) -> str:
    """The TOML or CSV block of the page that begins with `first`."""
    (found,) = [b for b in re.findall(r"```(?:toml|csv)\n(.*?)```", PAGE.read_text(), re.DOTALL) if b.startswith(first)]
    return found


def list_sensors() -> list[dict[str, str]]:
    """The rows of the table of built-in sensors, by its headings."""
    table = PAGE.read_text().split("\n## Sensors\n\n")[1].split("\n\n")[0].splitlines()
    heading, _, *rows = ([cell.strip(" `") for cell in line.strip("|").split("|")] for line in table)
    return [dict(zip(heading, row, strict=True)) for row in rows]


def test_the_table_of_sensors_lists_all_presets():
    names = registry().names("sensor")
    presets = [name for name in names if registry().load("sensor", name).__module__ == Preset.__module__]
    assert sorted(row["name"] for row in list_sensors()) == sorted(presets)


@pytest.mark.parametrize("row", list_sensors(), ids=lambda row: row["name"])
def test_the_table_of_sensors_states_the_numbers_of_the_code(row):
    geometry = registry().create("sensor", row["name"]).geometry
    x0, x1, y0, y1 = geometry.rectangle
    size_px, field_mm, mm_per_px, standoff_mm, depth_mm = (
        [float(number) for number in re.findall(r"[\d.]+", row[key].split("(")[0])]
        for key in ("image (w x h)", "field, mm", "mm per pixel", "standoff, mm", "maximal depth, mm")
    )
    assert row["camera"] == geometry.camera
    assert size_px == [geometry.width_px, geometry.height_px]
    assert field_mm == pytest.approx([1e3 * (x1 - x0), 1e3 * (y1 - y0)], abs=0.05)
    assert mm_per_px == pytest.approx([1e3 / scale for scale in geometry.scale_at_surface], abs=5e-5)
    assert (standoff_mm, depth_mm) == ([1e3 * geometry.standoff_m], [1e3 * geometry.max_depth_m])


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    return Localizer.create("pin", store=store, grid={"name": "face", "spacing_mm": 8})


def test_the_list_of_touches_can_be_read(localizer, tmp_path):
    write_touch(tmp_path / "first.npz", localizer.simulate(1)[0])
    (tmp_path / "second.png").touch()
    (tmp_path / "my_sensor").mkdir()
    (tmp_path / "my_sensor" / "calibration.json").write_text("{}")
    (tmp_path / "touches.toml").write_text(block("[[touch]]"))
    first, second = read_touch_list(tmp_path / "touches.toml")
    assert (first.path.name, first.sensor) == ("first.npz", "gelslim")
    assert Path(str(second.sensor)).name == "my_sensor"
    assert is_rigid(np.stack([np.asarray(t.T_base_sensor) for t in (first, second)]))
    assert np.asarray(first.T_base_sensor)[:3, 3] == pytest.approx([0.4, 0.0, 0.12])


def test_the_table_of_known_poses_can_be_read(tmp_path):
    for name in ("first", "second", "third"):
        (tmp_path / f"{name}.npz").touch()
    (tmp_path / "poses.csv").write_text(block("touch,"))
    examples = read_labelled_touches(tmp_path / "poses.csv")
    assert [len(example) for example in examples] == [2, 1]
    assert is_rigid(np.stack([touch.T_sensor_object for example in examples for touch in example]))
    assert examples[0][0].T_sensor_object[:3, 3] == pytest.approx([-0.012, 0.0035, 0.0246])


def test_the_prior_can_be_read(localizer, tmp_path):
    (tmp_path / "prior.toml").write_text(block('kind = "gaussian"'))
    prior = read_prior(tmp_path / "prior.toml", localizer.object)
    assert prior.frame == "base"
    weights = prior.view_from(np.eye(4))(localizer.model.grid.T_sensor_object)
    assert np.isfinite(weights).all()
