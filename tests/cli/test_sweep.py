"""`tactile-loc sweep`."""

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from cli_helpers import FLAT_SENSOR, assert_refused, command, start_process, succeed, write_box
from message_helpers import missing

psutil = pytest.importorskip("psutil")  # a dependency of distributed

PLAN = """\
sensor = "flat.toml"
object = ["pin", "head"]
refiner = ["none", {name = "icp", max_iterations = 5}]
count = 2
shape_px = 32
temperature = 0.01
option.grid.spacing_mm = 8
"""
COLUMNS = ["object", "sensor", "renderer", "grid", "encoder", "matcher", "refiner", "fuser", "noise", "seed", "state"]
TABLES = {"sweep.csv", "sweep.md", "sweep.json", "differences.csv", "touches.csv"}
FILES = TABLES | {"rows", "workers.log"}


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    """A plan file in the working folder."""
    (tmp_path / "flat.toml").write_text(FLAT_SENSOR)
    path = tmp_path / "sweep.toml"
    path.write_text(PLAN)
    return path


@pytest.mark.slow
def test_a_plan_is_evaluated_once_and_written(cli, plan, tmp_path):
    done = succeed(cli("sweep", "sweep.toml", "--workers", 1, "--json"))
    report = json.loads(done.stdout)
    assert (report["combinations"], report["evaluated"], report["failed"]) == (4, 4, 0)
    assert report["built"]["evaluation"] == 4
    assert {path.name for path in (tmp_path / "sweep").iterdir()} == FILES
    again = succeed(cli("sweep", "sweep.toml", "--line", "reg-1"))
    lines = again.stdout.splitlines()
    assert not missing(lines[0], "reg-1", "mm", "strong")
    assert lines[1].split() == ["components", "pin", "head"]
    assert any(re.match(r"4 combinations\b.*\b0\b.*\b4\b", line) for line in lines)
    for name in FILES - {"rows", "workers.log"}:
        assert name in lines[-1]


def test_the_command_line_overrides_the_plan(cli, plan):
    words = ["--object", "pin", "--refiner", "none,render", "--refiner", "icp", "--seed", "0,1", "--noise", "none,mild"]
    done = succeed(cli("sweep", "sweep.toml", *words, "-o", "encoder.cells=9,12", "--dry-run", "--json"))
    report = json.loads(done.stdout)
    assert (len(report["combinations"]), report["count"]) == (3 * 2 * 2 * 2, 2)
    first = ["pin", "file", "heightmap", "face", "pixel cells=9", "dense", "none", "product", "none", "0", "to do"]
    assert report["combinations"][0] == dict(zip(COLUMNS, first, strict=True))
    assert {one["refiner"] for one in report["combinations"]} == {"none", "render", "icp"}


def test_a_dry_run_lists_combinations_without_running_them(cli, plan, tmp_path):
    done = succeed(cli("sweep", "sweep.toml", "--dry-run", "--store", "fresh"))
    lines = done.stdout.splitlines()
    assert lines[0].split() == COLUMNS
    assert " ".join(lines[1].split()) == "pin file heightmap face pixel dense none product strong 0 to do"
    assert any(re.match(r"4 combinations\b.*\b2 touches\b.*\b4\b", line) for line in lines)
    assert {path.name for path in tmp_path.iterdir()} == {"flat.toml", "sweep.toml"}


def test_units_apply_to_mesh_files(cli, plan, tmp_path):
    write_box(tmp_path / "part.obj")
    done = succeed(cli("sweep", "sweep.toml", "--object", "part.obj,pin", "--units", "mm", "--dry-run", "--json"))
    assert [one["object"] for one in json.loads(done.stdout)["combinations"]] == ["part", "part", "pin", "pin"]


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        ([], ("plan",)),
        (["none.toml"], ("none.toml",)),
        (["bad.toml"], ("bad.toml", "'refinr'", "'refiner'")),
        (["--object", "pin,hok"], ("hok",)),
        (["--object", "pin", "--count", "0"], ("--count",)),
        (["--object", "pin", "--line", "best1"], ("best-1",)),
        (["--object", "pin", "--out", "file"], ("--out",)),
        (["--object", "pin,head", "--symmetry", "none"], ("--symmetry",)),
        (["--object", "pin", "--scheduler", "tcp://h:1", "--workers", "2"], ("--workers",)),
        (["--object", "pin", "--scheduler", "tcp://h:1", "--threads", "2"], ("--threads",)),
        (["--object", "pin", "--scheduler", "nowhere"], ("tcp://",)),
    ],
)
def test_bad_input_is_one_sentence_before_anything_runs(cli, tmp_path, words, mentioned):
    (tmp_path / "file").touch()
    (tmp_path / "bad.toml").write_text('refinr = "icp"\n')
    assert_refused(cli("sweep", *words), *mentioned)
    assert not (tmp_path / "sweep").exists()


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        (["--seed", "-1"], "--seed cannot be -1"),
        (["--seed", "x"], "--seed cannot be 'x'"),
        (["--refiner", "ipc"], "'ipc'"),
        (["--noise", "loud"], "'loud'"),
        (["-o", "grid.spacing=3"], "'spacing'"),
    ],
)
def test_an_error_in_an_option_beside_a_plan_does_not_name_the_file(cli, plan, words, mentioned):
    done = cli("sweep", plan.name, *words, "--dry-run")
    assert_refused(done, mentioned)
    assert plan.name not in done.stderr


@pytest.mark.slow
def test_failures_are_counted_and_the_exit_code_is_1(cli, plan, tmp_path):
    plan.write_text(PLAN.replace("8\n", "8\noption.grid.min_contact_percent = [2, 100]\n"))  # nothing has 100 %
    words = ["sweep", "sweep.toml", "--object", "pin", "--workers", 1]
    done = cli(*words)
    assert done.exit_code == 1
    assert not missing(done.stderr.splitlines()[-1], "failed", "2 of 4", "sweep/sweep.md")
    assert "failed" in done.stdout
    told = (tmp_path / "sweep" / "sweep.md").read_text()
    assert len(re.findall(r"^- .*\bgrid\.min_contact_percent\b", told, re.MULTILINE)) == 2
    as_json = cli(*words, "--json")
    assert (as_json.exit_code, json.loads(as_json.stdout)["failed"]) == (1, 2)


HANGING_S = 600


def finished(out: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in out.glob("rows/[!.]*.json")}


SIXTEEN = ["sweep", "sweep.toml", "--encoder", "pixel", "-o", "encoder.cells=9,10,11,12"]


def start(tmp_path: Path, store: Path) -> subprocess.Popen[str]:
    """Start a sweep that reacts to Ctrl-C as in a terminal."""
    line = command(*SIXTEEN, "--workers", "2")
    return start_process(line, tmp_path, store, start_new_session=True)


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    """The process ids of a sweep's workers, without the resource tracker of multiprocessing."""
    children = psutil.Process(process.pid).children()
    return [child.pid for child in children if any("multiprocessing.spawn" in word for word in child.cmdline())]


def wait_for(process: subprocess.Popen[str], reached: Callable[[], bool]) -> None:
    """Wait until `reached` returns True while a process runs; the time limit only prevents hangs."""
    end_s = time.monotonic() + HANGING_S
    while not reached():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end_s
        time.sleep(0.02)


@pytest.mark.slow
def test_an_interrupted_sweep_ends_its_workers_and_is_resumed(cli, plan, tmp_path):
    process = start(tmp_path, tmp_path / "store")
    out = tmp_path / "sweep"
    wait_for(process, lambda: len(finished(out)) >= 2)
    workers = workers_of(process)
    os.killpg(process.pid, signal.SIGINT)  # the whole group, as a terminal does
    _, stderr = process.communicate(timeout=HANGING_S)
    assert process.returncode == 130, stderr
    assert re.fullmatch(r"(note: sweep: \d+ of 16 .*\n)*interrupted\b.*\n", stderr)  # notes if it takes long
    assert len(workers) == 2
    assert not [pid for pid in workers if _runs(pid)]
    before = finished(out)
    assert 2 <= len(before) < 16
    assert not (out / "sweep.csv").exists()
    resumed = succeed(cli(*SIXTEEN, "--workers", 1, "--store", tmp_path / "store", "--json"))
    report = json.loads(resumed.stdout)
    # A worker may have stored an evaluation and ended before it wrote the row.
    assert (report["combinations"], report["evaluated"] + report["stored"]) == (16, 16 - len(before))
    assert report["stored"] <= len(workers)
    assert {name: time_ns for name, time_ns in finished(out).items() if name in before} == before


@pytest.mark.slow
def test_workers_end_when_their_parent_is_killed(plan, tmp_path):
    process = start(tmp_path, tmp_path / "store")
    wait_for(process, lambda: len(finished(tmp_path / "sweep")) > 0)
    workers = workers_of(process)
    process.kill()
    process.communicate()
    assert len(workers) == 2
    end_s = time.monotonic() + HANGING_S
    while any(_runs(pid) for pid in workers) and time.monotonic() < end_s:
        time.sleep(0.1)
    assert not [pid for pid in workers if _runs(pid)]


def _runs(pid: int) -> bool:
    """Return whether a process runs; zombies do not count."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
