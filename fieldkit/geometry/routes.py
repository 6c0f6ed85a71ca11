"""The shortest path round closed ground: along the corners that can be seen from one another, by Dijkstra's rule."""

import heapq
import math

import shapely

from fieldkit.geometry.polygons import KeepOut, Place

CLEAR_M = 0.05
"""Corners are passed this far off: a path along them must not touch."""
MOST_CORNERS = 400


def route(keep_out: KeepOut, start_m: Place, end_m: Place) -> tuple[Place, ...]:
    """Corners from `start_m` (left out) to `end_m`; empty where no path leads there.

    A start on closed ground is left by the shortest way first.
    """
    if keep_out.permits(start_m, end_m):
        return (end_m,)
    if keep_out.clearance_m(start_m) < 0.0:
        out_m = keep_out.nearest_open(start_m)
        onward = route(keep_out, out_m, end_m) if keep_out.clearance_m(out_m) >= 0.0 else ()
        return (out_m, *onward) if onward else ()
    places = [start_m, end_m, *_corners(keep_out)]
    best = {0: 0.0}
    before: dict[int, int] = {}
    waiting = [(math.dist(start_m, end_m), 0)]
    done: set[int] = set()
    while waiting:
        _, here = heapq.heappop(waiting)
        if here == 1:
            path = [1]
            while path[-1] in before:
                path.append(before[path[-1]])
            return tuple(places[index] for index in reversed(path[:-1]))
        if here in done:
            continue
        done.add(here)
        for there in range(1, len(places)):
            if there in done or not keep_out.permits(places[here], places[there]):
                continue
            length_m = best[here] + math.dist(places[here], places[there])
            if length_m < best.get(there, math.inf):
                best[there], before[there] = length_m, here
                heapq.heappush(waiting, (length_m + math.dist(places[there], end_m), there))
    return ()


def _corners(keep_out: KeepOut) -> list[Place]:
    """Open places just off the corners of the closed ground."""
    ring = shapely.boundary(shapely.buffer(keep_out.closed, CLEAR_M, join_style="mitre"))
    ring = shapely.simplify(ring, 0.2 * CLEAR_M)
    corners = [(float(e), float(n)) for e, n in shapely.get_coordinates(ring)[:MOST_CORNERS]]
    return [corner for corner in dict.fromkeys(corners) if keep_out.clearance_m(corner) > 0.0]
