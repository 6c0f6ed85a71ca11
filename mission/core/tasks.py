"""Teams on their way along their plans, leg by leg.

The robots of a team set out for their next way-points together: once all have arrived, or the leg has taken too long.
"""

from collections import Counter
from collections.abc import Container
from dataclasses import dataclass, field, replace

from fieldkit.engine.planning.base import Team
from fieldkit.messages import Command, GoTo, Plan, Waypoint
from mission.core.fleet import Fleet
from mission.core.kernel_settings import KernelSettings

SLOWER = 1.6
"""A leg may take so much longer than at the speed asked for: vehicles turn, and drive below a limit, not at it."""
SETTING_OFF_S = 5.0
"""And so much more, however short it is."""
LATE_LEGS = 3
"""So many legs in a row that ended by time-out are noted."""


@dataclass
class Task:
    """A team on its way along a plan."""

    paths: dict[str, tuple[Waypoint, ...]]
    began_ns: int
    leg: int = 0
    leg_started_ns: int = 0
    leg_limit_s: float = 0.0
    sent: bool = False

    @property
    def legs(self) -> int:
        """How many legs the longest path has."""
        return max((len(path) for path in self.paths.values()), default=0)

    def targets(self) -> dict[str, Waypoint]:
        """Robot to its way-point of the present leg; robots with shorter paths have none."""
        return {robot: path[self.leg] for robot, path in self.paths.items() if self.leg < len(path)}


@dataclass
class Tasks:
    """The task of each team that has one."""

    settings: KernelSettings
    fleet: Fleet
    of: dict[Team, Task] = field(default_factory=dict)
    timed_out: Counter[str] = field(default_factory=Counter)
    """Robot to how many of its legs ended by time-out, not at their way-points."""
    _late_in_a_row: Counter[str] = field(default_factory=Counter)

    def drop(self, robots: Container[str]) -> None:
        """Teams with one of these robots have no task any more."""
        self.of = {team: task for team, task in self.of.items() if not any(r in robots for r in team)}

    def keep(self, teams: Container[Team]) -> None:
        """Only these teams go on with what they are at."""
        self.of = {team: task for team, task in self.of.items() if team in teams}

    def remaining(self, now_ns: int) -> dict[Team, Plan]:
        """What every team has still to drive."""
        return {
            team: Plan(now_ns, {robot: path[task.leg :] for robot, path in task.paths.items()})
            for team, task in self.of.items()
        }

    def follow(self, now_ns: int, notes: list[str]) -> list[Command]:
        """The next way-points of all teams that are due for them; tasks that are over are dropped."""
        commands: list[Command] = []
        for team, task in list(self.of.items()):
            if any(not self.fleet.is_steerable(robot, now_ns) for robot in team):
                del self.of[team]
                continue
            if task.sent and task.leg < task.legs and self._is_leg_over(task, now_ns, notes):
                task.leg += 1
                task.sent = False
            if task.leg >= task.legs:
                # A team without a path waits for the next regular plan: asking at every tick would change nothing.
                waited_s = (now_ns - task.began_ns) * 1e-9
                if task.legs or waited_s >= self.settings.engine.planning_period_s:
                    del self.of[team]
                continue
            if not task.sent:
                commands += self._send_leg(task, now_ns)
        return commands

    def _send_leg(self, task: Task, now_ns: int) -> list[Command]:
        task.sent, task.leg_started_ns = True, now_ns
        limit_s = 0.0
        commands: list[Command] = []
        for robot, target in task.targets().items():
            up_m = self.settings.altitude_m.get(robot, target.up_m)
            commands.append(GoTo(now_ns, robot, replace(target, up_m=up_m)))
            limit_s = max(limit_s, self.fleet.distance_m(robot, target) / max(target.speed_m_s, 1e-3))
        task.leg_limit_s = SLOWER * limit_s + SETTING_OFF_S
        return commands

    def _is_leg_over(self, task: Task, now_ns: int, notes: list[str]) -> bool:
        """Whether all robots have arrived, or the leg has taken too long; who has not is counted."""
        away = {robot: self.fleet.distance_m(robot, target) for robot, target in task.targets().items()}
        late = {robot: m for robot, m in away.items() if m > self.settings.arrive_m}
        if late and (now_ns - task.leg_started_ns) * 1e-9 <= task.leg_limit_s:
            return False
        for robot in away.keys() - late.keys():
            self._late_in_a_row.pop(robot, None)
        for robot, away_m in late.items():
            self.timed_out[robot] += 1
            self._late_in_a_row[robot] += 1
            if self._late_in_a_row[robot] == LATE_LEGS:
                notes.append(
                    f"{robot}: {LATE_LEGS} legs in a row ended by time-out, the last {away_m:.1f} m before its "
                    f"way-point; it counts as arrived within {self.settings.arrive_m:.2f} m (engine.arrive_m)"
                )
        return True
