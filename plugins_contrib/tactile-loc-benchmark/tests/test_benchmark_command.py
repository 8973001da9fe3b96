"""`tactile-loc benchmark`."""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from cli_helpers import HANGS_S, assert_refused, command, start_process, succeed
from message_helpers import missing

from tactile_loc_benchmark.files import read_rows

SUITE = """\
name = "tiny"
summary = "A box"
objects = [{path = "brick.obj", units = "mm", symmetry = "none"}]

touches = [1, 2]
examples = 4
seed = 3

[[source]]
name = "sketch"
[[source]]
name = "library-source"
label = "photos"
[[method]]
name = "guess"
"""
TABLES = {"benchmark.json", "benchmark.md", "bop", "leaderboard.json", "report.html", "rows.parquet"}
FILES = {*TABLES, "rows", "workers.log"}


@pytest.fixture(autouse=True)
def suite(tmp_path: Path, box_file: Path) -> Path:
    """A suite of one box, in the working folder."""
    shutil.copy(box_file, tmp_path)
    path = tmp_path / "tiny.toml"
    path.write_text(SUITE)
    return path


@pytest.mark.slow
def test_a_suite_is_run_once_and_written(cli, tmp_path):
    done = succeed(cli("benchmark", "--suite", "tiny.toml", "--workers", 1, "--json"))
    report = json.loads(done.stdout)
    assert (report["suite"], report["jobs"], report["done"], report["failed"]) == ("tiny", 1, 1, 0)
    assert "pip install touch-maker" in report["left_out"]["photos"]
    assert {path.name for path in (tmp_path / "benchmark").iterdir()} == FILES
    again = succeed(cli("benchmark", "--suite", "tiny.toml"))
    lines = again.stdout.splitlines()
    assert not missing(lines[0], "source", "method", "95 % interval")
    assert [line.split()[:3] for line in lines[1:3]] == [["sketch", "1", "guess"], ["sketch", "2", "guess"]]
    assert any(line.startswith("left out: photos: ") for line in lines)
    assert any(line.startswith("1 job, 0 done now") for line in lines)
    for name in TABLES:
        assert name in lines[-1]
    page = (tmp_path / "benchmark" / "report.html").read_text()
    (tmp_path / "benchmark" / "report.html").unlink()
    assert_refused(cli("report", "benchmark"), "tactile-loc benchmark --report --out benchmark")
    succeed(cli("benchmark", "--report", "--json"))
    assert (tmp_path / "benchmark" / "report.html").read_text() == page


@pytest.mark.slow
def test_a_method_of_a_plugin_is_added_and_a_failure_has_exit_code_1(cli, tmp_path):
    words = ["benchmark", "--suite", "tiny.toml", "--workers", 1, "--examples", 2, "--source", "sketch"]
    succeed(cli(*words, "--method", "guess,oracle", "--out", "two"))
    rows = read_table(tmp_path / "two")
    assert {row["method"] for row in rows} == {"guess", "oracle"}
    assert {row["example"] for row in rows} == {0, 1}
    (tmp_path / "tiny.toml").write_text(SUITE.replace('"guess"', '"guess"\nfault = "error"'))
    failed = cli(*words, "--json")
    assert (failed.exit_code, json.loads(failed.stdout)["failed"]) == (1, 1)
    told = cli(*words)
    assert told.exit_code == 1
    assert "failed: guess on brick (sketch): ValueError: nothing works" in told.stdout


def test_the_labels_of_a_suite_are_listed_without_running_it(cli, tmp_path):
    shown = succeed(cli("benchmark", "--suite", "tiny.toml", "--list"))
    assert [line.split() for line in shown.stdout.splitlines()[1:]] == [
        ["source", "sketch", "sketch"],
        ["source", "photos", "library-source"],
        ["method", "guess", "guess"],
    ]
    report = json.loads(cli("benchmark", "--suite", "tiny.toml", "--list", "--source", "sketch", "--json").stdout)
    assert report["sources"] == [{"label": "sketch", "name": "sketch"}]
    assert not (tmp_path / "benchmark").exists()


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        (["--suite", "quik"], ("'quik'", "'quick'")),
        (["--source", "photo,scetch"], ("'scetch'", "sketch")),
        (["--source", "photos"], ("pip install touch-maker",)),
        (["--examples", "0"], ("--examples", "0")),
        (["--scheduler", "tcp://h:1", "--workers", "2"], ("--workers",)),
        (["--scheduler", "nowhere"], ("tcp://",)),
        (["--out", "brick.obj"], ("brick.obj",)),
    ],
)
def test_bad_input_is_one_sentence_before_anything_runs(cli, tmp_path, words, mentioned):
    given = words if "--suite" in words else ["--suite", "tiny.toml", *words]
    assert_refused(cli("benchmark", *given), *mentioned)
    assert not list((tmp_path).glob("benchmark/rows/*"))


def start(tmp_path: Path, out: str) -> subprocess.Popen[str]:
    """Start a benchmark with four jobs of some seconds."""
    line = command("benchmark", "--suite", "tiny.toml", "--workers", "1", "--out", out, "--source", "sketch")
    return start_process(line, tmp_path, tmp_path / "store", start_new_session=True)


def read_table(folder: Path) -> list[dict[str, Any]]:
    rows = read_rows(folder / "rows.parquet")
    return [{name: value for name, value in row.items() if name not in ("seconds", "prepared_s")} for row in rows]


@pytest.mark.slow
def test_a_killed_benchmark_is_resumed_with_the_same_table(tmp_path, suite):
    methods = "".join(f'[[method]]\nname = "guess"\nlabel = "guess {k}"\nsleep_s = 0.1{k}\n' for k in range(4))
    suite.write_text(SUITE.replace('[[method]]\nname = "guess"\n', methods))
    killed = start(tmp_path, "killed")
    end_s = time.monotonic() + HANGS_S
    while not (kept := list(tmp_path.glob("killed/rows/[!.]*.json"))):
        assert killed.poll() is None, killed.communicate()
        assert time.monotonic() < end_s
        time.sleep(0.02)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.communicate()
    assert not (tmp_path / "killed" / "rows.parquet").exists()
    before = {path: path.stat().st_mtime_ns for path in kept}
    for out in ("killed", "whole"):
        process = start(tmp_path, out)
        stdout, stderr = process.communicate(timeout=HANGS_S)
        assert process.returncode == 0, stderr
        if out == "killed":
            assert "4 jobs, " in stdout
            assert "4 jobs, 4 done now" not in stdout
    assert {path: path.stat().st_mtime_ns for path in kept} == before
    assert read_table(tmp_path / "killed") == read_table(tmp_path / "whole")
