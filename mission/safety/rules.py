"""Safety: pure, and last before the vehicles. It sees every event and every command, and may replace any command.

Rules, in the order they are asked:

- operator's hold, return, release or a withdrawal stands until resumed;
- a robot whose link is down, whose pose is unknown, stale, implausible or from the future gets `Hold`;
- a target that is not finite gets `Hold`; one beyond the fence is drawn back to it, one beyond the longest leg too;
- a way that crosses ground to be kept out of, or what lies outside the fence, gets `Hold`;
- a way that comes too near another robot's, as both would drive them now, gets `Hold`;
- no faster than the limit;
- robots nearer to each other than half the separation: the later-named one holds until the gap has opened;
- a stuck robot, a lost radio, a steering loop that was late: hold (`mission.safety.monitor`).

Escalation: a hold; then, where a robot is of no more use out there (battery, radio), home, in sequence
(`mission.safety.return_sequence`); then the operator is called and the robot is out of the mission until resumed.

Every intervention carries its reason. A hold is repeated until the vehicle says it holds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fieldkit.geometry.polygons import KeepOut
from fieldkit.geometry.segments import Place, Way, ever_m, keep_apart_m, leaves, nearest_m, standing
from fieldkit.messages import (
    CallOperator,
    Command,
    Event,
    GoTo,
    Hold,
    Operator,
    Pose,
    ReceiverState,
    Return,
    Tick,
    VehicleState,
    Waypoint,
)
from mission.safety.monitor import SafetySettings, Trouble, Watched, trouble_of, unfit
from mission.safety.return_sequence import ReturnSequence, home_way

__all__ = ["Safety", "SafetySettings"]

REPEAT_S = 3.0
"""A hold that has not been confirmed is repeated this often."""
STARTS_S = 4.0
"""How much later than another a robot may set out: it turns on the spot first, or its order is sent again."""
AT_ONCE = ((0.0, 0.0),)
_DELAYS_S = [STARTS_S * k / 5 for k in range(1, 6)]
LATE_STARTS = (*AT_ONCE, *((late_s, 0.0) for late_s in _DELAYS_S), *((0.0, late_s) for late_s in _DELAYS_S))
SLACK_M = 1e-6
"""More than rounding: what a quick look finds this much too far apart is so by a closer one too."""
SOON_S = 4.0
"""How far ahead robots under way are watched: time to tell one to stop over a poor link."""


@dataclass
class Safety:
    """See the module. `observe` every event before asking `judge` about the commands it led to."""

    settings: SafetySettings
    interventions: int = 0
    returning: ReturnSequence = field(default_factory=ReturnSequence)
    robots: dict[str, Watched] = field(init=False)
    """What it knows of each robot."""
    _tick_ns: int | None = None
    _late: str = ""

    def __post_init__(self) -> None:
        self.robots = {name: Watched(name) for name in self.settings.robots}

    def observe(self, event: Event) -> list[Command]:
        """Take in an event; commands that safety gives of its own."""
        match event:
            case Pose() if event.robot in self.robots:
                self.robots[event.robot].see(event, self.settings)
            case VehicleState() if event.robot in self.robots:
                self.robots[event.robot].vehicle = event
            case ReceiverState() if event.robot in self.robots:
                self.robots[event.robot].hear(event)
            case Operator():
                return self._operator(event)
            case Tick():
                return self._watch(event.t_ns)
            case _:
                pass
        return []

    def allow(self, command: Command) -> Command:
        """One command as it may be carried out: itself, a tamer one, or a hold."""
        return self.judge((command,))[0]

    def judge(self, commands: Sequence[Command]) -> list[Command]:
        """Commands given together, as they may be carried out; judged against each other, not against old ways.

        A robot that must stay stands in others' ways: whoever is refused is judged as standing, until none is new.
        """
        refused: dict[str, Hold] = {}
        lies = self._lies() if any(isinstance(command, GoTo) for command in commands) else {}
        while True:
            judged = self._judge_once(commands, refused, lies)
            new = {c.robot: c for c in judged if isinstance(c, Hold) and c.robot not in refused}
            if not new:
                break
            refused |= new
        for asked, allowed in zip(commands, judged, strict=True):
            self.interventions += allowed != asked
            self._note(allowed)
        return judged

    def _lies(self) -> dict[str, "_Lie"]:
        """All robots' ways before new ones are given."""
        return {name: _Lie(robot.ways(), robot.unseen(self.settings)) for name, robot in self.robots.items()}

    def _judge_once(
        self, commands: Sequence[Command], refused: dict[str, Hold], lies: dict[str, "_Lie"]
    ) -> list[Command]:
        """Each command in order, the robots in `refused` standing where they are."""
        ways = {
            name: standing(self.robots[name].place_m or (0.0, 0.0)) for name in refused if name in self.robots
        }
        undecided = {c.robot for c in commands if isinstance(c, GoTo)} - refused.keys()
        judged: list[Command] = []
        for command in commands:
            if not isinstance(command, GoTo):
                judged.append(command)
                continue
            if command.robot in refused:
                judged.append(refused[command.robot])
                continue
            undecided.discard(command.robot)
            judged.append(self._allow_goto(command, ways, lies, undecided))
            robot, allowed = self.robots.get(command.robot), judged[-1]
            if robot is not None and robot.place_m is not None and isinstance(allowed, GoTo):
                ways[command.robot] = _way_to(robot.place_m, allowed.waypoint)
        return judged

    def _note(self, command: Command) -> None:
        """Remember what a robot was told."""
        robot = self.robots.get(getattr(command, "robot", ""))
        if robot is None:
            return
        if isinstance(command, GoTo) and robot.place_m is not None:
            robot.send(_way_to(robot.place_m, command.waypoint), command.t_ns)
        elif isinstance(command, Hold | Return):
            robot.stop()

    # -- the operator ----------------------------------------------------------------------------------------

    def _operator(self, event: Operator) -> list[Command]:
        if event.action == "exclude":
            self._exclude(event)
            return []
        names = self.settings.robots if event.robot is None else (event.robot,)
        commands: list[Command] = []
        for robot in (self.robots[name] for name in names if name in self.robots):
            commands += self._order(robot, event)
        if event.action == "return":
            commands += self.returning.step(self.robots, self.settings, event.t_ns)
        return commands

    def _order(self, robot: Watched, event: Operator) -> list[Command]:
        """One robot's part of what the operator asked for."""
        reason = event.reason or f"operator: {event.action}"
        if event.action in ("hold", "end", "release", "resume"):
            self.returning.forget(robot.name)
        match event.action:
            case "hold" | "end":
                robot.ordered = "hold"
                robot.stop()
                return [Hold(event.t_ns, robot.name, reason)]
            case "return":
                robot.ordered = "return"
                robot.stop()
                self.returning.ask(robot.name, reason)
                return [Hold(event.t_ns, robot.name, f"{reason}, in sequence")]
            case "release":
                robot.ordered = "release"
                robot.stop()
            case "withdraw":
                robot.ordered = robot.ordered or "withdraw"
            case "resume":
                robot.ordered, robot.called, robot.troubled_ns = "", False, None
                robot.progress_ns = event.t_ns
            case _:
                pass
        return []

    def _exclude(self, event: Operator) -> None:
        if len(event.area_m) < 3 or not np.isfinite(event.area_m).all():
            return
        polygons = (*self.settings.keep_out.polygons, event.area_m)
        self.settings = replace(self.settings, keep_out=KeepOut(polygons))

    # -- time ------------------------------------------------------------------------------------------------

    def _watch(self, now_ns: int) -> list[Command]:
        """Hold robots that move though they must not; send home and call for what holding does not mend."""
        self._late = self._lateness(now_ns)
        for robot in self.robots.values():
            robot.now_ns = now_ns
        if self._late:  # what lasted while nobody looked is not held against a robot
            for robot in self.robots.values():
                robot.progress_ns = now_ns
                robot.troubled_ns = None if robot.troubled_ns is None else now_ns
        self._measure_gaps()
        commands: list[Command] = []
        for robot in self.robots.values():
            commands += self._look_at(robot, now_ns)
        commands += self.returning.step(self.robots, self.settings, now_ns)
        for command in commands:
            self._note(command)
        return commands

    def _lateness(self, now_ns: int) -> str:
        """The steering loop's own silence, or a clock that went back."""
        before_ns, self._tick_ns = self._tick_ns, now_ns
        gap_s = 0.0 if before_ns is None else (now_ns - before_ns) * 1e-9
        if gap_s < 0:
            return f"the mission's clock went back by {-gap_s:.1f} s"
        return f"the steering loop was silent for {gap_s:.1f} s" if gap_s > self.settings.overrun_s else ""

    def _look_at(self, robot: Watched, now_ns: int) -> list[Command]:
        if robot.ordered == "release" or (robot.pose is None and not robot.moving):
            return []
        trouble = trouble_of(robot, self.settings, now_ns)
        if trouble is None and self._late and robot.moving:
            trouble = Trouble("late", self._late)
        if trouble is None:
            robot.troubled_ns = None
            return self._taken_over(robot, now_ns)
        if robot.troubled_ns is None or robot.trouble != trouble.kind:
            robot.troubled_ns, robot.trouble = now_ns, trouble.kind
        lasted_s = (now_ns - robot.troubled_ns) * 1e-9
        return [*self._hold(robot, trouble, now_ns), *self._escalate(robot, trouble, lasted_s, now_ns)]

    def _hold(self, robot: Watched, trouble: Trouble, now_ns: int) -> list[Command]:
        """A hold, unless it holds already or is on its way home; again until the vehicle says so."""
        if robot.name in self.returning.under_way or not (robot.moving or not robot.holds):
            return []
        if robot.somebody_elses:
            robot.stop()
            return []
        if not robot.moving and (now_ns - robot.held_ns) * 1e-9 < REPEAT_S:
            return []
        robot.held_ns = now_ns
        robot.stop()
        self.interventions += 1
        return [Hold(now_ns, robot.name, trouble.reason)]

    def _escalate(self, robot: Watched, trouble: Trouble, lasted_s: float, now_ns: int) -> list[Command]:
        """What follows a hold that lasts."""
        after_s = self.settings.call_after_s if trouble.after_s is None else trouble.after_s
        if robot.called or robot.ordered or lasted_s < after_s:
            return []
        if trouble.then == "return":
            if robot.name in self.returning:
                return []
            self.returning.ask(robot.name, trouble.reason)
            robot.ordered = "return"
            return self._call(robot, f"{trouble.reason}: it is sent home", now_ns)
        return self._call(robot, trouble.reason, now_ns)

    def _taken_over(self, robot: Watched, now_ns: int) -> list[Command]:
        """Somebody else steers a robot that was ours, or its own failsafe has it."""
        if not robot.somebody_elses:
            robot.called = robot.called and bool(robot.ordered)
            return []
        robot.stop()
        if not robot.ours or robot.called or robot.ordered:
            return []
        text = robot.vehicle.text if robot.vehicle is not None else ""
        return self._call(robot, f"it is not ours to steer any more: {text}".rstrip(": "), now_ns)

    def _call(self, robot: Watched, reason: str, now_ns: int) -> list[Command]:
        robot.called = True
        self.interventions += 1
        return [CallOperator(now_ns, robot.name, reason)]

    def _measure_gaps(self) -> None:
        """Who is too near another robot, or will be if both go on: of two the later-named, where that helps."""
        limit = self.settings.near_m
        before = {name: robot.too_near for name, robot in self.robots.items()}
        for robot in self.robots.values():
            robot.too_near = False
        near = [moment for robot in self.robots.values() if (moment := self._moment(robot)) is not None]
        for later, mine in enumerate(near):
            for other in near[:later]:
                gap_m = math.dist(mine.place_m, other.place_m)
                if gap_m - mine.reach_m - other.reach_m > 1.2 * limit + SLACK_M:
                    continue  # most pairs, told at once: the rest costs fifty times as much
                if gap_m < (1.2 * limit if before[mine.robot.name] else limit):
                    if nearest_m(other.soon, mine.soon) < gap_m - 0.01:
                        (mine if self._drives(mine.robot) else other).robot.too_near = True
                elif (yields := self._must_yield(other, mine)) is not None:
                    yields.too_near = True

    def _must_yield(self, first: "_Moment", second: "_Moment") -> Watched | None:
        """Which of two has to stop now so that they do not meet on their next ways; None where they keep clear."""
        for mover, other in ((second, first), (first, second)):
            if other.somewhere is None or not self._drives(mover.robot):
                continue
            near_m, ground = self.settings.near_m, other.somewhere
            if ever_m(mover.soon, ground) < near_m and not leaves(mover.soon, ground, near_m):
                return mover.robot
        one, two = first.soon, second.soon
        if not (one.length_m or two.length_m) or keep_apart_m(one, two) >= self.settings.near_m:
            return None
        limit_m = min(self.settings.near_m, math.dist(one.start_m, two.start_m) - 0.01)
        if nearest_m(one, two) >= limit_m:
            return None
        helps = nearest_m(one, standing(two.start_m)) >= limit_m
        if self._drives(second.robot) and (helps or not self._drives(first.robot)):
            return second.robot
        return first.robot if self._drives(first.robot) else second.robot

    def _drives(self, robot: Watched) -> bool:
        """It is under way for us, to a way-point or home."""
        return robot.moving or robot.name in self.returning.under_way

    def _moment(self, robot: Watched) -> "_Moment | None":
        """Where it is and will be soon; None where its place is not known."""
        here, way = robot.place_m, robot.way()
        if here is None or way is None:
            return None
        if robot.name in self.returning.under_way:
            way = replace(home_way(robot), speed_m_s=self.settings.max_speed_m_s)
        obeys = way.length_m and not robot.strays
        soon = replace(way, end_m=way.at(SOON_S)) if obeys else robot.drift(SOON_S)
        return _Moment(robot, here, soon or standing(here), robot.unseen(self.settings))

    # -- way-points ------------------------------------------------------------------------------------------

    def _allow_goto(
        self, command: GoTo, ways: dict[str, Way], lies: dict[str, "_Lie"], undecided: set[str]
    ) -> Command:
        """`ways` are new ways given in the same breath; those of `undecided` come later: their old ones are void."""
        robot = self.robots.get(command.robot)
        reason = "there is no such robot in this mission" if robot is None else self._forbids(robot, command)
        if reason or robot is None or robot.pose is None:
            return Hold(command.t_ns, command.robot, reason)
        tame = self._tame(command.waypoint, robot.pose)
        way = _way_to((robot.pose.east_m, robot.pose.north_m), tame)
        if self.settings.keep_out.blocks(np.array([way.start_m]), np.array([way.end_m]))[0]:
            return Hold(command.t_ns, command.robot, "its way crosses ground it must keep out of")
        if reason := self._meets(robot, way, ways, lies, undecided):
            return Hold(command.t_ns, command.robot, reason)
        return GoTo(command.t_ns, command.robot, tame)

    def _forbids(self, robot: Watched, command: GoTo) -> str:
        """Why it may not be sent anywhere; empty when it may."""
        target = command.waypoint
        if not all(map(math.isfinite, (target.east_m, target.north_m, target.speed_m_s, target.up_m))):
            return f"its target is not finite: {target}"
        if robot.ordered:
            return f"a standing order: {robot.ordered}"
        # Not `astray`: from outside the fence or too near another, a way may lead back in, or apart.
        trouble = unfit(robot, self.settings, command.t_ns)
        return self._late if trouble is None else trouble.reason

    def _meets(
        self,
        robot: Watched,
        way: Way,
        ways: dict[str, Way],
        lies: dict[str, "_Lie"],
        undecided: set[str],
    ) -> str:
        """Whose way this one comes too near, however their starts fall; empty when it keeps clear."""
        limit_m = 1.2 * self.settings.near_m
        for name, lie in lies.items():
            if name == robot.name or name in undecided:
                continue
            if lie.somewhere is not None:
                nearest = ever_m(way, lie.somewhere)
                if nearest < limit_m and not leaves(way, lie.somewhere, limit_m):
                    return f"its way comes within {nearest:.2f} m of where {name} may be"
                continue
            new = ways.get(name)
            for its in lie.ways if new is None else (new,):
                if keep_apart_m(way, its) >= limit_m:
                    continue
                least_m = min(limit_m, math.dist(way.start_m, its.start_m) - 0.01)
                if ever_m(way, its) > least_m + SLACK_M:
                    continue  # they keep clear whenever they start
                nearest = min(nearest_m(way, its, a, b) for a, b in _starts(its))
                if nearest < least_m:
                    return f"its way comes within {nearest:.2f} m of {name}"
        return ""

    def _tame(self, target: Waypoint, pose: Pose) -> Waypoint:
        """The way-point within leg, fence and speed; unchanged when it is already."""
        east, north = self._inside(target.east_m, target.north_m)
        s = self.settings
        leg = math.hypot(east - pose.east_m, north - pose.north_m)
        if leg > s.max_leg_m:
            east = pose.east_m + (east - pose.east_m) * s.max_leg_m / leg
            north = pose.north_m + (north - pose.north_m) * s.max_leg_m / leg
            east, north = self._inside(east, north)  # from outside the fence, the way in comes first
        speed = min(max(target.speed_m_s, 0.0), s.max_speed_m_s)
        return Waypoint(east, north, speed, target.up_m)

    def _inside(self, east_m: float, north_m: float) -> tuple[float, float]:
        s = self.settings
        margin_e = min(s.fence_margin_m, s.size_east_m / 2)
        margin_n = min(s.fence_margin_m, s.size_north_m / 2)
        return (
            min(max(east_m, margin_e), s.size_east_m - margin_e),
            min(max(north_m, margin_n), s.size_north_m - margin_n),
        )


@dataclass(frozen=True, slots=True)
class _Moment:
    """A robot whose place is known, now and in the next moments."""

    robot: Watched
    place_m: Place
    soon: Way
    somewhere: Way | None
    """Where it may be, if its position is old."""
    reach_m: float = field(init=False)
    """How far from its place any of that leads."""

    def __post_init__(self) -> None:
        unseen_m = 0.0 if self.somewhere is None else self.somewhere.length_m
        object.__setattr__(self, "reach_m", max(self.soon.length_m, unseen_m))


@dataclass(frozen=True, slots=True)
class _Lie:
    """All that a robot may be doing, and where it may be if its position is old."""

    ways: tuple[Way, ...]
    somewhere: Way | None


def _starts(its: Way) -> tuple[tuple[float, float], ...]:
    """Delays of the one and the other to look at: close enough to each other to miss no meeting in between."""
    return AT_ONCE if its.length_m == 0 else LATE_STARTS


def _way_to(place_m: Place, waypoint: Waypoint) -> Way:
    """Straight from a place to a way-point."""
    return Way(place_m, (waypoint.east_m, waypoint.north_m), max(waypoint.speed_m_s, 0.01))
