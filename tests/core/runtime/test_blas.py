"""BLAS libraries use one thread while a block is open, and their own number of threads afterwards."""

from __future__ import annotations

import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from tactile_loc.core.runtime.blas import _find_libraries, use_one_blas_thread


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


def test_an_error_restores_the_threads():
    @use_one_blas_thread()
    def fail():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert count_blas_threads() == {3}
