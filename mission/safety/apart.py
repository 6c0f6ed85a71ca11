"""Safety on a robot that does not hear all the others: it keeps off the ground that those may have reached. Pure.

A robot of which nothing is known for longer than positions hold may be anywhere within what it can have driven since.
That ground grows until it is heard again. Where the operator says within which distance robots hear each other
(`contact_m`), one that lives and is not heard is further away than that, and one that does not live stands on the path
it was last on, which safety keeps clear of anyway.
"""

import math
from dataclasses import dataclass

from fieldkit.geometry.segments import Segment, ever_m, standing
from fieldkit.messages import Command, Event, GoTo, Hold, Tick, Waypoint
from mission.safety.limits import SafetySettings
from mission.safety.monitor import SLOW_M_S
from mission.safety.rules import Safety
from mission.safety.separation import CLEAR_OF_NEAR, Occupancy, are_layered


def least_contact_m(settings: SafetySettings) -> float:
    """Robots must hear each other at least this far away: two that come towards each other have to stop in between."""
    closing_m = 2.0 * settings.max_speed_m_s * settings.pose_timeout_s
    return settings.min_separation_m + closing_m + 2.0 * settings.braking_m


@dataclass
class SafetyApart(Safety):
    """The safety of robot `me`, which is told of others only what is heard of them."""

    me: str = ""
    contact_m: float | None = None

    def observe(self, event: Event) -> list[Command]:
        """As for one computer; and a hold where the path under way leads to where another may be by now."""
        commands = super().observe(event)
        mine = self.robots[self.me]
        if not isinstance(event, Tick) or not mine.moving or (segment := mine.segment()) is None:
            return commands
        if reason := self._may_meet(segment, event.t_ns):
            hold = Hold(event.t_ns, self.me, reason)
            self._note(hold)
            self.interventions += 1
            commands.append(hold)
        return commands

    def expect(self, robot: str, target: Waypoint | None) -> None:
        """Another says where it is going; None: it has been told to hold, and once it is seen to stand it does."""
        other = self.robots[robot]
        if target is None:
            other.stop()
            if math.hypot(*other.velocity_m_s) < SLOW_M_S:
                other.fading = None
        elif other.place_m is not None:
            end_m = (target.east_m, target.north_m)
            if other.target is None or other.target.end_m != end_m:
                other.send(Segment(other.place_m, end_m, max(target.speed_m_s, 0.01)), other.now_ns)

    def _allow_goto(
        self, command: GoTo, new: dict[str, Segment], occupied: dict[str, Occupancy], undecided: set[str]
    ) -> Command:
        allowed = super()._allow_goto(command, new, occupied, undecided)
        place_m = self.robots[self.me].place_m
        if not isinstance(allowed, GoTo) or command.robot != self.me or place_m is None:
            return allowed
        target = allowed.waypoint
        segment = Segment(place_m, (target.east_m, target.north_m), max(target.speed_m_s, 0.01))
        reason = self._may_meet(segment, command.t_ns)
        return Hold(command.t_ns, command.robot, reason) if reason else allowed

    def _may_meet(self, segment: Segment, now_ns: int) -> str:
        """Which robot that is not heard may be on this path; empty where none can."""
        if self.contact_m is not None:
            return ""
        settings, mine = self.settings, self.robots[self.me]
        for name, other in self.robots.items():
            if (
                name == self.me
                or other.pose is None
                or other.place_m is None
                or are_layered(mine, other, settings)
            ):
                continue
            silent_s = (now_ns - other.pose.t_ns) * 1e-9
            if silent_s <= settings.pose_timeout_s:
                continue
            reach_m = settings.max_speed_m_s * silent_s + CLEAR_OF_NEAR * settings.near_m
            if ever_m(segment, standing(other.place_m)) < reach_m:
                return f"{name} is not heard for {silent_s:.0f} s and may have come onto its path"
        return ""
