"""The commands of docs/chain.md run one after another, in a folder with meshes, and write the files of its table."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tactile_loc_cli.main import app
from typer.main import get_command
from typer.testing import CliRunner

from tactile_loc import load_object
from tactile_loc.io.approach_files import read_approaches
from tactile_loc.io.touch_lists import read_touch_list

PAGE = (Path(__file__).parents[1] / "docs" / "chain.md").read_text()


def find_blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


def list_rows(heading: str) -> list[list[str]]:
    """The cells of the table below a heading."""
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## )", PAGE, re.DOTALL | re.MULTILINE)
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in row] for row in rows]


def list_files() -> dict[str, str]:
    """The writer of each file, from the page's table."""
    return {file: writer for files, writer, _ in list_rows("Files") for file in re.findall(r"`([^`]+)`", files)}


@pytest.fixture
def workplace(tmp_path, monkeypatch, store) -> Path:
    """A folder with a part, a folder of parts, and the page's description of the part."""
    (tmp_path / "parts").mkdir()
    for name, file in (("pin", "part.stl"), ("pin", "parts/pin.stl"), ("cotter", "parts/cotter.stl")):
        mesh = load_object(name).mesh
        trimesh.Trimesh(mesh.vertices_m * 1e3, mesh.faces, process=False).export(tmp_path / file)
    (description,) = find_blocks("toml")
    (tmp_path / "part.toml").write_text(description)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))
    return tmp_path


def test_the_page_has_no_other_blocks():
    assert set(re.findall(r"^```(\w+)\n", PAGE, re.MULTILINE)) == {"toml", "sh"}


def test_the_options_that_save_time_exist():
    rows = list_rows("Keep it quick")
    assert len(rows) >= 4
    for option, _ in rows:
        name, *words = shlex.split(option.strip("`"))
        get_command(app).commands[name].make_context(name, words, resilient_parsing=True)  # arguments are left out


@pytest.mark.slow
def test_the_commands_run_in_order_and_write_the_listed_files(workplace):
    before = {str(path.relative_to(workplace)) for path in workplace.rglob("*")}
    for line in "".join(find_blocks("sh")).splitlines():
        program, *words = shlex.split(line)
        done = CliRunner().invoke(app, words, prog_name=program)
        assert (program, done.exit_code) == ("tactile-loc", 0), (line, done.stderr)
    files = list_files()
    assert {file for file in files if not (workplace / file).is_file()} == set()
    assert {file for file in files if file in before} == {file for file in files if files[file] == "you"}
    assert len(read_touch_list("touches/touches.toml")) == 3
    assert len(read_approaches("next/approaches.toml", np.eye(4))) == 50
