"""Compiled loops, and threads to share them out among.

Kernels are plain numba functions that release the GIL, and threads of our own call them for parts of a range: numba's
own parallel loops take several times as long to compile, and their threads wait for one another by spinning, which
costs whatever else the machine has to do.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from numba import config
from numba import njit as numba_njit

PARTS = 4  # a thread: whoever ends early takes another

FASTMATH = {"nsz", "arcp", "contract"}  # what `fast` allows: all but to forget about infinities and NaN


def njit(function: Callable[..., Any] | None = None, *, fast: bool = False) -> Any:
    """Compile a function with numba, keep it on disk, and let other threads run meanwhile.

    `fast` allows products and sums to be contracted and quotients to be multiplied; infinities and NaN keep their
    meaning.
    """
    if function is None:
        return lambda f: njit(f, fast=fast)
    compiled = numba_njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH if fast else False)(function)
    _require_fresh(compiled)
    return compiled


def _require_fresh(compiled: Any) -> None:
    """Let compiled code on disk be used only if it is of all the source that is in it, and can be read.

    numba looks at the file of the function itself, not at those of the functions that it calls and that are compiled
    into it: after an upgrade old code would go on working with new. And an index that names a class which is gone, or
    was cut off, would end the program.
    """
    file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if file is None:  # nothing is kept: numba is told not to compile
        return
    load_index, load_data = file._load_index, file._load_data

    def index() -> dict[Any, str]:
        file._source_stamp = _stamps(compiled)  # only now are all names of the functions it calls there
        try:
            return dict(load_index())
        except Exception:  # noqa: BLE001 - whatever a damaged or foreign file makes of unpickling
            return {}

    def data(name: str) -> Any:
        try:
            return load_data(name)
        except Exception as error:
            raise OSError(f"{name} cannot be read") from error  # then numba compiles

    file._load_index, file._load_data = index, data


def _stamps(compiled: Any) -> list[tuple[str, int, int]]:
    """The files of a compiled function and of those that it calls: name, time and size."""
    functions, files = [compiled], set()
    for function in functions:  # grows while it is walked
        python = function.py_func
        files.add(python.__code__.co_filename)
        called = (python.__globals__.get(name) for name in python.__code__.co_names)
        functions += [other for other in called if isinstance(other, type(compiled)) and other not in functions]
    stats = [(Path(file).name, os.stat(file)) for file in sorted(files)]
    return [(name, stat.st_mtime_ns, stat.st_size) for name, stat in stats]


def in_threads(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
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
