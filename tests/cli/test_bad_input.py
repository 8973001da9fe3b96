"""Bad input gives one sentence and exit code 2, without a traceback or unfinished files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_helpers import TINY, Cli, assert_refused, touch_depths, write_box

OUT = Path("out")
HOOK = ["--object", "hook"]


@pytest.fixture
def refused(cli: Cli):
    """Run with invalid arguments; the message must mention the given words."""

    def run(*words: object, mentions: tuple[str, ...]) -> None:
        assert_refused(cli("run", *TINY, "--out", OUT, *words), *mentions)
        assert not OUT.exists()

    return run


@pytest.mark.parametrize("coverage", [0, 1.5])
def test_an_impossible_coverage_is_refused(refused, coverage):
    refused("--coverage", coverage, mentions=("coverage",))


@pytest.mark.parametrize("tolerance", ["1", "0mm", "1mm,2cm"])
def test_a_tolerance_that_cannot_be_read_is_refused(refused, tolerance):
    refused("--tolerance", tolerance, mentions=("--tolerance", tolerance))


def test_a_missing_mesh_file_is_refused(refused):
    refused("--object", "gear.stl", mentions=("gear.stl", "pin"))


def test_a_misspelt_demo_object_is_refused_with_a_suggestion(refused):
    refused("--object", "pinn", mentions=("'pin'",))


def test_a_file_without_a_mesh_is_refused(refused):
    Path("notes.stl").write_text("milk, bread, eggs")
    refused("--object", "notes.stl", mentions=("notes.stl",))


def test_an_empty_mesh_is_refused(refused):
    write_box(Path("empty.obj"), faces=0)
    refused("--object", "empty.obj", mentions=("empty.obj",))


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_mesh_with_non_finite_vertices_is_refused(refused, value):
    write_box(Path("bad.obj"), x=value)
    refused("--object", "bad.obj", "--units", "mm", mentions=("bad.obj", "NaN"))


def test_a_mesh_without_extent_is_refused(refused):
    write_box(Path("point.obj"), 0, 0, 0)
    refused("--object", "point.obj", mentions=("point.obj", "extent"))


@pytest.mark.parametrize(("units", "length"), [("m", "3e+04 mm"), ("mm", "0.3 mm")])
def test_an_object_of_impossible_size_is_refused(refused, units, length):
    scale = 1 if units == "m" else 0.01
    write_box(Path("box.obj"), 30 * scale, 20 * scale, 10 * scale)
    refused("--object", "box.obj", "--units", units, mentions=(length, "1 mm", "1 m"))


def test_a_wrong_symmetry_is_refused(refused):
    box = ("--object", write_box(Path("box.obj")), "--units", "mm")
    refused(*box, "--symmetry", "z5", mentions=("z5",))
    refused(*box, "--symmetry", "round", mentions=("round",))


@pytest.mark.parametrize(
    ("words", "given"),
    [
        (["run", "--touch", "touch.npz"], "--touch touch.npz"),
        (["run", "--touch", "touches.toml"], "--touch touches.toml"),
        (["run", "--config", "run.toml"], "--touch in-file.npz"),
        (["mount", "--touch", "presses.toml"], "--touch presses.toml"),
        (["replay", "drive.mcap"], "drive.mcap"),
        (["live", "--camera", "0", "--no-view"], "camera 0"),
        (["live", ".", "--once", "--no-view"], "folder ."),
    ],
)
def test_touches_without_their_object_are_refused(cli, words, given):
    """A default object would be located in touches of another object."""
    Path("run.toml").write_text('[object]\nunits = "mm"\n[touch]\npath = "in-file.npz"\n')
    assert_refused(cli(*words), given, "--object")
    assert [path.name for path in Path().iterdir()] == ["run.toml"]


def test_the_object_of_touches_may_be_in_the_configuration(cli):
    """Also if it is the default object."""
    Path("run.toml").write_text('object.path = "hook"\ntouch.path = "none.npz"\n')
    assert_refused(cli("run", "--config", "run.toml"), "no file none.npz")


def test_a_missing_touch_file_is_refused(refused):
    refused(*HOOK, "--touch", "none.npz", mentions=("none.npz",))


def test_a_touch_of_the_wrong_size_is_refused(refused):
    np.save("touch.npy", touch_depths((64, 48)))
    refused(*HOOK, "--touch", "touch.npy", "--touch-unit", "m", mentions=("64 x 48", "200 x 200"))


def test_a_touch_of_the_wrong_type_is_refused(refused):
    np.save("touch.npy", touch_depths().astype(str))
    refused(*HOOK, "--touch", "touch.npy", "--touch-unit", "m", mentions=("touch.npy",))


def test_a_damaged_touch_file_is_refused(refused):
    Path("touch.npz").write_text("nothing")
    refused(*HOOK, "--touch", "touch.npz", mentions=("touch.npz",))


def test_a_touch_without_a_unit_is_refused(refused):
    np.save("touch.npy", touch_depths())
    refused(*HOOK, "--touch", "touch.npy", mentions=("--touch-unit",))


def test_a_touch_in_the_wrong_unit_is_refused(refused):
    depths = touch_depths() * 1e3
    depths[depths > 1.9] = 1.5
    depths[0] = 900.0
    np.save("touch.npy", depths)
    refused(*HOOK, "--touch", "touch.npy", "--touch-unit", "m", mentions=("unit",))


def test_a_touch_without_contact_is_refused(refused):
    np.save("touch.npy", np.full((200, 200), 0.002))
    refused(*HOOK, "--touch", "touch.npy", "--touch-unit", "m", mentions=("touch.npy", " mm"))


def test_a_touch_of_flat_contact_everywhere_is_refused(refused):
    np.save("touch.npy", np.zeros((200, 200)))
    refused(*HOOK, "--touch", "touch.npy", "--touch-unit", "m", mentions=("touch.npy", "flat"))


def test_a_press_depth_beyond_the_sensor_is_refused(refused, cli):
    refused("--press-depth", 5, mentions=("5 mm", "2 mm"))
    assert_refused(cli("build", *TINY, "--press-depth", 5), "5 mm", "2 mm")


def test_an_unknown_component_is_refused(refused):
    refused("--refiner", "ipc", mentions=("'ipc'", "'icp'"))
    refused("--grid", "zebra", mentions=("'zebra'", "face", "hopf"))


def test_an_unknown_option_lists_the_known_ones(refused):
    refused("-o", "grid.spacing=3", mentions=("'spacing'", "'spacing_mm'", "min_contact_percent (float)"))


def test_an_ill_typed_option_is_refused(refused):
    refused("-o", "refiner.iterations=many", mentions=("iterations", "'many'", "whole number"))
    refused("-o", "grid.spacing_mm=-1", mentions=("spacing_mm", "-1"))


def test_a_malformed_option_is_refused(refused):
    refused("-o", "spacing_mm", mentions=("SLOT.OPTION=VALUE", "grid.spacing_mm=3"))
    refused("-o", "gird.spacing_mm=3", mentions=("'gird'", "'grid'"))


def test_an_unknown_flag_or_value_is_refused(refused):
    refused("--objct", "pin", mentions=("--objct", "tactile-loc run -h"))
    refused("--units", "feet", mentions=("feet", "inch"))
    refused("--units", "feet", mentions=("--units cannot be 'feet'; give auto, m, mm, cm or inch",))
    refused("--top", "many", mentions=("--top cannot be 'many'; give a whole number",))
    refused("--top", 0, mentions=("--top cannot be 0; give 1 or more",))
    refused("--zero", "new.png", mentions=("--zero", "gelslim", "--sensor FOLDER"))


def test_a_wrong_value_has_the_same_message_everywhere(refused, cli):
    refused("--seed", -1, mentions=("--seed cannot be -1; give 0 or more",))
    assert_refused(cli("evaluate", "--seed", -1), "--seed cannot be -1; give 0 or more")
    Path("run.toml").write_text("seed = -1")
    refused("--config", "run.toml", mentions=("run.toml: seed cannot be -1; give 0 or more",))
    Path("run.toml").write_text("seed = 1")
    refused("--config", "run.toml", "--seed", -2, mentions=("--seed cannot be -2; give 0 or more",))
    Path("plan.toml").write_text("refiner = 'ipc'")
    assert_refused(cli("sweep", "plan.toml"), "plan.toml", "'ipc'", "choose none, ")


def test_a_missing_value_points_to_the_help_of_the_command(cli):
    assert_refused(cli("run", "--top"), "--top", "tactile-loc run -h")
    assert_refused(cli("store", "list", "--store"), "--store", "tactile-loc store list -h")


def test_a_sensor_without_its_path_is_refused(refused):
    refused("--sensor", "file", mentions=("'file'", "--sensor my_sensor.toml"))
    refused("--sensor", "calibrated", mentions=("'calibrated'", "--sensor FOLDER"))


def test_an_option_of_a_configuration_file_is_refused_with_the_files_name(cli):
    Path("g.toml").write_text("[grid]\nname = 'face'\nspacing = 3\n")
    assert_refused(cli("run", "--config", "g.toml"), "g.toml", "'spacing'", "'spacing_mm'")
    done = cli("run", "--config", "g.toml", "--grid", "hopf", "-o", "grid.spacin_mm=3")
    assert_refused(done, "'spacin_mm'")
    assert "g.toml" not in done.stderr
    Path("h.toml").write_text("object = 'pin'\n")
    assert_refused(cli("run", "--config", "h.toml"), "h.toml", "[object]", 'path = "pin"')


def test_an_unknown_command_is_refused(cli):
    assert_refused(cli("rnu"), "rnu")


def test_a_bad_configuration_file_is_refused(refused):
    refused("--config", "none.toml", mentions=("none.toml",))
    Path("broken.toml").write_text("grid = ")
    refused("--config", "broken.toml", mentions=("broken.toml", "TOML"))
    Path("unknown.toml").write_text("gird = 'face'")
    refused("--config", "unknown.toml", mentions=("unknown.toml", "'gird'", "'grid'"))
    Path("flat.toml").write_text("object = 'pin'\ngrid = 3")
    refused("--config", "flat.toml", mentions=("object", "table"))


def test_a_bad_sensor_file_is_refused(refused):
    refused("--sensor", "none.toml", mentions=("none.toml",))
    Path("sensor.toml").write_text("camera = 'pinhole'")
    refused("--sensor", "sensor.toml", mentions=("sensor.toml", "image_size_px"))


def test_an_output_path_that_is_a_file_is_refused_before_building(cli, tmp_path):
    OUT.write_text("mine")
    store = tmp_path / "untouched"
    for out in (OUT, OUT / "deeper"):
        assert_refused(cli("run", *TINY, "--out", out, "--store", store), "out", "--out")
        assert_refused(cli("simulate", "--out", out), "out", "--out")
    assert OUT.read_text() == "mine"
    assert not store.exists()


def test_a_store_path_that_is_a_file_is_refused(cli, tmp_path):
    Path("store").write_text("mine")
    assert_refused(cli("run", *TINY, "--out", OUT, "--store", "store"), "--store")
    assert_refused(cli("build", *TINY, "--store", "store"), "--store")
    assert Path("store").read_text() == "mine"
    assert not OUT.exists()


def test_a_grid_without_contact_is_refused(cli):
    assert_refused(cli("build", *TINY, "-o", "grid.min_contact_percent=100"), "min_contact_percent")


@pytest.mark.parametrize("count", [0, -3])
def test_a_count_of_zero_touches_is_refused(cli, count):
    assert_refused(cli("simulate", "--count", count, "--out", OUT), "--count")
    assert not OUT.exists()


def test_an_inverted_touch_is_refused_with_the_remedy(refused):
    row, column = np.mgrid[:200, :200] - 99.5
    indentation = np.maximum(0.0015 - 2e-7 * (row**2 + column**2), 0.0)
    np.save("touch.npy", indentation)
    np.savez("touch.npz", depth=indentation, unit="m")
    for touch in (("touch.npy", "--touch-unit", "m"), ("touch.npz",)):
        refused("--object", "hook", "--touch", *touch, mentions=("indentations", "--touch-kind indentation"))


def test_an_unknown_kind_of_touch_is_refused(refused):
    np.save("touch.npy", touch_depths())
    refused(
        "--object",
        "hook",
        "--touch",
        "touch.npy",
        "--touch-unit",
        "m",
        "--touch-kind",
        "depth",
        mentions=("depth", "indentation"),
    )
