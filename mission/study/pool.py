"""Trials over all cores, with progress and time left; what a killed study had done is not done again."""

import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from fieldkit.clock import wall_s

Progress = Callable[[float, str], None]
"""Told the share done and a line of text."""


def run_trials(
    trial: Callable[[Any], dict[str, Any]],
    jobs: Sequence[Any],
    progress: Progress = lambda share, text: None,
    *,
    workers: int | None = None,
    kept: Path | None = None,
) -> list[dict[str, Any]]:
    """The result of every job, in the order of the jobs. A job must be picklable and its `repr` name it.

    `kept` is a file of results, a JSON line each: jobs found in it are not run again.
    """
    done: dict[str, dict[str, Any]] = {}
    if kept is not None and kept.exists():
        for line in kept.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(line)
            except json.JSONDecodeError:  # the line a kill cut short
                continue
            done[row["job"]] = row["result"]
    left = [job for job in jobs if repr(job) not in done]
    began = wall_s()
    with ProcessPoolExecutor(workers or os.cpu_count()) as pool:
        futures = {pool.submit(trial, job): job for job in left}
        for count, future in enumerate(as_completed(futures), start=1):
            name = repr(futures[future])
            done[name] = future.result()
            if kept is not None:
                kept.parent.mkdir(parents=True, exist_ok=True)
                with kept.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps({"job": name, "result": done[name]}) + "\n")
            rest_s = (wall_s() - began) / count * (len(left) - count)
            finished = len(jobs) - len(left) + count
            progress(finished / len(jobs), f"{finished} of {len(jobs)} trials, {rest_s:.0f} s left")
    return [done[repr(job)] for job in jobs]
