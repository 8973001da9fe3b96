"""Compiled loops, and threads that share them.

Kernels are plain numba functions that release the GIL. Our own threads call them for parts of a range. numba's parallel
loops take several times as long to compile, and their threads wait in busy loops, which slows down all other work.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from itertools import pairwise
from threading import RLock
from typing import Any

from numba import config
from numba import njit as numba_njit

from tactile_loc.core.code_cache import open_code_folder

PARTS = 4  # parts per thread: a thread that finishes early takes another part

FASTMATH = {"nsz", "arcp", "contract"}  # for `fast`: all but ignoring infinities and NaN

_one_folder = RLock()  # numba has one setting for the folder of compiled code per process


def njit(function: Callable[..., Any] | None = None, *, fast: bool = False) -> Any:
    """Compile a function with numba, keep it on disk, and release the GIL while it runs.

    `fast` allows contraction of products and sums, and multiplication by reciprocals; infinities and NaN keep their
    meaning. Code on disk is used as long as no file changes that it is compiled from (`code_cache`). Import compiled
    functions and constants from other files before the first function of a file.
    """
    if function is None:
        return lambda f: njit(f, fast=fast)
    decorate = partial(numba_njit, nogil=True, error_model="numpy", fastmath=FASTMATH if fast else False)
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return decorate(function)
    with _one_folder:
        chosen: str = config.CACHE_DIR  # type: ignore[attr-defined]
        folder = open_code_folder(function, chosen)
        try:
            if folder:
                config.CACHE_DIR = str(folder)  # type: ignore[attr-defined] # numba reads it only here
            return decorate(function, cache=folder is not None)
        finally:
            config.CACHE_DIR = chosen  # type: ignore[attr-defined]


def run_in_threads(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
    """Call kernel(first, last, *arguments) for parts of range(count), shared among threads.

    The parts must not write to the same place. The number of threads is numba's (NUMBA_NUM_THREADS, or the process's
    cores), including the caller's.
    """
    threads = min(int(config.NUMBA_NUM_THREADS), count)  # type: ignore[attr-defined]
    if threads < 2:
        kernel(0, count, *arguments)
        return
    parts = min(count, PARTS * threads)
    limits = [count * i // parts for i in range(parts + 1)]
    waiting = iter(list(pairwise(limits)))

    def work() -> None:
        for first, last in waiting:
            kernel(first, last, *arguments)

    others = [_pool(os.getpid(), threads - 1).submit(work) for _ in range(threads - 1)]
    work()
    for other in others:
        if not other.cancel():  # it may not have started, if other callers keep the threads busy
            other.result()


@lru_cache(maxsize=8)
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Return the threads of this process; a forked process has none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="tactile-loc")
