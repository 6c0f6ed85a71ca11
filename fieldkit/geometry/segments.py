"""Straight segments driven in time: how near two of them come. Pure geometry, field frame."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

Place = tuple[float, float]


class Driven(Protocol):
    """A way that is driven in time: a straight segment, or a path that begins with a turn (`geometry.turns`)."""

    @property
    def start_m(self) -> Place: ...
    @property
    def length_m(self) -> float: ...
    @property
    def knots_s(self) -> tuple[float, ...]:
        """When its velocity changes. It is straight and steady in between."""
        ...

    @property
    def legs(self) -> "tuple[Segment, ...]":
        """Its straight pieces."""
        ...

    def at(self, t_s: float) -> Place:
        """Where it is after `t_s`."""
        ...


@dataclass(frozen=True, slots=True)
class Segment:
    """From one place straight to another, and to stand there. A robot that stands goes to where it is."""

    start_m: Place
    end_m: Place
    speed_m_s: float = 0.0
    delay_s: float = 0.0
    length_m: float = field(init=False, repr=False, compare=False)
    arrival_s: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # Once: safety looks at the segments of every two robots at every tick.
        length_m = math.dist(self.start_m, self.end_m)
        object.__setattr__(self, "length_m", length_m)
        takes_s = length_m / self.speed_m_s if self.speed_m_s > 0 else 0.0
        object.__setattr__(self, "arrival_s", self.delay_s + takes_s)

    @property
    def knots_s(self) -> tuple[float, ...]:
        return (self.delay_s, self.arrival_s)

    @property
    def legs(self) -> "tuple[Segment, ...]":
        return (self,)

    def at(self, t_s: float) -> Place:
        """Where it is after `t_s`."""
        if self.length_m == 0 or self.speed_m_s <= 0:
            return self.start_m
        share = min(max((t_s - self.delay_s) * self.speed_m_s / self.length_m, 0.0), 1.0)
        (e0, n0), (e1, n1) = self.start_m, self.end_m
        return (e0 + share * (e1 - e0), n0 + share * (n1 - n0))


def standing(place_m: Place) -> Segment:
    """A robot that stays where it is."""
    return Segment(place_m, place_m)


def nearest_m(one: Driven, other: Driven, one_late_s: float = 0.0, other_late_s: float = 0.0) -> float:
    """The least distance between two robots that set out now, or so much later, each at its speed."""
    moments = {
        0.0,
        *(knot_s + one_late_s for knot_s in one.knots_s),
        *(knot_s + other_late_s for knot_s in other.knots_s),
    }
    apart = [_apart(one.at(t_s - one_late_s), other.at(t_s - other_late_s)) for t_s in sorted(moments)]
    return min((_from_origin(a, b) for a, b in pairwise(apart)), default=math.hypot(*apart[-1]))


def keep_apart_m(one: Driven, other: Driven) -> float:
    """A distance they cannot come nearer than, whatever their speeds: quickly computed, and rarely more than needed."""
    return math.dist(one.start_m, other.start_m) - one.length_m - other.length_m


def ever_m(one: Driven, other: Driven) -> float:
    """The least distance between two ways, whenever they are driven."""
    return min(_ever_m(a, b) for a in one.legs for b in other.legs)


def _ever_m(one: Segment, other: Segment) -> float:
    if _cross(one, other):
        return 0.0
    return min(
        to_segment_m(one.start_m, other.start_m, other.end_m),
        to_segment_m(one.end_m, other.start_m, other.end_m),
        to_segment_m(other.start_m, one.start_m, one.end_m),
        to_segment_m(other.end_m, one.start_m, one.end_m),
    )


def leaves(segment: Segment, ground: Segment, clear_m: float) -> bool:
    """Whether a segment that starts on or beside another's ground leads off it at once, and clear of it.

    At more than 30 degrees: the distance from a straight ground grows all along a straight segment that begins so.
    """
    if segment.length_m == 0:
        return False
    share = min(1.0, clear_m / segment.length_m)
    (e0, n0), (e1, n1) = segment.start_m, segment.end_m
    places = (segment.start_m, (e0 + share * (e1 - e0), n0 + share * (n1 - n0)), segment.end_m)
    at_start_m, soon_m, at_end_m = (to_segment_m(place, ground.start_m, ground.end_m) for place in places)
    return at_end_m >= clear_m and soon_m >= at_start_m + 0.5 * share * segment.length_m


def to_segment_m(point: Place, start: Place, end: Place) -> float:
    """Distance of a point from a segment."""
    return _from_origin(
        (start[0] - point[0], start[1] - point[1]),
        (end[0] - point[0], end[1] - point[1]),
    )


def _cross(one: Segment, other: Segment) -> bool:
    """Whether each has its ends on both sides of the other. Segments that only touch do not cross: an end is near."""
    return _parts(one, other) and _parts(other, one)


def _parts(segment: Segment, other: Segment) -> bool:
    """Whether the line along a segment has the ends of another on different sides."""
    left, right = _side(segment, other.start_m), _side(segment, other.end_m)
    return (left < 0.0 < right) or (right < 0.0 < left)


def _side(segment: Segment, point: Place) -> float:
    """Positive to the left of the line along a segment, 0 on it."""
    (e0, n0), (e1, n1) = segment.start_m, segment.end_m
    return (e1 - e0) * (point[1] - n0) - (n1 - n0) * (point[0] - e0)


def _apart(one: Place, other: Place) -> Place:
    return (other[0] - one[0], other[1] - one[1])


def _from_origin(a: Place, b: Place) -> float:
    """Least distance of the segment from `a` to `b` from the origin."""
    step = (b[0] - a[0], b[1] - a[1])
    length2 = step[0] ** 2 + step[1] ** 2
    share = 0.0 if length2 == 0 else min(max(-(a[0] * step[0] + a[1] * step[1]) / length2, 0.0), 1.0)
    return math.hypot(a[0] + share * step[0], a[1] + share * step[1])
