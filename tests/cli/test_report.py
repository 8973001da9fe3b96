"""`tactile-loc report`, and `run --report`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import TINY, assert_refused

PIN = ["--object", "pin", *TINY]


def test_a_run_leaves_what_a_report_needs(cli):
    done = cli("run", *PIN, "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert sorted(path.name for path in Path("out").iterdir()) == ["result.json", "result.npz", "result.png"]
    done = cli("report", "out")
    assert done.exit_code == 0, done.stderr
    assert "written: out/report.html" in done.stdout
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert "pin on gelslim" in page
    assert page.endswith("</html>\n")


def test_a_run_makes_its_report_itself(cli):
    done = cli("run", *PIN, "--report", "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert "out/report.html" in done.stdout
    assert cli("report", "out/result.json", "--out", "pages/again.html").exit_code == 0
    assert Path("pages/again.html").read_text() == Path("out/report.html").read_text()


def test_several_touches_are_all_in_the_report(cli):
    assert cli("simulate", *PIN, "--count", 2, "--seed", 3, "--out", "touches").exit_code == 0
    poses = json.loads(Path("touches/poses.json").read_text())["T_sensor_object"]
    text = ""
    for name, T in poses.items():
        text += f'[[touch]]\npath = "touches/{name}.npz"\nT_base_sensor = {np.linalg.inv(T).tolist()}\n'
    Path("touches.toml").write_text(text)
    done = cli("run", *PIN, "--touch", "touches.toml", "--report", "--out", "out")
    assert done.exit_code == 0, done.stderr
    page = Path("out/report.html").read_text()
    assert "2 touches at once" in page
    assert all(f"observed contact shape: {name}" in page for name in poses)


def test_an_evaluation_has_a_report(cli):
    done = cli("evaluate", *PIN, "--count", 3, "--out", "evaluation")
    assert done.exit_code == 0, done.stderr
    assert cli("report", "evaluation").exit_code == 0
    assert "3 simulated touches of each object" in Path("evaluation/report.html").read_text()
    done = cli("evaluate", *PIN, "--count", 3, "--contacts", "1,2", "--out", "contacts")
    assert done.exit_code == 0, done.stderr
    assert cli("report", "contacts").exit_code == 0
    assert "2 contacts" in Path("contacts/report.html").read_text()


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ([], "holds no result"),
        (["result.json"], "no JSON"),
        (["result.json", "results.json"], "several results"),
    ],
)
def test_what_is_no_result_is_one_sentence(cli, files, says):
    Path("out").mkdir()
    for name in files:
        Path("out", name).write_text("")
    assert_refused(cli("report", "out"), "out", says)
    assert not Path("out/report.html").exists()


def test_a_folder_of_touches_and_a_report_do_not_go_together(cli):
    Path("touches").mkdir()
    assert_refused(cli("run", *PIN, "--touch", "touches", "--report"), "--report", "folder of touches")


def test_a_place_that_refuses_is_one_sentence(cli):
    assert cli("run", *PIN, "--out", "out").exit_code == 0
    Path("file").touch()
    assert_refused(cli("report", "out", "--out", "file/page.html"), "file/page.html", "cannot be written")
    assert_refused(cli("report", "out", "--out", "page.pdf"), "written as .html, not as page.pdf")
    assert not Path("page.pdf").exists()
