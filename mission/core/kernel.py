"""The whole mission as one pure function of its inbox: association, belief, planner, phase.

`step(event)` decides; somebody else acts. It reads no clock, no file and no random state but its own seeded
generators, so feeding a recorded inbox gives the same belief and the same commands, bit for bit.
"""

import hashlib
import struct
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fieldkit import plugins
from fieldkit import settings as given
from fieldkit.engine.association.detections import Associator
from fieldkit.engine.belief.base import Belief
from fieldkit.engine.planning.base import Planner, Situation
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import (
    Command,
    Detection,
    EndMission,
    Event,
    GoTo,
    Listening,
    Operator,
    Plan,
    Pose,
    ReceiverState,
    RssReading,
    SourceEstimate,
    Tick,
    VehicleState,
    Waypoint,
)


@dataclass(frozen=True, slots=True)
class KernelSettings:
    """What the kernel needs beyond the engine's settings."""

    engine: EngineSettings
    belief: str = "intensity"
    planner: str = "infogain"
    association_window_s: float = given.WINDOW_S.default
    association_lateness_s: float = given.LATENESS_S.default
    max_pose_gap_s: float = given.POSE_GAP_S.default
    arrive_m: float = given.ARRIVE_M.default
    """A robot so near to its way-point has arrived."""
    altitude_m: Mapping[str, float] = field(default_factory=dict, hash=False)
    """Robots that fly, and how high."""
    max_duration_s: float = given.MAX_DURATION_S.default
    sources_expected: int | None = None
    """End when this many are found; None where nobody knows."""
    stop_probability_left: float | None = None
    """End when the probability that a source is left falls below this."""
    stop_after_periods: int | None = None
    """End when nothing more was found in so many planning periods in a row: k_max of RWA and PRWA's Algorithm 2."""
    receiver_down_limit_s: float = given.RADIO_TIMEOUT_S.default
    """A robot whose radio is down for longer is not planned for: its team goes on without it."""
    battery_reserve_pct: float = given.BATTERY_RESERVE_PCT.default
    """What must be left when a robot is home again."""
    battery_pct_per_m: float = 0.0
    """What a metre costs; 0 where it is not known: then no path is too long."""
    idle_limit_s: float = given.IDLE_LIMIT_S
    """End when no robot could be steered for this long: somebody has to look."""


MOST_AT_ONCE = 5
"""Transmissions taken in at one tick: a step that takes seconds would leave nobody to steer."""
MOST_WAITING = 200
REFLECT_S = 2.0
"""Thinking over waits for a moment without a transmission, but no longer than this."""
NEWS_RANGES = 2.0
"""Within so many nominal ranges of the loudest source, what a robot hears may be from a source not found yet."""
NEWS_EVERY_S = 5.0
"""A team is not planned for anew more often on what it hears."""
SLOWER = 1.6
"""A leg may take so much longer than at the speed asked for: vehicles turn, and drive below a limit, not at it."""
LATE_LEGS = 3
"""So many legs in a row that ended by time-out are worth a word."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one event led to."""

    commands: tuple[Command, ...] = ()
    detections: tuple[Detection, ...] = ()
    plan: Plan | None = None
    notes: tuple[str, ...] = ()


NOTHING = Outcome()


@dataclass
class _Robot:
    pose: Pose | None = None
    home_m: tuple[float, float] | None = None
    """Where it was first seen: where it has to come back to."""
    vehicle: VehicleState | None = None
    held: bool = False
    """Held by the operator until resumed."""
    receiver_down_ns: int | None = None
    """Since when its radio is down."""


@dataclass
class _Task:
    """A team on its way along a plan."""

    paths: dict[str, tuple[Waypoint, ...]]
    began_ns: int
    leg: int = 0
    leg_started_ns: int = 0
    leg_limit_s: float = 0.0
    sent: bool = False


@dataclass
class Kernel:
    """See the module."""

    settings: KernelSettings
    started_ns: int | None = None
    ended: bool = False
    found_at_s: dict[int, float] = field(default_factory=dict)
    """Source identity to mission time of its (last) find."""

    def __post_init__(self) -> None:
        engine = self.settings.engine
        self.belief: Belief = plugins.load("fieldkit.beliefs", self.settings.belief)(engine)
        self.planner: Planner = plugins.load("fieldkit.planners", self.settings.planner)(engine)
        self.associator = Associator(
            engine.robots,
            window_s=self.settings.association_window_s,
            lateness_s=self.settings.association_lateness_s,
            max_pose_gap_s=self.settings.max_pose_gap_s,
        )
        self.robots = {robot: _Robot() for robot in engine.robots}
        self.removed: set[int] = set()
        """Sources the operator has taken away, by identity."""
        self.detections = 0
        self._closed = engine.keep_out
        self._backlog: deque[Detection] = deque()
        self.legs_timed_out: Counter[str] = Counter()
        """Robot to how many of its legs ended by time-out, not at their way-points."""
        self._late_legs: Counter[str] = Counter()
        """The same, in a row."""
        self.left_out = 0
        """Transmissions that were not thought about for lack of time."""
        self._now_ns = 0
        self._tasks: dict[tuple[str, ...], _Task] = {}
        self._next_plan_ns: int | None = None
        self._reflected_ns = 0
        self._unplanned: set[tuple[str, ...]] = set()
        """Teams that wait for a plan."""
        self._planned_ns: dict[tuple[str, ...], int] = {}
        self._steered_ns: int | None = None
        self._commands_digest = hashlib.sha256()
        self._sources: list[SourceEstimate] | None = None

    # -- the one entry ---------------------------------------------------------------------------------------

    def step(self, event: Event) -> Outcome:
        """Take in one event and say what to do. Unknown robots are ignored."""
        match event:
            case RssReading():
                self.associator.reading(event)
                outcome = NOTHING
            case Pose():
                self.associator.pose(event)
                if event.robot in self.robots:
                    robot = self.robots[event.robot]
                    robot.pose, robot.home_m = event, robot.home_m or (event.east_m, event.north_m)
                outcome = NOTHING
            case ReceiverState():
                self.associator.receiver(event)
                if event.robot in self.robots:
                    robot = self.robots[event.robot]
                    robot.receiver_down_ns = None if event.up else robot.receiver_down_ns or event.t_ns
                outcome = NOTHING
            case VehicleState():
                if event.robot in self.robots:
                    self.robots[event.robot].vehicle = event
                outcome = NOTHING
            case Operator():
                outcome = self._operator(event)
            case Tick():
                outcome = self._tick(event.t_ns)
        for command in outcome.commands:
            self._commands_digest.update(repr(command).encode())
        return outcome

    def digest(self) -> str:
        """Hex digest of the belief."""
        return self.belief.digest().hex()

    def commands_digest(self) -> str:
        """Hex digest of all commands given so far."""
        return self._commands_digest.hexdigest()

    def sources(self) -> list[SourceEstimate]:
        """The belief's present estimates."""
        if self._sources is None:
            self._sources = [
                replace(source, state="removed") if source.ident in self.removed else source
                for source in self.belief.sources()
            ]
        return self._sources

    def elapsed_s(self, t_ns: int) -> float:
        """Mission time since the first tick."""
        return 0.0 if self.started_ns is None else (t_ns - self.started_ns) * 1e-9

    # -- decisions ---------------------------------------------------------------------------------------

    def _operator(self, event: Operator) -> Outcome:
        if event.action == "remove":
            return self._remove(event)
        if event.action == "exclude":
            return self._exclude(event)
        targets = self.robots if event.robot is None else {event.robot: self.robots.get(event.robot)}
        for robot in targets.values():
            if robot is not None and event.action in ("hold", "return", "release", "withdraw"):
                robot.held = True
            elif robot is not None and event.action == "resume":
                robot.held = False
        self._tasks = {team: e for team, e in self._tasks.items() if not any(r in targets for r in team)}
        if event.action == "resume":
            self._next_plan_ns = None
        if event.action == "end":
            return self._end(event.t_ns, event.reason or "the operator ended the mission")
        who = "safety" if event.action == "withdraw" else "operator"
        why = f": {event.reason}" if event.reason else ""
        return Outcome(notes=(f"{who}: {event.action} {event.robot or 'all'}{why}",))

    def _remove(self, event: Operator) -> Outcome:
        """A transmitter that was taken away stays in the list and is looked for no more."""
        known = {source.ident for source in self.sources()}
        if event.source is None or event.source not in known:
            return Outcome(notes=(f"operator: there is no source {event.source} to remove",))
        self.removed.add(event.source)
        self._sources = None
        return Outcome(notes=(f"operator: source {event.source} has been taken away",))

    def _exclude(self, event: Operator) -> Outcome:
        """Plan anew round an area that robots must not enter from now on."""
        if len(event.area_m) < 3 or not np.isfinite(event.area_m).all():
            return Outcome(notes=("operator: an area needs at least three corners: nothing was closed",))
        self._closed = self._closed.also(event.area_m)
        planner = plugins.load("fieldkit.planners", self.settings.planner)
        self.planner = planner(replace(self.settings.engine, keep_out=self._closed))
        self._tasks.clear()
        self._next_plan_ns = None
        return Outcome(notes=("operator: an area was closed to all robots",))

    def _tick(self, now_ns: int) -> Outcome:
        if self.ended:
            return NOTHING
        self._now_ns = now_ns
        if self.started_ns is None:
            self.started_ns = now_ns
        teams = self._teams()
        held = any(robot.held for robot in self.robots.values())
        if teams or held or self._steered_ns is None:
            self._steered_ns = now_ns  # a hold by the operator may last
        notes: list[str] = []
        detections, stretches = self._due(now_ns, notes)
        for stretch in stretches:
            self.belief.listen(stretch)
        changed = self._believe(now_ns, detections)
        found_more = changed and self._note_finds(now_ns, notes)
        if reason := self._finished(now_ns, changed):
            ended = self._end(now_ns, reason)
            return Outcome(ended.commands, tuple(detections), None, (*notes, *ended.notes))
        self._unplanned.update(self._with_news(now_ns, teams, detections))
        plan = self._plan(now_ns, self._to_plan(now_ns, teams, found_more))
        commands = self._follow(now_ns, notes)
        return Outcome(tuple(commands), tuple(detections), plan, tuple(notes))

    def _believe(self, now_ns: int, detections: list[Detection]) -> bool:
        """Take in what was heard, or think it over when nothing is; whether the belief may have changed."""
        if detections:
            self.belief.detect_all(detections)
            self.detections += len(detections)
        changed = bool(detections)
        if not detections or (now_ns - self._reflected_ns) * 1e-9 > REFLECT_S:
            self._reflected_ns = now_ns
            changed = self.belief.reflect() or changed
        if changed:
            self._sources = None
        return changed

    def _with_news(
        self, now_ns: int, teams: tuple[tuple[str, ...], ...], detections: list[Detection]
    ) -> tuple[tuple[str, ...], ...]:
        """Teams that have just heard something near a source not found yet, and should stay rather than drive on.

        A planner that plans for all at once is not asked for the sake of one team.
        """
        if not detections or not self._team_by_team:
            return ()
        open_m = [(s.east_m, s.north_m) for s in self.sources() if s.state in ("candidate", "inconsistent")]
        engine = self.settings.engine
        reach_m = NEWS_RANGES * float(engine.antenna.nominal_range_m(max(engine.power_levels_db)))
        heard_by = {
            robot
            for detection in detections
            for robot, heard, place_m in zip(
                detection.robots, detection.heard, detection.position_m, strict=True
            )
            if heard and any(np.hypot(*(place_m - source_m)) <= reach_m for source_m in open_m)
        }
        latest_ns = now_ns - round(NEWS_EVERY_S * 1e9)
        return tuple(
            team
            for team in teams
            if heard_by.intersection(team) and self._planned_ns.get(team, 0) <= latest_ns
        )

    @property
    def _team_by_team(self) -> bool:
        return self.planner.TEAM_BY_TEAM

    def _to_plan(
        self, now_ns: int, teams: tuple[tuple[str, ...], ...], found_more: bool
    ) -> tuple[tuple[str, ...], ...]:
        """Which teams to plan for at this tick.

        A planner that goes team by team is asked for one a tick, the longest planned first: with many teams a plan for
        all would keep the radios waiting.
        """
        if self._next_plan_ns is None or now_ns >= self._next_plan_ns or found_more:
            self._next_plan_ns = now_ns + round(self.settings.engine.planning_period_s * 1e9)
            self._unplanned = set(teams)
        self._unplanned.update(team for team in teams if team not in self._tasks)
        waiting = sorted(self._unplanned.intersection(teams), key=lambda t: (self._planned_ns.get(t, 0), t))
        if self._team_by_team:
            waiting = waiting[:1]
        self._unplanned.difference_update(waiting)
        self._planned_ns.update(dict.fromkeys(waiting, now_ns))
        return tuple(waiting)

    def _due(self, now_ns: int, notes: list[str]) -> tuple[list[Detection], list[Listening]]:
        """What has become certain, no more at once than leaves time to steer; beyond a backlog the oldest are left."""
        certain, stretches = self.associator.advance(now_ns)
        self._backlog.extend(certain)
        if (too_many := len(self._backlog) - MOST_WAITING) > 0:
            for _ in range(too_many):
                self._backlog.popleft()
            if not self.left_out:
                notes.append("more is heard than can be thought about: the oldest transmissions are left out")
            self.left_out += too_many
        count = min(MOST_AT_ONCE, len(self._backlog))
        return [self._backlog.popleft() for _ in range(count)], stretches

    def _note_finds(self, now_ns: int, notes: list[str]) -> bool:
        """Keep the times of finds; whether one was made or withdrawn."""
        changed = False
        found = {source.ident: source for source in self.sources() if self._counts(source)}
        for ident, source in found.items():
            if ident not in self.found_at_s:
                self.found_at_s[ident] = self.elapsed_s(now_ns)
                notes.append(
                    f"found source {ident} at {source.east_m:.2f} m east, {source.north_m:.2f} m north "
                    f"(P {source.p_here:.2f}, {source.receptions:.1f} receptions)"
                )
                changed = True
        for ident in [i for i in self.found_at_s if i not in found]:
            del self.found_at_s[ident]
            why = next((s.note for s in self.sources() if s.ident == ident), "") or "merged with another"
            notes.append(f"source {ident} is no longer found: {why}")
            changed = True
        return changed

    def _counts(self, source: SourceEstimate) -> bool:
        """Found; one that was taken away counts only if it had been found before."""
        return source.state == "found" or (source.state == "removed" and source.ident in self.found_at_s)

    def _finished(self, now_ns: int, changed: bool) -> str:
        if self.elapsed_s(now_ns) >= self.settings.max_duration_s:
            return f"time is up ({self.settings.max_duration_s:.0f} s)"
        if self._steered_ns is not None and (now_ns - self._steered_ns) * 1e-9 > self.settings.idle_limit_s:
            return f"no robot could be steered for {self.settings.idle_limit_s:.0f} s"
        wanted = self.settings.sources_expected
        if wanted is not None and len(self.found_at_s) >= wanted:
            return f"all {wanted} expected sources are found"
        periods = self.settings.stop_after_periods
        if periods is not None:
            latest_s = max(self.found_at_s.values(), default=0.0)
            if self.elapsed_s(now_ns) - latest_s >= periods * self.settings.engine.planning_period_s:
                return f"nothing more was found in {periods} planning periods"
        limit = self.settings.stop_probability_left
        if limit is None or not (changed or self._next_plan_ns is None or now_ns >= self._next_plan_ns):
            return ""  # it changes slowly and costs a look at the whole field
        if (left := self.belief.probability_left()) < limit:
            return f"the probability that a source is left is {left:.3f}"
        return ""

    def _end(self, now_ns: int, reason: str) -> Outcome:
        self.ended = True
        self._tasks.clear()
        return Outcome(commands=(EndMission(now_ns, reason),), notes=(f"end: {reason}",))

    def _steerable(self, name: str) -> bool:
        robot = self.robots[name]
        if robot.pose is None or robot.held:
            return False
        down_ns = robot.receiver_down_ns
        if down_ns is not None and (self._now_ns - down_ns) * 1e-9 > self.settings.receiver_down_limit_s:
            return False
        vehicle = robot.vehicle
        return vehicle is None or (vehicle.link_up and vehicle.mode in ("guided", "hold"))

    def _teams(self) -> tuple[tuple[str, ...], ...]:
        teams = (tuple(r for r in team if self._steerable(r)) for team in self.settings.engine.teams)
        return tuple(team for team in teams if team)

    def _plan(self, now_ns: int, teams: tuple[tuple[str, ...], ...]) -> Plan | None:
        if not teams:
            return None
        self._tasks = {
            team: e for team, e in self._tasks.items() if team not in teams and team in self._teams()
        }
        position = {
            name: (robot.pose.east_m, robot.pose.north_m)
            for name, robot in self.robots.items()
            if robot.pose is not None
        }
        busy = {
            team: Plan(now_ns, {r: p[e.leg :] for r, p in e.paths.items()}) for team, e in self._tasks.items()
        }
        range_m = {name: left for name in position if (left := self._range_m(name)) is not None}
        home_m = {name: robot.home_m for name, robot in self.robots.items() if robot.home_m is not None}
        stray = {name: back for name in position if (back := self._way_back(position[name])) is not None}
        inside = tuple(team for team in teams if not stray.keys() & team)
        plan = self.planner.plan(
            Situation(now_ns, position, inside, busy, range_m, home_m, frozenset(self.removed)), self.belief
        )
        for team in teams:
            if team not in inside:
                for robot in team:
                    plan.paths[robot] = (stray[robot],) if robot in stray else ()
                    plan.purpose[robot] = "back inside" if robot in stray else "wait"
            self._tasks[team] = _Task({robot: plan.paths.get(robot, ()) for robot in team}, now_ns)
        return plan

    def _way_back(self, place_m: tuple[float, float]) -> Waypoint | None:
        """Where a robot that stands outside the fence or on closed ground goes first; None for one that does not."""
        closed = self._closed if self._closed.fence else replace(self._closed, fence=self._rectangle())
        if closed.wider(0.0).clearance_m(place_m) >= 0.0:
            return None
        engine = self.settings.engine
        east_m, north_m = closed.wider(engine.fence_margin_m + self.settings.arrive_m).nearest_open(place_m)
        return Waypoint(east_m, north_m, engine.max_speed_m_s)

    def _rectangle(self) -> tuple[tuple[float, float], ...]:
        grid = self.settings.engine.grid
        east_m, north_m = grid.size_east_m, grid.size_north_m
        return ((0.0, 0.0), (east_m, 0.0), (east_m, north_m), (0.0, north_m))

    def _range_m(self, name: str) -> float | None:
        """How far a robot can drive until its battery is at the reserve; None where that is not known."""
        vehicle, cost = self.robots[name].vehicle, self.settings.battery_pct_per_m
        if vehicle is None or vehicle.battery_pct is None or cost <= 0.0:
            return None
        return max(0.0, vehicle.battery_pct - self.settings.battery_reserve_pct) / cost

    def _follow(self, now_ns: int, notes: list[str]) -> list[Command]:
        """Send a team to its next way-points once all its robots have arrived, or it has taken too long."""
        commands: list[Command] = []
        for team, task in list(self._tasks.items()):
            if any(not self._steerable(robot) for robot in team):
                del self._tasks[team]
                continue
            legs = max((len(path) for path in task.paths.values()), default=0)
            if task.sent and task.leg < legs and self._leg_done(task, now_ns, notes):
                task.leg += 1
                task.sent = False
            if task.leg >= legs:
                # A team without a path waits for the next regular plan: asking at every tick would change nothing.
                if legs or (now_ns - task.began_ns) * 1e-9 >= self.settings.engine.planning_period_s:
                    del self._tasks[team]
                continue
            if not task.sent:
                commands += self._send_leg(task, now_ns)
        return commands

    def _send_leg(self, task: _Task, now_ns: int) -> list[Command]:
        task.sent, task.leg_started_ns = True, now_ns
        limit_s = 0.0
        commands: list[Command] = []
        for robot, path in task.paths.items():
            if task.leg < len(path):
                target = path[task.leg]
                up_m = self.settings.altitude_m.get(robot, target.up_m)
                commands.append(GoTo(now_ns, robot, replace(target, up_m=up_m)))
                limit_s = max(limit_s, self._distance(robot, target) / max(target.speed_m_s, 1e-3))
        task.leg_limit_s = SLOWER * limit_s + 5.0
        return commands

    def _leg_done(self, task: _Task, now_ns: int, notes: list[str]) -> bool:
        """Whether all robots have arrived, or the leg has taken too long; who has not is counted."""
        away = {
            robot: self._distance(robot, path[task.leg])
            for robot, path in task.paths.items()
            if task.leg < len(path)
        }
        late = {robot: m for robot, m in away.items() if m > self.settings.arrive_m}
        if late and (now_ns - task.leg_started_ns) * 1e-9 <= task.leg_limit_s:
            return False
        for robot in away.keys() - late.keys():
            self._late_legs.pop(robot, None)
        for robot, away_m in late.items():
            self.legs_timed_out[robot] += 1
            self._late_legs[robot] += 1
            if self._late_legs[robot] == LATE_LEGS:
                notes.append(
                    f"{robot}: {LATE_LEGS} legs in a row ended by time-out, the last {away_m:.1f} m before its "
                    f"way-point; it counts as arrived within {self.settings.arrive_m:.2f} m (engine.arrive_m)"
                )
        return True

    def _distance(self, robot: str, target: Waypoint) -> float:
        pose = self.robots[robot].pose
        assert pose is not None  # only steerable robots have tasks
        return float(np.hypot(target.east_m - pose.east_m, target.north_m - pose.north_m))


def state_digest(kernel: Kernel) -> str:
    """Hex digest over belief, commands and counters: equal only for equal histories."""
    whole = hashlib.sha256()
    whole.update(kernel.belief.digest())
    whole.update(kernel.commands_digest().encode())
    whole.update(struct.pack("<q", kernel.detections))
    return whole.hexdigest()
