"""The DPRWA paper's experiments (section VI): robots that talk only within a range.

The world is that of the PRWA paper. Figure 3(a) is the memory against the range, (b) the time against the number of
robots, (c) against the number of sources. The patrol is a train of pairs, each as far behind the next as they can talk;
the centralised PRWA has everybody's readings at once and no memory to speak of.
"""

from typing import Any

import numpy as np

from fieldkit.clock import wall_s
from fieldkit.world.sources import random_sources
from mission.lab.study.apart import Motion, Ring, Train, Walk, search_apart
from mission.lab.study.experiment import Experiment, Job, run
from mission.lab.study.packets import search
from mission.lab.study.pool import Progress
from mission.lab.study.prwa import CAP_S, LEVELS_DB, engine

METHODS = ("dprwa", "pair-random-walk", "pair-patrol")
RANGE_M, ROBOTS, SOURCES, RATE_HZ = 6.0, 8, 6, 0.05


def trial(job: Job) -> dict[str, Any]:
    """One search; x is the range (3a), the robots (3b) or the sources (3c); in 3a the value is the readings held."""
    range_m = job.x if job.study == "dprwa-fig3a" else RANGE_M
    robots = round(job.x) if job.study == "dprwa-fig3b" else ROBOTS
    sources = round(job.x) if job.study == "dprwa-fig3c" else SOURCES
    settings = engine(job.seed, robots)
    size = settings.grid.size_east_m
    hidden = tuple(
        random_sources(sources, size, size, LEVELS_DB, RATE_HZ, np.random.default_rng([job.seed, 99]))
    )
    start = np.array([(2.0 + 1.6 * k, 1.0) for k in range(robots)])
    began = wall_s()
    row: dict[str, Any]
    if job.method == "central-prwa":
        outcome = search(settings, "prwa", hidden, start, job.seed, CAP_S)
        row = {"value": outcome.time_s, "detections": outcome.detections, "most_held": 0, "mean_lag_s": 0.0}
        elapsed_s = outcome.elapsed_s
    else:
        motion: Motion
        match job.method:
            case "dprwa":
                motion = Ring(settings)
            case "pair-random-walk":
                motion = Walk(settings)
            case _:
                motion = Train(settings, range_m)
        apart = search_apart(settings, motion, hidden, start, job.seed, CAP_S, range_m)
        lag_s = float(np.mean(apart.lag_s)) if apart.lag_s else 0.0
        row = {
            "value": apart.time_s,
            "detections": apart.detections,
            "most_held": apart.most_held,
            "mean_lag_s": lag_s,
        }
        elapsed_s = apart.elapsed_s
    if job.study == "dprwa-fig3a":
        row |= {"value": row["most_held"], "time_s": row["value"]}
    return {**row, "simulated_s": elapsed_s, "wall_s": wall_s() - began}


FIG3A = Experiment(
    "dprwa-fig3a", "Readings aboard, eight robots, six sources", "range of communication, m", "most readings held",
    METHODS, (4, 6, 10, 15), trial,
)  # fmt: skip
FIG3B = Experiment(
    "dprwa-fig3b",
    "Time to find all, six sources",
    "robots",
    "s",
    (*METHODS, "central-prwa"),
    (4, 8, 12),
    trial,
    CAP_S,
)
FIG3C = Experiment(
    "dprwa-fig3c", "Time to find all, eight robots", "sources", "s", METHODS, (2, 4, 6, 8), trial, CAP_S
)


def fig3a(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 3(a): readings aboard against the range of communication."""
    return run(FIG3A, trials, seed, progress, **how)


def fig3b(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 3(b): time against the number of robots."""
    return run(FIG3B, trials, seed, progress, **how)


def fig3c(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 3(c): time against the number of sources."""
    return run(FIG3C, trials, seed, progress, **how)
