"""For the tests of safety: a field of robots that drive as they are told, and single ones as they have been seen."""

import math

from fieldkit.geometry.segments import Segment
from fieldkit.messages import (
    Command,
    GoTo,
    Hold,
    Operator,
    Pose,
    Return,
    Tick,
    VehicleMode,
    VehicleState,
    Waypoint,
)
from mission.safety.limits import SafetySettings
from mission.safety.monitor import Trouble, Watched
from mission.safety.rules import Safety

S = 1_000_000_000
LIMITS = SafetySettings(("a", "b"), 100.0, 100.0, max_speed_m_s=1.0, min_separation_m=2.0, pose_timeout_s=2.0)


class Field:
    """Safety, with robots that drive as they are told, a tick a second."""

    def __init__(self, **limits: object) -> None:
        settings = SafetySettings(("a", "b"), 20.0, 20.0, max_speed_m_s=0.5, min_separation_m=1.0)
        self.safety = Safety(SafetySettings(**{**_fields(settings), **limits}))  # type: ignore[arg-type]
        self.t_s = 0
        names = self.safety.settings.robots
        self.at = {name: (2.0 + 4.0 * k, 2.0) for k, name in enumerate(names)}
        self.home = dict(self.at)
        self.goal: dict[str, tuple[float, float] | None] = dict.fromkeys(names)
        self.mode: dict[str, VehicleMode] = dict.fromkeys(names, "guided")
        self.battery: dict[str, float | None] = dict.fromkeys(names)
        self.stuck: set[str] = set()
        self.dumb: set[str] = set()
        """Robots of which no position comes any more."""
        self.says_m_s: dict[str, float] = {}
        """How fast robots say that they are, where they say it."""
        self.log: list[Command] = []
        self.tick()

    def tick(self, seconds: int = 1, gap_s: int = 1) -> None:
        for _ in range(seconds):
            self.t_s += gap_s
            for name, place in self.at.items():
                if (goal := self.goal[name]) is not None and name not in self.stuck:
                    left = math.dist(place, goal)
                    share = min(1.0, 0.5 * gap_s / left) if left > 0 else 1.0
                    self.at[name] = tuple(p + share * (g - p) for p, g in zip(place, goal, strict=True))  # type: ignore[assignment]
                if name not in self.dumb:
                    self.safety.observe(Pose(self.t_s * S, name, *self.at[name]))
                state = VehicleState(
                    self.t_s * S,
                    name,
                    self.mode[name],
                    True,
                    True,
                    self.battery[name],
                    speed_m_s=self.says_m_s.get(name),
                )
                self.safety.observe(state)
            self.carry_out(self.safety.observe(Tick(self.t_s * S)))

    def carry_out(self, commands: list[Command]) -> None:
        self.log += commands
        for command in commands:
            match command:
                case GoTo(_, robot, waypoint):
                    self.goal[robot], self.mode[robot] = (waypoint.east_m, waypoint.north_m), "guided"
                case Hold(_, robot, _):
                    self.goal[robot], self.mode[robot] = None, "hold"
                case Return(_, robot, _):
                    self.goal[robot], self.mode[robot] = self.home[robot], "return"
                case _:
                    pass

    def ask(self, action: str, robot: str | None = None, **more: object) -> None:
        self.carry_out(self.safety.observe(Operator(self.t_s * S, action, robot, **more)))  # type: ignore[arg-type]

    def send(self, *targets: tuple[str, float, float]) -> list[Command]:
        asked = [GoTo(self.t_s * S, robot, Waypoint(east, north, 0.5)) for robot, east, north in targets]
        judged = self.safety.judge(asked)
        self.carry_out(judged)
        return judged

    def homeward(self, robot: str) -> int:
        """How often it was sent to the place where it was first seen."""
        return sum(
            isinstance(c, GoTo)
            and c.robot == robot
            and math.dist((c.waypoint.east_m, c.waypoint.north_m), self.home[robot]) < 1e-3
            for c in self.log
        )

    def said(self, kind: type, robot: str) -> list[str]:
        return [c.reason for c in self.log if isinstance(c, kind) and c.robot == robot]  # type: ignore[attr-defined]


def _fields(settings: SafetySettings) -> dict[str, object]:
    return {name: getattr(settings, name) for name in SafetySettings.__dataclass_fields__}


def ns(t_s: float) -> int:
    return round(t_s * 1e9)


def pose(t_s: float, east_m: float, north_m: float = 50.0, sigma_m: float = 0.0) -> Pose:
    return Pose(ns(t_s), "a", east_m, north_m, sigma_m=sigma_m)


def seen(*poses: Pose, settings: SafetySettings = LIMITS) -> Watched:
    robot = Watched("a")
    for each in poses:
        robot.now_ns = each.t_ns
        robot.see(each, settings)
    return robot


def driven(
    east_m_s: float, north_m_s: float = 0.0, seconds: float = 10.0, settings: SafetySettings = LIMITS
) -> Watched:
    """A robot that has driven steadily up to now, five positions a second; it ends at (50, 50)."""
    steps = round(5 * seconds)
    ago = [(steps - k) / 5 for k in range(steps + 1)]
    return seen(
        *(pose(seconds - s, 50.0 - east_m_s * s, 50.0 - north_m_s * s) for s in ago), settings=settings
    )


def on_its_way(to_m: tuple[float, float], speed_m_s: float = 1.0, at_s: float = 0.0) -> Watched:
    """One at (50, 50) that was just sent somewhere."""
    robot = seen(pose(at_s, 50.0))
    robot.send(Segment((50.0, 50.0), to_m, speed_m_s), ns(at_s))
    return robot


def kind(trouble: Trouble | None) -> str:
    return "" if trouble is None else trouble.kind
