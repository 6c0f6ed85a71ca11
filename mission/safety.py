"""Safety: pure, and last before the vehicles. It sees every event and every command, and may replace any command.

Rules, in the order they are asked:

- operator's hold or return stands until resumed;
- a robot whose link is down, whose pose is older than the limit, or that is not ours to steer gets `Hold`;
- a target that is not finite gets `Hold`; one beyond the fence is drawn back to it, one beyond the longest leg too;
- a way that crosses ground to be kept out of gets `Hold`;
- no faster than the limit;
- robots nearer to each other than half the separation: the later-named one holds until the gap has opened.

Every intervention carries its reason. A hold is repeated until the vehicle says it holds.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from fieldkit.engine.keepout import NOWHERE, KeepOut
from fieldkit.messages import (
    Command,
    EndMission,
    Event,
    GoTo,
    Hold,
    Operator,
    Pose,
    Return,
    Tick,
    VehicleState,
    Waypoint,
)

REPEAT_S = 3.0
"""A hold that has not been confirmed is repeated this often."""


@dataclass(frozen=True, slots=True)
class SafetySettings:
    """Limits no command passes. The fence is the field's rectangle, `fence_margin_m` inside its border."""

    robots: tuple[str, ...]
    size_east_m: float
    size_north_m: float
    fence_margin_m: float = 0.2
    max_speed_m_s: float = 0.4
    max_leg_m: float = 1_000.0
    pose_timeout_s: float = 2.0
    min_separation_m: float = 0.5
    keep_out: KeepOut = NOWHERE


@dataclass(slots=True)
class _Robot:
    pose: Pose | None = None
    vehicle: VehicleState | None = None
    moving: bool = False
    """Our last word to it was a way-point."""
    ordered: str = ""
    """The operator's standing order: hold, return or none."""
    held_ns: int = -(2**62)
    too_near: bool = False


@dataclass
class Safety:
    """See the module. `observe` every event before asking `allow` about the commands it led to."""

    settings: SafetySettings
    interventions: int = 0
    _robots: dict[str, _Robot] = field(init=False)

    def __post_init__(self) -> None:
        self._robots = {name: _Robot() for name in self.settings.robots}

    def observe(self, event: Event) -> list[Command]:
        """Take in an event; commands that safety gives of its own."""
        match event:
            case Pose() if event.robot in self._robots:
                self._robots[event.robot].pose = event
            case VehicleState() if event.robot in self._robots:
                self._robots[event.robot].vehicle = event
            case Operator():
                return self._operator(event)
            case Tick():
                return self._watch(event.t_ns)
            case _:
                pass
        return []

    def allow(self, command: Command) -> Command:
        """The command as it may be carried out: itself, a tamer one, or a hold."""
        match command:
            case GoTo():
                allowed = self._allow_goto(command)
            case Hold() | Return() | EndMission():
                allowed = command
        if allowed != command:
            self.interventions += 1
        robot = getattr(allowed, "robot", None)
        if robot in self._robots:
            self._robots[robot].moving = not isinstance(allowed, Hold)
        return allowed

    def _operator(self, event: Operator) -> list[Command]:
        names = self.settings.robots if event.robot is None else (event.robot,)
        commands: list[Command] = []
        for name in (n for n in names if n in self._robots):
            robot = self._robots[name]
            match event.action:
                case "hold" | "end":
                    robot.ordered, robot.moving = "hold", False
                    commands.append(Hold(event.t_ns, name, event.reason or f"operator: {event.action}"))
                case "return":
                    robot.ordered = "return"
                    commands.append(Return(event.t_ns, name, event.reason or "operator: return"))
                case "resume":
                    robot.ordered = ""
        return commands

    def _watch(self, now_ns: int) -> list[Command]:
        """Hold robots that move though they must not."""
        self._measure_gaps()
        commands: list[Command] = []
        for name, robot in self._robots.items():
            reason = self._unsafe(robot, now_ns)
            holds = robot.vehicle is not None and robot.vehicle.mode == "hold" and robot.vehicle.link_up
            if not reason or not (robot.moving or not holds) or robot.ordered == "return":
                continue
            if robot.vehicle is not None and robot.vehicle.mode == "other":
                robot.moving = False  # somebody else steers it: it is not ours to stop
                continue
            if robot.moving or (now_ns - robot.held_ns) * 1e-9 >= REPEAT_S:
                robot.moving, robot.held_ns = False, now_ns
                self.interventions += 1
                commands.append(Hold(now_ns, name, reason))
        return commands

    def _measure_gaps(self) -> None:
        limit = 0.5 * self.settings.min_separation_m
        names = list(self._robots)
        for later, name in enumerate(names):
            mine = self._robots[name]
            gaps = [self._gap(mine, self._robots[other]) for other in names[:later]]
            nearest = min(gaps, default=math.inf)
            mine.too_near = nearest < (1.2 * limit if mine.too_near else limit)

    @staticmethod
    def _gap(one: _Robot, other: _Robot) -> float:
        if one.pose is None or other.pose is None:
            return math.inf
        return math.hypot(one.pose.east_m - other.pose.east_m, one.pose.north_m - other.pose.north_m)

    def _unsafe(self, robot: _Robot, now_ns: int) -> str:
        """Why this robot must not move; empty when it may."""
        if robot.pose is None:
            return "" if not robot.moving else "its position is unknown"
        age_s = (now_ns - robot.pose.t_ns) * 1e-9
        if age_s > self.settings.pose_timeout_s:
            return f"its position is {age_s:.1f} s old (limit {self.settings.pose_timeout_s:.1f} s)"
        if robot.vehicle is not None and not robot.vehicle.link_up:
            return f"its link is down: {robot.vehicle.text}".rstrip(": ")
        if robot.moving and self._outside(robot.pose):
            return f"it is outside the fence, at {robot.pose.east_m:.1f} m east, {robot.pose.north_m:.1f} m north"
        if (
            robot.moving
            and self.settings.keep_out.contains(np.array([[robot.pose.east_m, robot.pose.north_m]]))[0]
        ):
            return "it has entered ground it must keep out of"
        if robot.moving and robot.too_near:
            return f"it is nearer than {0.5 * self.settings.min_separation_m:.2f} m to another robot"
        return ""

    def _outside(self, pose: Pose) -> bool:
        s = self.settings
        return not (-s.fence_margin_m <= pose.east_m <= s.size_east_m + s.fence_margin_m) or not (
            -s.fence_margin_m <= pose.north_m <= s.size_north_m + s.fence_margin_m
        )

    def _allow_goto(self, command: GoTo) -> Command:
        robot = self._robots.get(command.robot)
        target = command.waypoint
        if robot is None:
            return Hold(command.t_ns, command.robot, "safety does not know this robot")
        if not all(
            math.isfinite(value) for value in (target.east_m, target.north_m, target.speed_m_s, target.up_m)
        ):
            return Hold(command.t_ns, command.robot, f"its target is not finite: {target}")
        if robot.ordered:
            return Hold(command.t_ns, command.robot, f"operator: {robot.ordered}")
        if robot.pose is None:
            return Hold(command.t_ns, command.robot, "its position is unknown")
        age_s = (command.t_ns - robot.pose.t_ns) * 1e-9
        if age_s > self.settings.pose_timeout_s:
            return Hold(command.t_ns, command.robot, f"its position is {age_s:.1f} s old")
        if robot.vehicle is not None and not robot.vehicle.link_up:
            return Hold(command.t_ns, command.robot, "its link is down")
        tame = self._tame(target, robot.pose)
        here = np.array([[robot.pose.east_m, robot.pose.north_m]])
        if self.settings.keep_out.blocks(here, np.array([[tame.east_m, tame.north_m]]))[0]:
            return Hold(command.t_ns, command.robot, "its way crosses ground it must keep out of")
        return GoTo(command.t_ns, command.robot, tame)

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
