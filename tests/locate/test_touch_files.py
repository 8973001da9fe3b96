"""Touches from paths, and the table of their results."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import Localizer, write_sensor_file, write_touch
from tactile_loc.io.config import SlotConfig
from tactile_loc.io.touch_lists import ListedTouch
from tactile_loc.locate.touch_files import (
    COLUMNS,
    find_touches,
    is_folder,
    is_list,
    localize_files,
    match_localizers,
    name_folders,
    name_listed_sensor,
    read_observations,
    write_table,
)
from tactile_loc.plugin import TouchError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("b.npz", "a.PNG", "notes.txt", "c.npy"):
        (tmp_path / name).touch()
    return tmp_path


def test_a_folder_or_pattern_means_many_touches_and_a_toml_file_a_list(folder):
    assert [is_folder(folder), is_folder(folder / "*.npz"), is_folder(folder / "b.npz")] == [True, True, False]
    (folder / "odd*name.npz").touch()
    assert not is_folder(folder / "odd*name.npz")
    assert is_list(folder / "touches.TOML")
    assert not is_list(folder / "b.npz")


def test_touches_are_found_by_suffix_in_the_order_of_names(folder):
    for name in ("._b.npz", "b10.npz", "b9.npz"):
        (folder / name).touch()
    assert [path.name for path in find_touches(folder)] == ["a.PNG", "b.npz", "b9.npz", "b10.npz", "c.npy"]
    assert [path.name for path in find_touches(folder / "*.npz")] == ["b.npz", "b9.npz", "b10.npz"]
    with pytest.raises(TouchError, match=naming("*.txt", ".npz")):
        find_touches(folder / "*.txt")


def test_each_touch_has_a_folder_of_its_own():
    names = name_folders([Path("in", name) for name in ("a.npz", "a.png", "a.png.npy", "b.png", "c.tar.npz")])
    assert list(names.values()) == ["a.npz", "a.png", "a.png.npy", "b", "c.tar"]


def test_the_overview_of_simulated_touches_is_no_touch(tmp_path):
    for name in ("touch-0000.png", "touches.png"):
        (tmp_path / name).touch()
    assert len(find_touches(tmp_path)) == 2
    (tmp_path / "poses.json").touch()
    for folder in (tmp_path, tmp_path / "*.png"):
        assert [path.name for path in find_touches(folder)] == ["touch-0000.png"]


def test_the_contact_shapes_of_simulated_touches_are_chosen(folder):
    (folder / "poses.json").touch()
    assert [path.name for path in find_touches(folder)] == ["b.npz"]
    (folder / "b.npz").unlink()
    found = [path.name for path in find_touches(folder)]
    assert found == ["a.PNG", "c.npy"]  # an array file has the same name as the image


def test_each_file_is_located_or_gets_a_reason(localizer: Localizer, tmp_path):
    (touch,) = localizer.simulate(1, seed=0)
    write_touch(tmp_path / "good.npz", touch)
    (tmp_path / "bad.npz").write_text("no touch")
    bad, good = localize_files(localizer, [tmp_path / "bad.npz", tmp_path / "good.npz"])
    assert bad[1] is None
    assert "bad.npz" in bad[0].problem
    assert good[0].best is good[1].best
    assert bad[0].make_row() == {"touch": "bad.npz", "verdict": "", "says": bad[0].problem}
    assert (bad[0].verdict, good[0].verdict) == (None, good[1].verdict)
    path = write_table(tmp_path / "results.csv", [bad[0], good[0]])
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["verdict"] for row in rows] == ["", good[1].verdict]
    assert [(row["touch"], row["says"]) for row in rows] == [("bad.npz", bad[0].problem), ("good.npz", "")]
    place_mm = [float(rows[1][key]) for key in ("x_mm", "y_mm", "z_mm")]
    np.testing.assert_allclose(place_mm, 1e3 * good[1].best.T_sensor_object[:3, 3], atol=1e-3)
    assert set(rows[0]) == set(COLUMNS)
    assert rows[1]["probability_within"] == f"{good[1].outcome.right:.4f}"


def test_the_error_of_the_mount_adds_to_the_error_of_the_sensor_pose(localizer: Localizer, tmp_path):
    (touch,) = localizer.simulate(1, seed=0)
    write_touch(tmp_path / "touch.npz", touch)
    covariance = np.diag([1e-6] * 3 + [0.0] * 3).tolist()
    (tmp_path / "mount.toml").write_text(f"T_flange_sensor = {np.eye(4).tolist()}\ncovariance = {covariance}\n")
    (tmp_path / "touches.toml").write_text(
        f'mount = "mount.toml"\n[[touch]]\npath = "touch.npz"\nT_base_flange = {np.eye(4).tolist()}\n'
    )
    ((_, read),) = read_observations(localizer, tmp_path / "touches.toml")
    assert read.T_base_sensor_std_m == pytest.approx(np.hypot(2e-4, 1e-3))
    assert read.T_base_sensor_std_rad == pytest.approx(touch.T_base_sensor_std_rad)
    np.testing.assert_array_equal(read.T_base_sensor, np.eye(4))


def test_a_listed_sensor_file_keeps_the_options_of_the_same_sensor(localizer: Localizer, tmp_path, monkeypatch):
    """The list names the file by another path than the localizer does."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    for name in ("flat.toml", "other.toml"):
        write_sensor_file(tmp_path / name, localizer.scene.geometry)
    sensor = SlotConfig(name="file", options={"path": "flat.toml", "gel": "layer"})
    own = Localizer(localizer.config.model_copy(update={"sensor": sensor}), localizer.object, localizer.store)
    listed = [ListedTouch(Path("a.npz"), sensor=name) for name in ("out/../flat.toml", "other.toml")]
    same, other = match_localizers(own, listed)
    assert same is own
    assert other.config.sensor.options == {"path": "other.toml"}


def test_a_list_names_a_sensor_unless_it_has_options_or_another_name_than_unicode(tmp_path):
    (tmp_path / "calibrated").mkdir()
    for name, options, listed in (
        ("digit", {}, "digit"),
        ("digit", {"max_depth_mm": 1.0}, None),
        ("digit", {"path": "flat.toml"}, None),
        ("file", {"path": str(tmp_path / "flat.toml")}, "../flat.toml"),
        ("file", {"path": str(tmp_path / "flat.toml"), "gel": "layer"}, None),
        ("file", {"path": str(tmp_path / os.fsdecode(b"\xe4.toml"))}, None),
        ("calibrated", {"path": str(tmp_path / "calibrated")}, "../calibrated"),
    ):
        assert name_listed_sensor(SlotConfig(name=name, options=options), tmp_path / "out") == listed
