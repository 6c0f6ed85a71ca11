"""Robots on their way home, in sequence, by our own way-points at the mission's speed. Pure.

A robot sets out when its path home is clear of all the others, standing or driving; nothing on the vehicles keeps them
apart. The path goes round closed ground. The vehicle's own return (which drives at its own speed, straight) is the
last resort, for one that does not get on by way-points. Where nobody can set out any more, the operator is asked.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from fieldkit.geometry.polygons import KeepOut
from fieldkit.geometry.routes import route
from fieldkit.geometry.segments import Driven, Place, Segment, ever_m, standing
from fieldkit.messages import CallOperator, Command, GoTo, Hold, Land, Return, Waypoint
from fieldkit.settings import REPEAT_S
from mission.safety.limits import SafetySettings
from mission.safety.monitor import LONG_AGO_NS, SLOW_M_S, Watched, is_out, position_fault, too_fast
from mission.safety.separation import are_layered

SLOWEST_M_S = 0.1
"""The least speed a robot on its way home is taken to make."""
SLACK_S = 60.0
CORNER_M = 0.5
"""A corner of the path home counts as passed this near to it, where the way on from there is open."""
REST_S = 3.0
"""A robot that has been near home for so long is home, though it still turns."""


@dataclass
class _Trip:
    """One robot's way home."""

    reason: str
    path: tuple[Place, ...]
    until_ns: int
    """When it should be home at the latest."""
    ordered_ns: int
    """When it was last ordered there; long ago: it has no order for where to go now."""
    leg: int = 0
    nearest_m: float = math.inf
    """The least of its way that was ever left."""
    nearest_ns: int = 0
    near_ns: int | None = None
    """Since when it has been near home."""
    by_itself: bool = False
    """By the vehicle's own return."""
    lands: bool = False
    """It is home and was ordered to land."""

    @property
    def goal_m(self) -> Place:
        return self.path[-1]

    def left_m(self, here: Place) -> float:
        """What is left of its way."""
        ahead = (here, *self.path[self.leg :])
        return sum(math.dist(a, b) for a, b in itertools.pairwise(ahead))


@dataclass
class ReturnSequence:
    """Who waits to go home, and who is on the way."""

    waiting: dict[str, str] = field(default_factory=dict)
    """Robot to why it goes home, in order."""
    under_way: dict[str, _Trip] = field(default_factory=dict)
    not_before_ns: dict[str, int] = field(default_factory=dict)
    """Robots that were stopped on their way, and when they may set out again at the earliest."""
    strayed: set[str] = field(default_factory=set)
    """Robots that have been out of bounds, or too fast, on their way."""

    def ask(self, name: str, reason: str) -> None:
        """It is to go home. Asking twice is harmless."""
        if name not in self.waiting and name not in self.under_way:
            self.waiting[name] = reason

    def forget(self, name: str) -> None:
        """It is not to go home any more."""
        self.waiting.pop(name, None)
        self.under_way.pop(name, None)
        self.not_before_ns.pop(name, None)
        self.strayed.discard(name)

    def ask_anew(self, robots: Mapping[str, Watched], closed: KeepOut) -> set[str]:
        """Those under way across ground that was closed meanwhile: they are to stop, and to set out on another path."""
        stopped: set[str] = set()
        for name, trip in list(self.under_way.items()):
            ahead = (_seen_at(robots[name]), *trip.path[trip.leg :])
            if not trip.lands and not all(closed.permits(a, b) for a, b in itertools.pairwise(ahead)):
                del self.under_way[name]
                self.waiting[name] = trip.reason
                stopped.add(name)
        return stopped

    def __contains__(self, name: str) -> bool:
        return name in self.waiting or name in self.under_way

    def segments(self, robots: Mapping[str, Watched], settings: SafetySettings) -> dict[str, Segment]:
        """What those under way drive now."""
        return {
            name: Segment(_seen_at(robots[name]), trip.path[trip.leg], settings.max_speed_m_s)
            for name, trip in self.under_way.items()
        }

    def step(self, robots: Mapping[str, Watched], settings: SafetySettings, now_ns: int) -> list[Command]:
        """What to order whom now."""
        commands: list[Command] = []
        for name in list(self.under_way):
            commands += self._go_on(robots[name], settings, now_ns)
        for name in list(self.waiting):
            robot = robots[name]
            here = self._start_of(robot, settings, now_ns)
            if here is None:
                continue
            path = _path_home(robot, here, settings)
            if path and self._is_clear(robot, (here, *path), robots, settings):
                length_m = sum(math.dist(a, b) for a, b in itertools.pairwise((here, *path)))
                until_ns = now_ns + round(1e9 * (SLACK_S + length_m / SLOWEST_M_S))
                trip = _Trip(self.waiting.pop(name), path, until_ns, now_ns, nearest_ns=now_ns)
                self.under_way[name] = trip
                commands.append(_order(robot, trip, settings, now_ns))
        if self.waiting and not self.under_way:
            commands += self._give_up(robots, settings, now_ns)
        return commands

    def _start_of(self, robot: Watched, settings: SafetySettings, now_ns: int) -> Place | None:
        """Where one that waits could set out from now; None where it could not, whatever the others do."""
        rests = now_ns >= self.not_before_ns.get(robot.name, LONG_AGO_NS)
        return _place_of(robot, settings, now_ns) if rests else None

    def _go_on(self, robot: Watched, settings: SafetySettings, now_ns: int) -> list[Command]:
        """One that is under way: home, on to the next corner, still going, or not getting there."""
        name, trip, here = robot.name, self.under_way[robot.name], _seen_at(robot)
        if trip.lands:
            return self._land(robot, trip, now_ns)
        if self._is_home(robot, trip, settings, now_ns):
            if name in settings.altitude_m:
                trip.lands, trip.ordered_ns = True, LONG_AGO_NS
                return self._land(robot, trip, now_ns)
            self.forget(name)
            return [Hold(now_ns, name, f"it is home: {trip.reason}")]
        if now_ns > trip.until_ns:
            self.forget(name)
            return [
                Hold(now_ns, name, f"it was sent home ({trip.reason}) and did not get there"),
                CallOperator(now_ns, name, f"it did not get home: {trip.reason}"),
            ]
        if robot.somebody_elses:
            self.forget(name)
            said = "" if robot.vehicle is None else robot.vehicle.reason
            why = f"it is not ours to steer any more: {said}".rstrip(": ")
            return [CallOperator(now_ns, name, f"{why}, on its way home: {trip.reason}")]
        if why := _must_stop(robot, trip, settings, now_ns):
            return self._stop(robot, trip, settings, now_ns, why)
        while _has_passed(trip, here, settings):
            trip.leg, trip.ordered_ns = trip.leg + 1, LONG_AGO_NS
        if (left_m := trip.left_m(here)) < trip.nearest_m - 0.1:
            trip.nearest_m, trip.nearest_ns = left_m, now_ns
        if not trip.by_itself and (now_ns - trip.nearest_ns) * 1e-9 > settings.stall_s:
            return self._last_resort(robot, trip, settings, now_ns)
        not_ordered = trip.ordered_ns == LONG_AGO_NS
        if not_ordered or (_goes_elsewhere(robot, trip) and (now_ns - trip.ordered_ns) * 1e-9 > REPEAT_S):
            trip.ordered_ns = now_ns
            return [_order(robot, trip, settings, now_ns)]
        return []

    def _stop(
        self, robot: Watched, trip: _Trip, settings: SafetySettings, now_ns: int, why: str
    ) -> list[Command]:
        """Hold on the way, and go on from there when that can be; one that strays or ignores our speed twice stays."""
        name, strays = robot.name, is_out(robot, settings) or bool(too_fast(robot, settings))
        if strays and name in self.strayed:
            self.forget(name)
            return [
                Hold(now_ns, name, why),
                CallOperator(now_ns, name, f"{why}, once more on its way home: {trip.reason}"),
            ]
        if strays:
            self.strayed.add(name)
        if not robot.too_near:  # else the others' paths say when
            self.not_before_ns[name] = now_ns + round(REPEAT_S * 1e9)
        del self.under_way[name]
        self.waiting[name] = trip.reason
        return [Hold(now_ns, name, f"{why}; it goes on home when it can")]

    def _land(self, robot: Watched, trip: _Trip, now_ns: int) -> list[Command]:
        """Above its home: ordered to land until it does; done when it stands or has switched its motors off."""
        vehicle = robot.vehicle
        if vehicle is not None and vehicle.link_up and (vehicle.on_ground or not vehicle.armed):
            self.forget(robot.name)
            return []
        if now_ns > trip.until_ns or robot.somebody_elses:
            self.forget(robot.name)
            return [CallOperator(now_ns, robot.name, f"it did not land: {trip.reason}")]
        if (vehicle is not None and vehicle.mode == "land") or (now_ns - trip.ordered_ns) * 1e-9 <= REPEAT_S:
            return []
        trip.ordered_ns = now_ns
        return [Land(now_ns, robot.name, f"it is home: {trip.reason}")]

    def _last_resort(
        self, robot: Watched, trip: _Trip, settings: SafetySettings, now_ns: int
    ) -> list[Command]:
        """It does not get on by way-points: its own return, where a straight line home is open; else the operator."""
        if settings.bounds.permits(_seen_at(robot), trip.goal_m):
            trip.by_itself, trip.ordered_ns, trip.leg = True, now_ns, len(trip.path) - 1
            return [_order(robot, trip, settings, now_ns)]
        self.forget(robot.name)
        return [CallOperator(now_ns, robot.name, f"it does not get on on its way home: {trip.reason}")]

    def _is_home(self, robot: Watched, trip: _Trip, settings: SafetySettings, now_ns: int) -> bool:
        """Near where it started, and come to rest: one ordered to hold while it still drives would roll past."""
        near_m = max(0.3, settings.near_m)
        if trip.leg < len(trip.path) - 1 or math.dist(_seen_at(robot), trip.goal_m) > near_m:
            trip.near_ns = None
            return False
        if trip.near_ns is None:
            trip.near_ns = now_ns
        rests = math.hypot(*robot.velocity_m_s) <= SLOW_M_S
        return rests or (now_ns - trip.near_ns) * 1e-9 >= REST_S

    def _is_clear(
        self,
        robot: Watched,
        path: tuple[Place, ...],
        robots: Mapping[str, Watched],
        settings: SafetySettings,
    ) -> bool:
        """Whether its path, from where it is, keeps clear of all the others."""
        mine = _ways(robot, path, settings)
        for other in robots.values():
            if other is robot or other.place_m is None or are_layered(robot, other, settings):
                continue
            trip = self.under_way.get(other.name)
            if trip is not None:
                theirs = _ways(other, (other.place_m, *trip.path[trip.leg :]), settings)
            else:
                left = other.segment() or standing(other.place_m)
                somewhere = other.unseen(settings)
                theirs = [left, other.way(left, settings)] if somewhere is None else [somewhere]
            # Side by side is where robots start: only a path that comes nearer than now is in the way.
            limit_m = min(settings.near_m * 1.2, math.dist(path[0], other.place_m) - 0.01)
            if any(ever_m(one, two) < limit_m for one in mine for two in theirs):
                return False
        return True

    def _may_set_out_yet(self, robot: Watched, settings: SafetySettings, now_ns: int) -> bool:
        """Whether one that cannot set out now is expected to: it rests, or nobody has been called for it yet."""
        if self._start_of(robot, settings, now_ns) is not None or robot.pose is None or robot.somebody_elses:
            return False
        return not robot.called or now_ns < self.not_before_ns.get(robot.name, LONG_AGO_NS)

    def _give_up(self, robots: Mapping[str, Watched], settings: SafetySettings, now_ns: int) -> list[Command]:
        """If no robot is under way and none will set out soon: the blocked ones stay, and the operator is called."""
        if any(self._may_set_out_yet(robots[name], settings, now_ns) for name in self.waiting):
            return []
        commands: list[Command] = []
        for name, reason in list(self.waiting.items()):
            if self._start_of(robots[name], settings, now_ns) is None:
                continue
            if any(other.moving for other in robots.values()):
                continue  # its path may come free
            del self.waiting[name]
            commands.append(
                CallOperator(now_ns, name, f"its way home is blocked; it stays where it is: {reason}")
            )
        return commands


def _ways(robot: Watched, path: Sequence[Place], settings: SafetySettings) -> list[Driven]:
    """The segments of `path` as a robot may drive them: straight, or beginning with its widest turn."""
    straight = [Segment(a, b) for a, b in itertools.pairwise(path)]
    return [robot.way(straight[0], settings), *straight]


def _place_of(robot: Watched, settings: SafetySettings, now_ns: int) -> Place | None:
    """Where a robot is that can be ordered to go home; None where nobody knows, it is not heard, or it is not ours."""
    heard = robot.vehicle is None or robot.vehicle.link_up
    if robot.somebody_elses or not heard or position_fault(robot, settings, now_ns):
        return None
    return robot.place_m


def _must_stop(robot: Watched, trip: _Trip, settings: SafetySettings, now_ns: int) -> str:
    """Why one on its way home must hold as any other would; empty where it need not."""
    if reason := robot.late or position_fault(robot, settings, now_ns):
        return reason
    if robot.vehicle is not None and not robot.vehicle.link_up:
        return "its link is down"
    if is_out(robot, settings):
        return f"it is outside the fence or on closed ground, {robot.outside_m:.1f} m deep"
    if robot.too_near:
        return "it is too near another robot"
    return "" if trip.by_itself else too_fast(robot, settings)  # its own return has a speed of its own


def _seen_at(robot: Watched) -> Place:
    """Where a robot under way is: only one that has been seen sets out."""
    assert robot.place_m is not None
    return robot.place_m


def _path_home(robot: Watched, here: Place, settings: SafetySettings) -> tuple[Place, ...]:
    """Corners of the way home, as near to where it started as margins allow; empty where there is none."""
    return route(settings.margins, here, settings.margins.nearest_open(robot.home_m or here))


def _has_passed(trip: _Trip, here: Place, settings: SafetySettings) -> bool:
    """Whether it may go on to the next corner: near this one, and not across the closed ground that it goes round."""
    if trip.leg == len(trip.path) - 1 or math.dist(here, trip.path[trip.leg]) > CORNER_M:
        return False
    return settings.bounds.permits(here, trip.path[trip.leg + 1])


def _order(robot: Watched, trip: _Trip, settings: SafetySettings, now_ns: int) -> Command:
    if trip.by_itself:
        return Return(now_ns, robot.name, f"{trip.reason}; it did not get on by way-points")
    east_m, north_m = trip.path[trip.leg]
    up_m = settings.altitude_m.get(robot.name, 0.0)
    return GoTo(now_ns, robot.name, Waypoint(east_m, north_m, settings.max_speed_m_s, up_m))


def _goes_elsewhere(robot: Watched, trip: _Trip) -> bool:
    """Its vehicle says that it does something else than it was ordered."""
    if robot.vehicle is None or not robot.vehicle.link_up:
        return False
    return robot.vehicle.mode != ("return" if trip.by_itself else "guided")
