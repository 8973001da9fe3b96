"""The page touchability.md and the README: their command and their program run, with a few touches of a small part."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

ROOT = Path(__file__).parents[3]
PAGE, README = ROOT / "docs" / "touchability.md", Path(__file__).parents[1] / "README.md"
FEW = ["--touches", "20", "--sets", "1", "--workers", "1", "-o", "grid.directions=300"]


def find_block(page: Path, language: str) -> str:
    if not page.is_file():
        pytest.skip(f"there is no {page}: these tests were copied out of the repository")
    (text,) = re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return text


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "TACTILE_LOC_STORE": str(folder / "store"), "OMP_NUM_THREADS": "1"}
    return subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    block = trimesh.creation.box([14, 10, 6])
    step = trimesh.creation.box([5, 6, 4]).apply_translation([3, 1, 4.9])
    trimesh.boolean.union([block, step], engine="manifold").export(tmp_path / "part.stl")
    return tmp_path


@pytest.mark.slow
def test_the_command_of_the_page_writes_the_shares(folder):
    program, *words = shlex.split(find_block(PAGE, "sh").splitlines()[-1])
    assert program == "tactile-loc"
    done = run(folder, "-m", "tactile_loc_cli.main", *words, *FEW, "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert json.loads((folder / "touchability" / "touchability.json").read_text())["studies"] == said["studies"]
    assert [row["touches"] for row in said["studies"][0]["shares"]] == [1, 2, 3]


@pytest.mark.slow
def test_a_press_beyond_the_sensor_is_refused_in_one_sentence(folder):
    words = ["touchability", "part.stl", "--units", "mm", "--press-depth", "50", *FEW]
    done = run(folder, "-m", "tactile_loc_cli.main", *words)
    assert done.returncode == 2
    assert "--press-depth" in done.stderr
    assert len(done.stderr.strip().splitlines()) <= 2
    assert not (folder / "touchability").exists()


@pytest.mark.slow
def test_the_program_of_the_readme_prints_shares(folder):
    program = find_block(README, "python").replace('"pin"', '"pin", grid={"name": "whole", "directions": 300}')
    (folder / "program.py").write_text(program)
    done = run(folder, "program.py")
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["1", "2", "3"]
