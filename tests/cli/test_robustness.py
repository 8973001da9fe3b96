"""Interruptions, several processes at once, full disks and damaged stores."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import TINY, assert_one_error, assert_refused, command

SLOW = ["--renderer", "raycast", "-o", "grid.spacing_mm=4"]  # long enough to be interrupted


def start(tmp_path: Path, store: Path, *words: str) -> subprocess.Popen[str]:
    """Start a build as in a terminal: a shell's background jobs, these tests among them, would ignore Ctrl-C."""
    return subprocess.Popen(
        command("build", *words), cwd=tmp_path, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "TACTILE_LOC_STORE": str(store)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


def wait_for(store: Path, pattern: str, seconds: float = 60) -> Path:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = sorted(store.glob(pattern))
        if found:
            return found[0]
        time.sleep(0.002)
    raise AssertionError(f"no {pattern} within {seconds} s")


def contents(store: Path) -> dict[str, dict[str, str]]:
    """The checksums of every artifact's files."""
    manifests = store.glob("*/*/manifest.json")
    return {f"{m.parent.parent.name}/{m.parent.name}": json.loads(m.read_text())["files"] for m in manifests}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """What a build leaves when nobody disturbs it."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    process = start(folder, folder / "store", *SLOW)
    assert process.wait(120) == 0
    process.communicate()
    return contents(folder / "store")


def test_an_interrupted_build_is_resumed_and_ends_alike(tmp_path, uninterrupted):
    store = tmp_path / "store"
    process = start(tmp_path, store, *SLOW)
    first_shard = wait_for(store, "shapes/*.partial/depth-00000-enough.npy")
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    assert "what was finished is kept" in stderr
    assert "Traceback" not in stderr
    assert not list(store.glob("bank/*/manifest.json"))
    kept = (first_shard.parent / "depth-00000.npy").stat()
    resumed = start(tmp_path, store, *SLOW)
    assert resumed.wait(120) == 0
    resumed.communicate()
    assert contents(store) == uninterrupted
    (shard,) = store.glob("shapes/*/depth-00000.npy")
    assert (shard.stat().st_ino, shard.stat().st_mtime_ns) == (kept.st_ino, kept.st_mtime_ns)  # not rendered again


def test_two_processes_build_the_same_object_at_once(tmp_path, uninterrupted):
    store = tmp_path / "store"
    processes = [start(tmp_path, store, *SLOW) for _ in range(2)]
    outputs = [process.communicate(timeout=120) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], outputs
    assert contents(store) == uninterrupted
    for stage in ("grid", "shapes", "bank"):
        words = sorted(line for stdout, _ in outputs for line in stdout.splitlines() if line.startswith(f"{stage}: "))
        assert [w for w in words if "poses" not in w] == [f"{stage}: built", f"{stage}: reused"]


def test_a_truncated_artifact_is_rebuilt(cli, tmp_path):
    store = tmp_path / "store"
    assert cli("run", *TINY, "--store", store, "--out", "first").exit_code == 0
    for bank in store.glob("bank/*/bank.npy"):
        bank.chmod(0o644)
        bank.write_bytes(bank.read_bytes()[:100])
    again = cli("run", *TINY, "--store", store, "--out", "second")
    assert again.exit_code == 0, again.stderr
    assert again.stderr.startswith("warning: ")
    first, second = (json.loads(Path(out, "result.json").read_text())["hypotheses"] for out in ("first", "second"))
    assert [h["probability"] for h in first] == [h["probability"] for h in second]
    poses = [np.array([h["T_sensor_object"] for h in hypotheses]) for hypotheses in (first, second)]
    assert poses[0] == pytest.approx(poses[1], abs=1e-8)  # threads add up in any order


def test_a_full_disk_under_the_store(cli, tmp_path):
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


def test_results_that_cannot_be_written_leave_the_old_ones(cli, monkeypatch):
    assert cli("run", *TINY, "--out", "out").exit_code == 0
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    result = cli("run", *TINY, "--out", "out", "--seed", "5")
    assert_one_error(result.stderr, result.exit_code, "No space left on device")
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
