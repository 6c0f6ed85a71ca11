"""A team without a common computer against one computer, on the same seeds: finds, times, agreement, traffic.

Four robots in two pairs, or eight in four, look for three sources in a field of 16 m, each by its own agent over a
simulated network; radios and sources are those of the trust study. What one computer would have believed is worked out
from the same logs afterwards, and compared by its hash.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fieldkit.engine.grid import Grid
from fieldkit.world.network import Air
from fieldkit.world.sources import TransientSource, random_sources
from mission.core.kernel_settings import KernelSettings
from mission.lab.flock import Flock
from mission.lab.simulate import Truth, simulate
from mission.lab.study import killed
from mission.lab.study.pool import Progress
from mission.lab.study.scenarios import run_scenarios
from mission.lab.study.trust import CELL_M, LEVELS_DB, RATE_HZ, antenna
from mission.lab.study.trust import settings as trust_settings
from mission.safety.limits import SafetySettings
from mission.safety.rules import Safety

FIELD_M, MOST_S = 16.0, 3_000.0
ROBOTS, SOURCES = ("r0", "r1", "r2", "r3"), 3
STARTS_M = {4: (2.0, 4.0, 12.0, 14.0), 8: (1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0, 15.0)}
"""Number of robots to where they stand in a row, east; all 1 m north."""
CENTRAL, CENTRAL_EIGHT = "one computer", "eight robots, one computer"
AIR = Air()
"""Everybody hears everybody, 50 ms late."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """What the network is like, and what happens to the agents."""

    name: str
    air: Air = AIR
    contact_m: float | None = None
    """What the agents are told of the range."""
    clock_s: tuple[float, ...] = ()
    killed_s: float = math.inf
    """When the agent of the last robot dies."""
    kills: bool = False
    """Short trials of `mission.lab.study.killed` instead: somebody dies at any time, and half come back."""
    away_s: float | None = None
    """An agent of those is back after this time instead."""
    robots: int = len(ROBOTS)
    """In pairs."""


HALVES = frozenset(ROBOTS[:2])
SCENARIOS = (
    Scenario(CENTRAL),
    Scenario("full contact"),
    Scenario("contact within 6 m", Air(range_m=6.0), contact_m=6.0),
    Scenario("30 % lost", Air(loss=0.3)),
    Scenario("5 s late", Air(delay_s=5.0)),
    Scenario("30 % lost, 5 s late, out of order", Air(loss=0.3, delay_s=4.0, jitter_s=2.0, repeated=0.1)),
    Scenario("cut in two from 60 to 360 s", Air(cut_s=(60.0, 360.0), apart=HALVES)),
    Scenario(
        "cut in two, contact within 6 m promised", Air(cut_s=(60.0, 360.0), apart=HALVES), contact_m=6.0
    ),
    Scenario("clocks 2 s apart", clock_s=(0.0, 2.0, -2.0, 0.5)),
    Scenario("one agent dies after 100 s", killed_s=100.0),
    Scenario(CENTRAL_EIGHT, robots=8),
    Scenario("eight robots, full contact", robots=8),
    Scenario("eight robots, contact within 6 m", Air(range_m=6.0), contact_m=6.0, robots=8),
    Scenario("killed", kills=True),
    Scenario("back after an hour", kills=True, away_s=3_600.0),
)


@dataclass(frozen=True, slots=True)
class Job:
    """One trial."""

    scenario: Scenario
    seed: int
    most_s: float = MOST_S


def kernel_settings(seed: int, most_s: float, robots: int) -> KernelSettings:
    """What every agent, or the one computer, is given."""
    grid = Grid(FIELD_M, FIELD_M, CELL_M)
    teams = tuple((f"r{k}", f"r{k + 1}") for k in range(0, robots, 2))
    engine = replace(trust_settings(seed), grid=grid, teams=teams, expected_sources=3.0)
    return KernelSettings(engine, max_duration_s=most_s, sources_expected=SOURCES)


def safety_settings(kernel: KernelSettings) -> SafetySettings:
    """The limits of that field."""
    engine = kernel.engine
    return SafetySettings(
        engine.robots,
        FIELD_M,
        FIELD_M,
        max_speed_m_s=engine.max_speed_m_s,
        min_separation_m=engine.min_separation_m,
    )


def hidden(seed: int) -> tuple[TransientSource, ...]:
    """What is to be found; no two nearer than tells them apart, which is another study's business."""
    rng = np.random.default_rng([seed, 99])
    return tuple(
        random_sources(SOURCES, FIELD_M, FIELD_M, LEVELS_DB, RATE_HZ, rng, min_separation_m=6 * CELL_M)
    )


def trial(job: Job) -> dict[str, Any]:
    """One mission of a scenario."""
    if job.scenario.kills:
        return killed.trial(job.seed, job.scenario.away_s)
    scenario = job.scenario
    kernel = kernel_settings(job.seed, job.most_s, scenario.robots)
    start_m = tuple((east_m, 1.0) for east_m in STARTS_M[scenario.robots])
    truth = Truth(antenna(), hidden(job.seed), start_m, max_speed_m_s=kernel.engine.max_speed_m_s)
    safety = safety_settings(kernel)
    if scenario.name in (CENTRAL, CENTRAL_EIGHT):
        judge = Safety(safety)
        result = simulate(
            kernel, truth, job.seed,
            on_step=lambda kernel, event, outcome: [*judge.observe(event), *judge.judge(outcome.commands)],
        )  # fmt: skip
        return {
            "seed": job.seed, "time_s": result.time_to_all_s, "false_finds": result.false_finds,
            "elapsed_s": result.elapsed_s,
        }  # fmt: skip
    flock = Flock(
        kernel, safety, truth, scenario.air, job.seed, contact_m=scenario.contact_m, clock_s=scenario.clock_s
    )
    if scenario.killed_s < math.inf:
        while flock.world.t_s < scenario.killed_s:
            flock.step()
        flock.kill(ROBOTS[-1])
    flown = flock.fly(job.most_s + 30.0)
    return {
        "seed": job.seed,
        "time_s": flown.time_to_all_s,
        "false_finds": flown.false_finds,
        "elapsed_s": flown.elapsed_s,
        "same": flown.same,
        "compared": flown.compared,
        "most_bytes_s": max(flown.bytes_s.values()),
        "oldest_s": flown.oldest_s,
        "merged_s": flown.merged_s,
        "nearest_m": flown.nearest_m,
        "ordered_too_near": flown.ordered_too_near,
        "could_be_known": flown.could_be_known,
    }


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of one scenario; times count only missions that found all."""
    if "victim" in rows[0]:
        return killed.summarise(rows)
    times = np.array([row["time_s"] for row in rows if row["time_s"] is not None])
    told: dict[str, Any] = {
        "trials": len(rows),
        "found_all": int(times.size),
        "mean_time_s": round(float(times.mean()), 1) if times.size else None,
        "false_finds": int(sum(row["false_finds"] for row in rows)),
        "times_s": {str(row["seed"]): row["time_s"] for row in rows},
    }
    if "same" not in rows[0]:
        return told
    merged = [row["merged_s"] for row in rows if row["merged_s"] is not None]
    return told | {
        "same_belief": all(row["same"] for row in rows),
        "beliefs_compared": int(sum(row["compared"] for row in rows)),
        "most_bytes_s": round(max(row["most_bytes_s"] for row in rows), 1),
        "oldest_s": max(row["oldest_s"] for row in rows),
        "merged_within_s": max(merged, default=None),
        "nearest_m": round(min(row["nearest_m"] for row in rows), 2),
        "ordered_too_near": int(sum(row["ordered_too_near"] for row in rows)),
        "could_be_known": int(sum(row["could_be_known"] for row in rows)),
    }


def run(
    trials: int, seed: int, progress: Progress, *, only: str = "", most_s: float = MOST_S, **how: Any
) -> dict[str, Any]:
    """Scenarios whose name contains `only`, `trials` each from `seed` on, with their time against one computer's."""
    result = run_scenarios(
        "agents", SCENARIOS, lambda scenario, at: Job(scenario, at, most_s), trial, summarise, trials, seed, progress,
        only=only, **how,
    )  # fmt: skip
    told = result["scenarios"]
    for scenario in SCENARIOS:
        row, central = told.get(scenario.name), told.get(CENTRAL_EIGHT if scenario.robots == 8 else CENTRAL)
        if row is not None and central is not None and "times_s" in row:
            row["times_central"] = _against(row["times_s"], central["times_s"])
    return result


def _against(mine: dict[str, float | None], central: dict[str, float | None]) -> float | None:
    """Mean time over the mean time of one computer, of the seeds on which both found all."""
    both = [(t, c) for seed, t in mine.items() if t is not None and (c := central[seed]) is not None]
    return round(sum(t for t, _ in both) / sum(c for _, c in both), 3) if both else None
