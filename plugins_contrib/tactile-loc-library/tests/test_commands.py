"""`tactile-loc library`: building, adding, removing, checking, listing and identifying parts."""

import json
from pathlib import Path

import pytest
import trimesh
from cli_helpers import assert_refused, succeed
from tactile_loc import NullEvidence

from tactile_loc_library.commands import LOCATED, UNKNOWN
from tactile_loc_library.identification import LOCATED as SHORTLIST

MADE = ["--units", "mm", "--symmetry", "none"]
BUILD = ["library", "build", "parts", "--out", "lib", *MADE, "--directions", 100, "--workers", 1]


@pytest.fixture
def library(cli) -> Path:
    """A library of a plate and a rod; their meshes are in the folder `parts`."""
    Path("parts").mkdir()
    trimesh.creation.box((30, 20, 6)).export("parts/plate.stl")
    trimesh.creation.cylinder(4, 20, sections=16).export("parts/rod.stl")
    done = succeed(cli(*BUILD))
    assert done.stdout.startswith("2 parts built, 0 kept; 2 parts, ")
    return Path("lib")


def test_parts_are_listed_with_their_sizes(cli, library):
    lines = cli("library", "list", library).stdout.splitlines()
    assert lines[0].split() == ["part", "x", "mm", "y", "mm", "z", "mm", "places", "symmetry", "made", "from"]
    assert lines[1].split()[:4] == ["plate", "30.0", "20.0", "6.0"]
    assert lines[2].split()[-2:] == ["none", "rod.stl"]
    said = json.loads(cli("library", "list", library, "--json").stdout)
    assert [part["name"] for part in said["parts"]] == ["plate", "rod"]
    assert said["grid"]["options"]["directions"] == 100
    files = [path for path in library.rglob("*") if path.suffix in (".bin", ".npy", ".parquet")]
    assert said["bytes"] == sum(path.stat().st_size for path in files)


def test_a_part_is_added_with_the_librarys_options_and_removed(cli, library):
    trimesh.creation.box((12, 10, 8)).export("block.stl")
    done = succeed(cli("library", "add", library, "block.stl", *MADE, "--workers", 1))
    assert done.stdout.startswith("1 part built, 0 kept; 3 parts, ")
    done = cli("library", "remove", library, "plate", "rod")
    assert done.stdout.startswith("2 parts removed; 1 part, ")
    assert_refused(cli("library", "remove", library, "plate"), "no part 'plate'", "choose block")


def test_a_bad_mesh_is_named_and_the_exit_code_is_2(cli, library):
    Path("parts/broken.stl").write_text("solid x\nendsolid x\n")
    done = cli(*BUILD, "--json")
    assert done.exit_code == 2
    assert "failed: broken: " in done.stderr
    said = json.loads(done.stdout)
    assert list(said["failed"]) == ["broken"]
    assert said["kept"] == ["plate", "rod"]


def test_damage_is_listed_and_repaired(cli, library):
    assert cli("library", "check", library).stdout.startswith("all checksums match: 2 parts")
    (path,) = library.rglob("vectors.npy")
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    done = cli("library", "check", library)
    assert done.exit_code == 1
    assert done.stdout.splitlines()[0] == "damaged part: rod"
    assert "vectors.npy: its content does not match its checksum" in done.stdout
    assert json.loads(cli("library", "check", library, "--json").stdout)["damaged"] == ["rod"]
    assert cli("library", "add", library, "parts", *MADE, "--workers", 1).stdout.startswith("1 part built, 1 kept")
    assert cli("library", "check", library).exit_code == 0


@pytest.mark.parametrize("words", [["check"], ["list"], ["remove"], ["add"]])
def test_a_missing_library_is_refused(cli, words):
    trimesh.creation.box((12, 10, 8)).export("block.stl")
    more = {"remove": ["block"], "add": ["block.stl", "--workers", 1]}.get(words[0], [])
    assert_refused(cli("library", *words, "nowhere", *more), "no library in nowhere", "library build")


def test_the_touched_part_is_identified(cli, library):
    given = ["--sensor", "gelsight-mini", "-o", "temperature=0.05"]
    plate = ["--object", "parts/plate.stl", "--units", "mm", *given]
    assert cli("simulate", *plate, "--together", 2, "--seed", 3, "--out", "touches").exit_code == 0
    words = ["library", "identify", library, "--touch", "touches/touches.toml", *given, "--out", "out", "--json"]
    done = cli(*words, "--report", "--around", 5)
    assert done.exit_code in (0, 1), done.stderr
    said = json.loads(done.stdout)
    assert [one["name"] for one in said["objects"]] == ["plate", "rod"]
    assert said["next_touch"]["ranked"]
    assert json.loads(Path("out/identification.json").read_text()).items() <= said.items()
    assert Path("out/report.html").exists()
    assert_refused(cli(*words[:-1], "--located", 0), "cannot be 0")
    assert (SHORTLIST.most, NullEvidence.prior) == (LOCATED, UNKNOWN)
