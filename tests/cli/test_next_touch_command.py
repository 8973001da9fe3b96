"""`tactile-loc next-touch`: from a result and a list of approaches to a table, a file and a picture."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cli_helpers import SURE, TINY, assert_refused, succeed, touch_depths
from tactile_loc_cli.main import app
from typer.testing import CliRunner

from tactile_loc.core.geometry.rigid import make_transform, rotation_about


@pytest.fixture(scope="module")
def result(store, tmp_path_factory) -> Path:
    """The result of one simulated touch."""
    folder = tmp_path_factory.mktemp("located")
    words = ["run", "--object", "pin", *TINY, *SURE, "--store", str(store)]
    done = CliRunner().invoke(app, [*words, "--out", str(folder / "located")])
    assert done.exit_code == 0, done.stderr
    return folder / "located" / "result.json"


def listed(name: str, *starts: np.ndarray, more: str = "") -> str:
    Path(name).write_text("".join(f"[[approach]]\nT_sensor_next = {T.tolist()}\n{more}" for T in starts))
    return name


def motion(x_mm: float, yaw_deg: float = 0.0) -> np.ndarray:
    """A motion back by 50 mm, along x, and about z."""
    return make_transform(rotation_about([0, 0, 1], np.radians(yaw_deg)), [1e-3 * x_mm, 0.0, -0.05])


@pytest.mark.usefixtures("drawn_pictures")
def test_approaches_to_a_result_are_ranked_and_drawn(cli, result):
    poses = listed("poses.toml", motion(0), motion(4, 90), motion(500))
    done = succeed(cli("next-touch", result, "--candidates", poses, "--out", "out", "--json"))
    said = json.loads(done.stdout)
    assert said["written"] == ["out/next_touch.json", "out/next_touch.png"]
    assert json.loads(Path("out/next_touch.json").read_text()).items() <= said.items()
    worth = [one["worth"] for one in said["ranked"]]
    assert worth == sorted(worth, reverse=True)
    beside = next(one for one in said["ranked"] if one["name"] == "approach 3")  # half a metre away
    assert beside["information_nats"] == pytest.approx(0)
    assert set(beside["travel_m"]) == {None}
    assert sum(mode["probability"] for mode in said["modes"]) == pytest.approx(1)
    table = cli("next-touch", result, "--candidates", poses, "--out", "out")
    assert "nats" in table.stdout
    assert "approach 3" in table.stdout
    of_folder = cli("next-touch", result.parent, "--candidates", poses, "--out", "out")
    assert (of_folder.exit_code, of_folder.stdout) == (0, table.stdout)


def test_bad_input_is_one_sentence(cli, result):
    poses = listed("poses.toml", motion(0))
    assert_refused(cli("next-touch", "nowhere.json", "--candidates", poses), "nowhere.json")
    for source in ([], ["--candidates", poses, "--around", "3"]):
        assert_refused(cli("next-touch", result, *source), "--candidates", "--around")
    Path("empty").mkdir()
    assert_refused(cli("next-touch", "empty", "--candidates", poses), "empty", "result.json")
    assert_refused(cli("next-touch", result, "--candidates", "no.toml"), "no.toml")
    assert_refused(cli("next-touch", result, "--candidates", listed("none.toml")), "none.toml", "[[approach]]")
    far = listed("far.toml", motion(0), more="cost = inf\n")
    assert_refused(cli("next-touch", result, "--candidates", far), "1 approach")
    assert not Path("tactile-loc-next-touch").exists()


@pytest.mark.usefixtures("drawn_pictures")
def test_drawn_approaches_are_written_for_the_next_call(cli, result):
    drawn = succeed(cli("next-touch", result, "--around", "20", "--seed", "3", "--out", "out", "--json"))
    said = json.loads(drawn.stdout)
    assert said["written"] == ["out/next_touch.json", "out/next_touch.png", "out/approaches.toml"]
    assert len(said["ranked"]) == 20
    again = json.loads(cli("next-touch", result, "--candidates", "out/approaches.toml", "--json").stdout)
    assert [one["name"] for one in again["ranked"]] == [one["name"] for one in said["ranked"]]
    assert [one["information_nats"] for one in again["ranked"]] == pytest.approx(
        [one["information_nats"] for one in said["ranked"]]
    )


def test_a_finger_that_hits_the_object_is_out_of_reach(cli, result):
    pytest.importorskip("fcl", reason="python-fcl is not installed")
    poses = listed("poses.toml", motion(0), motion(500))
    trimesh.creation.box((200, 200, 110)).export("finger.stl")  # 30 mm in front of the gel
    finger = ("--finger", "finger.stl", "--units", "mm")
    done = succeed(cli("next-touch", result, "--candidates", poses, *finger, "--out", "out", "--json"))
    said = json.loads(done.stdout)
    assert [one["name"] for one in said["ranked"]] == ["approach 2"]  # half a metre away
    assert "finger" in said["out_of_reach"][0]["reason"]
    assert said["stops"] is False


def test_what_the_finger_must_not_hit_is_checked(cli, result):
    poses = listed("poses.toml", motion(0))
    given = ("next-touch", result, "--candidates", poses)
    assert_refused(cli(*given, "--floor", "0"), "--floor", "--finger")
    assert_refused(cli(*given, "--finger", "20x20x20mm", "--floor", "0"), "floor")
    assert_refused(cli(*given, "--finger", "20x0x20mm"), "20x0x20mm")
    assert_refused(cli(*given, "--finger", "none.stl"), "none.stl")
    np.save("touch.npy", touch_depths())
    Path("run.toml").write_text("temperature = 0.05\n")
    touch = ["--config", "run.toml", "--touch", "touch.npy", "--touch-unit", "m"]
    succeed(cli("run", "--object", "pin", *TINY, *touch, "--out", "alone"))
    alone = ("next-touch", "alone", "--candidates", poses, "--finger", "20x20x20mm")
    assert_refused(cli(*alone, "--floor", "0"), "T_base_sensor", "--floor")
