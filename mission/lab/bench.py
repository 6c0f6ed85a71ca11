"""`fieldkit bench`: the figures the documentation quotes, as JSON, each a ratio within one run where it can be.

A benchmark is a function without arguments that returns plain values, found by name in `fieldkit.benchmarks`.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from fieldkit.channel.model import Antenna
from fieldkit.clock import wall_s
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.likelihood.pairwise import attenuation_db, ratio_tables
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.infogain import InfoGainPlanner
from fieldkit.engine.planning.prwa import PrwaPlanner
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening
from fieldkit.world.channel import sample_rss_dbm


def median_s(action: Callable[[], Any], repeats: int = 21) -> float:
    """Median wall time of a call, after one that is not counted."""
    action()
    times = []
    for _ in range(repeats):
        began = wall_s()
        action()
        times.append(wall_s() - began)
    return float(np.median(times))


def settings(
    *, cells: int = 50, pairs: int = 3, prior_rule: str = "dirichlet", sensing: str = "pairwise"
) -> EngineSettings:
    """The PRWA paper's simulated field: 25 m with 50 x 50 cells, five power levels 2 dB apart."""
    exponent, threshold = 2.53, -90.0
    antenna = Antenna(exponent, threshold + 10 * exponent * np.log10(3.45), 3.3, threshold)
    return EngineSettings(
        Grid(cells * 0.5, cells * 0.5, 0.5),
        antenna,
        tuple((f"r{2 * k}", f"r{2 * k + 1}") for k in range(pairs)),
        (-8.0, -6.0, -4.0, -2.0, 0.0),
        prior_rule=prior_rule,
        sensing=sensing,
    )


def random_detection(engine: EngineSettings, rng: np.random.Generator, hearing: int) -> Detection:
    """A transmission that the first `hearing` robots heard, all robots within a few metres of each other."""
    size = engine.grid.size_east_m
    robots = engine.robots
    position = rng.uniform(0.4 * size, 0.4 * size + 6.0, (len(robots), 2))
    rss = np.where(np.arange(len(robots)) < hearing, np.floor(rng.uniform(-88, -70, len(robots))), np.nan)
    return Detection(0, robots, position, np.zeros(len(robots)), rss, np.zeros(len(robots), dtype=bool))


def pairwise_numpy(
    points_m: FloatArray,
    detection: Detection,
    antenna: Antenna,
    min_range_m: float,
    *,
    by_table: bool = False,
) -> FloatArray:
    """(n,) Theorem 1 in plain numpy: the twin the compiled kernel is measured against.

    As one writes it from the paper, with the integral of eq 12 in closed form (the integral of Phi is
    u Phi(u) + phi(u)); or, `by_table`, by the kernel's own tables with `np.interp`.
    """
    beta = antenna.path_loss_exponent
    _, nodes, log_e11, log_e10 = ratio_tables(antenna.sigma_db, beta)
    scale = np.sqrt(2.0) * antenna.sigma_db

    def integral(u: FloatArray) -> FloatArray:
        return np.asarray(u * ndtr(u) + np.exp(-0.5 * u * u) / np.sqrt(2.0 * np.pi))

    a = attenuation_db(points_m, detection.position_m, antenna, min_range_m)
    z = detection.rss_dbm
    total = np.zeros(points_m.shape[0])
    for p in range(len(z)):
        for q in range(len(z)):
            if np.isnan(z[p]) or p == q:
                continue
            if np.isnan(z[q]):
                x = a[q] - a[p] - (z[p] - antenna.threshold_dbm)
                if by_table:
                    total += np.interp(10.0 ** (x / (5.0 * beta)), nodes, log_e10)
                else:
                    left = 1.0 - scale * (integral((1.0 - x) / scale) - integral(-x / scale))
                    total += np.log(np.maximum(left, 1e-300))
            elif p < q:
                x = a[q] - a[p] - (z[p] - z[q])
                if by_table:
                    total += np.interp(10.0 ** (x / (5.0 * beta)), nodes, log_e11)
                else:
                    inside = ndtr((1.0 - x) / scale) - ndtr((-1.0 - x) / scale)
                    total += np.log(np.maximum(inside, 1e-300))
    return total


def spog_numpy(
    points_m: FloatArray,
    detection: Detection,
    engine: EngineSettings,
    log_prior: FloatArray,
    log_absent: FloatArray,
    *,
    by_table: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """One SPOG update in plain numpy, Dirichlet rule aside: P1 and log(1 - P)."""
    log = (
        pairwise_numpy(points_m, detection, engine.antenna, engine.grid.cell_m / 2, by_table=by_table)
        + log_prior
    )
    p1 = np.exp(log - log.max())
    p1 /= p1.sum()
    return p1, log_absent + np.log1p(-np.minimum(p1, 1.0 - 1e-16))


def spog() -> dict[str, Any]:
    """One SPOG update against the plain numpy twin in the same run: the paper's field, and a very large one."""
    return {
        "2,500 cells, 3 of 6 robots hear": _spog(settings(), 3, 101, 21),
        "1,000,000 cells, 3 of 16 robots hear": _spog(settings(cells=1000, pairs=8), 3, 5, 1),
        "1,000,000 cells, 8 of 16 robots hear": _spog(settings(cells=1000, pairs=8), 8, 5, 1),
    }


def _spog(engine: EngineSettings, hearing: int, repeats: int, twin_repeats: int) -> dict[str, float]:
    detection = random_detection(engine, np.random.default_rng(1), hearing)
    belief = SpogBelief(engine)
    points = engine.grid.centres_m
    log_prior, log_absent = belief.log_prior.copy(), belief.log_absent.copy()
    fast = median_s(lambda: belief.detect(detection), repeats)

    def twin(by_table: bool) -> float:
        return median_s(
            lambda: spog_numpy(points, detection, engine, log_prior, log_absent, by_table=by_table),
            twin_repeats,
        )

    plain, tabled = twin(False), twin(True)
    return {
        "update_ms": 1e3 * fast,
        "numpy_twin_ms": 1e3 * plain,
        "times_faster": plain / fast,
        "numpy_with_our_tables_ms": 1e3 * tabled,
        "times_faster_than_with_tables": tabled / fast,
    }


def plan() -> dict[str, Any]:
    """One PRWA plan with entropy spacing: 3 pairs, three clusters of about 250 cells."""
    engine = settings()
    belief = SpogBelief(engine)
    presence = np.zeros(engine.grid.shape)
    for row, column in ((8, 8), (8, 40), (40, 25)):
        presence[row - 8 : row + 8, column - 8 : column + 8] = 0.2
    belief.log_absent = np.log1p(-presence.ravel())
    belief.log_prior = np.log((presence.ravel() + 1e-6) / (presence + 1e-6).sum())
    planner = PrwaPlanner(engine)
    place = {robot: (3.0 + 3.0 * k, 12.0) for k, robot in enumerate(engine.robots)}
    situation = Situation(0, place, engine.teams, {})
    return {
        "plan_ms": 1e3 * median_s(lambda: planner.plan(situation, belief), 5),
        "pairs": 3,
        "cells_per_cluster": 256,
    }


def heard_by_team(
    engine: EngineSettings, place: tuple[float, float], power_db: float, rng: np.random.Generator
) -> Detection:
    """A transmission from `place` as a team around it hears it; the channel is tried until somebody does."""
    while True:
        robots = np.array(place) + rng.normal(0.0, 2.0, (len(engine.robots), 2))
        rss = sample_rss_dbm(engine.antenna, np.hypot(*(robots - place).T), power_db, rng)
        if not np.isnan(rss).all():
            m = len(engine.robots)
            return Detection(0, engine.robots, robots, np.zeros(m), rss, np.zeros(m, dtype=bool))


def loaded_belief(engine: EngineSettings, detections: int, rng: np.random.Generator) -> IntensityBelief:
    """The default belief after so many detections of eight sources spread over the field, in turn.

    The team listens as long round each source as a source of the reference rate takes to send once.
    """
    belief = IntensityBelief(engine)
    size = min(engine.grid.size_east_m, 50.0)
    places = [(float(e), float(n)) for e, n in rng.uniform(0.1 * size, 0.9 * size, (8, 2))]
    wait_ns = round(1e9 / engine.reference_rate_hz)
    for k in range(detections):
        heard = heard_by_team(engine, places[k % 8], -4.0, rng)
        belief.listen(Listening(0, wait_ns, heard.robots, heard.position_m))
        belief.detect(heard)
    return belief


def belief() -> dict[str, Any]:
    """One update and one replan of the default engine: 8 robots, 8 sources, 300 detections, on two sizes of field."""
    return {
        "2,500 cells, 300 detections": _one_look(50, 300),
        "250,000 cells, 300 detections": _one_look(500, 300),
    }


def belief_long() -> dict[str, Any]:
    """The same after ever more detections: the cost must not grow with them. Takes many minutes."""
    return {f"2,500 cells, {n:,} detections": _one_look(50, n) for n in (300, 1_000, 3_000, 10_000)}


def _one_look(cells: int, detections: int) -> dict[str, float]:
    engine = settings(cells=cells, pairs=4, prior_rule="em", sensing="levels")
    rng = np.random.default_rng(7)
    loaded = loaded_belief(engine, detections, rng)
    planner = InfoGainPlanner(engine)
    place = {robot: (5.0 + 1.5 * k, 10.0) for k, robot in enumerate(engine.robots)}
    situation = Situation(0, place, planner.teams(engine.teams), {})
    news = iter([heard_by_team(engine, (12.0, 12.0), -4.0, rng) for _ in range(12)])
    update_s = median_s(lambda: loaded.detect(next(news)), 9)
    plan_s = median_s(lambda: planner.plan(situation, loaded), 5)
    return {"update_ms": 1e3 * update_s, "replan_ms": 1e3 * plan_s, "both_ms": 1e3 * (update_s + plan_s)}


def kernel() -> dict[str, Any]:
    """Simulated seconds per wall second of the kernel loop: the default engine, 6 robots, 4 sources, 600 s."""
    from fieldkit.world.sources import random_sources
    from mission.core.kernel_settings import KernelSettings
    from mission.lab.simulate import Truth, simulate

    engine = settings(prior_rule="em", sensing="levels")
    sources = tuple(random_sources(4, 25.0, 25.0, engine.power_levels_db, 0.05, np.random.default_rng(5)))
    truth = Truth(engine.antenna, sources, tuple((2.0 + 2.0 * k, 1.0) for k in range(6)))
    run = KernelSettings(engine, max_duration_s=600.0, sources_expected=99)
    simulate(run, truth, 0)
    began = wall_s()
    result = simulate(run, truth, 1)
    took = wall_s() - began
    return {
        "simulated_s_per_wall_s": result.elapsed_s / took,
        "simulated_s": result.elapsed_s,
        "detections": result.kernel.detections,
    }


def replay() -> dict[str, Any]:
    """Replay of a recorded simulated mission of 600 s with 4 robots: times real time."""
    from mission.lab.synthetic import record_simulated
    from mission.replay.replay import replay as replay_log

    with tempfile.TemporaryDirectory() as folder:
        log = record_simulated(Path(folder), seed=3, duration_s=600.0)
        done = replay_log(log)
        return {
            "times_real_time": done.duration_s / done.wall_s,
            "events_per_s": done.events / done.wall_s,
            "events": done.events,
            "size_mb": log.stat().st_size / 1e6,
        }


def particles() -> dict[str, Any]:
    """One step of the CSMA particle filter: 5,000 particles of 10 sources, collisions of any two counted."""
    from fieldkit.engine.belief.particles import ParticleFilter, Strength
    from fieldkit.engine.likelihood.csma import dipole_gain, packet_shares

    gain = dipole_gain(np.radians(np.arange(360.0)))
    cloud = ParticleFilter((100.0, 100.0), 10, Strength(1e5, 2.0, gain, 2.0), np.random.default_rng(0))
    rng = np.random.default_rng(1)
    readings = iter([((*rng.uniform(0, 100, 2), 0.3), float(rng.integers(20, 600))) for _ in range(40)])

    def step() -> None:
        robot, z = next(readings)
        cloud.update(robot, z, *packet_shares(0.01, 10))
        cloud.most_probable(2.0)

    return {"step_ms": 1e3 * median_s(step, 31), "particles": 5000, "sources": 10}
