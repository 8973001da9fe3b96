"""`tactile-loc identify`: from a folder of meshes and touches to a name, a table and an exit code."""

import json
import re
from pathlib import Path

import pytest
import trimesh
from cli_helpers import assert_refused, succeed

SETTINGS = "temperature = 0.05\n[grid]\nname = 'whole'\ndirections = 300\nturns = 24\n"
IDENTIFY = ["identify", "--objects", "parts", "--units", "mm", "--sensor", "gelsight-mini", "--config", "run.toml"]


@pytest.fixture
def parts(cli) -> Path:
    """A folder with a plate and a rod, and three touches of the plate."""
    Path("parts").mkdir()
    trimesh.creation.box((30, 20, 6)).export("parts/plate.stl")
    trimesh.creation.cylinder(4, 40, sections=32).export("parts/rod.stl")
    Path("run.toml").write_text(SETTINGS)
    plate = ["--object", "parts/plate.stl", "--units", "mm", "--sensor", "gelsight-mini", "--config", "run.toml"]
    succeed(cli("simulate", *plate, "--together", 3, "--seed", 3, "--out", "touches"))
    return Path("parts")


def test_identify_names_the_object_or_none(cli, parts):
    done = succeed(cli(*IDENTIFY, "--touch", "touches/touches.toml", "--out", "out", "--report", "--json"))
    said = json.loads(done.stdout)
    assert said["verdict"] == "certain"
    assert "<h1>certain: plate" in Path("out/report.html").read_text()
    assert said["identified"] == "plate"
    assert said["objects"][0]["poses"][0]["imprint_iou"] > 0.95
    assert json.loads(Path("out/identification.json").read_text()).items() <= said.items()
    (parts / "plate.stl").unlink()
    done = cli(*IDENTIFY, "--touch", "touches/touches.toml", "--out", "out")
    assert done.exit_code == 1, done.stderr
    assert done.stdout.startswith("not found: none of these")


def test_a_required_verdict_decides_the_exit_code(cli, parts):
    wanted = [*IDENTIFY, "--touch", "touches/touch-0000.npz", "--require", "certain", "--out", "out", "--around", 20]
    assert cli(*wanted).exit_code == 3, "after one touch, an unknown object is too probable"
    wanted += ["--unknown", 0.02]
    done = succeed(cli(*wanted))
    assert re.match(r"certain: plate \d", done.stdout)
    trimesh.creation.box((30, 20.3, 6)).export(parts / "same.stl")
    done = cli(*wanted)
    assert done.exit_code == 3, done.stderr
    assert re.match(r"ambiguous: (plate|same) \d.* %, (plate|same) \d", done.stdout)
    said = json.loads(Path("out/identification.json").read_text())
    assert said["verdict"] == "ambiguous"
    assert {mode["object"] for mode in said["next_touch"]["modes"]} == {"plate", "same"}
    best = said["next_touch"]["ranked"][0]["name"]
    assert best in Path("out/approaches.toml").read_text()
    assert re.search(rf"1 +{best}", done.stdout)


def test_a_given_symmetry_counts_for_every_object(cli, parts):
    words = [*IDENTIFY, "--touch", "touches/touch-0000.npz", "--out", "out", "--json"]
    counts = []
    for more in ([], ["--symmetry", "none"]):
        found = json.loads(cli(*words, *more).stdout)["objects"]
        (plate,) = (one for one in found if one["name"] == "plate")
        counts.append(len(plate["poses"]))
    assert counts[0] < counts[1], "turned poses of the plate are different poses"
    assert_refused(cli(*words[:-1], "--symmetry", "round"), "'round'", "symmetry")


def test_bad_input_is_one_sentence(cli, parts):
    touch = ["--touch", "touches/touch-0000.npz"]
    assert_refused(cli("identify", "--objects", "nowhere", *touch), "nowhere", "folder")
    Path("empty").mkdir()
    assert_refused(cli("identify", "--objects", "empty", *touch), "empty", "mesh")
    Path("empty/library.json").write_text("{}")
    assert_refused(cli("identify", "--objects", "empty", *touch), "tactile-loc library identify empty --touch")
    assert_refused(cli(*IDENTIFY, "--touch", "no.npz"), "no.npz")
    assert_refused(cli(*IDENTIFY, *touch, "--unknown", 0), "prior=0.0")
    trimesh.creation.box((30, 20, 6)).export(parts / "plate.obj")
    assert_refused(cli(*IDENTIFY, *touch), "plate")
    assert not Path("tactile-loc-identify").exists()
