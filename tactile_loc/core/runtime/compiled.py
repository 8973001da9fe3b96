"""Compiled loops, and the threads that run them.

Kernels are plain numba functions that release the GIL. Threads of this module call the kernels for parts of a range.
The parallel loops of numba are not used, because they take several times as long to compile. Their threads also wait in
busy loops, which slows down all other work. So do the threads of BLAS
libraries, which are switched off while touches are located.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, lru_cache, update_wrapper
from itertools import pairwise
from threading import RLock, local
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

from tactile_loc.core.runtime.lazy import pause_collection

PARTS = 4  # parts per thread; a thread that finishes early takes another part

FASTMATH = {"nsz", "arcp", "contract"}  # for `fast`; infinities and NaN keep their meaning

Item = TypeVar("Item")
Result = TypeVar("Result")

_one_compiler = RLock()
_thread = local()  # `alone` is set in the threads of `map_in_threads` and `run_aside`


class Kernel:
    """A function that numba compiles at its first call. numba is imported only then, because that takes a while."""

    def __init__(self, function: Callable[..., Any], fast: bool) -> None:
        update_wrapper(self, function)
        self._function, self._fast, self._compiled, self._inner = function, fast, None, None

    @property
    def compiled(self) -> Any:
        """numba's dispatcher of the function, or the function itself under NUMBA_DISABLE_JIT."""
        if self._compiled is None:
            with _one_compiler, pause_collection():  # several threads call a kernel for the first time
                self._compiled = self._compiled or self._compile()
        return self._compiled

    def _compile(self) -> Any:
        from numba import config

        from tactile_loc.core.runtime.code_cache import keep_code

        compiled = self._make_dispatcher()
        return compiled if config.DISABLE_JIT else keep_code(compiled)  # type: ignore[attr-defined]

    def _make_dispatcher(self, **options: bool) -> Any:
        from numba import njit

        # C programs do not call these functions, so wrappers for C would only take time to compile
        options |= {"nogil": True, "no_cfunc_wrapper": True}
        return njit(self._function, fastmath=FASTMATH if self._fast else False, error_model="numpy", **options)

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function."""
        return self.compiled(*arguments)

    @property
    def _numba_type_(self) -> Any:
        """numba's type of this function, for kernels that call it. Their code contains its code, without a wrapper."""
        from numba import typeof

        with _one_compiler:
            self._inner = self._inner or self._make_dispatcher(no_cpython_wrapper=True)
        return typeof(self._inner)


def njit(function: Callable[..., Any] | None = None, *, fast: bool = False) -> Any:
    """Compile a function with numba at its first call, and keep its code on disk. It releases the GIL while it runs.

    `fast` allows contraction of products and sums, and multiplication by reciprocals. Infinities and NaN keep their
    meaning. The code on disk is used until a kernel module changes (see `code_cache`). Write `@njit` at the start of a
    line, and take compiled functions and constants from modules with such a line only.
    """
    return Kernel(function, fast) if function is not None else lambda f: Kernel(f, fast)


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
    with use_one_blas_thread(), ThreadPoolExecutor(threads, "tactile-loc-item", _compute_alone) as pool:
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


def run_aside(function: Callable[[], Result]) -> Future[Result]:
    """Call function() in another thread, which computes alone, and return its future at once."""
    return _aside(os.getpid()).submit(function)


def count_threads() -> int:
    """Return the number of threads for compiled loops: NUMBA_NUM_THREADS or the number of cores.

    It is 1 in an item of `map_in_threads`, and in a function that runs aside.
    """
    if getattr(_thread, "alone", False):
        return 1
    from numba import config  # it takes a while to import

    return int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


@lru_cache(maxsize=8)
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Return the threads of this process. A forked process cannot use the threads of its parent."""
    return ThreadPoolExecutor(threads, thread_name_prefix="tactile-loc")


@lru_cache(maxsize=2)
def _aside(process: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count(), "tactile-loc-aside", _compute_alone)


def _compute_alone() -> None:
    _thread.alone = True


@contextmanager
def use_one_blas_thread() -> Iterator[None]:
    """Let BLAS libraries of this process compute with the calling thread alone until the block ends.

    The threads of OpenBLAS wait in busy loops after each product, for longer than the products of a search take. So two
    threads need almost twice the processor time, and slow down all other work. Blocks of several threads may overlap:
    the first block decides, and the others change nothing. Libraries that are loaded after the first block are left
    alone.
    """
    with _find_libraries().limit(limits=1, user_api="blas"):
        yield


@cache
def _find_libraries() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")
