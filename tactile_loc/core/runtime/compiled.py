"""Compiled loops, and the threads that run them.

Kernels are plain numba functions that release the GIL. Threads of this module call the kernels for parts of a range.
The parallel loops of numba are not used, because they take several times as long to compile. Their threads also wait in
busy loops, which slows down all other work. So do the threads of BLAS libraries: see `core/blas.py`.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache, partial
from itertools import pairwise
from threading import RLock, local
from typing import Any, TypeVar

from numba import config
from numba import njit as numba_njit

from tactile_loc.core.runtime.blas import use_one_blas_thread
from tactile_loc.core.runtime.code_cache import open_code_folder

PARTS = 4  # parts per thread; a thread that finishes early takes another part

FASTMATH = {"nsz", "arcp", "contract"}  # for `fast`; infinities and NaN keep their meaning

Item = TypeVar("Item")
Result = TypeVar("Result")

_one_folder = RLock()  # numba has only one folder setting per process
_thread = local()  # `alone` is set in the threads of `map_in_threads`


def njit(function: Callable[..., Any] | None = None, *, fast: bool = False) -> Any:
    """Compile a function with numba, and keep its code on disk. The function releases the GIL while it runs.

    `fast` allows contraction of products and sums, and multiplication by reciprocals. Infinities and NaN keep their
    meaning. The code on disk is used until one of its source files changes (see `code_cache`). In each file, import
    compiled functions and constants from other files before the first compiled function.
    """
    if function is None:
        return lambda f: njit(f, fast=fast)
    # C programs do not call these functions, so wrappers for C would only take time to compile
    decorate = partial(
        numba_njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True, fastmath=FASTMATH if fast else False
    )
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
    """Call kernel(first, last, *arguments) for parts of range(count), in several threads.

    The parts must not write to the same memory. The number of threads, including the caller's, is numba's:
    NUMBA_NUM_THREADS, or the number of cores. Within `map_in_threads`, it is one.
    """
    threads = min(count_threads(), count)
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
        if not other.cancel():  # the thread has not started if other callers keep it busy
            other.result()


def map_in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield function(item) for each item, in order. Several items are processed at once, each by one thread.

    This uses the cores better than `run_in_threads` if each item takes milliseconds or longer. Items are taken in the
    caller's thread, at most PARTS per thread in advance. If a call raises an error, no further call starts.
    """
    threads = count_threads()
    if threads < 2:
        yield from map(function, items)
        return
    with (
        use_one_blas_thread(),
        ThreadPoolExecutor(threads, "tactile-loc-item", lambda: setattr(_thread, "alone", True)) as pool,
    ):
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(function, item))
                if len(waiting) == PARTS * threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def count_threads() -> int:
    """Return the number of threads for compiled loops: NUMBA_NUM_THREADS or the number of cores, 1 if in an item."""
    return 1 if getattr(_thread, "alone", False) else int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


@lru_cache(maxsize=8)
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Return the threads of this process. A forked process cannot use the threads of its parent."""
    return ThreadPoolExecutor(threads, thread_name_prefix="tactile-loc")
