"""Threads share the parts of a range, compiled code is reused, and errors in threads are raised."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from numba import config

from tactile_loc.core.runtime.compiled import count_threads, map_in_threads, njit, run_in_threads


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 2, 7, 100])
def test_every_item_is_processed_once(monkeypatch, count, threads):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", threads)
    done = np.zeros(count, int)

    def kernel(first, last, step):
        done[first:last] += step

    run_in_threads(kernel, count, 3)
    assert (done == 3).all()


def test_threads_run_at_the_same_time(monkeypatch):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 3)
    together = threading.Barrier(3, timeout=60)
    met = set()

    def kernel(first, last):
        if threading.get_ident() not in met:
            met.add(threading.get_ident())
            together.wait()

    run_in_threads(kernel, 12)
    assert len(met) == 3


def test_an_error_in_another_thread_is_raised(monkeypatch):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 2)
    caller = threading.get_ident()
    begun = threading.Event()

    def kernel(first, last):
        if threading.get_ident() == caller:
            begun.wait(60)
        else:
            begun.set()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_in_threads(kernel, 4)


def test_threaded_calls_may_be_nested(monkeypatch):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 2)
    done = np.zeros((4, 4), int)

    def inner(first, last, row):
        done[row, first:last] += 1

    def outer(first, last):
        for row in range(first, last):
            run_in_threads(inner, 4, row)

    run_in_threads(outer, 4)
    assert (done == 1).all()


FILES = {
    "pairs": """
from typing import NamedTuple

class {pair}(NamedTuple):
    a: float
    b: float
""",
    "constants": """
OFFSET = {offset}.0
""",
    "called": """
from constants import OFFSET
from tactile_loc.core.runtime.compiled import njit

@njit
def helper(pair):
    return pair.a * {factor}.0 + pair.b + OFFSET
""",
    "calling": """
from called import helper
from tactile_loc.core.runtime.compiled import njit

@njit
def kernel(pair):
    return later(pair)

@njit
def later(pair):
    return helper(pair)
""",
    "main": """
import calling, pairs
value = calling.kernel(pairs.{pair}(3.0, 1.0))
hits = sum(calling.kernel.stats.cache_hits.values()) if hasattr(calling.kernel, "stats") else None
print(value, hits)
""",
}


def start(folder, environment=None, **values):
    """Start a kernel that calls a function of another file; its constant and argument type are in two more files."""
    for name, text in FILES.items():
        path = folder / f"{name}.py"
        text = text.format(**{"pair": "Pair", "factor": 2, "offset": 0, **values})
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
    command = [sys.executable, "main.py"]
    # Python's own byte code is not renewed if a source changes within a second and keeps its size
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **(environment or {})}
    return subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def finish(process):
    """Return the kernel's result and its number of cache hits."""
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out.split()


def run(folder, environment=None, **values):
    return finish(start(folder, environment, **values))


def folders(root):
    """Return the folders of compiled code of calling.py."""
    return [path for path in root.rglob("calling.*") if path.is_dir()]


@pytest.mark.slow
def test_compiled_code_is_reused_until_a_source_changes(tmp_path):
    assert run(tmp_path) == ["7.0", "0"]
    assert run(tmp_path) == ["7.0", "1"]
    assert run(tmp_path, factor=4) == ["13.0", "0"]  # an indirectly called function in another file changed
    assert run(tmp_path, factor=4, offset=1) == ["14.0", "0"]  # a constant in a third file changed
    assert len(folders(tmp_path)) == 2  # only two of the three versions are kept
    assert run(tmp_path, factor=4) == ["13.0", "1"]  # the previous version again


@pytest.mark.slow
def test_an_index_with_a_removed_class_is_ignored(tmp_path):
    assert run(tmp_path, pair="Pair") == ["7.0", "0"]
    assert run(tmp_path, pair="Two") == ["7.0", "0"]
    assert run(tmp_path, pair="Two") == ["7.0", "1"]


@pytest.mark.slow
def test_reordered_class_fields_require_compilation(tmp_path):
    assert run(tmp_path) == ["7.0", "0"]
    swapped = "from typing import NamedTuple\nclass Pair(NamedTuple):\n    b: float\n    a: float\n"
    (tmp_path / "pairs.py").write_text(swapped)
    done = subprocess.run([sys.executable, "main.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["5.0", "0"]


@pytest.mark.slow
def test_truncated_compiled_code_is_compiled_again(tmp_path):
    assert run(tmp_path) == ["7.0", "0"]
    for suffix, left in (("nbi", -5), ("nbi", 0), ("nbc", -5)):
        for path in tmp_path.rglob(f"*.{suffix}"):
            path.write_bytes(path.read_bytes()[:left])
        assert run(tmp_path) == ["7.0", "0"]
    assert run(tmp_path) == ["7.0", "1"]


@pytest.mark.slow
def test_several_processes_can_compile_at_the_same_time(tmp_path):
    assert [finish(one)[0] for one in [start(tmp_path) for _ in range(3)]] == ["7.0"] * 3
    assert run(tmp_path) == ["7.0", "1"]


@pytest.mark.slow
def test_the_user_cache_is_used_beside_read_only_sources(tmp_path):
    (source := tmp_path / "source").mkdir()
    (source / "__pycache__").touch()  # no folder can be made there, not even by root
    environment = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    assert run(source, environment) == ["7.0", "0"]
    assert run(source, environment) == ["7.0", "1"]
    assert len(folders(tmp_path / "cache")) == 1
    (tmp_path / "file").touch()
    process = start(source, {"XDG_CACHE_HOME": str(tmp_path / "file")})
    assert process.communicate()[1].count("set NUMBA_CACHE_DIR to a folder") == 2, "one warning per file"
    assert process.returncode == 0


@pytest.mark.slow
def test_numba_settings_are_respected(tmp_path):
    (source := tmp_path / "source").mkdir()
    assert run(source, {"NUMBA_DISABLE_JIT": "1", "NUMBA_CACHE_DIR": str(tmp_path / "chosen")}) == ["7.0", "None"]
    assert not (tmp_path / "chosen").exists()
    assert run(source, {"NUMBA_CACHE_DIR": str(tmp_path / "chosen")}) == ["7.0", "0"]
    assert run(source, {"NUMBA_CACHE_DIR": str(tmp_path / "chosen")}) == ["7.0", "1"]
    assert folders(tmp_path / "chosen")
    assert not folders(source)


def test_the_cache_folder_of_other_functions_is_unchanged():
    before = config.CACHE_DIR
    njit(lambda x: x + 1)
    assert before == config.CACHE_DIR


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 7, 100])
def test_items_are_processed_in_order(monkeypatch, count, threads):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", threads)
    assert list(map_in_threads(lambda item: item**2, range(count))) == [item**2 for item in range(count)]


def test_items_are_processed_at_the_same_time_each_by_one_thread(monkeypatch):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 3)
    together = threading.Barrier(3, timeout=60)

    def meet(item):
        together.wait()
        return count_threads(), threading.get_ident()

    found = list(map_in_threads(meet, range(3)))
    assert [threads for threads, _ in found] == [1, 1, 1]
    assert len({thread for _, thread in found}) == 3
    assert count_threads() == 3


def test_few_items_are_taken_in_advance(monkeypatch):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 2)
    taken = []
    results = map_in_threads(lambda item: item, (taken.append(item) or item for item in range(1000)))
    assert next(results) == 0
    results.close()
    assert len(taken) < 20


def test_an_error_of_an_item_is_raised_and_ends_the_work(monkeypatch):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 2)
    done = []

    def fail(item):
        if item == 3:
            raise ZeroDivisionError
        done.append(item)
        return item

    results = map_in_threads(fail, range(1000))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ZeroDivisionError):
        next(results)
    assert len(done) < 20
