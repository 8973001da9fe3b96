"""Libraries are built part by part: bad meshes, what is kept, interruptions, and equal bytes in any order."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time

import pytest
from library_helpers import FEW, NAMES, flip, read_files
from tactile_loc import TactileLocError
from tactile_loc.commands import WorkerOptions
from tactile_loc.plugin import ConfigError

from tactile_loc_library import building
from tactile_loc_library.building import WAITING, PartJob, build_library, list_meshes, run_here
from tactile_loc_library.library import Library
from tactile_loc_library.record import LibraryError, PlaceGrid

HANGS_S = 600  # generous limit, since a machine may be busy


def refuse(jobs, sources):
    """Run no job, and require that none is missing."""
    assert [sources[job.key].name for job in jobs] == []
    return run_here([], sources)


@pytest.fixture
def sources(meshes):
    return list_meshes([meshes], "mm", "none")


def test_the_library_has_a_row_and_a_record_for_each_mesh(built, meshes):
    library = Library.open(built)
    assert library.names == NAMES
    for k, name in enumerate(NAMES):
        row, record = library.rows[name], library.read(name)
        assert (row.x_mm, row.y_mm, row.z_mm) == pytest.approx((10 + k, 8, 9))
        assert record.object.mesh.extents_m == pytest.approx([0.010 + 1e-3 * k, 0.008, 0.009])
        assert (row.centre_x_m, row.centre_y_m, row.centre_z_m) == record.centre_m
        assert row.source == record.source == f"{name}.stl"
        assert row.places == len(record.patches) == len(record.vectors) == len(record.placements)
    assert not (built / WAITING).exists()


def test_a_second_build_keeps_all_parts(library, sources):
    before = read_files(library.path)
    done = build_library(library.path, sources, FEW, refuse)
    assert (done.made, done.kept) == ((), NAMES)
    assert read_files(library.path) == before


def test_a_changed_mesh_or_option_is_built_again(library, meshes, tmp_path):
    for mesh in meshes.iterdir():
        shutil.copy(mesh, tmp_path)
    shutil.copy(tmp_path / "part-1.stl", tmp_path / "part-0.stl")
    done = build_library(library.path, list_meshes([tmp_path], "mm", "none"), FEW)
    assert (done.made, done.kept) == (("part-0",), NAMES[1:])
    assert done.library.rows["part-0"].x_mm == pytest.approx(11)
    more = PlaceGrid("whole", {"directions": 120})
    asked = list_meshes([tmp_path / "part-0.stl"], "mm", "none")
    done = build_library(library.path, asked, more)
    assert (done.made, done.library.names) == (("part-0",), ("part-0",))
    assert done.library.manifest.grid["options"]["directions"] == 120


def test_a_damaged_part_is_built_again(library, sources, built):
    shard = library.shards[0].folder
    flip(shard / "vectors.npy", -1)  # of the last part
    done = build_library(library.path, sources, FEW)
    assert (done.made, done.kept) == (NAMES[-1:], NAMES[:-1])
    assert not done.library.find_damage()
    assert read_files(library.path) == read_files(built)


def test_bad_meshes_are_named_and_the_others_are_built(sources, meshes, tmp_path):
    (tmp_path / "empty.stl").write_text("solid x\nendsolid x\n")
    (tmp_path / "noise.ply").write_bytes(b"not a mesh")
    done = build_library(tmp_path / "out", list_meshes([tmp_path, meshes / "part-0.stl"], "mm", "none"), FEW)
    assert list(done.failed) == ["empty", "noise"]
    assert "no faces" in done.failed["empty"]
    assert done.library.names == ("part-0",)
    with pytest.raises(LibraryError, match=r"no part could be made; empty: .*no faces"):
        build_library(tmp_path / "none", list_meshes([tmp_path], "mm"), FEW)
    assert not (tmp_path / "none" / "library.json").exists()


def test_an_unexpected_error_fails_one_part(sources, tmp_path, monkeypatch):
    made = building.make_record

    def explode(obj, *rest):
        if obj.name == "part-1":
            raise ZeroDivisionError("by chance")
        return made(obj, *rest)

    monkeypatch.setattr(building, "make_record", explode)
    done = build_library(tmp_path / "out", sources[:2], FEW)
    assert done.failed == {"part-1": "ZeroDivisionError: by chance"}
    assert done.made == ("part-0",)


def test_a_full_disk_ends_the_build_and_leaves_the_library(library, sources, built, monkeypatch):
    """A mesh is not to blame, so the library must not lose parts."""

    def fill(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(building, "replace_file", fill)
    more = PlaceGrid("whole", {"directions": 120})
    with pytest.raises(LibraryError, match="No space left"):
        build_library(library.path, sources, more)
    assert read_files(library.path) == read_files(built)


def test_missing_meshes_and_two_of_one_name_are_refused(meshes, tmp_path):
    (tmp_path / "empty").mkdir()
    for missing in (tmp_path / "none.stl", tmp_path / "empty"):
        with pytest.raises(TactileLocError, match="mesh"):
            list_meshes([missing])
    shutil.copy(meshes / "part-0.stl", tmp_path)
    with pytest.raises(LibraryError, match=r"would both be called part-0; rename"):
        list_meshes([meshes, tmp_path])
    assert len(list_meshes([meshes, meshes / "part-0.stl"])) == 6


def test_other_folders_grids_and_workers_are_refused(sources, tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(LibraryError, match=r"thesis.txt; choose a new folder"):
        build_library(tmp_path, sources, FEW)
    with pytest.raises(ConfigError, match="choose the grid whole"):
        build_library(tmp_path / "out", sources, PlaceGrid("face", {}))
    job = PartJob("0" * 64, tmp_path, FEW)
    with pytest.raises(ConfigError, match="the worker's tactile-loc differs"):
        job.measure(sources[0], None)


def test_a_build_that_was_interrupted_between_parts_continues(sources, built, tmp_path):
    def stop(jobs, sources):
        yield from run_here(jobs[:3], sources)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_library(tmp_path / "out", sources, FEW, stop)
    waiting = tmp_path / "out" / WAITING
    assert len(list(waiting.iterdir())) == 3
    torn = min(waiting.iterdir())
    torn.write_bytes(torn.read_bytes()[:-1])  # as after a power cut

    def count(jobs, sources):
        assert len(jobs) == 4
        return run_here(jobs, sources)

    build_library(tmp_path / "out", sources, FEW, count)
    assert read_files(tmp_path / "out") == read_files(built)


BUILD = """
import os, signal, sys
from tactile_loc_cli.main import app

records = []

def kill_at_the_third(event, arguments):
    if event == "os.rename" and sys.argv[4] in str(arguments[1]):
        records.append(arguments[1])
        if len(records) == 3:
            os.kill(os.getpid(), signal.SIGKILL)

if sys.argv[3] == "killed":
    sys.addaudithook(kill_at_the_third)
app(["library", "build", sys.argv[1], "--out", sys.argv[2], "--units", "mm", "--symmetry", "none",
     "--directions", "100", "--workers", "1"])
"""


@pytest.mark.slow
def test_a_killed_build_continues_with_equal_files(meshes, built, tmp_path):
    command = [sys.executable, "-c", BUILD, str(meshes), str(tmp_path / "out")]
    assert subprocess.run([*command, "killed", WAITING], timeout=HANGS_S).returncode == -signal.SIGKILL
    assert len(list((tmp_path / "out" / WAITING).glob("[!.]*"))) == 2
    assert not (tmp_path / "out" / "library.json").exists()
    assert subprocess.run([*command, "continued", WAITING], timeout=HANGS_S).returncode == 0
    assert read_files(tmp_path / "out") == read_files(built)


@pytest.mark.slow
def test_two_local_workers_give_equal_files(sources, built, tmp_path):
    out = tmp_path / "out"
    build_library(out, sources, FEW, WorkerOptions(2).choose(out / WAITING).run_jobs)
    assert read_files(out) == read_files(built)


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_costs_only_time(sources, built, tmp_path):
    from distributed import LocalCluster

    out = tmp_path / "out"
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False}
    ) as cluster:
        victim = cluster.workers[0]

        def kill() -> None:
            limit_s = time.monotonic() + HANGS_S
            while not list((out / WAITING).glob("[!.]*")) and time.monotonic() < limit_s:
                time.sleep(0.005)
            os.kill(victim.pid, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        done = build_library(out, sources, FEW, WorkerOptions(scheduler=cluster.scheduler_address).choose(out).run_jobs)
        killer.join()
    assert (done.made, done.failed) == (NAMES, {})
    assert read_files(out) == read_files(built)
