"""The threads of BLAS libraries, switched off while touches are located."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


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
