"""`tactile-loc run --touch FOLDER`."""

import csv
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import TINY, assert_refused, succeed, touch_depths
from message_helpers import missing

from tactile_loc.locate.probability.outcome_model import OutcomeModel

FOLDER = Path("touches")
PIN = ["--object", "pin", *TINY]


@pytest.fixture
def folder(cli, tmp_path) -> Path:
    """Two touches of the pin, and a file without contact."""
    assert cli("simulate", "--object", "pin", "--count", 2, "--out", FOLDER, *TINY).exit_code == 0
    np.savez(FOLDER / "zero.npz", depth=np.full((200, 200), 0.002, np.float32), unit="m")
    return FOLDER


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "results.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pictures")
def test_each_touch_has_a_line_and_its_results(cli, folder):
    """The required verdict is that of all touches, so the file without contact decides the exit code."""
    done = cli("run", *PIN, "--touch", folder, "--out", "out", "--pictures", "--report", "--require", "certain")
    assert done.exit_code == 3, done.stderr
    found = rows(Path("out"))
    assert [row["touch"] for row in found] == ["touch-0000.npz", "touch-0001.npz", "zero.npz"]
    assert "contact" in found[2]["says"]
    assert found[2]["verdict"] == "no contact"
    counts = Counter(row["verdict"] for row in found[:2])
    assert not missing(done.stdout, "3 touches", "1 without contact", *(f"{n} {name}" for name, n in counts.items()))
    assert done.stderr.count("warning: ") == 1
    assert "<h1>" in Path("out/report.html").read_text()
    for row in found[:2]:
        assert row["touch"] in done.stdout
        result = json.loads((Path("out") / Path(row["touch"]).stem / "result.json").read_text())
        assert row["verdict"] == result["verdict"] in ("certain", "ambiguous")
        T = np.array(result["hypotheses"][0]["T_sensor_object"])
        np.testing.assert_allclose([float(row[k]) for k in ("x_mm", "y_mm", "z_mm")], 1e3 * T[:3, 3], atol=1e-3)
        assert (Path("out") / Path(row["touch"]).stem / "result.png").stat().st_size > 10_000


def test_a_touch_in_a_folder_is_located_as_alone(cli, folder):
    (folder / "touch-0001.png").write_bytes(b"")
    done = succeed(cli("run", *PIN, "--touch", folder, "--out", "all", "--json"))
    said = json.loads(done.stdout)
    assert (said["located"], said["written"]) == (2, ["all/results.csv"])
    assert "contact" in said["touches"][2]["error"]
    assert "--touch 'touches/touch-*.png'" in done.stderr, "photos beside contact shapes are reported"
    assert cli("run", *PIN, "--touch", folder / "touch-0001.npz", "--out", "one").exit_code == 0
    both = [json.loads(Path(p).read_text()) for p in ("all/touch-0001/result.json", "one/result.json")]
    poses = [np.array(r["hypotheses"][0]["T_sensor_object"]) for r in both]
    np.testing.assert_allclose(*poses, atol=1e-5)
    assert said["touches"][1]["T_sensor_object"] == poses[0].tolist()
    assert both[0]["touch"]["T_sensor_object"] == both[1]["touch"]["T_sensor_object"]
    assert not Path("all/touch-0001/result.png").exists()
    assert_refused(cli("run", *PIN, "--touch", folder, "--prior", "prior.toml"), "--prior", "folder")


def test_poorly_explained_touches_are_named(cli, folder, monkeypatch):
    monkeypatch.setattr(OutcomeModel, "measure_excess", lambda model, evidence: np.ones(len(evidence.fits)))
    done = cli("run", *PIN, "--touch", folder, "--out", "out")
    assert not missing(done.stderr, 2, "touch-0000.npz", "touch-0001.npz")
    assert {row["verdict"] for row in rows(Path("out"))} == {"poor fit", "no contact"}
    unrefined = cli("run", *PIN, "--touch", folder, "--out", "out", "--refiner", "none")
    assert "touch-0001.npz" not in unrefined.stderr, "the imprint of a grid pose means little"


def test_a_folder_without_a_locatable_touch_is_refused(cli, tmp_path):
    (tmp_path / "empty").mkdir()
    assert_refused(cli("run", *PIN, "--touch", "empty"), "empty", ".npz")
    (tmp_path / "bad").mkdir()
    np.savez("bad/a.npz", depth=np.full((200, 200), 0.002, np.float32), unit="m")
    np.savez("bad/b.npz", depth=touch_depths((30, 30)), unit="m")
    assert_refused(cli("run", *PIN, "--touch", "bad"), "bad", "a.npz")
