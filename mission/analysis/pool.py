"""Jobs on this machine's cores or on a Dask cluster. A worker that is killed loses nothing: its job is done again."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from fieldkit.errors import ConfigError, DataError
from fieldkit.extras import need

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")
MOST_KILLED = 3
"""So many times in a row workers may be killed before any job is done."""
KILLED = (
    "a worker process was killed again and again: most likely there is too little memory. "
    "Say fewer --workers, or larger cells (--set field.cell_m=...)"
)
NO_MEMORY = "there is too little memory: say fewer --workers, or larger cells (--set field.cell_m=...)"


def each_done(
    do: Callable[[Job], Outcome], jobs: Sequence[Job], *, workers: int | None = None, dask: str | None = None
) -> Iterator[tuple[int, Outcome]]:
    """Each job's number and what `do` made of it, as they get done; in order with one worker.

    `workers` None: one a core. With `dask`, the address of a scheduler, its workers do the work. Raises `ConfigError`
    where no scheduler answers there, and `DataError` where workers are killed again and again or memory runs out.
    """
    try:
        if not jobs:
            return
        if dask:
            yield from _on_dask(do, jobs, dask)
        elif workers == 1 or len(jobs) == 1:
            yield from enumerate(map(do, jobs))
        else:
            yield from _here(do, jobs, workers)
    except MemoryError as error:
        raise DataError(NO_MEMORY) from error


def _here(
    do: Callable[[Job], Outcome], jobs: Sequence[Job], workers: int | None
) -> Iterator[tuple[int, Outcome]]:
    left, killed = dict(enumerate(jobs)), 0
    while left:
        pool = ProcessPoolExecutor(workers)
        try:
            numbers = {pool.submit(do, job): number for number, job in left.items()}
            for future in as_completed(numbers):
                outcome = future.result()
                del left[numbers[future]]
                killed = 0
                yield numbers[future], outcome
        except BrokenProcessPool as error:  # with one process that dies, Python gives up all of a pool
            killed += 1
            if killed >= MOST_KILLED:
                raise DataError(KILLED) from error
        finally:
            pool.shutdown(cancel_futures=True)


def _on_dask(
    do: Callable[[Job], Outcome], jobs: Sequence[Job], address: str
) -> Iterator[tuple[int, Outcome]]:
    """On a cluster, which itself gives to another worker what a killed one had."""
    distributed: Any = need("distributed", "fleet")
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(
            f"--dask {address}: no scheduler answers there ({error}); start one with 'dask scheduler' and workers that "
            "see the same folders"
        ) from error
    with client:
        numbers = {client.submit(do, job, pure=False): number for number, job in enumerate(jobs)}
        try:
            for future in distributed.as_completed(list(numbers)):
                yield numbers[future], future.result()
        except distributed.KilledWorker as error:
            raise DataError(KILLED) from error
