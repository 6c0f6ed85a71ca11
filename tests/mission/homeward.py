"""For the tests of the return sequence: robots put where a test wants them, and the sequence that sends them home."""

from dataclasses import replace

from fieldkit.messages import Command, GoTo, Pose, VehicleState, Waypoint
from mission.safety.limits import SafetySettings
from mission.safety.monitor import LONG_AGO_NS, Watched
from mission.safety.return_sequence import ReturnSequence

Place = tuple[float, float]
LIMITS = SafetySettings(("a", "b"), 40.0, 40.0, max_speed_m_s=1.0, min_separation_m=2.0, pose_timeout_s=5.0)
WALL = ((10.0, 19.0), (30.0, 19.0), (30.0, 21.0), (10.0, 21.0))


class Team:
    """Robots that are put where a test wants them, and the sequence that sends them home."""

    def __init__(self, settings: SafetySettings = LIMITS, **homes: Place) -> None:
        self.settings, self.t_s = settings, 1000.0
        self.sequence = ReturnSequence()
        self.robots = {name: Watched(name) for name in homes}
        for name, home in homes.items():
            self.put(name, home)
            self.says(name)

    @property
    def now_ns(self) -> int:
        return round(self.t_s * 1e9)

    def put(self, name: str, place: Place, up_m: float = 0.0) -> None:
        """It is seen there, at rest."""
        self.robots[name].see(Pose(self.now_ns, name, *place, up_m=up_m), self.settings)
        self.robots[name].velocity_m_s, self.robots[name].jumped_ns = (0.0, 0.0), LONG_AGO_NS

    def says(self, name: str, mode: str = "guided", **more: object) -> None:
        self.robots[name].vehicle = VehicleState(self.now_ns, name, mode, True, **more)  # type: ignore[arg-type]

    def step(self, after_s: float = 0.0) -> list[Command]:
        self.t_s += after_s
        for robot in self.robots.values():
            robot.now_ns = self.now_ns
            if robot.pose is not None:
                robot.pose = replace(robot.pose, t_ns=self.now_ns)
        return self.sequence.step(self.robots, self.settings, self.now_ns)

    def goto(self, name: str, place: Place, up_m: float = 0.0) -> GoTo:
        return GoTo(self.now_ns, name, Waypoint(*place, self.settings.max_speed_m_s, up_m))


def leaving(far: Place = (5.0, 35.0), home: Place = (5.0, 5.0), settings: SafetySettings = LIMITS) -> Team:
    """One robot, just ordered to go home from far away."""
    team = Team(settings, a=home)
    team.put("a", far)
    team.sequence.ask("a", "low")
    (order,) = team.step()
    assert isinstance(order, GoTo)
    return team
