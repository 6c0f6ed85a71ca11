"""A search from packet to packet: between transmissions nothing is computed, so hours take a second.

For the papers' experiments, whose beliefs know nothing of silence. Robots drive the legs of their plans at the planned
speeds, all robots of a team starting a leg together; positions at each transmission are exact, radios as the antenna
says. Everything random is drawn from the seed before the search begins, so that every method meets the same sources,
packets and noise (common random numbers).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fieldkit import plugins
from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.planning.base import Planner, Situation
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Plan
from fieldkit.world.sources import TransientSource

PERIODIC = ("prwa", "rwa")
"""Planners that plan anew every period; the others when a team has come to the end of its path."""
ROBOTS_APART_M = 0.6
"""How near to each other the studies' planners may send robots; all their published figures are made with it."""


@dataclass(slots=True)
class TimedPath:
    """Where the robots of one group are from now on: corners in time, and which planner's group it is."""

    t_s: FloatArray
    """(k + 1,)"""
    place_m: FloatArray
    """(k + 1, m, 2)"""

    def at(self, t_s: FloatArray) -> FloatArray:
        """(n, m, 2) at times (n,)."""
        index = np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, max(0, len(self.t_s) - 2))
        after = np.minimum(index + 1, len(self.t_s) - 1)
        span = np.maximum(self.t_s[after] - self.t_s[index], 1e-9)
        share = np.clip((t_s - self.t_s[index]) / span, 0.0, 1.0)[:, None, None]
        return np.asarray(self.place_m[index] + share * (self.place_m[after] - self.place_m[index]))


@dataclass(slots=True)
class Outcome:
    """How a search went."""

    time_s: float | None
    """When every source had a cell with P > p_t within one cell of it; None within the limit."""
    elapsed_s: float
    detections: int
    transmissions: int
    false_clusters: int
    """Clusters of cells with P > p_t further than two cells from every source, at the end."""
    plans: int
    trace: list[tuple[float, list[float]]] = field(default_factory=list)
    """Time and P at the source cells after every detection, where asked for."""


def search(
    engine: EngineSettings,
    planner: str,
    hidden: tuple[TransientSource, ...],
    start_m: FloatArray,
    seed: int,
    cap_s: float,
    *,
    channel: Antenna | None = None,
    belief: SpogBelief | None = None,
    watch: bool = False,
    on_detection: Callable[[float, Detection], None] | None = None,
) -> Outcome:
    """Run one search to its end or `cap_s`. `start_m` (robots, 2); `channel` is the true antenna if another."""
    walk = plugins.load("fieldkit.planners", planner)(engine)
    alone = getattr(walk, "alone", planner == "rwa")
    sent = transmissions(hidden, seed, cap_s)
    run = _Search(
        engine=engine,
        walk=walk,
        is_periodic=planner in PERIODIC,
        groups=[(r,) for r in engine.robots] if alone else list(engine.teams),
        hidden=hidden,
        sent=sent,
        noise=np.random.default_rng([seed, 1]).normal(0.0, 1.0, (len(sent.t_s), len(engine.robots))),
        radio=channel or engine.antenna,
        belief=belief or SpogBelief(engine),
        place=dict(zip(engine.robots, np.asarray(start_m, dtype=float), strict=True)),
        watch=watch,
        on_detection=on_detection,
    )
    return run.to_the_end(cap_s)


@dataclass
class _Search:
    """One search under way: what is true, what is believed, and where the robots are."""

    engine: EngineSettings
    walk: Planner
    is_periodic: bool
    """Whether the planner plans anew every period; else when a group has come to the end of its path."""
    groups: list[tuple[str, ...]]
    hidden: tuple[TransientSource, ...]
    sent: "Sent"
    noise: FloatArray
    """(packets, robots) standard normal."""
    radio: Antenna
    belief: SpogBelief
    place: dict[str, FloatArray]
    watch: bool
    on_detection: Callable[[float, Detection], None] | None
    paths: dict[tuple[str, ...], TimedPath] = field(default_factory=dict)
    packet: int = 0
    """How many packets have been sent."""
    next_plan_s: float = 0.0

    def __post_init__(self) -> None:
        self.column = {robot: index for index, robot in enumerate(self.engine.robots)}
        self.near = cells_near(self.engine, self.hidden)
        self.log_found = float(np.log1p(-self.engine.found_probability))
        self.outcome = Outcome(None, 0.0, 0, len(self.sent.t_s), 0, 0)

    def to_the_end(self, cap_s: float) -> Outcome:
        """Plan, drive to the next decision, take in the packets sent meanwhile; until all is found or `cap_s`."""
        now_s = 0.0
        while now_s < cap_s and self.outcome.time_s is None:
            self._plan(now_s)
            until_s = min([cap_s, *(timed.t_s[-1] for timed in self.paths.values())])
            if self.is_periodic:
                until_s = min(until_s, self.next_plan_s)
            until_s = max(until_s, now_s + 0.5)
            self._drive(until_s)
            now_s = until_s if self.outcome.time_s is None else self.outcome.time_s
        self.outcome.elapsed_s = now_s
        self.outcome.false_clusters = _false_clusters(self.belief, self.hidden, self.engine)
        return self.outcome

    def _plan(self, now_s: float) -> None:
        """New paths for the groups that are due for one."""
        periodic = self.is_periodic and now_s >= self.next_plan_s - 1e-9
        due = [
            g for g in self.groups if g not in self.paths or periodic or self.paths[g].t_s[-1] <= now_s + 1e-9
        ]
        if due:
            position = {r: (float(p[0]), float(p[1])) for r, p in self.place.items()}
            plan = self.walk.plan(Situation(round(now_s * 1e9), position, tuple(due), {}), self.belief)
            self.outcome.plans += 1
            for group in due:
                self.paths[group] = timed_path_of(plan, group, self.place, now_s, self.engine.max_speed_m_s)
        if periodic:
            self.next_plan_s = now_s + self.engine.planning_period_s

    def _drive(self, until_s: float) -> None:
        """Everything that is sent and heard until then; it ends with the packet that finds the last source."""
        last = int(np.searchsorted(self.sent.t_s, until_s, side="right"))
        times = self.sent.t_s[self.packet : last]
        at = np.empty((len(times) + 1, len(self.column), 2))
        when = np.append(times, until_s)
        for group, timed in self.paths.items():
            at[:, [self.column[r] for r in group]] = timed.at(when)
        sources, noise = self.sent.source[self.packet : last], self.noise[self.packet : last]
        rss = _heard(self.radio, self.hidden, sources, at[:-1], noise, self.paths, self.column, times)
        for k in np.flatnonzero(~np.isnan(rss).all(axis=1)):
            self._take_in(float(times[k]), at[k], rss[k])
            if all(float(self.belief.log_absent[cells].min()) < self.log_found for cells in self.near):
                self.outcome.time_s = float(times[k])
                break
        self.packet = last
        self.place = {robot: at[-1, self.column[robot]] for robot in self.engine.robots}

    def _take_in(self, t_s: float, at_m: FloatArray, rss_dbm: FloatArray) -> None:
        robots = self.engine.robots
        directed = bool(self.radio.pattern_db)
        heading = _headings(at_m, self.paths, self.column, t_s) if directed else np.zeros(len(robots))
        saturated = np.zeros(len(robots), dtype=bool)
        detection = Detection(round(t_s * 1e9), robots, at_m, heading, rss_dbm, saturated)
        self.belief.detect(detection)
        self.outcome.detections += 1
        if self.on_detection is not None:
            self.on_detection(t_s, detection)
        if self.watch:
            self.outcome.trace.append((t_s, _presence_at(self.belief, self.near)))


@dataclass(frozen=True, slots=True)
class Sent:
    """Packets: when (n,), and from which source (n,)."""

    t_s: FloatArray
    source: np.ndarray


def transmissions(hidden: tuple[TransientSource, ...], seed: int, cap_s: float) -> Sent:
    """All packets in order of time, each source a Poisson process of its own generator."""
    times, sources = [], []
    for index, source in enumerate(hidden):
        rng = np.random.default_rng([seed, 2, index])
        expected = source.rate_hz * cap_s
        gaps = rng.exponential(1.0 / source.rate_hz, int(expected + 6.0 * np.sqrt(expected) + 20))
        at = np.cumsum(gaps)
        at = at[at < cap_s]
        times.append(at)
        sources.append(np.full(len(at), index))
    t, s = np.concatenate(times), np.concatenate(sources)
    order = np.argsort(t, kind="stable")
    return Sent(t[order], s[order])


def timed_path_of(
    plan: Plan, group: tuple[str, ...], place: dict[str, Any], now_s: float, top_m_s: float
) -> TimedPath:
    """Corners in time: a leg lasts until its slowest robot has arrived."""
    legs = max((len(plan.paths.get(r, ())) for r in group), default=0)
    t, corners = [now_s], [np.array([place[r] for r in group])]
    for leg in range(legs):
        here = corners[-1].copy()
        lasts = 0.0
        for index, robot in enumerate(group):
            path = plan.paths.get(robot, ())
            if leg < len(path):
                to = np.array([path[leg].east_m, path[leg].north_m])
                lasts = max(
                    lasts, float(np.hypot(*(to - here[index]))) / max(min(path[leg].speed_m_s, top_m_s), 1e-6)
                )
                here[index] = to
        t.append(t[-1] + lasts)
        corners.append(here)
    if legs == 0 or t[-1] - now_s < 0.5:  # nowhere to go: look again in a while
        t.append(max(t[-1], now_s + 5.0))
        corners.append(corners[-1])
    return TimedPath(np.array(t), np.array(corners))


def _heard(
    radio: Antenna,
    hidden: tuple[TransientSource, ...],
    source: np.ndarray,
    at_m: FloatArray,
    noise: FloatArray,
    paths: dict[tuple[str, ...], TimedPath],
    column: dict[str, int],
    times: FloatArray,
) -> FloatArray:
    """(n, m) integer readings of n packets, nan where a robot does not hear one."""
    where = np.array([(s.east_m, s.north_m) for s in hidden])[source]
    power = np.array([s.power_db for s in hidden])[source]
    offset = where[:, None, :] - at_m
    distance = np.hypot(offset[..., 0], offset[..., 1])
    mean = radio.mean_rss_dbm(distance, power[:, None])
    if radio.pattern_db and len(times):
        heading = np.array([_headings(at_m[k], paths, column, float(t)) for k, t in enumerate(times)])
        mean = mean + radio.gain_db(
            np.degrees(np.arctan2(offset[..., 0], offset[..., 1])) - heading, distance
        )
    reading = np.floor(mean + radio.sigma_db * noise + 0.5)
    heard = reading > radio.threshold_dbm
    if radio.saturation_dbm is not None:
        reading = np.minimum(reading, radio.saturation_dbm)
    return np.where(heard, reading, np.nan)


def readings_dbm(radio: Antenna, source: TransientSource, at_m: FloatArray, noise: FloatArray) -> FloatArray:
    """(m,) integer readings of one packet by robots at (m, 2), antennas the same all round; nan where not heard."""
    distance = np.hypot(*(np.array([source.east_m, source.north_m]) - at_m).T)
    reading = np.floor(radio.mean_rss_dbm(distance, source.power_db) + radio.sigma_db * noise + 0.5)
    return np.where(reading > radio.threshold_dbm, reading, np.nan)


def _headings(
    at_m: FloatArray, paths: dict[tuple[str, ...], TimedPath], column: dict[str, int], t_s: float
) -> FloatArray:
    """(m,) degrees clockwise from north: along the leg each robot is on."""
    heading = np.zeros(len(column))
    for group, timed in paths.items():
        leg = int(np.clip(np.searchsorted(timed.t_s, t_s, side="right") - 1, 0, len(timed.t_s) - 2))
        along = timed.place_m[leg + 1] - timed.place_m[leg]
        for index, robot in enumerate(group):
            heading[column[robot]] = np.degrees(np.arctan2(along[index, 0], along[index, 1])) % 360.0
    return heading


def cells_near(engine: EngineSettings, hidden: tuple[TransientSource, ...]) -> list[np.ndarray]:
    """For each source the flat indices of its cell and the eight round it."""
    grid = engine.grid
    result = []
    for source in hidden:
        row, column = grid.cell_of(source.east_m, source.north_m)
        rows = [r for r in range(row - 1, row + 2) if 0 <= r < grid.n_north]
        columns = [c for c in range(column - 1, column + 2) if 0 <= c < grid.n_east]
        result.append(np.array([r * grid.n_east + c for r in rows for c in columns]))
    return result


def _presence_at(belief: SpogBelief, near: list[np.ndarray]) -> list[float]:
    return [float(-np.expm1(belief.log_absent[cells].min())) for cells in near]


def _false_clusters(belief: SpogBelief, hidden: tuple[TransientSource, ...], engine: EngineSettings) -> int:
    true = np.array([(s.east_m, s.north_m) for s in hidden])
    return sum(
        float(np.hypot(*(true - (s.east_m, s.north_m)).T).min()) > 2.0 * engine.grid.cell_m
        for s in belief.sources()
    )


def with_seed(engine: EngineSettings, seed: int) -> EngineSettings:
    """The same settings for another trial."""
    return replace(engine, seed=seed)
