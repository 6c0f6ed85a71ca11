"""The DPRWA paper's experiments (section VI) flown by agents: the robots' own code, over a network with a range.

World, radios, sources and their seeds are those of `dprwa`; the transmissions are drawn anew, as agents live in ticks
and not from packet to packet. Every robot has an agent of its own, with safety and a limit on what it sends, where
`dprwa` has a replica for each pair that exchanges all at once. `replicas` is `dprwa`'s own search on the same seeds.

A source counts as found when it is in the belief that an agent acts on, and the search ends when one agent has all.
"""

import math
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from fieldkit.clock import wall_s
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.decentralised.logs import Stream
from fieldkit.engine.planning.dprwa_apart import DprwaApartPlanner, Team
from fieldkit.engine.settings import EngineSettings
from fieldkit.world.network import Air
from fieldkit.world.sources import TransientSource, random_sources
from mission.core.kernel_settings import KernelSettings
from mission.lab.flock import START_NS, Flock
from mission.lab.simulate import Truth
from mission.lab.study.apart import LOOK_S
from mission.lab.study.dprwa import RANGE_M, RATE_HZ, ROBOTS, SOURCES
from mission.lab.study.dprwa import trial as replicas
from mission.lab.study.experiment import Experiment, Job, run
from mission.lab.study.packets import cells_near
from mission.lab.study.pool import Progress
from mission.lab.study.prwa import CAP_S, LEVELS_DB, engine
from mission.safety.limits import SafetySettings

PLANNERS = {"agents": "dprwa-apart", "agents-random-walk": "pair-random-walk"}
METHODS = (*PLANNERS, "replicas")
PLANNING_S = 30.0
"""Robots that had to give way learn at the next planning how to be on their ring again; the paper's have no safety."""
LATE_S = 10.0
"""A meeting is kept where the teams were in range no further from its time than this."""


@dataclass
class Watch:
    """What is noted of a team under way."""

    flock: Flock
    near: list[np.ndarray]
    """The cells round each source."""
    range_m: float
    nearest_m: float = math.inf
    """The least distance between two robots."""
    most_held: int = 0
    lag_s: list[float] = field(default_factory=list)
    met: list[tuple[float, Team, Team]] = field(default_factory=list)
    """When which teams were in range."""
    meetings: set[tuple[float, Team, Team]] = field(default_factory=set)
    """When they should be, by anybody's ring."""
    rings: dict[int, set[int]] = field(default_factory=dict)
    """Number of a period to the ends that agents had it end at."""

    def look(self) -> bool:
        """Note what is so now; whether one agent has found all."""
        flock, now_s = self.flock, self.flock.world.t_s
        self.lag_s.append(max(flock.lag_s(name) for name in flock.agents))
        for agent in flock.agents.values():
            held = sum(
                len(agent.logs.entries[key]) - agent.common.fed.get(key, 0)
                for key in agent.logs.keys(agent.logs.robots)
                if key[1] == Stream.HEARD
            )
            self.most_held = max(self.most_held, held)
            planner = agent.line.kernel.planner
            if isinstance(planner, DprwaApartPlanner) and planner.period:
                self.rings.setdefault(planner.period, set()).add(planner.until_ns)
                self.meetings |= {
                    ((t_ns - START_NS) * 1e-9, first, second) for t_ns, first, second in planner.meetings_ns
                }
        place_m = {name: (rover.east_m, rover.north_m) for name, rover in flock.world.rovers.items()}
        for first, second in combinations(flock.settings.engine.teams, 2):
            if min(math.dist(place_m[a], place_m[b]) for a in first for b in second) <= self.range_m:
                self.met.append((now_s, first, second))
        return any(self._has_all(agent.line.kernel.belief) for agent in flock.agents.values())

    def _has_all(self, belief: object) -> bool:
        assert isinstance(belief, SpogBelief)
        found = math.log1p(-self.flock.settings.engine.found_probability)
        return all(float(belief.log_absent[cells].min()) < found for cells in self.near)

    def told(self, time_s: float | None) -> dict[str, Any]:
        """The row of a trial."""
        flock = self.flock
        due = [each for each in self.meetings if each[0] <= flock.world.t_s - LATE_S]
        kept = sum(
            any(abs(t_s - when_s) <= LATE_S and {first, second} == {*who} for when_s, *who in self.met)
            for t_s, first, second in due
        )
        return {
            "value": time_s,
            "most_held": self.most_held,
            "mean_lag_s": float(np.mean(self.lag_s)),
            "most_bytes_s": max(flock.network.carried.values()) / flock.world.t_s,
            "meetings": len(due),
            "meetings_kept": kept,
            "rings": len(self.rings),
            "rings_alike": sum(len(ends) == 1 for ends in self.rings.values()),
            "same_belief": flock.agrees(),
            "nearest_m": self.nearest_m,
            "ordered_too_near": flock.too_near.orders,
            "could_be_known": flock.too_near.could_be_known,
            "simulated_s": flock.world.t_s,
        }


def flock(
    settings: EngineSettings, planner: str, hidden: tuple[TransientSource, ...], seed: int, range_m: float
) -> Flock:
    """The team, in a row at the field's southern border."""
    size_m, speed_m_s = settings.grid.size_east_m, settings.max_speed_m_s
    start_m = tuple((2.0 + 1.6 * k, 1.0) for k in range(len(settings.robots)))
    return Flock(
        KernelSettings(settings, "spog", planner, max_duration_s=10.0 * CAP_S),
        SafetySettings(
            settings.robots, size_m, size_m, max_speed_m_s=speed_m_s, min_separation_m=settings.min_separation_m
        ),
        Truth(settings.antenna, hidden, start_m, max_speed_m_s=speed_m_s),
        Air(range_m=range_m),
        seed,
        contact_m=range_m,
    )  # fmt: skip


def trial(job: Job, cap_s: float = CAP_S) -> dict[str, Any]:
    """One search; x is the range (3a), the robots (3b) or the sources (3c); in 3a the value is the readings held."""
    study = job.study.replace("dprwa-agents", "dprwa")
    if job.method == "replicas":
        return replicas(Job(study, "dprwa", job.x, job.seed))
    range_m = job.x if study == "dprwa-fig3a" else RANGE_M
    robots = round(job.x) if study == "dprwa-fig3b" else ROBOTS
    sources = round(job.x) if study == "dprwa-fig3c" else SOURCES
    settings = replace(engine(job.seed, robots), planning_period_s=PLANNING_S)
    size_m = settings.grid.size_east_m
    hidden = tuple(
        random_sources(sources, size_m, size_m, LEVELS_DB, RATE_HZ, np.random.default_rng([job.seed, 99]))
    )
    began = wall_s()
    watch = Watch(
        flock(settings, PLANNERS[job.method], hidden, job.seed, range_m),
        cells_near(settings, hidden),
        range_m,
    )
    team, time_s = watch.flock, None
    team.begin()
    while time_s is None and team.world.t_s < cap_s:
        for _ in range(round(LOOK_S / team.world.step_s)):
            team.step()
            watch.nearest_m = min(watch.nearest_m, team.nearest_m())
        time_s = team.world.t_s if watch.look() else None
    row = watch.told(time_s)
    if study == "dprwa-fig3a":
        row |= {"value": row["most_held"], "time_s": row["value"]}
    return {**row, "wall_s": wall_s() - began}


FIG3A = Experiment(
    "dprwa-agents-fig3a", "Readings aboard, eight robots, six sources", "range of communication, m",
    "most readings held", METHODS, (4, 6, 10, 15), trial,
)  # fmt: skip
FIG3B = Experiment(
    "dprwa-agents-fig3b", "Time to find all, six sources", "robots", "s", METHODS, (4, 8, 12), trial, CAP_S
)
FIG3C = Experiment(
    "dprwa-agents-fig3c",
    "Time to find all, eight robots",
    "sources",
    "s",
    METHODS,
    (2, 4, 6, 8),
    trial,
    CAP_S,
)


def fig3a(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 3(a) by agents: readings aboard against the range of communication."""
    return run(FIG3A, trials, seed, progress, **how)


def fig3b(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 3(b) by agents: time against the number of robots."""
    return run(FIG3B, trials, seed, progress, **how)


def fig3c(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 3(c) by agents: time against the number of sources."""
    return run(FIG3C, trials, seed, progress, **how)
