"""`tactile-loc run`, from touch to files."""

import dataclasses
import json
import os
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cli_helpers import SURE, TINY, assert_refused, succeed, touch_depths, write_box
from PIL import Image
from rerun_helpers import read
from tactile_loc_cli import results
from tactile_loc_cli.main import app
from tactile_loc_cli.results import _name_side, make_title, say_result
from typer.testing import CliRunner

from tactile_loc import Localization, load_object
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.io.config import TouchConfig
from tactile_loc.locate.result import result_arrays
from tactile_loc.locate.result.verdict import Outcome, Verdict, explain_verdict
from tactile_loc.plugin.helpers import rotation_about
from tactile_loc.plugins.grids.face import find_resting_normal
from tactile_loc.store.locks import lock, open_folder

ROOT = Path(__file__).parents[2]


def is_locked(folder: Path) -> bool:
    """Return whether another process holds the lock of a folder."""
    descriptor = open_folder(folder)
    try:
        return not lock(descriptor, wait=False)
    finally:
        os.close(descriptor)


@pytest.fixture(scope="module")
def result(store: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """The result of `run` on a tiny grid, with its output and files."""
    folder, write, alone = tmp_path_factory.mktemp("run"), result_arrays.write_arrays, []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(
            result_arrays, "write_arrays", lambda *given: alone.append(is_locked(given[0].parent)) or write(*given)
        )
        done = CliRunner().invoke(app, ["run", *TINY, "--out", "out", "--store", str(store)])
    assert done.exit_code == 0, done.stderr
    said = {"stdout": done.stdout, "stderr": done.stderr, "folder": folder / "out", "alone": alone}
    return {**said, **json.loads((folder / "out/result.json").read_text())}


def test_the_summary_states_the_verdicts_meaning_and_the_unlisted_probability(result, capsys):
    assert result["stdout"].startswith(f"{result['verdict']}: {explain_verdict(Verdict(result['verdict']))}")
    found = Localization.load(result["folder"])
    outcome = Outcome(0.8, 0.1, 0.1)
    for listed, shown in ((0.5, True), (0.895, False)):
        first = dataclasses.replace(found.best, probability=listed)
        say_result(dataclasses.replace(found, hypotheses=(first,), outcome=outcome))
        assert ("40 % of the probability" in capsys.readouterr().out) == shown


@pytest.mark.parametrize(
    ("paths", "shown"),
    [
        ([None] * 2, "2 simulated touches"),
        (["a.npy"], "a.npy"),
        (["a.npy", "b.npy", "c.npy"], "3 touches: a.npy, b.npy, c.npy"),
        (["a.npy", "b.npy", "c.npy", "d.npy"], "4 touches: a.npy, b.npy, c.npy, ..."),
    ],
)
def test_the_header_of_the_table_names_the_touches(result, capsys, paths, shown):
    found = Localization.load(result["folder"])
    first, *others = (dataclasses.replace(found.touch, name=str(path)) for path in paths)
    config = found.config.model_copy(update={"touch": TouchConfig(path=paths[0])})
    say_result(dataclasses.replace(found, touch=first, others=tuple(others), config=config))
    assert f"hook in the base frame, {shown}\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("verdict", "stated"), [("certain", True), ("ambiguous", True), ("poor fit", False), ("not found", False)]
)
def test_the_headline_and_the_title_state_a_probability_only_beside_a_trusted_verdict(result, capsys, verdict, stated):
    found = Localization.load(result["folder"])
    assessed = dataclasses.replace(found.assessment, verdict=Verdict(verdict))
    found = dataclasses.replace(found, assessed=assessed, outcome=Outcome(0.5, 0.3, 0.2))
    say_result(found)
    headline = capsys.readouterr().out.splitlines()[0]
    title = make_title(found)
    assert headline.startswith(f"{verdict}: ")
    assert title.startswith(f"{verdict}: hook on ")
    assert [" probability" in text for text in (headline, title)] == [stated, stated]
    assert "()" not in headline
    assert ", ," not in title


def test_an_unmet_requirement_ends_with_its_own_code_and_the_result(cli, result):
    """The same run with a tiny tolerance is not certain. It is written and reported, but ends with exit code 3."""
    assert result["tolerance"] == "1mm"
    done = cli("run", *TINY, "--out", "required", "--tolerance", "0.0001mm", "--require", "certain", "--json")
    assert done.exit_code == 3
    said = json.loads(done.stdout)
    assert (said["verdict"], said["tolerance"]) == ("ambiguous", "0.0001mm")
    assert 0 < said["probability_within"] < 0.9
    assert said["next_step"]
    assert Path("required/result.json").is_file()
    assert cli("run", *TINY, "--out", "required", "--require", "maybe").exit_code == 2


def test_the_files_are_written_before_the_output(cli, result, monkeypatch):
    """The reader of the output may close it early, as `head` does."""

    def close(record):
        raise BrokenPipeError

    monkeypatch.setattr(results, "say_result", close)
    done = cli("run", *TINY, "--report", "--out", "closed")
    assert isinstance(done.exception, BrokenPipeError)
    written = {path.name for path in Path("closed").iterdir()}
    assert written == {path.name for path in result["folder"].iterdir()} | {"report.html"}


def test_run_without_a_touch_locates_a_simulated_one(result):
    assert result["object"]["name"] == "hook"
    assert result["touch"]["path"] is None
    T = np.array(result["hypotheses"][0]["T_sensor_object"])
    T_true = np.array(result["touch"]["T_sensor_object"])
    distance = measure_pose_errors(load_object("hook"), T[None], T_true)[0]
    assert result["errors"]["best_m"] == pytest.approx(distance)
    assert result["errors"]["best_listed_m"] <= result["errors"]["best_m"]
    assert distance < 3e-3  # the grid's spacing is 8 mm


def test_the_output_names_files_and_figures_and_shows_the_pose_in_mm_and_degrees(result):
    for words in ("entropy", "error: ", "time: ", "out/result.json", "out/result.png"):
        assert words in result["stdout"]
    assert result["stderr"] == ""
    best = result["hypotheses"][0]
    T = np.array(best["T_base_object"])  # the sensor poses of simulated touches are known
    row = next(line for line in result["stdout"].splitlines() if line.split()[:1] == ["1"])
    row = row.replace("(", "").replace(",", "")
    shown = [float(word) for word in row.replace(")", "").split()]
    assert shown[1] == pytest.approx(100 * best["probability"], abs=0.06)
    assert shown[2:5] == pytest.approx(1e3 * T[:3, 3], abs=0.006)
    angle_rad, axis = np.radians(shown[5]), np.array(shown[6:9])
    K = np.cross(np.eye(3), axis)
    R = np.eye(3) + np.sin(angle_rad) * K + (1 - np.cos(angle_rad)) * K @ K
    assert np.abs(R - T[:3, :3]).max() < 0.01
    assert shown[-1] == pytest.approx(1e3 * best["error_m"], abs=0.06)


def test_the_output_names_the_searched_side_of_the_object(cli, result):
    mesh = load_object(result["object"]["name"]).mesh
    (line,) = [line for line in result["stdout"].splitlines() if line.startswith("searched: the object's side")]
    shown = [float(word) for word in re.search(r"\((.*?)\)", line)[1].split(",")]
    assert shown == pytest.approx(find_resting_normal(mesh), abs=0.006)
    chosen = succeed(cli("run", "--object", "pin", *TINY, *SURE, "-o", "grid.face=+y", "--out", "chosen"))
    assert not [line for line in chosen.stdout.splitlines() if line.startswith("searched: the object's side")]


@pytest.mark.parametrize(("turn_deg", "side"), [(0, "-z"), (180, "+z"), (90, "-y")])
def test_the_advised_face_is_the_one_that_touches_in_a_certain_pose(turn_deg, side):
    T = np.eye(4)
    T[:3, :3] = rotation_about([1, 0, 0], np.radians(turn_deg))
    found = SimpleNamespace(best=SimpleNamespace(T_sensor_object=T), verdict=Verdict.CERTAIN)
    assert _name_side(found) == side
    found.verdict = Verdict.NOT_FOUND
    assert _name_side(found) == "SIDE"


def test_result_files_are_complete_and_written_under_a_lock(result):
    assert result["alone"] == [True]
    assert not is_locked(result["folder"])
    with Image.open(result["folder"] / "result.png") as picture:
        picture.load()
        assert picture.width > 600
    assert sorted(path.name for path in result["folder"].iterdir()) == ["result.json", "result.npz", "result.png"]


def test_the_option_flag_also_sets_plain_settings(cli, tmp_path):
    done = cli("build", "--object", "pin", *TINY, "-o", "shape_px=small")
    assert done.exit_code != 0
    assert "shape_px" in done.stderr
    done = succeed(cli("run", "--object", "pin", *TINY, *SURE, "-o", "shape_px=48", "--out", "out"))
    assert json.loads((tmp_path / "out/result.json").read_text())["configuration"]["shape_px"] == 48


def as_toml(value: object) -> str:
    """Write a JSON value as one line of TOML, without nulls."""
    if isinstance(value, dict):
        pairs = [f"{key} = {as_toml(item)}" for key, item in value.items() if item is not None]
        return "{" + ", ".join(pairs) + "}"
    return "[" + ", ".join(map(as_toml, value)) + "]" if isinstance(value, list) else json.dumps(value)


def test_the_configuration_in_the_result_gives_the_same_result(cli, result, tmp_path):
    configuration = result["configuration"]
    assert configuration["grid"]["options"]["spacing_mm"] == 8
    assert configuration["grid"]["options"]["face"] == "auto"  # the default is written explicitly
    lines = [f"{key} = {as_toml(value)}" for key, value in configuration.items() if value is not None]
    Path("again.toml").write_text("\n".join(lines))
    succeed(cli("run", "--config", "again.toml", "--out", "again"))
    again = json.loads((tmp_path / "again/result.json").read_text())
    for key in ("configuration", "object", "touch", "grid_poses", "normalised_entropy"):
        assert again[key] == result[key]
    assert [h["probability"] for h in again["hypotheses"]] == [h["probability"] for h in result["hypotheses"]]
    poses = [np.array([h["T_sensor_object"] for h in found["hypotheses"]]) for found in (result, again)]
    assert poses[0] == pytest.approx(poses[1], abs=1e-8)  # threads sum in varying order


def test_the_command_line_overrides_the_file(cli, tmp_path):
    Path("run.toml").write_text(
        'top = 7\n[object]\npath = "hook"\n[grid]\nname = "face"\nspacing_mm = 9\nmin_contact_percent = 3\n'
        '[refiner]\nname = "icp"\nmax_iterations = 5\n'
    )
    given = ["--object", "pin", "--refiner", "none", "--top", 2]
    succeed(cli("run", "--config", "run.toml", *given, *TINY, *SURE, "--out", "out"))
    result = json.loads((tmp_path / "out/result.json").read_text())
    configuration = result["configuration"]
    assert configuration["object"]["path"] == "pin"
    assert configuration["refiner"] == {"name": "none", "options": {}}
    assert configuration["grid"]["options"]["spacing_mm"] == 8
    assert configuration["grid"]["options"]["min_contact_percent"] == 3
    assert len(result["hypotheses"]) <= 2


def test_run_reads_touch_mesh_and_sensor_files(cli, tmp_path):
    write_box(Path("box.obj"))
    Path("sensor.toml").write_text((ROOT / "examples/my_sensor.toml").read_text())
    box = ["--object", "box.obj", "--units", "mm", "--sensor", "sensor.toml"]
    succeed(cli("simulate", *box, "--count", 1, "--out", "touches", *TINY))
    done = succeed(cli("run", *box, "--touch", "touches/touch-0000.npz", "--press-depth", 1, *TINY))
    result = json.loads((tmp_path / "tactile-loc-result/result.json").read_text())
    assert result["touch"]["path"] == "touches/touch-0000.npz"
    assert result["touch"]["press_depth_m"] == pytest.approx(1e-3)
    assert result["configuration"]["sensor"]["name"] == "file"
    assert result["configuration"]["sensor"]["options"]["path"] == "sensor.toml"
    assert re.search(r"\bframe\b.*\bsensor\b", done.stdout)


def test_guesses_are_shown_as_one_line_warnings(cli):
    write_box(Path("box.obj"), faces=10)
    done = succeed(cli("run", *TINY, *SURE, "--object", "box.obj"))
    assert all(line.startswith("warning: ") for line in done.stderr.splitlines())
    assert any("watertight" in line for line in done.stderr.splitlines())
    assert any(re.search(r"\bmm\b", line) for line in done.stderr.splitlines())


def test_the_result_records_the_noise_of_a_simulated_touch(cli, result, tmp_path):
    succeed(cli("run", *TINY, "--noise", "mild", "--out", "noisy"))
    noisy = json.loads((tmp_path / "noisy/result.json").read_text())
    assert (result["touch"]["noise"], noisy["touch"]["noise"]) == ("none", "mild")
    assert noisy["configuration"]["touch"]["noise"] == "mild"
    assert noisy["touch"]["press_depth_m"] < result["touch"]["press_depth_m"]


def test_an_unknown_noise_level_and_noise_for_a_touch_file_are_refused(cli):
    np.save("touch.npy", touch_depths())
    touch = ["--object", "hook", "--touch", "touch.npy", "--touch-unit", "m"]
    for level in ("none", "mild"):
        assert_refused(cli("run", *TINY, *touch, "--noise", level), "--noise", "touch.npy")
    Path("run.toml").write_text('[touch]\nnoise = "strong"\n')
    assert_refused(cli("run", *TINY, *touch, "--config", "run.toml"), "--noise", "touch.npy")
    succeed(cli("run", *TINY, *touch, "--out", "out"))
    assert json.loads(Path("out/result.json").read_text())["touch"]["noise"] is None
    assert_refused(cli("run", "--noise", "weak"), "weak", "mild")
    Path("run.toml").write_text('[touch]\nnoise = "weak"\n')
    assert_refused(cli("run", "--config", "run.toml"), "touch.noise", "weak", "mild")


def test_the_result_lists_the_poses_of_the_set(cli, tmp_path):
    assert cli("simulate", *TINY, "--count", 1, "--out", "touches").exit_code == 0
    touch = ["--object", "hook", "--touch", "touches/touch-0000.npz"]
    done = succeed(cli("run", *TINY, *touch, "--top", 1, "--coverage", 0.9, "--out", "out"))
    result = json.loads((tmp_path / "out/result.json").read_text())
    found = result["pose_set"]
    assert found["coverage"] == 0.9
    assert found["poses"] == len(result["hypotheses"])
    assert found["promised"] == (found["reason"] == "")
    assert re.search(rf"90 ?% set: {found['poses']} pose", done.stdout)


def test_a_rerun_file_is_written_beside_the_result(cli):
    pytest.importorskip("rerun", reason="rerun is not installed")
    succeed(
        cli("run", "--object", "pin", *TINY, "-o", "temperature=0.001", "--out", "out", "--rerun", "out/result.rrd")
    )
    best = json.loads(Path("out/result.json").read_text())["hypotheses"][0]["T_sensor_object"]
    (place,) = read(Path("out/result.rrd"))["base/sensor/object"]["Transform3D:translation"][0]
    np.testing.assert_allclose(place, np.array(best)[:3, 3], atol=1e-6)
    Path("many").mkdir()
    assert_refused(cli("run", "--object", "pin", "--touch", "many", "--rerun", "a.rrd"), "--rerun")


def test_names_that_are_not_unicode_or_not_printable_are_kept_apart_from_their_text(cli, tmp_path):
    name = os.fsdecode(b"-Geh\xe4use[red]\n$x$")
    mesh, touch = write_box(tmp_path / f"{name}.obj"), tmp_path / f"{name}.npz"
    np.savez(touch, depth=touch_depths(), unit="m")
    shown = r"-Geh\xe4use[red]\n$x$"
    done = succeed(
        cli("run", f"--object={mesh}", "--units", "mm", f"--touch={touch}", f"--out={name}", *TINY, *SURE, "--report")
    )
    assert shown in done.stdout
    found = Localization.load(Path(name))
    assert (found.object.name, found.touch.name) == (shown, f"{shown}.npz")
    assert (found.object.source, found.config.touch.path) == (str(mesh), str(touch))
    assert cli("report", f"{Path(name).absolute()}").exit_code == 0
    assert "Geh\\xe4use" in (Path(name) / "report.html").read_text(encoding="utf-8")
    assert cli("run", f"--object={mesh}", "--units", "mm", "--touch", ".", "--out", "all", *TINY, *SURE).exit_code == 0
    assert shown in Path("all/results.csv").read_text(encoding="utf-8")
