"""How near robots come to each other: on new segments before they are given, and while they drive. Pure.

A robot may still be doing what it was ordered before: its occupancy holds all that is possible. One whose position is
old may be anywhere on what it can have driven since. Robots that fly one above the other do not meet. One on wheels
turns wide: it swings to the side before it is on its way, towards a neighbour too.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from fieldkit.geometry.segments import (
    Driven,
    Place,
    Segment,
    ever_m,
    keep_apart_m,
    leaves,
    nearest_m,
    standing,
)
from fieldkit.geometry.turns import is_behind, turning, until
from mission.safety.limits import SafetySettings
from mission.safety.monitor import Watched

STARTS_S = 4.0
"""How much later than another a robot may set out: it turns on the spot first, or its order is sent again."""
AT_ONCE = ((0.0, 0.0),)
_DELAYS_S = [STARTS_S * k / 5 for k in range(1, 6)]
LATE_STARTS = (*AT_ONCE, *((late_s, 0.0) for late_s in _DELAYS_S), *((0.0, late_s) for late_s in _DELAYS_S))
TURNS_ROUND = 2.0
"""A robot that turns round gets no further from its segment than so many turning radii."""
SLACK_M = 1e-6
"""More than rounding: what a quick look finds this much too far apart is so by a closer one too."""
CLEAR_OF_NEAR = 1.2
"""A new path keeps so many times the distance that is too near, and two that were too near part as far."""
OFF_SIGMAS = 3.0
MOST_CLEAR = 1.5
"""A new path keeps so many deviations more than too near of what two positions may be off, and no more than so many
times that distance: who is refused asks again with the next positions, until by chance they seem far enough apart."""
SOON_S = 4.0
"""How far ahead robots under way are watched: time to order one to stop over a poor link."""
ALOFT_SHARE = 0.7
"""Robots keep their layers to within this share of the vertical separation: a gust is not a descent."""


@dataclass(frozen=True, slots=True)
class Occupancy:
    """All that a robot may be doing, and where it may be if its position is old."""

    robot: Watched
    segments: tuple[Segment, ...]
    somewhere: Segment | None


def occupancies(robots: Mapping[str, Watched], settings: SafetySettings) -> dict[str, Occupancy]:
    """Every robot's, before new segments are given."""
    return {
        name: Occupancy(robot, robot.segments(), robot.unseen(settings)) for name, robot in robots.items()
    }


def clear_m(robot: Watched, other: Watched, settings: SafetySettings) -> float:
    """How far a new path of `robot` keeps from another."""
    off_m = math.hypot(*(each.pose.sigma_m for each in (robot, other) if each.pose is not None))
    near_m = settings.near_m
    return min(max(CLEAR_OF_NEAR * near_m, near_m + OFF_SIGMAS * off_m), MOST_CLEAR * near_m)


def conflict(
    robot: Watched,
    segment: Segment,
    new: Mapping[str, Segment],
    occupied: Mapping[str, Occupancy],
    undecided: Collection[str],
    settings: SafetySettings,
) -> str:
    """Which robot `segment` comes too near, at any start of the two; empty where it keeps clear of all.

    `new` are segments given together with it. Those of `undecided` robots come later, and their old ones are void.
    """
    if robot.name in settings.on_foot:
        return ""
    swing_m = 2.0 * TURNS_ROUND * settings.turn_radius_m
    turns = _turns(robot, segment, settings)
    for name, occupancy in occupied.items():
        if name == robot.name or name in undecided or are_layered(robot, occupancy.robot, settings):
            continue
        limit_m = clear_m(robot, occupancy.robot, settings)
        if occupancy.somewhere is not None:
            nearest = ever_m(segment, occupancy.somewhere)
            if nearest < limit_m and not leaves(segment, occupancy.somewhere, limit_m):
                return f"its path comes within {nearest:.2f} m of where {name} may be"
            continue
        given = new.get(name)
        for other in occupancy.segments if given is None else (given,):
            if keep_apart_m(segment, other) >= limit_m + swing_m:  # a short cut
                continue
            least_m = min(limit_m, math.dist(segment.start_m, other.start_m) - 0.01)
            nearest = _nearest_m(segment, other, least_m)
            if nearest < least_m:
                return f"its path comes within {nearest:.2f} m of {name}"
            for mine in turns:
                for theirs in _turns(occupancy.robot, other, settings):
                    nearest = _nearest_m(mine, theirs, least_m)
                    if nearest < least_m:
                        return f"turning, it comes within {nearest:.2f} m of {name}"
    return ""


def _nearest_m(one: Driven, other: Driven, least_m: float) -> float:
    """How near two come at any start of theirs; no closer look where that is more than `least_m` anyway."""
    ever = ever_m(one, other)
    if ever > least_m + SLACK_M:
        return ever
    return min(nearest_m(one, other, a, b) for a, b in _starts(other))


def _turns(robot: Watched, segment: Segment, settings: SafetySettings) -> tuple[Driven, ...]:
    """How it may turn on its way; one sent back where it came from, to either side."""
    radius_m, heading_deg = settings.turns_in_m(robot.name), robot.heading_deg
    way = turning(segment, heading_deg, radius_m)
    if radius_m == 0.0 or not is_behind(segment, heading_deg):
        return (way,)
    return way, turning(segment, heading_deg, radius_m, wrong_way=True)


def are_layered(one: Watched, other: Watched, settings: SafetySettings) -> bool:
    """Whether two robots fly so far above each other, by their layers and as they are now, that they cannot meet."""
    gap_m = settings.vertical_separation_m
    layers = settings.altitude_m.get(one.name, 0.0) - settings.altitude_m.get(other.name, 0.0)
    if abs(layers) < gap_m or one.pose is None or other.pose is None:
        return False
    return abs(one.pose.up_m - other.pose.up_m) >= ALOFT_SHARE * gap_m


def mark_too_near(
    robots: Mapping[str, Watched], homeward: Mapping[str, Segment], settings: SafetySettings
) -> None:
    """Set `too_near` on those that are, or will be if both go on: of two the later-named, or both where one
    is not enough.

    `homeward` are the segments of robots on their way home.
    """
    near_m, apart_m = settings.near_m, CLEAR_OF_NEAR * settings.near_m
    before = {name: robot.too_near for name, robot in robots.items()}
    for robot in robots.values():
        robot.too_near = False
    # People give way to nobody: whoever drives near one has to.
    drives = {name for name, robot in robots.items() if robot.moving or name in homeward} - settings.on_foot
    near = [moment for robot in robots.values() if (moment := _moment(robot, homeward, settings)) is not None]
    for later, mine in enumerate(near):
        for other in near[:later]:
            gap_m = math.dist(mine.place_m, other.place_m)
            if gap_m - mine.reach_m - other.reach_m > apart_m:  # a short cut, for most pairs
                continue
            if are_layered(mine.robot, other.robot, settings):
                continue
            if gap_m < (apart_m if before[mine.robot.name] else near_m):
                if nearest_m(other.soon, mine.soon) < gap_m - 0.01:
                    (mine if mine.robot.name in drives else other).robot.too_near = True
                    # Where that does not help, since the other drives past or over it, that one waits as well.
                    if nearest_m(other.soon, standing(mine.place_m)) < min(near_m, gap_m) - 0.01:
                        other.robot.too_near = other.robot.name in drives
            elif (yields := _must_yield(other, mine, drives, settings)) is not None:
                yields.too_near = True
    for name in settings.on_foot:
        robots[name].too_near = False


@dataclass(frozen=True, slots=True)
class _Moment:
    """A robot whose place is known, now and in the next moments."""

    robot: Watched
    place_m: Place
    soon: Driven
    somewhere: Segment | None
    """Where it may be, if its position is old."""
    reach_m: float = field(init=False)
    """How far from its place any of that leads."""

    def __post_init__(self) -> None:
        lengths_m = [segment.length_m for segment in (self.soon, self.somewhere) if segment is not None]
        object.__setattr__(self, "reach_m", max(lengths_m))


def _moment(robot: Watched, homeward: Mapping[str, Segment], settings: SafetySettings) -> _Moment | None:
    """Where it is and will be soon; None where its place is not known."""
    left = robot.segment()
    if left is None:
        return None
    here, segment = left.start_m, homeward.get(robot.name, left)
    ahead_s = SOON_S + settings.braking_m / max(settings.max_speed_m_s, 1e-3)
    obeys = segment.length_m and not robot.strays
    soon = until(robot.way(segment, settings), ahead_s) if obeys else robot.drift(ahead_s)
    return _Moment(robot, here, soon or standing(here), robot.unseen(settings))


def _must_yield(
    first: _Moment, second: _Moment, drives: Collection[str], settings: SafetySettings
) -> Watched | None:
    """Which of two has to stop now so that they do not meet; None where they keep clear."""
    near_m = settings.near_m
    for mover, other in ((second, first), (first, second)):
        if other.somewhere is None or mover.robot.name not in drives:
            continue
        straight = Segment(mover.place_m, mover.soon.legs[-1].end_m)
        if ever_m(mover.soon, other.somewhere) < near_m and not leaves(straight, other.somewhere, near_m):
            return mover.robot
    one, two = first.soon, second.soon
    if keep_apart_m(one, two) >= near_m:  # a short cut
        return None
    limit_m = min(near_m, math.dist(one.start_m, two.start_m) - 0.01)
    if all(nearest_m(one, two, *late_s) >= limit_m for late_s in _seen_apart(first.robot, second.robot)):
        return _past_a_slow_one(first, second, limit_m)
    helps = nearest_m(one, standing(two.start_m)) >= limit_m
    second_drives, first_drives = second.robot.name in drives, first.robot.name in drives
    if second_drives and (helps or not first_drives):
        return second.robot
    return first.robot if first_drives else second.robot


def _seen_apart(one: Watched, other: Watched) -> tuple[tuple[float, float], ...]:
    """How much later each may be, against the other, than where it was last seen says: one seen earlier has got on.

    A robot's own agent sees it now, and another half a second late: at 0.4 m/s that is what keeps two apart that cross.
    """
    if one.pose is None or other.pose is None:
        return AT_ONCE
    later_s = (one.pose.t_ns - other.pose.t_ns) * 1e-9
    return AT_ONCE if later_s == 0.0 else (*AT_ONCE, (max(later_s, 0.0), max(-later_s, 0.0)))


def _past_a_slow_one(first: _Moment, second: _Moment, limit_m: float) -> Watched | None:
    """Which of two drives too near past the other that has not got going: a car turns wide before it gets on."""
    if first.robot.lags(STARTS_S) and nearest_m(standing(first.place_m), second.soon) < limit_m:
        return second.robot
    if second.robot.lags(STARTS_S) and nearest_m(first.soon, standing(second.place_m)) < limit_m:
        return first.robot
    return None


def _starts(other: Driven) -> tuple[tuple[float, float], ...]:
    """Delays of the one and the other to look at: close enough to each other to miss no meeting in between."""
    return AT_ONCE if other.length_m == 0 else LATE_STARTS
