"""Threads: one of BLAS for small matrices, and the machine's processors for independent work on arrays.

More BLAS threads change rounding from machine to machine, and starve on a busy one.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep BLAS to one thread, as a context or, called, as a decorator of a function."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


def in_threads(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Return ``[function(item) for item in items]``; NumPy releases the interpreter, so processors share them."""
    workers = min(_processors(), len(items))
    if workers < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, items))


def _processors() -> int:
    """Processors that this process may run on, where the system tells them."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _controller() -> Any:
    import numpy  # noqa: F401  the controller sees only the libraries loaded before it is made
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
