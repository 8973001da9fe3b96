"""The commands build, simulate, objects and plugins, and the options --version and --help."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import FLAT_SENSOR, SURE, TINY, Cli, assert_refused, succeed
from PIL import Image

from tactile_loc import StageStore, __version__
from tactile_loc.io.config import choose_component
from tactile_loc.io.touch_lists import read_touch_list
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.slots.registry import SLOTS


def test_version_and_help_are_printed(cli: Cli):
    assert cli("--version").stdout == f"tactile-loc {__version__}\n"
    assert cli("-h").stdout == cli("--help").stdout == cli().stdout
    for command in ("run", "build", "simulate", "objects", "plugins"):
        assert command in cli("-h").stdout
        assert cli(command, "-h").exit_code == 0


def stages(stdout: str) -> dict[str, str]:
    """Return "built" or "reused" for each stage except the temperature, which is fitted for some encoders."""
    return dict(re.findall(r"^(?!temperature)([\w-]+) \(.*\): (built|reused)$", stdout, re.MULTILINE))


@pytest.mark.slow
def test_build_repeats_only_the_stages_that_a_change_affects(cli, tmp_path):
    store = tmp_path / "store"
    first, again, other = (
        succeed(cli("build", *TINY, "--store", store, *more)).stdout for more in ([], [], ["-o", "encoder.cells=10"])
    )
    assert stages(first) == {"grid": "built", "shapes": "built", "bank": "built"}
    assert stages(again) == dict.fromkeys(("grid", "shapes", "bank"), "reused")
    assert stages(other) == {"grid": "reused", "shapes": "reused", "bank": "built"}
    assert str(store) in first
    assert all(entry.complete for entry in StageStore(store).entries())
    (line,) = [line for line in first.splitlines() if line.startswith("grid: ") and "poses" in line]
    words = line.split()
    assert int(words[1]) > 50
    assert float(words[3]) == pytest.approx(8, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    "touch", [["--object", "hook", "--touch", "touches/touch-0000.npz"], []], ids=["one touch", "three touches"]
)
def test_run_reuses_the_stages_of_build(cli, tmp_path, touch):
    store = StageStore(tmp_path / "store")
    cli("simulate", *TINY, "--count", 1, "--out", "touches")
    assert stages(cli("build", *TINY, "--store", store.root).stdout)["bank"] == "built"
    built = {entry.path for entry in store.entries()}
    succeed(cli("run", *TINY, *touch, "--coverage", 0.8, "--store", store.root))
    assert {entry.path for entry in store.entries()} == built


@pytest.mark.usefixtures("drawn_pictures")
def test_simulate_writes_touches_that_run_reads(cli):
    succeed(cli("simulate", "--count", 3, "--press-depth", 1.5, "--seed", 4, "--out", "out"))
    names = ["touch-0000", "touch-0001", "touch-0002"]
    assert sorted(p.name for p in Path("out").iterdir()) == ["poses.json", *(f"{n}.npz" for n in names), "touches.png"]
    record = json.loads(Path("out/poses.json").read_text())
    assert record["press_depth_m"] == pytest.approx(1.5e-3)
    for name in names:
        with np.load(f"out/{name}.npz") as touch:
            assert touch["T_sensor_object"].tolist() == record["T_sensor_object"][name]
    with Image.open("out/touches.png") as picture:
        picture.load()
    succeed(cli("run", "--object", "hook", *TINY, *SURE, "--touch", "out/touch-0002.npz", "--out", "result"))
    result = json.loads(Path("result/result.json").read_text())
    assert result["touch"]["T_sensor_object"] == record["T_sensor_object"]["touch-0002"]


def test_simulated_touches_of_an_object_at_rest_are_listed(cli):
    succeed(cli("simulate", "--together", 2, "--opposed", "--out", "out"))
    record = json.loads(Path("out/poses.json").read_text())
    for touch in read_touch_list("out/touches.toml"):
        assert touch.T_base_sensor.tolist() == record["T_base_sensor"][touch.path.stem]
        placed = touch.T_base_sensor @ np.array(record["T_sensor_object"][touch.path.stem])
        np.testing.assert_allclose(placed, record["T_base_object"], atol=1e-12)
    alone = cli("simulate", "--count", 1, "--out", "out")
    assert "touches.toml" in alone.stderr  # it does not fit the new touches


@pytest.mark.parametrize(
    ("sensor", "written"),
    [
        (["--sensor", "digit"], "digit"),
        (["--sensor", "flat.toml"], "out/../flat.toml"),
        (["--sensor", "digit", "-o", "sensor.max_depth_mm=1"], None),
    ],
    ids=str,
)
def test_a_list_of_simulated_touches_names_their_sensor(cli, sensor, written):
    """Then `run` needs no --sensor. A list cannot state the options of a sensor."""
    Path("flat.toml").write_text(FLAT_SENSOR)
    assert cli("simulate", *TINY, *sensor, "--together", 2, "--out", "out").exit_code == 0
    assert [touch.sensor for touch in read_touch_list("out/touches.toml")] == [written, written]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "evaluate"])
def test_touches_of_another_sensor_are_located_without_naming_it(cli, command):
    words = ["--object", "hook", *TINY]
    Path("flat.toml").write_text(FLAT_SENSOR)
    assert cli("simulate", *words, "--sensor", "flat.toml", "--together", 2, "--out", "out").exit_code == 0
    flag = "--touch" if command == "run" else "--touches"
    succeed(cli(command, *words, "--refiner", "none", flag, "out/touches.toml", "--out", "result"))


@pytest.mark.parametrize(
    "words", [["--opposed"], ["--together", 3, "--opposed"], ["--together", 3, "--count", 3]], ids=str
)
def test_numbers_of_touches_that_do_not_fit_are_refused(cli, words):
    assert_refused(cli("simulate", *words, "--out", "out"))
    assert not Path("out/touches.toml").exists()


def test_simulate_with_noise_follows_the_seed(cli):
    for level, out in (("none", "clean"), ("strong", "a"), ("strong", "b")):
        succeed(cli("simulate", "--count", 3, *([] if level == "none" else ["--noise", level]), "--out", out))
    clean, noisy = (json.loads(Path(f"{out}/poses.json").read_text()) for out in ("clean", "a"))
    assert (clean["noise"], noisy["noise"]) == ("none", "strong")
    assert clean["press_depth_m"] == pytest.approx(2e-3)
    assert noisy["press_depth_m"] is None  # each touch has its own press depth
    presses = set()
    for name in noisy["T_sensor_object"]:
        with np.load(f"a/{name}.npz") as a, np.load(f"b/{name}.npz") as b:
            assert np.array_equal(a["depth"], b["depth"])
            presses.add(float(a["press_depth"]))
    assert len(presses) == 3
    succeed(cli("run", "--object", "hook", *TINY, "--touch", "a/touch-0000.npz", "--out", "result"))


def test_plugins_lists_slots_components_and_options(cli):
    rows = [line.split() for line in cli("plugins").stdout.splitlines()]
    for slot in SLOTS:
        default = choose_component(slot).name
        assert [slot, default, "tactile-loc"] in [row[:3] for row in rows]
    lines = cli("plugins", "refiner").stdout.splitlines()[1:]
    rows = [line.split() for line in lines if not line.startswith("not installed: ")]
    assert {"none", "icp"} <= {row[1] for row in rows}
    assert {row[0] for row in rows} == {"refiner"}
    shown = cli("plugins", "grid", "face").stdout
    (row,) = [line for line in shown.splitlines() if "grid.spacing_mm" in line]
    default = str(FaceGrid.Options().spacing_mm)
    assert row.split()[:3] == ["grid.spacing_mm", "float", default]
    assert "mm" in row.split(default)[1]
    assert "options" in cli("plugins", "refiner", "none").stdout


def test_an_unknown_slot_or_component_is_refused(cli):
    assert_refused(cli("plugins", "refinr"), "'refiner'")
    assert_refused(cli("plugins", "refiner", "ipc"), "'icp'")
    assert_refused(cli("plugins", "refinr", "icp"), "refiner")
