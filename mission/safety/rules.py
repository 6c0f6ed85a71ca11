"""Safety: pure, and last before the vehicles. It sees every event and every command, and may replace any command.

Rules, in the order they are asked:

- operator's hold, return, release or a withdrawal stands until resumed;
- an area that the operator closes stops those whose way leads across it, and sends those on their way home round it;
- a robot whose link is down, whose pose is unknown, stale, implausible or from the future gets `Hold`;
- a target that is not finite gets `Hold`; one beyond the fence is drawn back to it, one beyond the longest leg too;
- a path onto closed ground or out of the fence, margins included, gets `Hold`; a path back in is always allowed;
- a path that comes too near another robot's, as both would drive them now, gets `Hold`;
- no faster than the limit;
- robots nearer to each other than half the separation: the later-named one holds until the gap has opened;
- a robot out of bounds, a stuck or too fast one, a lost radio, a steering loop that was late: hold
  (`mission.safety.monitor`).

Escalation: a hold; then, where a robot is of no more use out there (battery, radio), home, in sequence
(`mission.safety.return_sequence`); then the operator is called and the robot is out of the mission until resumed.

Every intervention carries its reason. A hold is repeated until the vehicle says it holds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fieldkit.geometry.polygons import KeepOut
from fieldkit.geometry.segments import Place, Segment, standing
from fieldkit.messages import (
    CallOperator,
    Command,
    Event,
    GoTo,
    Hold,
    Land,
    Operator,
    Pose,
    ReceiverState,
    Return,
    Tick,
    VehicleState,
    Waypoint,
)
from fieldkit.settings import REPEAT_S
from mission.safety.limits import SafetySettings
from mission.safety.monitor import ACQUIRE_S, Trouble, Watched, not_ready, trouble_of
from mission.safety.return_sequence import ReturnSequence
from mission.safety.separation import Occupancy, conflict, mark_too_near, occupancies

__all__ = ["Safety", "SafetySettings"]


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
                self.robots[event.robot].hear_vehicle(event)
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
        """One command as it may be carried out: itself, a clamped one, or a hold."""
        return self.judge((command,))[0]

    def judge(self, commands: Sequence[Command]) -> list[Command]:
        """Commands given together, as they may be carried out; judged against each other, not against old segments.

        A robot that must stay stands in others' paths: whoever is refused is judged as standing, until none is new.
        """
        refused: dict[str, Hold] = {}
        any_goto = any(isinstance(command, GoTo) for command in commands)
        occupied = occupancies(self.robots, self.settings) if any_goto else {}
        while True:
            judged = self._judge_once(commands, refused, occupied)
            new = {c.robot: c for c in judged if isinstance(c, Hold) and c.robot not in refused}
            if not new:
                break
            refused |= new
        for asked, allowed in zip(commands, judged, strict=True):
            self.interventions += allowed != asked
            self._note(allowed)
        return judged

    def _judge_once(
        self, commands: Sequence[Command], refused: dict[str, Hold], occupied: dict[str, Occupancy]
    ) -> list[Command]:
        """Each command in order, the robots in `refused` standing where they are."""
        known = (robot for name, robot in self.robots.items() if name in refused)
        new = {robot.name: standing(place) for robot in known if (place := robot.place_m) is not None}
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
            judged.append(self._allow_goto(command, new, occupied, undecided))
            robot, allowed = self.robots.get(command.robot), judged[-1]
            if robot is not None and robot.place_m is not None and isinstance(allowed, GoTo):
                new[command.robot] = segment_to(robot.place_m, allowed.waypoint)
        return judged

    def _note(self, command: Command) -> None:
        """Remember what a robot was ordered."""
        robot = self.robots.get(getattr(command, "robot", ""))
        if robot is None:
            return
        if isinstance(command, GoTo) and robot.place_m is not None:
            robot.send(segment_to(robot.place_m, command.waypoint), command.t_ns)
        elif isinstance(command, Hold | Return | Land):
            robot.stop()

    def ours(self) -> list[str]:
        """Robots that are ours to stop unasked: neither released, nor steered by somebody else."""
        return [
            name
            for name, robot in self.robots.items()
            if robot.ordered != "release" and not robot.somebody_elses
        ]

    # -- the operator ----------------------------------------------------------------------------------------

    def _operator(self, event: Operator) -> list[Command]:
        if event.action == "exclude":
            return self._exclude(event)
        names = self.settings.robots if event.robot is None else (event.robot,)
        commands: list[Command] = []
        for robot in (self.robots[name] for name in names if name in self.robots):
            commands += self._order(robot, event)
        if event.action == "return":
            commands += self.returning.step(self.robots, self.settings, event.t_ns)
            for command in commands:
                self._note(command)
        return commands

    def _order(self, robot: Watched, event: Operator) -> list[Command]:
        """One robot's part of what the operator asked for."""
        reason = event.reason or f"operator: {event.action}"
        if event.robot is None and robot.ordered == "release":
            # Somebody else has it: a word to all stops it as well, but neither ends that nor takes it back.
            return [Hold(event.t_ns, robot.name, reason)] if event.action == "hold" else []
        if event.action in ("hold", "end", "release", "resume"):
            self.returning.forget(robot.name)
        match event.action:
            case "hold" | "end":
                robot.ordered = "hold"
                robot.stop()
                is_ours = event.action == "hold" or not robot.somebody_elses
                return [Hold(event.t_ns, robot.name, reason)] if is_ours else []
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
                robot.progress_ns = robot.resumed_ns = event.t_ns
            case _:
                pass
        return []

    def _exclude(self, event: Operator) -> list[Command]:
        """Close an area from now on, and stop those on a path across it: one may be there before it is sent anew."""
        if len(event.area_m) < 3 or not np.isfinite(event.area_m).all():
            return []
        self.settings = self.settings.closed_too(event.area_m)
        closed = KeepOut((event.area_m,), margin_m=self.settings.fence_margin_m)
        stopped = self.returning.ask_anew(self.robots, closed)
        for robot in self.robots.values():
            segment = robot.segment()
            if not robot.moving or robot.somebody_elses or segment is None:
                continue
            if not closed.permits(segment.start_m, segment.end_m):
                stopped.add(robot.name)
        reason = "an area was closed that its path leads across"
        commands: list[Command] = [Hold(event.t_ns, name, reason) for name in self.robots if name in stopped]
        for command in commands:
            self._note(command)
        return commands

    # -- time ------------------------------------------------------------------------------------------------

    def _watch(self, now_ns: int) -> list[Command]:
        """Hold robots that move though they must not; send home and call for what holding does not mend."""
        self._late = self._lateness(now_ns)
        for robot in self.robots.values():
            robot.now_ns, robot.late = now_ns, self._late
        if self._late:  # what lasted while nobody looked is not held against a robot
            for robot in self.robots.values():
                robot.progress_ns = now_ns
                robot.troubled_ns = None
        mark_too_near(self.robots, self.returning.segments(self.robots, self.settings), self.settings)
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
        if robot.ordered == "release" or robot.pose is None:
            return []
        homeward = robot.name in self.returning.under_way  # its sequence minds what happens under way
        trouble = (not_ready if homeward else trouble_of)(robot, self.settings, now_ns)
        if trouble is None and self._late and robot.moving:
            trouble = Trouble("late", self._late)
        if trouble is None:
            robot.troubled_ns = None
            return self._taken_by_others(robot, now_ns)
        if robot.troubled_ns is None or robot.trouble != trouble.kind:
            robot.troubled_ns, robot.trouble = now_ns, trouble.kind
        lasted_s = (now_ns - robot.troubled_ns) * 1e-9
        return [*self._hold(robot, trouble, now_ns), *self._escalate(robot, trouble, lasted_s, now_ns)]

    def _hold(self, robot: Watched, trouble: Trouble, now_ns: int) -> list[Command]:
        """A hold, unless it holds already or is on its way home; again until the vehicle says so."""
        if robot.name in self.returning.under_way or (robot.holds and not robot.moving):
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
        if robot.name in self.settings.on_foot:
            return []  # people look after themselves: they go on as soon as what is wrong has passed
        after_s = self.settings.call_after_s if trouble.after_s is None else trouble.after_s
        homeward = robot.ordered == "return" and trouble.then != "return"
        if robot.called or (robot.ordered and not homeward) or lasted_s < after_s:
            return []
        if trouble.then == "return":
            self.returning.ask(robot.name, trouble.reason)
            robot.ordered = "return"
            return self._call(robot, f"{trouble.reason}: it is sent home", now_ns)
        return self._call(robot, trouble.reason, now_ns)

    def _taken_by_others(self, robot: Watched, now_ns: int) -> list[Command]:
        """Somebody else steers a robot that was ours, or its own failsafe has it."""
        if not robot.somebody_elses:
            robot.called = robot.called and bool(robot.ordered)
            return []
        robot.stop()
        if not robot.ours or robot.called or robot.ordered:
            return []
        if (now_ns - robot.resumed_ns) * 1e-9 < ACQUIRE_S:
            return []  # it is being acquired, and still shows whose it was
        why = robot.vehicle.reason if robot.vehicle is not None else ""
        return self._call(robot, f"it is not ours to steer any more: {why}".rstrip(": "), now_ns)

    def _call(self, robot: Watched, reason: str, now_ns: int) -> list[Command]:
        robot.called = True
        self.interventions += 1
        return [CallOperator(now_ns, robot.name, reason)]

    # -- way-points ------------------------------------------------------------------------------------------

    def _allow_goto(
        self, command: GoTo, new: dict[str, Segment], occupied: dict[str, Occupancy], undecided: set[str]
    ) -> Command:
        """`new` are segments given together with this one; those of `undecided` come later: their old ones are void."""
        robot = self.robots.get(command.robot)
        reason = "there is no such robot in this mission" if robot is None else self._forbids(robot, command)
        if reason or robot is None or robot.pose is None:
            return Hold(command.t_ns, command.robot, reason)
        clamped = self._clamp(command.waypoint, robot.pose)
        segment = segment_to((robot.pose.east_m, robot.pose.north_m), clamped)
        if not self.settings.margins.permits(segment.start_m, segment.end_m):
            return Hold(command.t_ns, command.robot, "its path leads out of the fence or onto closed ground")
        if reason := conflict(robot, segment, new, occupied, undecided, self.settings):
            return Hold(command.t_ns, command.robot, reason)
        return GoTo(command.t_ns, command.robot, clamped)

    def _forbids(self, robot: Watched, command: GoTo) -> str:
        """Why it may not be sent anywhere; empty when it may."""
        target = command.waypoint
        if not all(map(math.isfinite, (target.east_m, target.north_m, target.speed_m_s, target.up_m))):
            return f"its target is not finite: {target}"
        if robot.ordered:
            return f"a standing order: {robot.ordered}"
        # Not what stops one under way: from outside the fence or too near another, a path may lead back in, or apart.
        trouble = not_ready(robot, self.settings, command.t_ns)
        return self._late if trouble is None else trouble.reason

    def _clamp(self, target: Waypoint, pose: Pose) -> Waypoint:
        """The way-point within leg, fence and speed; unchanged when it is already."""
        s = self.settings
        east, north = s.fence.nearest_open((target.east_m, target.north_m))
        leg = math.hypot(east - pose.east_m, north - pose.north_m)
        if leg > s.max_leg_m:
            east = pose.east_m + (east - pose.east_m) * s.max_leg_m / leg
            north = pose.north_m + (north - pose.north_m) * s.max_leg_m / leg
            east, north = s.fence.nearest_open(
                (east, north)
            )  # from outside the fence, the path in comes first
        speed = min(max(target.speed_m_s, 0.0), s.max_speed_m_s)
        return Waypoint(east, north, speed, target.up_m)


def segment_to(place_m: Place, waypoint: Waypoint) -> Segment:
    """Straight from a place to a way-point."""
    return Segment(place_m, (waypoint.east_m, waypoint.north_m), max(waypoint.speed_m_s, 0.01))
