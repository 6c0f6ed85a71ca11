"""Ground that robots must keep out of: closed areas, and all that lies outside a fence. Planners and safety ask here.

Shapely (GEOS) does the geometry. Positions are east, north in metres.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from fieldkit.messages import FloatArray

Place = tuple[float, float]
Polygon = tuple[Place, ...]
FAR_M = 1e7
"""How far the ground outside a fence is taken to reach."""
ROUNDING_M = 1e-6
"""A place that was drawn back to a margin lies on it, not within it."""
ARC = 32
"""Straight pieces that a quarter of a circle is made of: margins at corners are right to 0.03 %."""
STEP_M = 0.1
MOST_STEPS = 200
DEEPER_M = 0.05
"""A way back in may lead this much deeper than its start: a robot turns before it gets on."""


@dataclass(frozen=True)
class KeepOut:
    """Closed polygons (at least three corners each), what lies outside `fence` (empty: nothing), and a margin.

    With `margin_m`, ground nearer than that to any of them is closed as well.
    """

    polygons: tuple[Polygon, ...] = ()
    fence: Polygon = ()
    margin_m: float = 0.0

    @cached_property
    def _bare(self) -> Any:
        """The closed ground without a margin."""
        parts = [_valid(polygon) for polygon in self.polygons]
        if self.fence:
            parts.append(shapely.difference(_everything(), _valid(self.fence)))
        return shapely.union_all(parts)

    @cached_property
    def closed(self) -> Any:
        """The closed ground as one shapely geometry, margin included."""
        whole = (
            self._bare
            if self.margin_m <= 0.0
            else shapely.buffer(self._bare, self.margin_m - ROUNDING_M, quad_segs=ARC)
        )
        shapely.prepare(whole)
        return whole

    @cached_property
    def _open(self) -> Any:
        """The ground that is left; its border touches nothing that is closed."""
        return shapely.difference(
            _everything(), shapely.buffer(self._bare, max(self.margin_m, ROUNDING_M), quad_segs=ARC)
        )

    @cached_property
    def _border(self) -> Any:
        return shapely.boundary(self.closed)

    @cached_property
    def is_nothing(self) -> bool:
        """Whether no ground is closed at all."""
        return not (self.polygons or self.fence)

    @cached_property
    def needs_detours(self) -> bool:
        """Whether a straight line between two open places may cross closed ground."""
        if self.polygons:
            return True
        return bool(self.fence) and not shapely.equals(_valid(self.fence), _valid(self.fence).convex_hull)

    @cached_property
    def leaves_room(self) -> bool:
        """Whether any ground inside the fence is left open."""
        return not self.fence or not shapely.covers(self.closed, _valid(self.fence))

    def wider(self, margin_m: float) -> "KeepOut":
        """The same with so much margin."""
        return replace(self, margin_m=margin_m)

    def also(self, polygon: Polygon) -> "KeepOut":
        """The same with one more area closed."""
        return replace(self, polygons=(*self.polygons, polygon))

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """(k,) whether each of points (k, 2) lies on closed ground."""
        if self.is_nothing:
            return np.zeros(len(points_m), dtype=bool)
        return np.asarray(shapely.contains_xy(self.closed, points_m[:, 0], points_m[:, 1]))

    def blocks(self, start_m: FloatArray, end_m: FloatArray) -> NDArray[np.bool_]:
        """(k,) whether the straight path from start (k, 2) to end (k, 2) touches closed ground."""
        if self.is_nothing:
            return np.zeros(len(start_m), dtype=bool)
        return np.asarray(shapely.intersects(self.closed, _lines(start_m, end_m)))

    def distance_m(self, start_m: FloatArray, end_m: FloatArray) -> FloatArray:
        """(k,) how near the straight path from start to end, (k, 2) each, comes to closed ground; 0 at a touch."""
        if self.is_nothing:
            return np.full(len(start_m), np.inf)
        return np.asarray(shapely.distance(self.closed, _lines(start_m, end_m)))

    def clearance_m(self, place_m: Place) -> float:
        """How far a place is from closed ground; on closed ground, how deep it lies in it, as a negative number."""
        if self.is_nothing:
            return math.inf
        point = shapely.Point(place_m)
        outside_m = float(shapely.distance(self.closed, point))
        return outside_m if outside_m > 0.0 else -float(shapely.distance(self._border, point))

    def nearest_open(self, place_m: Place) -> Place:
        """The open place nearest to a place: itself where it is open, and where nothing is."""
        if self.is_nothing or shapely.is_empty(self._open):
            return place_m
        place_m = (min(max(place_m[0], -FAR_M), FAR_M), min(max(place_m[1], -FAR_M), FAR_M))
        if self.clearance_m(place_m) >= 0.0:
            return place_m
        nearest = shapely.shortest_line(shapely.Point(place_m), self._open)
        east_m, north_m = shapely.get_coordinates(nearest)[-1]
        return (float(east_m), float(north_m))

    def permits(self, start_m: Place, end_m: Place) -> bool:
        """Whether a robot may drive straight from start to end.

        It may cross no closed ground. One that stands on closed ground may always drive out of it: on a path whose
        first part is closed, the rest is open, and which leads nowhere deeper than it stands.
        """
        if self.is_nothing or not self.blocks(np.array([start_m]), np.array([end_m]))[0]:
            return True
        if not self.contains(np.array([start_m]))[0] or self.contains(np.array([end_m]))[0]:
            return False
        steps = max(2, min(MOST_STEPS, math.ceil(math.dist(start_m, end_m) / STEP_M)))
        share = np.linspace(0.0, 1.0, steps)[:, None]
        along = np.array(start_m) + share * (np.array(end_m) - np.array(start_m))
        closed = self.contains(along)
        out = int(np.argmin(closed))  # the first that is open
        rest = shapely.LineString([along[out], end_m])
        if closed[out:].any() or shapely.intersects(self.closed, rest):
            return False
        at_start_m = self.clearance_m(start_m)
        return all(self.clearance_m((e, n)) >= at_start_m - DEEPER_M for e, n in along[:out].tolist())


NOWHERE = KeepOut()
"""No ground is closed."""


def fault_of(corners: Sequence[Place]) -> str:
    """What is wrong with a polygon; empty where it is a simple one with an area."""
    if len(corners) < 3:
        return f"a polygon needs at least 3 corners, got {len(corners)}"
    if not np.isfinite(corners).all():
        return "a corner is not a finite number"
    polygon = shapely.Polygon(corners)
    if not shapely.is_valid(polygon):
        reason = shapely.is_valid_reason(polygon)
        where = reason[reason.find("[") :] if "[" in reason else ""
        return f"its sides cross or touch each other {where}".rstrip()
    return "" if polygon.area > 1e-6 else "it has no area"


def margin_m(place: Place, fence: Sequence[Place]) -> float:
    """Distance of a place from a fence; negative outside it."""
    polygon, point = _valid(tuple(fence)), shapely.Point(place)
    away_m = float(shapely.distance(shapely.boundary(polygon), point))
    return away_m if shapely.covers(polygon, point) else -away_m


def _valid(corners: Polygon) -> Any:
    """A polygon from corners; one whose sides cross is taken for all that they enclose."""
    polygon = shapely.Polygon(corners)
    return polygon if shapely.is_valid(polygon) else shapely.make_valid(polygon)


def _everything() -> Any:
    return shapely.box(-FAR_M, -FAR_M, FAR_M, FAR_M)


def _lines(start_m: FloatArray, end_m: FloatArray) -> Any:
    return shapely.linestrings(np.stack([start_m, end_m], axis=1))
