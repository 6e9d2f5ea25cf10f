"""The same work on this process, on the machine's cores or on a Dask cluster: same blocks, same bits.

Every block is one call of one function, whoever runs it, with one BLAS thread; results come back in the order
of the blocks, and nothing is summed across blocks. So the number of workers cannot change a single bit (on
machines of one kind: other processors have other sine routines).
"""

from __future__ import annotations

import asyncio
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from symstiff.errors import UserError
from symstiff.threads import one_thread

Result = TypeVar("Result")
Progress = Callable[[str, float], None]
_SECONDS_TO_CONNECT = 10
_installed: Callable[..., Any] | None = None


def slices(count: int, size: int) -> tuple[slice, ...]:
    """Cut ``range(count)`` into blocks of ``size``; depends on nothing but the two numbers."""
    return tuple(slice(start, min(start + size, count)) for start in range(0, count, size))


def map_blocks(
    function: Callable[..., Result],
    blocks: Sequence[tuple[Any, ...]],
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress | None = None,
    label: str = "evaluating",
) -> list[Result]:
    """Return ``[function(*block) for block in blocks]``, computed by ``workers`` processes or a Dask cluster.

    ``cluster`` is a scheduler's address (``tcp://host:port``) and wins over ``workers``. The function and the
    blocks must be picklable; with more than one worker, processes are spawned. Raises UserError where the
    cluster cannot be used; an exception of the function is passed on.
    """
    return list(stream_blocks(function, blocks, workers, cluster, progress, label))


def stream_blocks(
    function: Callable[..., Result],
    blocks: Sequence[tuple[Any, ...]],
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress | None = None,
    label: str = "evaluating",
) -> Iterator[Result]:
    """Yield what ``map_blocks`` returns, block by block in order, so that a caller can store it in place."""
    if workers < 1:
        raise UserError(f"workers = {workers}: use at least one")
    if cluster is not None:
        results = _on_cluster(function, blocks, cluster)
    elif workers > 1 and len(blocks) > 1:
        results = _on_cores(function, blocks, min(workers, len(blocks)))
    else:
        results = (_call(function, block) for block in blocks)
    for done, result in enumerate(results, start=1):
        if progress is not None:
            progress(label, done / len(blocks))
        yield result


def _on_cores(
    function: Callable[..., Result], blocks: Sequence[tuple[Any, ...]], workers: int
) -> Iterator[Result]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=_install, initargs=(function,)) as pool:
        yield from pool.map(_call_installed, blocks)


def _on_cluster(
    function: Callable[..., Result], blocks: Sequence[tuple[Any, ...]], address: str
) -> Iterator[Result]:
    with _client(address) as client:
        shared = client.scatter(function, broadcast=True, hash=False)
        futures = [client.submit(_call, shared, block, pure=False) for block in blocks]
        for future in futures:
            yield future.result()


@contextmanager
def _client(address: str) -> Iterator[Any]:
    try:
        from distributed import Client
        from distributed.comm import connect
    except ImportError as error:
        raise UserError("--cluster needs Dask: pip install symstiff[dask]") from error

    async def asked() -> None:
        (await connect(address, timeout=_SECONDS_TO_CONNECT)).abort()

    try:
        asyncio.run(asked())  # a client that finds nobody complains once more when it is gone
        client = Client(address, timeout=_SECONDS_TO_CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise UserError(
            f"--cluster {address}: no Dask scheduler answers there: give the address that it "
            "prints, e.g. tcp://host:8786"
        ) from error
    with client:
        yield client


def _install(function: Callable[..., Any]) -> None:
    global _installed
    _installed = function


def _call_installed(block: tuple[Any, ...]) -> Any:
    assert _installed is not None
    return _call(_installed, block)


def _call(function: Callable[..., Result], block: tuple[Any, ...]) -> Result:
    with one_thread():
        return function(*block)
