"""Bad input gives one sentence and exit code 2, without a traceback or unfinished files."""

from pathlib import Path

import numpy as np
import pytest
from cli_helpers import TINY, Cli, assert_refused, touch_depths, write_box

OUT = Path("out")
IN_M = "--object hook --touch-unit m --touch"
TEXTS = {
    "notes.stl": "milk, bread, eggs",
    "damaged.npz": "nothing",
    "broken.toml": "grid = ",
    "unknown.toml": "gird = 'face'",
    "flat.toml": "object = 'pin'\ngrid = 3",
    "object.toml": "object = 'pin'\n",
    "negative.toml": "seed = -1",
    "positive.toml": "seed = 1",
    "misspelt.toml": "[grid]\nname = 'face'\nspacing = 3\n",
    "sensor.toml": "camera = 'pinhole'",
    "plan.toml": "refiner = 'ipc'",
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files that cannot be used."""
    folder = tmp_path_factory.mktemp("inputs")
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    write_box(folder / "box.obj")
    row, column = np.mgrid[:200, :200] - 99.5
    np.save(folder / "sound.npy", touch_depths())
    np.save(folder / "small.npy", touch_depths((64, 48)))
    np.save(folder / "inverted.npy", np.maximum(0.0015 - 2e-7 * (row**2 + column**2), 0.0))
    return folder


@pytest.mark.parametrize(
    ("line", "mentions"),
    [
        ("--coverage 0", ["coverage"]),
        ("--coverage 1.5", ["coverage"]),
        ("--tolerance 1", ["--tolerance", "1"]),
        ("--tolerance 0mm", ["--tolerance", "0mm"]),
        ("--tolerance 1mm,2cm", ["--tolerance", "1mm,2cm"]),
        ("--object gear.stl", ["gear.stl", "pin"]),
        ("--object pinn", ["'pin'"]),
        ("--object notes.stl", ["notes.stl"]),
        ("--object box.obj --units m", ["3e+04 mm", "1 mm", "1 m"]),
        ("--object box.obj --units mm --symmetry z5", ["z5"]),
        ("--object hook --touch none.npz", ["none.npz"]),
        ("--object hook --touch damaged.npz", ["damaged.npz"]),
        ("--object hook --touch sound.npy", ["--touch-unit"]),
        (f"{IN_M} inverted.npy", ["indentations", "--touch-kind indentation"]),
        (f"{IN_M} small.npy", ["64 x 48", "200 x 200"]),
        (f"{IN_M} sound.npy --touch-kind depth", ["depth", "indentation"]),
        ("--press-depth 5", ["5 mm", "2 mm"]),
        ("--refiner ipc", ["'ipc'", "'icp'"]),
        ("--grid zebra", ["'zebra'", "face", "hopf"]),
        ("-o grid.spacing=3", ["'spacing'", "'spacing_mm'", "min_contact_percent (float)"]),
        ("-o refiner.iterations=many", ["iterations", "'many'", "whole number"]),
        ("-o grid.spacing_mm=-1", ["spacing_mm", "-1"]),
        ("-o spacing_mm", ["SLOT.OPTION=VALUE", "grid.spacing_mm=3"]),
        ("-o gird.spacing_mm=3", ["'gird'", "'grid'"]),
        ("--objct pin", ["--objct", "tactile-loc run -h"]),
        ("--units feet", ["--units cannot be 'feet'; give auto, m, mm, cm or inch"]),
        ("--top many", ["--top cannot be 'many'; give a whole number"]),
        ("--top 0", ["--top cannot be 0; give 1 or more"]),
        ("--top -1", ["--top cannot be -1; give 1 or more"]),
        ("--top", ["--top", "tactile-loc run -h"]),
        ("--zero new.png", ["--zero", "gelslim", "--sensor FOLDER"]),
        ("--seed -1", ["--seed cannot be -1; give 0 or more"]),
        ("--config negative.toml", ["negative.toml: seed cannot be -1; give 0 or more"]),
        ("--config positive.toml --seed -2", ["--seed cannot be -2; give 0 or more"]),
        ("--config none.toml", ["none.toml"]),
        ("--config broken.toml", ["broken.toml", "TOML"]),
        ("--config unknown.toml", ["unknown.toml", "'gird'", "'grid'"]),
        ("--config flat.toml", ["object", "table"]),
        ("--config object.toml", ["object.toml", "[object]", 'path = "pin"']),
        ("--sensor file", ["'file'", "--sensor my_sensor.toml"]),
        ("--sensor calibrated", ["'calibrated'", "--sensor FOLDER"]),
        ("--sensor none.toml", ["none.toml"]),
        ("--sensor sensor.toml", ["sensor.toml", "image_size_px"]),
    ],
)
def test_run_refuses_bad_input_in_one_sentence(cli, inputs, monkeypatch, line, mentions):
    monkeypatch.chdir(inputs)
    assert_refused(cli("run", *TINY, "--out", OUT, *line.split()), *mentions)
    assert not OUT.exists()


@pytest.mark.parametrize(
    ("line", "mentions"),
    [
        ("rnu", ["rnu"]),
        ("build --press-depth 5", ["5 mm", "2 mm"]),
        ("build --grid face -o grid.min_contact_percent=100", ["min_contact_percent"]),
        ("evaluate --seed -1", ["--seed cannot be -1; give 0 or more"]),
        ("run --config misspelt.toml", ["misspelt.toml", "'spacing'", "'spacing_mm'"]),
        ("simulate --count 0 --out out", ["--count"]),
        ("simulate --count -3 --out out", ["--count"]),
        ("store list --store", ["--store", "tactile-loc store list -h"]),
        ("sweep plan.toml", ["plan.toml", "'ipc'", "choose none, "]),
    ],
)
def test_other_commands_refuse_bad_input_in_one_sentence(cli, inputs, monkeypatch, line, mentions):
    monkeypatch.chdir(inputs)
    assert_refused(cli(*line.split()), *mentions)
    assert not OUT.exists()


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


def test_an_option_of_the_command_line_is_refused_without_the_files_name(cli, inputs):
    done = cli("run", "--config", inputs / "misspelt.toml", "--grid", "hopf", "-o", "grid.spacin_mm=3")
    assert_refused(done, "'spacin_mm'")
    assert "misspelt.toml" not in done.stderr


def test_an_output_path_that_is_a_file_is_refused_before_building(cli: Cli, tmp_path):
    OUT.write_text("mine")
    store = tmp_path / "untouched"
    for out in (OUT, OUT / "deeper"):
        assert_refused(cli("run", *TINY, "--out", out, "--store", store), "out", "--out")
        assert_refused(cli("simulate", "--out", out), "out", "--out")
    assert OUT.read_text() == "mine"
    assert not store.exists()


def test_a_store_path_that_is_a_file_is_refused(cli):
    Path("store").write_text("mine")
    assert_refused(cli("run", *TINY, "--out", OUT, "--store", "store"), "--store")
    assert_refused(cli("build", *TINY, "--store", "store"), "--store")
    assert Path("store").read_text() == "mine"
    assert not OUT.exists()
