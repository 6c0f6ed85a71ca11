"""A search by pairs of robots that keep their own beliefs and talk only in range: what DPRWA's experiments need.

Each pair is a `Replica`: it logs its turns and readings, exchanges logs with pairs in range, and feeds its belief up
to its checkpoint. Between events nothing is computed, as in `packets`, from which the packets and their noise come, so
all methods meet the same ones. Pairs in range are looked for every `LOOK_S` and at each meeting of the ring; range
counts between their nearest robots.

A source counts as found when it is in the belief of one pair, and the search ends when one pair has found all.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations
from typing import Protocol

import numpy as np

from fieldkit.engine.belief.base import Snapshot
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.decentralised.exchange import Replica, exchange
from fieldkit.engine.decentralised.tracks import TrackAssociator
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.circle import Period, make_circle
from fieldkit.engine.planning.dprwa import DprwaPlanner
from fieldkit.engine.planning.walks import PairRandomWalk, lanes, typical_range_m
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import FieldkitError
from fieldkit.messages import FloatArray, Pose, RssReading
from fieldkit.world.sources import TransientSource
from mission.lab.study.packets import TimedPath, cells_near, readings_dbm, timed_path_of, transmissions

LOOK_S = 5.0
S = 1_000_000_000


@dataclass(slots=True)
class Apart:
    """How a search of pairs apart went."""

    time_s: float | None
    elapsed_s: float
    detections: int = 0
    """Transmissions that somebody heard."""
    most_held: int = 0
    """The most readings after its checkpoint that a pair had aboard."""
    exchanges: int = 0
    lag_s: list[float] = field(default_factory=list)
    """How far the worst pair's checkpoint lay back, at every look."""


class Motion(Protocol):
    """Where pairs go."""

    def paths(self, now_s: float, here_m: list[FloatArray], team: "Team") -> dict[int, TimedPath]:
        """New paths, by pair, for those that have come to the end of theirs."""
        ...


@dataclass
class Team:
    """All pairs, their replicas and paths."""

    settings: EngineSettings
    replicas: list[Replica]
    paths: dict[int, TimedPath] = field(default_factory=dict)
    meetings_s: list[float] = field(default_factory=list)
    mark_ns: int | None = None
    """The moment whose belief all will plan from; each keeps it when its checkpoint comes past."""
    kept: dict[int, Snapshot] = field(default_factory=dict)


class Ring:
    """DPRWA: every pair plans the period by itself, from the belief of the last period's beginning on the ring."""

    def __init__(self, settings: EngineSettings) -> None:
        self._planners = [DprwaPlanner(settings) for _ in settings.teams]
        self._end_s = 0.0

    def paths(self, now_s: float, here_m: list[FloatArray], team: Team) -> dict[int, TimedPath]:
        if now_s < self._end_s - 1e-6:
            return {}
        if team.mark_ns is None:
            team.kept = {pair: Snapshot.of(replica.belief) for pair, replica in enumerate(team.replicas)}
        periods: list[Period] = []
        for pair, planner in enumerate(self._planners):
            if pair not in team.kept:
                raise FieldkitError(
                    f"dprwa: pair {pair} has no checkpoint after a whole ring: range too short to meet?"
                )
            periods.append(planner.periods(here_m, team.kept[pair])[0][1])
        mine = periods[0]
        self._end_s = now_s + mine.duration_s
        team.mark_ns = round((now_s + mine.ring_start_s) * S)
        team.kept = {}
        team.meetings_s = sorted({now_s + mine.ring_start_s + m.t_s for m in mine.meetings})
        return {
            pair: TimedPath(now_s + period.t_s[pair], period.place_m[pair])
            for pair, period in enumerate(periods)
        }


class Walk:
    """Every pair walks at random."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self._walk = PairRandomWalk(settings)

    def paths(self, now_s: float, here_m: list[FloatArray], team: Team) -> dict[int, TimedPath]:
        fresh = {}
        for pair, group in enumerate(self.settings.teams):
            if pair in team.paths and team.paths[pair].t_s[-1] > now_s + 1e-9:
                continue
            place = dict(zip(group, here_m[pair], strict=True))
            position = {r: (float(e), float(n)) for r, (e, n) in place.items()}
            plan = self._walk.plan(
                Situation(round(now_s * S), position, (group,), {}), team.replicas[pair].belief
            )
            fresh[pair] = timed_path_of(plan, group, place, now_s, self.settings.max_speed_m_s)
        return fresh


class Train:
    """Pairs one behind the other on a fixed route of lanes, so near that all can talk all the time."""

    def __init__(self, settings: EngineSettings, range_m: float) -> None:
        corners = lanes(settings)
        self._circle = make_circle(
            corners, np.zeros(len(corners)), 0.0, settings.max_speed_m_s, typical_range_m(settings),
            {len(team) for team in settings.teams}, settings.grid, settings.fence_margin_m,
        )  # fmt: skip
        self._apart_s = range_m / settings.max_speed_m_s
        self._speed_m_s = settings.max_speed_m_s
        self._started = False

    def paths(self, now_s: float, here_m: list[FloatArray], team: Team) -> dict[int, TimedPath]:
        if self._started and min(timed.t_s[-1] for timed in team.paths.values()) > now_s + 1e-9:
            return {}
        last = len(here_m) - 1
        first_s = [(last - pair) * self._apart_s for pair in range(len(here_m))]
        if not self._started:
            self._started = True
            self._laps = 0
            begin = [self._circle.at(phi, len(here)) for phi, here in zip(first_s, here_m, strict=True)]
            arrive_s = max(
                float(np.hypot(*(a - b).T).max()) / self._speed_m_s
                for a, b in zip(begin, here_m, strict=True)
            )
            return {
                pair: TimedPath(
                    np.array([now_s, now_s + max(arrive_s, 1e-3)]), np.array([here_m[pair], begin[pair]])
                )
                for pair in range(len(here_m))
            }
        paths = {}
        tau = self._circle.tau_s
        for pair, here in enumerate(here_m):
            begin_s = first_s[pair] + self._laps * tau
            moments = [begin_s, *self._circle.corners_s(begin_s, begin_s + tau), begin_s + tau]
            places = np.array([self._circle.at(phi, len(here)) for phi in moments])
            paths[pair] = TimedPath(now_s + np.array(moments) - begin_s, places)
        self._laps += 1
        return paths


def search_apart(
    settings: EngineSettings,
    motion: Motion,
    hidden: tuple[TransientSource, ...],
    start_m: FloatArray,
    seed: int,
    cap_s: float,
    range_m: float,
    make_belief: Callable[[EngineSettings], SpogBelief] = SpogBelief,
) -> Apart:
    """One search to its end or `cap_s`; `start_m` is (robots, 2), `range_m` how far pairs can talk."""
    robots = settings.robots
    names = tuple(f"pair {k}" for k in range(len(settings.teams)))
    team = Team(
        settings,
        [
            Replica(name, names, make_belief(settings), lambda: TrackAssociator(robots), aboard=group)
            for name, group in zip(names, settings.teams, strict=True)
        ],
    )
    sent = transmissions(hidden, seed, cap_s)
    noise = np.random.default_rng([seed, 1]).normal(0.0, 1.0, (len(sent.t_s), len(robots)))
    near = cells_near(settings, hidden)
    log_found = float(np.log1p(-settings.found_probability))
    column = {robot: index for index, robot in enumerate(robots)}
    here = [np.asarray(start_m, dtype=float)[[column[r] for r in group]] for group in settings.teams]
    result = Apart(None, cap_s)
    now_s, packet, next_look_s = 0.0, 0, LOOK_S
    for pair, group in enumerate(settings.teams):
        _log(team.replicas[pair], group, here[pair], 0.0)
    while now_s < cap_s:
        team.paths |= motion.paths(now_s, here, team)
        until_s = min(cap_s, *(float(timed.t_s[-1]) for timed in team.paths.values()))
        moments = _moments(team, now_s, until_s, next_look_s)
        last = int(np.searchsorted(sent.t_s, until_s, side="right"))
        moments += [(float(t), 1, k) for k, t in enumerate(sent.t_s[packet:last], start=packet)]
        for t_s, kind, index in sorted(moments):
            if kind == 0:
                group = settings.teams[index]
                _log(team.replicas[index], group, _at(team.paths[index], t_s), t_s)
            elif kind == 1:
                heard = _hear(team, hidden, sent.source[index], noise[index], t_s, column)
                result.detections += heard
            else:
                if index:
                    next_look_s = t_s + LOOK_S
                _look(team, t_s, range_m, result)
                if any(_found_all(replica, near, log_found) for replica in team.replicas):
                    result.time_s = result.elapsed_s = t_s
                    return result
        here = [_at(team.paths[pair], until_s) for pair in range(len(names))]
        packet, now_s = last, until_s
    return result


def _moments(team: Team, now_s: float, until_s: float, next_look_s: float) -> list[tuple[float, int, int]]:
    """(time, kind, which) of turns (0), and of looks for others: the regular ones (2, 1) and meetings (2, 0)."""
    moments = [
        (float(t), 0, pair)
        for pair, timed in team.paths.items()
        for t in timed.t_s
        if now_s - 1e-9 < t <= until_s + 1e-9
    ]
    moments += [(float(t), 2, 1) for t in np.arange(next_look_s, until_s, LOOK_S)]
    return moments + [(t, 2, 0) for t in team.meetings_s if now_s < t <= until_s + 1e-6]


def _at(timed: TimedPath, t_s: float) -> FloatArray:
    return np.asarray(timed.at(np.array([t_s]))[0])


def _log(replica: Replica, group: tuple[str, ...], place_m: FloatArray, t_s: float) -> None:
    t_ns = round(t_s * S)
    if t_ns < replica.knows_ns[replica.me][replica.me]:
        return  # it has met somebody at this very moment, and has logged its place then
    for robot, (east, north) in zip(group, place_m, strict=True):
        replica.measure(Pose(t_ns, robot, float(east), float(north)))


def _hear(
    team: Team,
    hidden: tuple[TransientSource, ...],
    source: int,
    noise: FloatArray,
    t_s: float,
    column: dict[str, int],
) -> bool:
    """Whoever hears a transmission logs it; whether anybody did."""
    heard = False
    for pair, group in enumerate(team.settings.teams):
        place = _at(team.paths[pair], t_s)
        rss = readings_dbm(team.settings.antenna, hidden[source], place, noise[[column[r] for r in group]])
        for robot, z in zip(group, rss, strict=True):
            if not np.isnan(z):
                heard = True
                team.replicas[pair].measure(RssReading(round(t_s * S), robot, float(z)))
    return heard


def _look(team: Team, t_s: float, range_m: float, result: Apart) -> None:
    """Pairs in range exchange, there and back so that news pass along a chain; then all look for a checkpoint."""
    place = [_at(timed, t_s) for _, timed in sorted(team.paths.items())]
    for replica in team.replicas:
        result.most_held = max(result.most_held, replica.held().readings)
    in_range = [
        (a, b)
        for a, b in combinations(range(len(place)), 2)
        if np.hypot(*(place[a][:, None] - place[b][None]).transpose(2, 0, 1)).min() <= range_m
    ]
    alone = [0] if len(place) == 1 else []  # who has nobody to wait for has a checkpoint whenever it looks
    for pair in sorted({pair for both in in_range for pair in both}.union(alone)):
        _log(team.replicas[pair], team.settings.teams[pair], place[pair], t_s)
        team.replicas[pair].tick(round(t_s * S))
    for a, b in [*in_range, *in_range[::-1]] if len(in_range) > 1 else in_range:
        exchange(team.replicas[a], team.replicas[b])
        result.exchanges += 1
    for pair, replica in enumerate(team.replicas):
        if team.mark_ns is not None and pair not in team.kept and replica.checkpoint_ns >= team.mark_ns:
            replica.synchronise(team.mark_ns)
            team.kept[pair] = Snapshot.of(replica.belief)
        replica.synchronise()
        result.most_held = max(result.most_held, replica.held().readings)
    worst_ns = min(replica.checkpoint_ns for replica in team.replicas)
    result.lag_s.append(t_s - max(worst_ns, 0) / S)


def _found_all(replica: Replica, near: list[np.ndarray], log_found: float) -> bool:
    belief = replica.belief
    assert isinstance(belief, SpogBelief)
    return all(float(belief.log_absent[cells].min()) < log_found for cells in near)
