"""Who does the work: this process, several, or a Dask scheduler."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from rangecam.errors import UsageError

Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]
"""As the built-in map: it may work elsewhere, and yields in order."""


@contextmanager
def workers(jobs: int = 1, scheduler: str | None = None) -> Iterator[Executor | None]:
    """Give who works: processes on this machine, a Dask scheduler at an address, or nobody else (jobs = 1).

    The workers of a scheduler need rangecam and the files of the sources. Raises UsageError if Dask is not installed
    or does not answer, or for less than one job.
    """
    if jobs < 1:
        raise UsageError(f"jobs = {jobs}: expected at least 1")
    if scheduler is not None:
        with _dask(scheduler) as client:
            yield client.get_executor()
    elif jobs == 1:
        yield None
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            yield pool


def _dask(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("--scheduler needs Dask, which is not installed: pip install 'rangecam[cluster]'") from error
    try:
        return Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UsageError(f"no Dask scheduler answers at {address}") from error


def mapping(executor: Executor | None, watch: Callable[[Any, int], Iterator[Any]]) -> Mapper:
    """Return a map that lets `executor` (None: nobody else) work; `watch` sees every item pass, of how many."""

    def mapper(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        if executor is None:
            return watch(map(function, items), len(items))
        return watch((future.result() for future in [executor.submit(function, one) for one in items]), len(items))

    return mapper
