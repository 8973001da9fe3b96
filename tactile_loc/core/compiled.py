"""Compiled loops, and threads to share them out among.

Kernels are plain numba functions that release the GIL, and threads of our own call them for parts of a range: numba's
own parallel loops take several times as long to compile, and their threads wait for one another by spinning, which
costs whatever else the machine has to do.
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

PARTS = 4  # a thread: whoever ends early takes another

FASTMATH = {"nsz", "arcp", "contract"}  # what `fast` allows: all but to forget about infinities and NaN

_one_folder = RLock()  # numba's setting of the folder for compiled code is the process's


def njit(function: Callable[..., Any] | None = None, *, fast: bool = False) -> Any:
    """Compile a function with numba, keep it on disk, and let other threads run meanwhile.

    `fast` allows products and sums to be contracted and quotients to be multiplied; infinities and NaN keep their
    meaning. Code on disk is used while no file changes that it is compiled from (`code_cache`). Import the compiled
    functions and constants of other files before the first function of a file.
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
                config.CACHE_DIR = str(folder)  # type: ignore[attr-defined] # numba looks at it once, here
            return decorate(function, cache=folder is not None)
        finally:
            config.CACHE_DIR = chosen  # type: ignore[attr-defined]


def run_in_threads(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
    """Call kernel(first, last, *arguments) for parts of range(count), shared out among threads.

    The parts must not write to the same place. As many threads as numba may use (NUMBA_NUM_THREADS, or the cores that
    the process has), one of them the caller's.
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
        if not other.cancel():  # it may not have begun, when other callers keep the threads busy
            other.result()


@lru_cache(maxsize=8)
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """The threads of this process: one that was forked has none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="tactile-loc")
