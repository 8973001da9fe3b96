"""`tactile-loc live`: one line per frame, a web page while it runs, and one sentence if the source fails."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from urllib.request import urlopen

import numpy as np
import pytest
from cli_helpers import HANGS_S, TINY, assert_refused, command, start_process, succeed
from message_helpers import missing

from tactile_loc.io.streams import frame_sources

LOCATED = ["--object", "pin", *TINY, "-o", "temperature=0.001"]
WITH_POSE = {"certain", "ambiguous", "poor fit", "not found"}  # the grid is too coarse to expect one of them
NOTHING = np.full((200, 200), 0.002, np.float32)


@pytest.fixture(scope="module")
def touches(tmp_path_factory, store) -> Path:
    """A folder of three simulated touches with their overview, one touch without contact, and one of the wrong size."""
    folder = tmp_path_factory.mktemp("touches")
    line = command("simulate", "--object", "pin", *TINY, "--count", "3", "--seed", "1", "--out", folder)
    subprocess.run(line, check=True, env={**os.environ, "TACTILE_LOC_STORE": str(store)}, timeout=HANGS_S)
    np.savez(folder / "touch-no.npz", depth=NOTHING, unit="m", press_depth=0.001)
    np.savez(folder / "touch-strange.npz", depth=NOTHING[:50], unit="m", press_depth=0.001)
    for k, name in enumerate(sorted(folder.iterdir())):
        os.utime(name, (k, k))
    return folder


def records(path: Path | str) -> list[dict]:
    return [json.loads(line) for line in Path(path).read_text().splitlines()]


def test_every_frame_of_a_folder_gives_a_line(cli, touches):
    words = ["live", touches, *LOCATED, "--once", "--no-view", "--out", "found.jsonl"]
    done = succeed(cli(*words))
    counts = re.findall(r"(\d+) (certain|ambiguous|poor fit|not found)", done.stdout)
    assert sum(int(n) for n, _ in counts) == 3
    assert ("no pose is certain" in done.stderr) == ("certain" not in dict(map(reversed, counts)))
    assert not missing(done.stdout, "5 frames", "1 refused", "0 dropped")
    assert re.search(r"\b1 \w+ contact", done.stdout)
    assert not missing(done.stdout, "touch-strange.npz", "50 x 200")
    found = records("found.jsonl")
    assert [record["verdict"] for record in found[3:]] == ["no contact", None]
    assert {record["verdict"] for record in found[:3]} <= WITH_POSE
    for record in found[:3]:
        touch = np.load(touches / record["name"])
        off_m = np.linalg.norm(np.array(record["T_sensor_object"])[:3, 3] - touch["T_sensor_object"][:3, 3])
        assert record["probability"] > 0
        assert off_m < 0.05
    done = cli(*words, "--json")
    said = json.loads(done.stdout)
    assert said["located"] == said["certain"] + said["ambiguous"] + said["poor_fit"] == 3 - said["not_found"]
    assert len(records("found.jsonl")) == 10  # appended


def test_refusing_all_frames_is_an_error(cli, touches):
    Path("in").mkdir()
    shutil.copy(touches / "touch-strange.npz", "in")
    done = cli("live", "in", *LOCATED, "--once", "--no-view", "--out", "found.jsonl")
    assert done.exit_code == 2
    assert not missing(done.stdout, "1 frame: 1 refused")
    assert "touch-strange.npz" in done.stderr
    assert [record["verdict"] for record in records("found.jsonl")] == [None]


def test_a_vanished_folder_is_one_sentence_and_keeps_the_lines(cli, touches, monkeypatch):
    shutil.copytree(touches, "in")
    monkeypatch.setattr(frame_sources.time, "sleep", lambda _: shutil.rmtree("in"))
    done = cli("live", "in", *LOCATED, "--no-view", "--out", "found.jsonl")
    assert_refused(done, "in ", "No such file")
    assert [record["number"] for record in records("found.jsonl")] == [4]
    assert records("found.jsonl")[0]["dropped"] == 4


def test_a_disconnected_camera_is_one_sentence(cli, touches, monkeypatch):
    reads = iter([(True, np.zeros((200, 200, 3), np.uint8)), (False, None)])
    camera = SimpleNamespace(isOpened=lambda: True, read=lambda: next(reads), release=lambda: None, get=lambda _: 0.0)
    monkeypatch.setattr("cv2.VideoCapture", lambda device: camera)
    done = cli("live", "--camera", "0", *LOCATED, "--no-view", "--out", "found.jsonl")
    assert_refused(done, "camera 0", "1")
    assert records("found.jsonl")[0]["verdict"] is None
    assert "`sensor`" in records("found.jsonl")[0]["says"]


def test_bad_input_is_one_sentence(cli, touches):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        for words, mentioned in (
            ([], "--camera"),
            ([touches, "--camera", "0"], "--camera"),
            (["--camera", "0", "--once"], "--once"),
            (["nowhere"], "nowhere"),
            ([touches, "--out", "found.csv"], "found.csv"),
            ([touches, "--port", port], f"port {port}"),
            ([touches, "--sensor", "gelslam"], "gelslam"),
        ):
            assert_refused(cli("live", *words, *LOCATED), mentioned)
    assert list(Path().iterdir()) == []


@pytest.fixture
def going(touches, tmp_path, store) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Return a function that starts the command in a separate process; the fixture ends it after the test."""
    started: list[subprocess.Popen[str]] = []

    def start(*words: object) -> subprocess.Popen[str]:
        started.append(start_process(command("live", *words, *LOCATED), tmp_path, store))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def wait_for_lines(path: Path, count: int) -> None:
    ends_s = time.monotonic() + HANGS_S
    while not path.exists() or path.read_text().count("\n") < count:
        assert time.monotonic() < ends_s
        time.sleep(0.05)


@pytest.mark.slow
def test_live_shows_new_frames_until_ctrl_c(going, touches, tmp_path):
    (folder := tmp_path / "in").mkdir()
    live = going(folder, "--port", "0", "--out", "found.jsonl")
    url = live.stdout.readline().split("view: ")[1].strip()
    with urlopen(f"{url}events", timeout=HANGS_S) as stream:
        for k, name in enumerate(("touch-0000.npz", "touch-no.npz"), 1):
            shutil.copy(touches / name, folder)
            state = json.loads(stream.readline().removeprefix(b"data: "))
            assert stream.readline() == b"\n"
            assert state["number"] == k - 1
            assert bool(state["T"]) == (k == 1)
            wait_for_lines(tmp_path / "found.jsonl", k)
        live.send_signal(signal.SIGINT)
        assert stream.read() == b"event: end\ndata: {}\n\n"
    out, err = live.communicate(timeout=HANGS_S)
    assert live.returncode == 0
    assert all(line.startswith("warning: ") for line in err.splitlines()), err
    assert sum(map(int, re.findall(r"(\d+) (?:certain|ambiguous|poor fit)", out))) == 1
    assert not missing(out, "2 frames", "0 dropped")
    assert re.search(r"\b1 \w+ contact", out)
    first, second = (record["verdict"] for record in records(tmp_path / "found.jsonl"))
    assert first in WITH_POSE
    assert second == "no contact"


@pytest.mark.slow
def test_a_rerun_file_is_written_beside_the_lines(cli, touches):
    pytest.importorskip("rerun", reason="rerun is not installed")
    words = ["live", touches, *LOCATED, "--once", "--no-view"]
    done = succeed(cli(*words, "--rerun", "found.rrd"))
    assert "found.rrd" in done.stdout
    verify = [sys.executable, "-m", "rerun", "rrd", "verify", "found.rrd"]
    assert subprocess.run(verify, timeout=HANGS_S).returncode == 0
    assert_refused(cli(*words, "--rerun", "found.txt"), ".rrd", "found.txt")
