"""`tactile-loc report`, and `run --report`."""

import re
from pathlib import Path

import pytest
from cli_helpers import TINY, assert_refused, succeed
from message_helpers import missing

PIN = ["--object", "pin", *TINY]


def test_a_run_writes_the_files_for_a_report_at_a_usable_path(cli):
    done = succeed(cli("run", *PIN, "--out", "out"))
    assert sorted(path.name for path in Path("out").iterdir()) == ["result.json", "result.npz", "result.png"]
    done = succeed(cli("report", "out"))
    assert "out/report.html" in done.stdout
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert not missing(page, "pin", "gelslim")
    assert page.endswith("</html>\n")
    Path("file").touch()
    assert_refused(cli("report", "out", "--out", "file/page.html"), "file/page.html")
    assert_refused(cli("report", "out", "--out", "page.pdf"), ".html", "page.pdf")
    assert not Path("page.pdf").exists()
    Path("empty").mkdir()
    assert_refused(cli("report", "empty"), "empty", "recall.json")


@pytest.mark.slow
def test_the_report_option_writes_the_same_report(cli):
    done = succeed(cli("run", *PIN, "--report", "--out", "out"))
    assert "out/report.html" in done.stdout
    assert cli("report", "out/result.json", "--out", "pages/again.html").exit_code == 0
    assert Path("pages/again.html").read_text() == Path("out/report.html").read_text()


def test_the_report_contains_all_touches(cli):
    succeed(cli("simulate", *PIN, "--together", 2, "--seed", 3, "--out", "touches"))
    succeed(cli("run", *PIN, "--touch", "touches/touches.toml", "--report", "--out", "out"))
    page = Path("out/report.html").read_text()
    assert not missing(page, "2 touches")
    assert all(re.search(rf"observed[^<]*\b{name}\b", page) for name in ("touch-0000", "touch-0001"))
