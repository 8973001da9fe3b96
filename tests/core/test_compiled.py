"""Parts of a range are shared out among threads, each once, and what goes wrong in one is seen."""

from __future__ import annotations

import subprocess
import sys
import threading

import numpy as np
import pytest
from numba import config

from tactile_loc.core.compiled import in_threads


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 2, 7, 100])
def test_every_item_is_done_once(monkeypatch, count, threads):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", threads)
    done = np.zeros(count, int)

    def kernel(first, last, step):
        done[first:last] += step

    in_threads(kernel, count, 3)
    assert (done == 3).all()


def test_threads_work_at_the_same_time(monkeypatch):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 3)
    together = threading.Barrier(3, timeout=60)
    met = set()

    def kernel(first, last):
        if threading.get_ident() not in met:
            met.add(threading.get_ident())
            together.wait()

    in_threads(kernel, 12)
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
        in_threads(kernel, 4)


def test_it_may_be_called_from_within(monkeypatch):
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 2)
    done = np.zeros((4, 4), int)

    def inner(first, last, row):
        done[row, first:last] += 1

    def outer(first, last):
        for row in range(first, last):
            in_threads(inner, 4, row)

    in_threads(outer, 4)
    assert (done == 1).all()


CALLED = """
from typing import NamedTuple
from tactile_loc.core.compiled import njit

class {pair}(NamedTuple):
    a: float
    b: float

@njit
def helper(pair):
    return pair.a * {factor}.0 + pair.b
"""
CALLING = """
from called import {pair}, helper
from tactile_loc.core.compiled import njit

@njit
def kernel(pair):
    return later(pair)

@njit
def later(pair):
    return helper(pair)
"""


def run(folder, **values):
    """Run a kernel of one file that calls one of another; return what it says, and how often it was found on disk."""
    for name, text in (("called", CALLED), ("calling", CALLING)):
        path = folder / f"{name}.py"
        if not path.exists() or path.read_text() != text.format(**values):
            path.write_text(text.format(**values))
    main = "from calling import *; print(kernel({pair}(3.0, 1.0)), sum(kernel.stats.cache_hits.values()))"
    done = subprocess.run(
        [sys.executable, "-c", main.format(**values)], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_compiled_code_is_kept_until_any_source_of_it_changes(tmp_path):
    assert run(tmp_path, pair="Pair", factor=2) == ["7.0", "0"]
    assert run(tmp_path, pair="Pair", factor=2) == ["7.0", "1"]
    assert run(tmp_path, pair="Pair", factor=4) == ["13.0", "0"]  # a function in another file, called by one it calls
    assert run(tmp_path, pair="Two", factor=4) == ["13.0", "0"]  # an index that names a class which is gone


def test_compiled_code_that_was_cut_off_is_compiled_again(tmp_path):
    assert run(tmp_path, pair="Pair", factor=2) == ["7.0", "0"]
    for suffix in ("nbi", "nbc"):
        for path in tmp_path.rglob(f"*.{suffix}"):
            path.write_bytes(path.read_bytes()[:-5])
        assert run(tmp_path, pair="Pair", factor=2) == ["7.0", "0"]
        assert run(tmp_path, pair="Pair", factor=2) == ["7.0", "1"]
