"""`tactile-loc mount`: from a list of touches to a mount file that `run` uses; bad lists are one sentence."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import assert_refused, succeed

from tactile_loc.core.geometry.lie import compute_pose_errors
from tactile_loc.core.geometry.rigid import invert, make_transform, rotation_about
from tactile_loc.io.mount_files import read_mount

X = make_transform(rotation_about([1, 2, 0], 1.0), [0.02, -0.03, 0.1])
Y = make_transform(rotation_about([0, 1, 3], 2.0), [0.4, 0.1, 0.2])
PIN = ["--object", "pin", "--sensor", "gelsight-mini"]


def table(name: str, F: np.ndarray) -> str:
    return f'[[touch]]\npath = "touches/{name}.npz"\nT_base_flange = {F.tolist()}\n'


@pytest.fixture
def tables(cli) -> list[str]:
    """The TOML tables of eight touches of the pin, which is fixed at pose Y."""
    succeed(cli("simulate", *PIN, "--count", 8, "--noise", "mild", "--out", "touches"))
    poses = json.loads(Path("touches/poses.json").read_text())["T_sensor_object"]
    return [table(name, Y @ invert(np.array(S)) @ invert(X)) for name, S in poses.items()]


def written(name: str, *tables: str) -> str:
    Path(name).write_text("\n".join(tables))
    return name


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pictures")
def test_a_mount_is_found_and_used(cli, tables):
    Path("run.toml").write_text("temperature = 1e-3\n")  # no temperature is fitted
    touches = written("touches.toml", *tables)
    done = succeed(cli("mount", *PIN, "--config", "run.toml", "--touch", touches, "--out", "out", "--json"))
    said = json.loads(done.stdout)
    assert said["written"] == ["out/mount.toml", "out/mount.png"]
    assert len(said["touch"]) == 8
    e = compute_pose_errors(X, read_mount("out/mount.toml").T_flange_sensor)
    assert np.linalg.norm(e[:3]) < 5e-4
    assert np.linalg.norm(e[3:]) < np.radians(1.5)
    used = written("used.toml", 'mount = "out/mount.toml"', *tables[:3])
    done = succeed(cli("run", *PIN, "--config", "run.toml", "--touch", used, "--out", "run"))
    result = json.loads(Path("run/result.json").read_text())
    assert result["errors"]["best_m"] < 1e-3


def test_bad_input_is_one_sentence(cli, tables):
    no_flange = '[[touch]]\npath = "touches/touch-0000.npz"\n'
    for lines, mentioned in (
        (tables[:3], ("at least 4", " 3 touches")),
        ([*tables, no_flange], ("touch 9", "T_base_flange")),
        ([tables[0] + 'sensor = "digit"\n', *tables[1:]], ("digit", "gelsight-mini", "--sensor digit")),
    ):
        assert_refused(cli("mount", *PIN, "--touch", written("bad.toml", *lines), "--out", "out"), *mentioned)
    Path("nominal.toml").write_text("xyz_mm = [0, 0, 0]\n")
    touches = ["--touch", written("touches.toml", *tables)]
    assert_refused(cli("mount", *PIN, *touches, "--nominal", "nominal.toml", "--out", "out"), "nominal.toml")
    assert_refused(cli("run", *PIN, *touches, "--out", "out"), "touch 1", "mount =")
    assert not Path("out").exists()
