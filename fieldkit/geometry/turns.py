"""Paths that begin with a turn: a robot steered like a car drives an arc before it is on its way. Pure geometry.

The arc is that of Dubins' paths: from the present heading, to the side of the way-point, at the turning radius, until
the way-point lies ahead (L. E. Dubins, American Journal of Mathematics 79, 1957). It is drawn as chords.
"""

import math
from dataclasses import dataclass

from fieldkit.geometry.segments import Place, Segment

CHORD_RAD = math.radians(30.0)
"""A chord of so much is off its arc by 3.4 % of the radius."""
STRAIGHT_RAD = math.radians(10.0)
"""A way-point as far off the heading as this is ahead: what the turn adds is a thousandth of the way."""
BEHIND_DEG = 15.0
TURNING_SHARE = 0.6
"""A robot slows down in a turn: to this share of its speed, about."""


@dataclass(frozen=True, slots=True)
class Path:
    """Straight legs driven one after the other, each from where and when the one before ends."""

    legs: tuple[Segment, ...]

    @property
    def start_m(self) -> Place:
        return self.legs[0].start_m

    @property
    def length_m(self) -> float:
        return sum(leg.length_m for leg in self.legs)

    @property
    def knots_s(self) -> tuple[float, ...]:
        return (self.legs[0].delay_s, *(leg.arrival_s for leg in self.legs))

    def at(self, t_s: float) -> Place:
        """Where it is after `t_s`."""
        for leg in self.legs:
            if t_s <= leg.arrival_s:
                return leg.at(t_s)
        return self.legs[-1].end_m


def turning(
    segment: Segment, heading_deg: float | None, radius_m: float, *, wrong_way: bool = False
) -> Segment | Path:
    """How a robot that looks along `heading_deg` (clockwise from north) drives `segment`; straight where that is
    not known, where it turns on the spot (`radius_m` 0) or where the way lies ahead.

    A way-point inside the turning circle is passed where the circle comes nearest to it. With `wrong_way` it turns to
    the side away from its way-point: of one almost behind nobody knows to which side it turns.
    """
    if heading_deg is None or radius_m <= 0.0 or segment.length_m == 0.0:
        return segment
    (east, north), (to_east, to_north) = segment.start_m, segment.end_m
    heading = math.radians(heading_deg)
    ahead, right = (math.sin(heading), math.cos(heading)), (math.cos(heading), -math.sin(heading))
    along_m = (to_east - east) * ahead[0] + (to_north - north) * ahead[1]
    across_m = (to_east - east) * right[0] + (to_north - north) * right[1]
    if abs(math.atan2(across_m, along_m)) <= STRAIGHT_RAD:
        return segment
    across = abs(across_m) / radius_m
    sweep = _sweep_rad(along_m / radius_m, -across if wrong_way else across)
    side = math.copysign(radius_m, -across_m if wrong_way else across_m)
    chords = max(1, math.ceil(sweep / CHORD_RAD))
    places = [segment.start_m]
    for k in range(1, chords + 1):
        angle = sweep * k / chords
        forward_m, sideways_m = radius_m * math.sin(angle), side * (1.0 - math.cos(angle))
        places.append(
            (
                east + forward_m * ahead[0] + sideways_m * right[0],
                north + forward_m * ahead[1] + sideways_m * right[1],
            )
        )
    legs: list[Segment] = []
    at_s = segment.delay_s
    for start, end in zip(places, [*places[1:], segment.end_m], strict=True):
        speed_m_s = segment.speed_m_s * (TURNING_SHARE if len(legs) < chords else 1.0)
        legs.append(Segment(start, end, speed_m_s, at_s))
        at_s = legs[-1].arrival_s
    return Path(tuple(legs))


def is_behind(segment: Segment, heading_deg: float | None) -> bool:
    """Whether the end lies so far behind that nobody knows to which side a robot turns."""
    if heading_deg is None or segment.length_m == 0.0:
        return False
    (east, north), (to_east, to_north) = segment.start_m, segment.end_m
    off_deg = math.degrees(math.atan2(to_east - east, to_north - north)) - heading_deg
    return abs((off_deg + 180.0) % 360.0 - 180.0) >= 180.0 - BEHIND_DEG


def until(way: Segment | Path, t_s: float) -> Segment | Path:
    """The part of a way that is driven within `t_s`."""
    legs = [leg for leg in way.legs if leg.delay_s < t_s] or [way.legs[0]]
    last = legs[-1]
    if last.arrival_s > t_s:
        legs[-1] = Segment(last.start_m, last.at(t_s), last.speed_m_s, last.delay_s)
    return legs[0] if len(legs) == 1 else Path(tuple(legs))


def _sweep_rad(along: float, across: float) -> float:
    """How far round the circle of radius 1 about (0, 1) goes a robot that starts at the origin along the first axis,
    until (along, across) lies straight ahead, or is nearest."""
    off_centre = (along, across - 1.0)
    distance = math.hypot(*off_centre)
    bearing = math.atan2(
        off_centre[0], -off_centre[1]
    )  # the angle round the centre at which the circle is nearest
    if distance > 1.0:
        bearing -= math.acos(1.0 / distance)  # the tangent touches that much earlier
    return bearing % (2.0 * math.pi)
