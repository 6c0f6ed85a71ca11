"""The PRWA paper's experiments (section VII): five motions against the number of sources, of robots, and as driven.

Sensing and belief as in the paper (Theorem 1, SPOG), with the Dirichlet rule for eq 2, which as printed finds one
source only. What the paper leaves open is stated where it is decided: walk lengths and lane widths in
`planning.walks`, the planning period here.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.clock import wall_s
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.world.sources import random_sources
from mission.lab.study.experiment import Experiment, Job, run
from mission.lab.study.packets import ROBOTS_APART_M, search
from mission.lab.study.pool import Progress
from mission.lab.study.twin import against_numpy

METHODS = ("prwa", "pair-random-walk", "random-walk", "pair-patrol", "patrol")
LEVELS_DB = (-8.0, -6.0, -4.0, -2.0, 0.0)
CAP_S = 15_000.0
PERIOD_S = 200.0
"""The paper does not give the period of planning."""


def engine(seed: int, robots: int) -> EngineSettings:
    """Section VII.A: 25 m, 50 x 50 cells, ranges of 1.67 to 3.45 m at five powers, 0.4 m/s."""
    exponent, threshold = 2.53, -90.0
    antenna = Antenna(exponent, threshold + 10.0 * exponent * float(np.log10(3.45)), 3.3, threshold)
    return EngineSettings(
        Grid(25.0, 25.0, 0.5),
        antenna,
        tuple((f"r{2 * k}", f"r{2 * k + 1}") for k in range(robots // 2)),
        LEVELS_DB,
        planning_period_s=PERIOD_S,
        min_separation_m=ROBOTS_APART_M,
        sensing="pairwise",
        prior_rule="dirichlet",
        seed=seed,
    )


def physical(seed: int) -> EngineSettings:
    """Section VII.B: 10 m, 50 x 50 cells, four robots 0.34 m wide; radios that reach 0.48 to 1.0 m."""
    base = engine(seed, 4)
    antenna = Antenna(2.53, -90.0, 3.3, -90.0)  # 1 m at the strongest level
    return replace(base, grid=Grid(10.0, 10.0, 0.2), antenna=antenna, min_separation_m=0.4)


def _search(settings: EngineSettings, job: Job, sources: int, rate_hz: float, cap_s: float) -> dict[str, Any]:
    size = settings.grid.size_east_m
    rng = np.random.default_rng([job.seed, 99])
    hidden = tuple(random_sources(sources, size, size, LEVELS_DB, rate_hz, rng))
    start = np.array([(2.0 + 0.8 * size / 12.5 * k, 1.0) for k in range(len(settings.robots))])
    start[:, 0] = np.minimum(start[:, 0], size - 1.0)
    began = wall_s()
    outcome = search(settings, job.method, hidden, start, job.seed, cap_s)
    return {
        "value": outcome.time_s,
        "detections": outcome.detections,
        "false_clusters": outcome.false_clusters,
        "simulated_s": outcome.elapsed_s,
        "wall_s": wall_s() - began,
    }


def trial(job: Job) -> dict[str, Any]:
    """One search of one of the three experiments."""
    match job.study:
        case "prwa-fig5a":
            return _search(engine(job.seed, 6), job, round(job.x), 0.05, CAP_S)
        case "prwa-fig5b":
            return _search(engine(job.seed, round(job.x)), job, 4, 0.05, CAP_S)
        case "prwa-fig7":
            return _search(physical(job.seed), job, round(job.x), 0.1, CAP_S)
    raise ValueError(f"study: expected one of the PRWA paper's, got {job.study!r}")


FIG5A = Experiment(
    "prwa-fig5a", "Time to find all, six robots", "sources", "s", METHODS, (1, 2, 4, 6), trial, CAP_S
)
FIG5B = Experiment(
    "prwa-fig5b", "Time to find all, four sources", "robots", "s", METHODS, (4, 6, 8, 10), trial, CAP_S
)
FIG7 = Experiment(
    "prwa-fig7", "Time to find all, settings of the physical experiment", "sources", "s",
    ("prwa", "pair-random-walk"), (1, 2, 3), trial, CAP_S,
)  # fmt: skip


def fig5a(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 5(a): localisation time against the number of sources; and the speed of a search against plain numpy."""
    settings = engine(seed, 6)
    hidden = random_sources(4, 25.0, 25.0, LEVELS_DB, 0.05, np.random.default_rng([seed, 99]))
    result = run(FIG5A, trials, seed, progress, **how)
    return {**result, "against_numpy": against_numpy(settings, tuple(hidden), CAP_S)}


def fig5b(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 5(b): localisation time against the number of robots."""
    return run(FIG5B, trials, seed, progress, **how)


def fig7(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 7: the physical experiment's settings, simulated."""
    return run(FIG7, trials, seed, progress, **how)
