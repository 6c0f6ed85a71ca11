"""The RWA paper's experiments (section VII): one robot with a directional antenna.

50 x 50 cells of 5.08 cm (the 2-sigma rule in the antenna's unit), packets at 0.012 a second, 0.4 m/s; every packet in
the field is heard, near or far. Eq 2 as printed finds one source only: `em` is used.
"""

from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.channel.pattern import lobe_gain_db
from fieldkit.clock import wall_s
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.world.sources import random_sources
from mission.lab.study.experiment import Experiment, Job, run
from mission.lab.study.packets import search
from mission.lab.study.pool import Progress

CELL_M, CELLS, RATE_HZ, SPEED_M_S = 0.0508, 50, 0.012, 0.4
PERIOD_S = 800.0
CAP_S = 20_000.0
SATURATED_M = 0.6 * CELL_M
"""d_a: not the distance of any two cells' centres, lest rounding decide 15 dB."""
METHODS = ("rwa", "random-walk", "patrol")


def antenna() -> Antenna:
    """Section IV.A: c = 63.09 at one cell, beta 2.53, sigma 3.3 dB, the parabolic lobe with its floor 15.2 dB down."""
    exponent = 2.53
    floor_db = -20.0 * float(np.log10(np.cos(np.radians(80.0))))
    gains = lobe_gain_db(np.arange(0.0, 360.0), 0.0, 4.0, floor_db)
    at_1m = 10.0 * np.log10(63.09) - 10.0 * exponent * np.log10(1.0 / CELL_M)
    saturated = 10.0 * np.log10(63.09)  # z_max <= 10 log10 c (eq 11)
    return Antenna(
        exponent, float(at_1m), 3.3, -90.0, float(np.floor(saturated)), tuple(gains.tolist()), SATURATED_M
    )


def engine(seed: int, period_s: float = PERIOD_S) -> EngineSettings:
    """One robot."""
    size = CELLS * CELL_M
    return EngineSettings(
        Grid(size, size, CELL_M),
        antenna(),
        (("r0",),),
        (0.0,),
        planning_period_s=period_s,
        max_speed_m_s=SPEED_M_S,
        found_probability=0.8,  # p_t of section VII.C
        fence_margin_m=CELL_M / 2.0,
        min_separation_m=CELL_M,
        sensing="directional",
        prior_rule="em",
        seed=seed,
    )


def trial(job: Job) -> dict[str, Any]:
    """One search; in figure 6(a) methods are numbers of sources and x is the period, in the others x is the sources."""
    if job.study == "rwa-fig6a":
        sources, planner, settings = int(job.method.split()[0]), "rwa", engine(job.seed, job.x)
    else:
        sources, planner, settings = round(job.x), job.method, engine(job.seed)
    if job.study == "rwa-fig6b":
        sources, planner = 6, "rwa"
    size = settings.grid.size_east_m
    hidden = tuple(
        random_sources(
            sources,
            size,
            size,
            (0.0,),
            RATE_HZ,
            np.random.default_rng([job.seed, 99]),
            min_separation_m=3 * CELL_M,
        )
    )
    began = wall_s()
    convergence = job.study == "rwa-fig6b"
    cap_s = job.x if convergence else CAP_S
    outcome = search(
        settings, planner, hidden, np.array([[size / 2, size / 2]]), job.seed, cap_s, watch=convergence
    )
    row: dict[str, Any] = {
        "value": outcome.time_s,
        "detections": outcome.detections,
        "false_clusters": outcome.false_clusters,
        "simulated_s": outcome.elapsed_s,
        "wall_s": wall_s() - began,
    }
    if convergence:  # P at the sources at the time x; sources found before stay found
        row["value"] = float(np.mean(outcome.trace[-1][1])) if outcome.trace else 0.0
        steps = np.diff([p for _, p in outcome.trace], axis=0) if len(outcome.trace) > 1 else np.zeros((1, 1))
        row["share_of_steps_down"] = float((steps < -1e-9).mean())
    return row


FIG6A = Experiment(
    "rwa-fig6a", "Time to find all against the planning period", "tau_0, s", "s",
    ("2 sources", "6 sources", "10 sources"), (200, 400, 800, 1600), trial, CAP_S,
)  # fmt: skip
FIG6B = Experiment(
    "rwa-fig6b", "P at the cells of six sources", "s", "mean P", ("rwa",),
    (250, 500, 1000, 2000, 4000, 8000), trial,
)  # fmt: skip
FIG6C = Experiment(
    "rwa-fig6c", "Time to find all, one robot", "sources", "s", METHODS, (2, 4, 6, 8, 10), trial, CAP_S
)


def fig6a(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 6(a): localisation time against tau_0."""
    return run(FIG6A, trials, seed, progress, **how)


def fig6b(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 6(b): how P at the sources converges."""
    return run(FIG6B, trials, seed, progress, **how)


def fig6c(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 6(c): localisation time against the number of sources."""
    return run(FIG6C, trials, seed, progress, **how)
