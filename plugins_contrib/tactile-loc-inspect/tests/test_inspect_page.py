"""docs/inspect.md, the README and the command: the example runs, and finds its burr."""

import json
import re
from pathlib import Path

import pytest
from cli_helpers import assert_one_error
from page_helpers import list_commands, read_page

from tactile_loc_inspect.inspection import InspectionError

README = Path(__file__).parents[1] / "README.md"


def test_the_example_of_the_page_finds_the_burr(cli):
    page = read_page("inspect.md")
    (program,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(compile(program, "inspect.md", "exec"), {})
    simulate, inspect = [words for words in list_commands(page) if {"simulate", "touches/touches.toml"} & {*words}]
    assert cli(*simulate[1:]).exit_code == 0
    done = cli(*inspect[1:], "--json")
    assert done.exit_code == 1, done.stderr
    found = json.loads(done.stdout)
    assert found["verdict"] == "differs"
    first = found["differences"][0]
    assert first["point_m"] == pytest.approx([24.8e-3, -3.9e-3, -28.9e-3], abs=6e-4)
    assert 1e-4 < first["height_m"] < 4e-4
    for name in ("inspection.json", "inspection.png", "report.html"):
        assert (Path("inspection") / name).stat().st_size > 1000
    assert "differs" in (Path("inspection") / "report.html").read_text()


def test_the_readmes_program_runs(monkeypatch, store_folder, capsys):
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store_folder))
    (program,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    exec(compile(program, "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith("as the model, within ")


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("result", "--touch", "touch.npz"),
        ("result", "--units", "m"),
        ("--touch", "touch.npz"),
        ("none",),
        ("folder",),
        ("folder/touches.toml",),
    ],
)
def test_touches_come_from_one_source_and_need_their_part(cli, words):
    Path("folder").mkdir()
    Path("folder", "touches.toml").write_text("[[touch]]\n")
    done = cli("inspect", *words)
    assert_one_error(done.stderr, done.exit_code)
    said = cli("inspect", *words, "--json")
    assert json.loads(said.stdout)["error"]["kind"] == InspectionError.__name__


def test_an_uncertain_result_needs_a_pose(cli, located_uncertain):
    located_uncertain.save("result")
    done = cli("inspect", "result")
    assert_one_error(done.stderr, done.exit_code, "--pose 1")
    assert not Path("tactile-loc-inspection").exists()
    assert cli("inspect", "result", "--pose", 1).exit_code in (0, 1)
