"""Trials over all cores or a Dask cluster, with progress and time left; what a killed study had done is kept.

A result counts by the name of its job, its `repr`: however often a trial was begun, lost with its worker, or handed
in, it stands once in what comes back.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any
from uuid import uuid4

from fieldkit.clock import wall_s
from fieldkit.errors import ConfigError, FieldkitError
from fieldkit.extras import need

Progress = Callable[[float, str], None]
"""Called with the share done and a line of text."""
Trial = Callable[[Any], dict[str, Any]]

CONNECT_S = 15.0
"""How long a Dask scheduler and its first worker are waited for."""
MAX_DEATHS = 5
"""So often a trial is handed in anew after a Dask scheduler gave it up because its workers died."""


def having(only: str, names: Iterable[str]) -> list[str]:
    """Of `names` the one that is `only`, or those that have it in them. Raises `ConfigError` where none has."""
    names = list(dict.fromkeys(names))
    chosen = [name for name in names if name == only] or [name for name in names if only in name]
    if not chosen:
        raise ConfigError(
            f"--only {only!r}: no row of this study has that in its name; rows are: {'; '.join(names)}"
        )
    return chosen


def run_trials(
    trial: Trial,
    jobs: Sequence[Any],
    progress: Progress = lambda share, text: None,
    *,
    workers: int | None = None,
    kept: Path | None = None,
    dask: str | None = None,
) -> list[dict[str, Any]]:
    """The result of every job, in the order of the jobs. A job must be picklable and its `repr` name it.

    `kept` is a file of results, a JSON line each: jobs found in it are not run again. `dask` is the address of a
    scheduler (tcp://host:8786) whose workers have fieldkit installed; else `workers` processes here, all cores if None.
    Raises `ConfigError` where Dask is not installed or not reachable.
    """
    done = {} if kept is None else read_kept(kept)
    left = {repr(job): job for job in jobs if repr(job) not in done}
    before = len(jobs) - len(left)
    began = wall_s()
    results = _on_dask(trial, left, dask) if dask else _on_cores(trial, left, workers)
    for name, result in results:
        if name in done:
            continue
        done[name] = result
        if kept is not None:
            with kept.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps({"job": name, "result": result}) + "\n")
        count = len(done.keys() & left.keys())
        rest_s = (wall_s() - began) / count * (len(left) - count)
        progress(
            (before + count) / len(jobs), f"{before + count} of {len(jobs)} trials, {_spoken(rest_s)} left"
        )
    return [done[repr(job)] for job in jobs]


def read_kept(path: Path) -> dict[str, dict[str, Any]]:
    """Results by job name from a file of JSON lines, and the file made ready to go on; empty where there is none.

    A line that a kill cut short is closed, so that the next one does not run into it, and left out.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8", errors="replace")
    if text and not text.endswith("\n"):
        with path.open("a", encoding="utf-8") as stream:
            stream.write("\n")
    done: dict[str, dict[str, Any]] = {}
    for line in text.splitlines():
        try:
            row = json.loads(line)
            done[row["job"]] = row["result"]
        except (json.JSONDecodeError, KeyError, TypeError):
            continue
    return done


def _on_cores(
    trial: Trial, left: dict[str, Any], workers: int | None
) -> Iterator[tuple[str, dict[str, Any]]]:
    pool = ProcessPoolExecutor(workers or os.cpu_count())
    try:
        futures = {pool.submit(trial, job): name for name, job in left.items()}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenProcessPool as error:
        raise FieldkitError(
            "study: a worker process was killed, perhaps for want of memory; run it again with the same --out to go "
            "on, with fewer --workers"
        ) from error
    finally:  # stopped half-way: what has not begun is not begun
        pool.shutdown(cancel_futures=True)


def _on_dask(trial: Trial, left: dict[str, Any], address: str) -> Iterator[tuple[str, dict[str, Any]]]:
    distributed = need("distributed", "fleet")
    try:
        client = distributed.Client(address, timeout=CONNECT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(
            f"--dask {address}: no scheduler answers ({error}); start one with `dask scheduler` and give its "
            "address, such as tcp://192.168.1.10:8786"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise ConfigError(
                f"--dask {address}: the scheduler has no workers; start some with `dask worker {address}`"
            ) from None

        def submit(name: str) -> Any:
            # A key of its own: a cluster may still hold another run's trial of the same name.
            return client.submit(trial, left[name], key=f"{name}-{uuid4().hex}", pure=False)

        names = {submit(name): name for name in left}
        deaths = dict.fromkeys(left, 0)
        coming = distributed.as_completed(list(names))
        for future in coming:
            name = names.pop(future)
            try:
                result = future.result()
            except (
                distributed.KilledWorker
            ):  # the scheduler gives up after a few deaths; they need not be its fault
                deaths[name] += 1
                if deaths[name] > MAX_DEATHS:
                    raise
                again = submit(name)
                names[again] = name
                coming.add(again)
                continue
            yield name, result


def _spoken(seconds: float) -> str:
    """A duration as people say it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
