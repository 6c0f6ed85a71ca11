"""Robots on their way home, in sequence: one sets out when its straight way is clear of all the others. Pure.

Vehicles return by their own means and in a straight line; nothing on them keeps them apart. So those whose ways
come near another robot, standing or driving, wait. Where nobody can set out any more, the operator is asked.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fieldkit.geometry.segments import Way, ever_m, standing
from fieldkit.messages import CallOperator, Command, Hold, Return
from mission.safety.monitor import SafetySettings, Watched

SLOW_M_S = 0.1
"""The least speed a robot on its way home is taken to make."""
REPEAT_S = 3.0


@dataclass
class ReturnSequence:
    """Who waits to go home, and who is on the way."""

    waiting: dict[str, str] = field(default_factory=dict)
    """Robot to why it goes home, in order."""
    under_way: dict[str, int] = field(default_factory=dict)
    """Robot to when it was last told to return, ns."""
    until: dict[str, int] = field(default_factory=dict)
    """Robot to when it should be home at the latest, ns."""
    reasons: dict[str, str] = field(default_factory=dict)

    def ask(self, name: str, reason: str) -> None:
        """It is to go home. Asking twice is harmless."""
        if name not in self.waiting and name not in self.under_way:
            self.waiting[name] = reason

    def forget(self, name: str) -> None:
        """It is not to go home any more."""
        for table in (self.waiting, self.under_way, self.until, self.reasons):
            table.pop(name, None)

    def __contains__(self, name: str) -> bool:
        return name in self.waiting or name in self.under_way

    def step(self, robots: Mapping[str, Watched], settings: SafetySettings, now_ns: int) -> list[Command]:
        """What to tell whom now."""
        commands = self._watch(robots, settings, now_ns)
        for name in list(self.waiting):
            robot = robots[name]
            if robot.place_m is None or robot.home_m is None or robot.somebody_elses:
                continue
            if robot.vehicle is not None and not robot.vehicle.link_up:
                continue
            if self._is_clear(robot, robots, settings):
                reason = self.waiting.pop(name)
                self.under_way[name] = now_ns
                self.until[name] = now_ns + round(1e9 * (60.0 + home_way(robot).length_m / SLOW_M_S))
                self.reasons[name] = reason
                commands.append(Return(now_ns, name, reason))
        if self.waiting and not self.under_way:
            commands += self._give_up(robots, settings, now_ns)
        return commands

    def _watch(self, robots: Mapping[str, Watched], settings: SafetySettings, now_ns: int) -> list[Command]:
        """Those under way: home, still going, or not getting there."""
        commands: list[Command] = []
        for name in list(self.under_way):
            robot, reason = robots[name], self.reasons[name]
            if is_home(robot, settings):
                self.forget(name)
                commands.append(Hold(now_ns, name, f"it is home: {reason}"))
            elif now_ns > self.until[name]:
                self.forget(name)
                commands.append(Hold(now_ns, name, f"it was sent home ({reason}) and did not get there"))
                commands.append(CallOperator(now_ns, name, f"it did not get home: {reason}"))
            elif robot.somebody_elses:
                self.forget(name)
            elif robot.too_near:
                self.forget(name)
                self.waiting[name] = reason
                commands.append(
                    Hold(now_ns, name, "it is too near another robot; it goes on home when it can")
                )
            elif _should_be_told_again(robot) and (now_ns - self.under_way[name]) * 1e-9 > REPEAT_S:
                self.under_way[name] = now_ns
                commands.append(Return(now_ns, name, reason))
        return commands

    def _is_clear(self, robot: Watched, robots: Mapping[str, Watched], settings: SafetySettings) -> bool:
        mine = home_way(robot)
        if settings.keep_out.blocks(np.array([mine.start_m]), np.array([mine.end_m]))[0]:
            return False
        for other in robots.values():
            if other is robot or other.place_m is None:
                continue
            if other.name in self.under_way:
                its = home_way(other)
            else:
                its = other.unseen(settings) or other.way() or standing(other.place_m)
            # Side by side is where robots start: only a way that comes nearer than now is in the way.
            now_m = math.dist(mine.start_m, its.start_m)
            if ever_m(mine, its) < min(settings.near_m * 1.2, now_m - 0.01):
                return False
        return True

    def _give_up(self, robots: Mapping[str, Watched], settings: SafetySettings, now_ns: int) -> list[Command]:
        """Nobody is under way and nobody can set out: those that could be told to go stay, and somebody is asked."""
        stuck = [name for name in self.waiting if robots[name].place_m is not None and robots[name].home_m]
        commands: list[Command] = []
        for name in stuck:
            reason = self.waiting[name]
            robot = robots[name]
            if robot.somebody_elses or (robot.vehicle is not None and not robot.vehicle.link_up):
                continue
            if any(other.moving for other in robots.values()):
                continue  # its way may come free
            del self.waiting[name]
            commands.append(
                CallOperator(now_ns, name, f"its way home is blocked; it stays where it is: {reason}")
            )
        return commands


def home_way(robot: Watched) -> Way:
    """Straight home from where it is."""
    here = robot.place_m or (0.0, 0.0)
    return Way(here, robot.home_m or here, 1.0)


def is_home(robot: Watched, settings: SafetySettings) -> bool:
    """Within half a separation of where it started."""
    return robot.place_m is not None and home_way(robot).length_m <= max(0.3, settings.near_m)


def _should_be_told_again(robot: Watched) -> bool:
    return robot.vehicle is not None and robot.vehicle.link_up and robot.vehicle.mode != "return"
