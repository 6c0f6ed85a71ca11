"""Straight ways of robots: how near two of them come, and what lies outside a fence. Pure geometry, field frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from fieldkit.geometry.polygons import KeepOut, Polygon

Place = tuple[float, float]
FAR_M = 1e7
"""How far the ground outside a fence is taken to reach."""


@dataclass(frozen=True, slots=True)
class Way:
    """From one place straight to another, and to stand there. A robot that stands goes to where it is."""

    start_m: Place
    end_m: Place
    speed_m_s: float = 0.0
    delay_s: float = 0.0
    length_m: float = field(init=False, repr=False, compare=False)
    arrival_s: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # Once: safety looks at the ways of every two robots at every tick.
        length_m = math.dist(self.start_m, self.end_m)
        object.__setattr__(self, "length_m", length_m)
        takes_s = length_m / self.speed_m_s if self.speed_m_s > 0 else 0.0
        object.__setattr__(self, "arrival_s", self.delay_s + takes_s)

    def at(self, t_s: float) -> Place:
        """Where it is after `t_s`."""
        if self.length_m == 0 or self.speed_m_s <= 0:
            return self.start_m
        share = min(max((t_s - self.delay_s) * self.speed_m_s / self.length_m, 0.0), 1.0)
        (e0, n0), (e1, n1) = self.start_m, self.end_m
        return (e0 + share * (e1 - e0), n0 + share * (n1 - n0))


def standing(place_m: Place) -> Way:
    """A robot that stays where it is."""
    return Way(place_m, place_m)


def nearest_m(one: Way, other: Way, one_late_s: float = 0.0, other_late_s: float = 0.0) -> float:
    """The least distance between two robots that set out now, or so much later, each at its speed."""
    moments = {
        0.0,
        one.delay_s + one_late_s,
        other.delay_s + other_late_s,
        one.arrival_s + one_late_s,
        other.arrival_s + other_late_s,
    }
    apart = [_apart(one.at(t_s - one_late_s), other.at(t_s - other_late_s)) for t_s in sorted(moments)]
    return min((_from_origin(a, b) for a, b in pairwise(apart)), default=math.hypot(*apart[-1]))


def keep_apart_m(one: Way, other: Way) -> float:
    """A distance they cannot come nearer than, whatever their speeds: quickly told, and rarely more than needed."""
    return math.dist(one.start_m, other.start_m) - one.length_m - other.length_m


def ever_m(one: Way, other: Way) -> float:
    """The least distance between two ways, whenever they are driven."""
    if _cross(one, other):
        return 0.0
    return min(
        to_segment_m(one.start_m, other.start_m, other.end_m),
        to_segment_m(one.end_m, other.start_m, other.end_m),
        to_segment_m(other.start_m, one.start_m, one.end_m),
        to_segment_m(other.end_m, one.start_m, one.end_m),
    )


def leaves(way: Way, ground: Way, clear_m: float) -> bool:
    """Whether a way that starts on or beside another's ground leads off it at once, and clear of it.

    At more than 30 degrees: the distance from a straight ground grows all along a straight way that begins so.
    """
    if way.length_m == 0:
        return False
    share = min(1.0, clear_m / way.length_m)
    (e0, n0), (e1, n1) = way.start_m, way.end_m
    places = (way.start_m, (e0 + share * (e1 - e0), n0 + share * (n1 - n0)), way.end_m)
    at_start_m, soon_m, at_end_m = (to_segment_m(place, ground.start_m, ground.end_m) for place in places)
    return at_end_m >= clear_m and soon_m >= at_start_m + 0.5 * share * way.length_m


def to_segment_m(point: Place, start: Place, end: Place) -> float:
    """Distance of a point from a segment."""
    return _from_origin(
        (start[0] - point[0], start[1] - point[1]),
        (end[0] - point[0], end[1] - point[1]),
    )


def _cross(one: Way, other: Way) -> bool:
    """Whether each has its ends on both sides of the other. Ways that only touch do not cross: an end is near."""
    return _parts(one, other) and _parts(other, one)


def _parts(way: Way, other: Way) -> bool:
    """Whether the line along a way has the ends of another on different sides."""
    left, right = _side(way, other.start_m), _side(way, other.end_m)
    return (left < 0.0 < right) or (right < 0.0 < left)


def _side(way: Way, point: Place) -> float:
    """Positive to the left of the line along a way, 0 on it."""
    (e0, n0), (e1, n1) = way.start_m, way.end_m
    return (e1 - e0) * (point[1] - n0) - (n1 - n0) * (point[0] - e0)


def _apart(one: Place, other: Place) -> Place:
    return (other[0] - one[0], other[1] - one[1])


def _from_origin(a: Place, b: Place) -> float:
    """Least distance of the segment from `a` to `b` from the origin."""
    step = (b[0] - a[0], b[1] - a[1])
    length2 = step[0] ** 2 + step[1] ** 2
    share = 0.0 if length2 == 0 else min(max(-(a[0] * step[0] + a[1] * step[1]) / length2, 0.0), 1.0)
    return math.hypot(a[0] + share * step[0], a[1] + share * step[1])


def outside(fence: Sequence[Place]) -> Polygon:
    """All ground outside a fence (at least three corners) as one polygon to keep out of.

    A keyhole: round the far border, in along a seam, round the fence, out along the same seam. The seam runs west
    from the westernmost corner, so it lies outside, and a ray to the east never crosses it.
    """
    first = min(range(len(fence)), key=lambda index: fence[index][0])
    corners = [*fence[first:], *fence[:first]]
    seam = (-FAR_M, corners[0][1])
    far = [seam, (-FAR_M, -FAR_M), (FAR_M, -FAR_M), (FAR_M, FAR_M), (-FAR_M, FAR_M), seam]
    return (*far, *corners, corners[0])


def margin_m(place: Place, fence: Sequence[Place]) -> float:
    """Distance of a place from a fence; negative outside it."""
    edges = zip(fence, (*fence[1:], fence[0]), strict=True)
    distance = min(to_segment_m(place, start, end) for start, end in edges)
    is_inside = KeepOut((tuple(fence),)).contains(np.array([place]))[0]
    return distance if is_inside else -distance
