"""Threads share the parts of a range, and errors in threads are raised."""

import threading

import numpy as np
import pytest
from numba import config
from threadpoolctl import threadpool_info, threadpool_limits

from tactile_loc.core.runtime.compiled import (
    _find_libraries,
    count_threads,
    map_in_threads,
    run_in_threads,
    use_one_blas_thread,
)


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


def count_blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def three_threads():
    _find_libraries.cache_clear()  # other tests may have loaded more libraries since
    with threadpool_limits(3, user_api="blas"):
        yield
    _find_libraries.cache_clear()


def test_a_block_has_one_thread():
    with use_one_blas_thread():
        assert count_blas_threads() == {1}
        with use_one_blas_thread():
            assert count_blas_threads() == {1}
        assert count_blas_threads() == {1}
    assert count_blas_threads() == {3}


def test_overlapping_blocks_restore_the_threads():
    opened, close = threading.Event(), threading.Event()

    def hold():
        with use_one_blas_thread():
            opened.set()
            close.wait(60)

    other = threading.Thread(target=hold)
    with use_one_blas_thread():
        other.start()
        opened.wait(60)
        assert count_blas_threads() == {1}
    close.set()
    other.join()
    assert count_blas_threads() == {3}
