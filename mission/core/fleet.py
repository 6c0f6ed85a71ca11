"""What is known of the robots: where they are, whether they can be steered, and how far they may drive."""

from dataclasses import dataclass, field

import numpy as np

from fieldkit.engine.planning.base import Team
from fieldkit.messages import Pose, ReceiverState, VehicleState, Waypoint
from mission.core.kernel_settings import KernelSettings


@dataclass
class Robot:
    """One robot as last heard of."""

    pose: Pose | None = None
    home_m: tuple[float, float] | None = None
    """Where it was first seen: where it has to come back to."""
    vehicle: VehicleState | None = None
    held: bool = False
    """Held by the operator until resumed."""
    released: bool = False
    """Given to somebody else until it is asked for by name."""
    receiver_down_ns: int | None = None
    """Since when its radio is down."""


@dataclass
class Fleet:
    """All robots of a mission. Events of others are ignored."""

    settings: KernelSettings
    teams: tuple[Team, ...] = ()
    """Who is planned for together; as the mission states where nothing else is said."""
    robots: dict[str, Robot] = field(init=False)

    def __post_init__(self) -> None:
        self.teams = self.teams or self.settings.engine.teams
        self.robots = {name: Robot() for name in self.settings.engine.robots}

    def take_in(self, event: Pose | ReceiverState | VehicleState) -> None:
        """Remember what was heard of one robot."""
        robot = self.robots.get(event.robot)
        if robot is None:
            return
        match event:
            case Pose():
                robot.pose, robot.home_m = event, robot.home_m or (event.east_m, event.north_m)
            case ReceiverState():
                robot.receiver_down_ns = None if event.up else robot.receiver_down_ns or event.t_ns
            case VehicleState():
                robot.vehicle = event

    def any_held(self) -> bool:
        """Whether the operator holds somebody."""
        return any(robot.held for robot in self.robots.values())

    def is_steerable(self, name: str, now_ns: int) -> bool:
        """Whether a robot would follow a way-point, and hears."""
        robot = self.robots[name]
        if robot.pose is None or robot.held:
            return False
        down_ns = robot.receiver_down_ns
        if down_ns is not None and (now_ns - down_ns) * 1e-9 > self.settings.radio.timeout_s:
            return False
        vehicle = robot.vehicle
        return vehicle is None or (vehicle.link_up and vehicle.mode in ("guided", "hold"))

    def steerable_teams(self, now_ns: int) -> tuple[Team, ...]:
        """The teams as they are left: without robots that cannot be steered, none of them empty."""
        teams = (tuple(name for name in team if self.is_steerable(name, now_ns)) for team in self.teams)
        return tuple(team for team in teams if team)

    def positions_m(self) -> dict[str, tuple[float, float]]:
        """Robot to (east, north), of those that have been seen."""
        return {
            name: (robot.pose.east_m, robot.pose.north_m)
            for name, robot in self.robots.items()
            if robot.pose is not None
        }

    def heights_m(self) -> dict[str, float]:
        """Robot to how high it is above the field's origin, of those that have been seen."""
        return {name: robot.pose.up_m for name, robot in self.robots.items() if robot.pose is not None}

    def homes_m(self) -> dict[str, tuple[float, float]]:
        """Robot to where it was first seen."""
        return {name: robot.home_m for name, robot in self.robots.items() if robot.home_m is not None}

    def range_m(self, name: str) -> float | None:
        """How far a robot can drive until its battery is at the reserve; None where that is not known."""
        vehicle, limits = self.robots[name].vehicle, self.settings.battery
        if vehicle is None or vehicle.battery_pct is None or limits.pct_per_m <= 0.0:
            return None
        return max(0.0, vehicle.battery_pct - limits.reserve_pct) / limits.pct_per_m

    def distance_m(self, name: str, target: Waypoint) -> float:
        """How far a steerable robot is from a way-point."""
        pose = self.robots[name].pose
        assert pose is not None  # only steerable robots have tasks
        return float(np.hypot(target.east_m - pose.east_m, target.north_m - pose.north_m))
