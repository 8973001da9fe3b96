"""Interruptions, several processes at once, full disks and damaged stores."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from cli_helpers import HANGS_S, TINY, assert_one_error, assert_refused, start_process

# `tactile-loc build` with small shards; it prints a line and waits at the point that its first argument names
BUILD = """
import signal, sys
from tactile_loc.locate.sources import listed_grid as model
from tactile_loc.locate.probability import temperature
from tactile_loc.store.workspace import Workspace
from tactile_loc_cli.main import main

model.SHARD, temperature.TOUCHES = 50, 15
save, stop = Workspace.save_array, sys.argv.pop(1)

def save_and_stop(self, name, *arguments, **options):
    save(self, name, *arguments, **options)
    if name == "depth-00000-enough":
        print("a shard is saved", flush=True)
        signal.pause()

if stop == "first shard":
    Workspace.save_array = save_and_stop
if stop == "start":
    print("ready", flush=True)
    sys.stdin.readline()
main()
"""


def start(tmp_path: Path, store: Path, stop: str = "nowhere") -> subprocess.Popen[str]:
    """Start a build that reacts to Ctrl-C as in a terminal."""
    return start_process([sys.executable, "-c", BUILD, stop, "build", *TINY], tmp_path, store, stdin=subprocess.PIPE)


def ended(process: subprocess.Popen[str], code: int) -> tuple[str, str]:
    """Wait for a process, require its exit code, and return its output."""
    stdout, stderr = process.communicate(timeout=HANGS_S)
    assert process.returncode == code, stderr
    return stdout, stderr


def contents(store: Path) -> dict[str, dict[str, str]]:
    """The checksums of every artifact's files."""
    manifests = store.glob("*/*/manifest.json")
    return {f"{m.parent.parent.name}/{m.parent.name}": json.loads(m.read_text())["files"] for m in manifests}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """Return the store after an undisturbed build."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    ended(start(folder, folder / "store"), 0)
    return contents(folder / "store")


@pytest.mark.slow
def test_an_interrupted_build_is_resumed_with_the_same_result(tmp_path, uninterrupted):
    store = tmp_path / "store"
    process = start(tmp_path, store, "first shard")
    assert process.stdout.readline() == "a shard is saved\n"
    process.send_signal(signal.SIGINT)
    _, stderr = ended(process, 130)
    assert "interrupted" in stderr
    assert "Traceback" not in stderr
    assert not list(store.glob("bank/*/manifest.json"))
    (first_shard,) = store.glob("shapes/*.partial/depth-00000.npz")
    kept = first_shard.stat()
    ended(start(tmp_path, store), 0)
    assert contents(store) == uninterrupted
    (shard,) = store.glob("shapes/*/depth-00000.npz")
    assert (shard.stat().st_ino, shard.stat().st_mtime_ns) == (kept.st_ino, kept.st_mtime_ns)  # not rendered again
    assert len(list(shard.parent.glob("depth-*.npz"))) > 2


@pytest.mark.slow
def test_two_concurrent_builds_share_the_work(tmp_path, uninterrupted):
    store = tmp_path / "store"
    processes = [start(tmp_path, store, "start") for _ in range(2)]
    assert [process.stdout.readline() for process in processes] == ["ready\n", "ready\n"]
    for process in processes:
        process.stdin.write("go on\n")
        process.stdin.flush()
    outputs = [ended(process, 0) for process in processes]
    assert contents(store) == uninterrupted
    for stage in ("grid", "shapes"):  # there are several banks, and each process may build some
        found = [re.findall(rf"^{stage} \(.*\): (built|reused)$", stdout, re.MULTILINE) for stdout, _ in outputs]
        assert sorted(found) == [["built"], ["reused"]]


def test_a_full_disk_is_reported_without_damaged_files(cli, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)], capture_output=True).returncode:
        pytest.skip("needs the right to mount a small disk")
    try:
        assert_refused(cli("run", *TINY, "--store", disk / "store", "--out", "out"), "full")
        assert not Path("out").exists()
        result = cli("run", *TINY, "--out", disk / "out")
        assert_refused(result, "--out")
        left = [path.name for path in (disk / "out").iterdir()] if (disk / "out").exists() else []
        assert left in ([], ["result.json"], ["result.png"])
        for name in left:
            assert name != "result.json" or json.loads((disk / "out" / name).read_text())
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


@pytest.mark.slow
def test_a_failed_write_keeps_the_old_results(cli, monkeypatch):
    assert cli("run", *TINY, "--out", "out").exit_code == 0
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    result = cli("run", *TINY, "--out", "out", "--seed", "5")
    assert_one_error(result.stderr, result.exit_code, "No space left on device")
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
