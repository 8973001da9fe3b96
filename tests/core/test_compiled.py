"""Parts of a range are shared out among threads, each once, and what goes wrong in one is seen."""

from __future__ import annotations

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
