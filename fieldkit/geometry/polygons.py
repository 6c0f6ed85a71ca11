"""Ground the robots must not enter: polygons in the field frame."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fieldkit.messages import FloatArray

Polygon = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class KeepOut:
    """Any number of simple polygons, each at least three corners (east, north in metres)."""

    polygons: tuple[Polygon, ...] = ()

    @cached_property
    def _edges(self) -> tuple[FloatArray, FloatArray]:
        """Start and end of every edge, (e, 2) each."""
        starts = [corner for polygon in self.polygons for corner in polygon]
        ends = [corner for polygon in self.polygons for corner in (*polygon[1:], polygon[0])]
        return np.array(starts, dtype=float).reshape(-1, 2), np.array(ends, dtype=float).reshape(-1, 2)

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """(k,) whether each of points (k, 2) lies in a polygon: a ray to the east crosses an odd number of edges."""
        inside = np.zeros(len(points_m), dtype=bool)
        for polygon in self.polygons:
            corners = np.array(polygon, dtype=float)
            nexts = np.roll(corners, -1, axis=0)
            north = points_m[:, 1, None]
            spans = (corners[:, 1] > north) != (nexts[:, 1] > north)
            with np.errstate(divide="ignore", invalid="ignore"):
                share = (north - corners[:, 1]) / (nexts[:, 1] - corners[:, 1])
                at = corners[:, 0] + share * (nexts[:, 0] - corners[:, 0])
            inside |= (spans & (points_m[:, 0, None] < at)).sum(axis=1) % 2 == 1
        return inside

    def blocks(self, start_m: FloatArray, end_m: FloatArray) -> NDArray[np.bool_]:
        """(k,) whether the straight way from start (k, 2) to end (k, 2) touches a polygon or ends in one."""
        if not self.polygons:
            return np.zeros(len(start_m), dtype=bool)
        a, b = self._edges
        p, q = start_m[:, None, :], end_m[:, None, :]
        crossing = (_side(p, q, a) * _side(p, q, b) <= 0) & (_side(a, b, p) * _side(a, b, q) <= 0)
        # Edges in line with the way but beyond it touch nothing: their boxes must overlap as well.
        overlap = (np.minimum(p, q) <= np.maximum(a, b)).all(-1) & (np.minimum(a, b) <= np.maximum(p, q)).all(
            -1
        )
        return np.asarray((crossing & overlap).any(axis=1) | self.contains(end_m))

    def distance_m(self, start_m: FloatArray, end_m: FloatArray) -> FloatArray:
        """(k,) how near the straight way from start (k, 2) to end (k, 2) comes to a polygon; 0 where it touches one."""
        if not self.polygons:
            return np.full(len(start_m), np.inf)
        a, b = self._edges
        p, q = start_m[:, None, :], end_m[:, None, :]
        each = [
            _to_segment_m(p, a, b),
            _to_segment_m(q, a, b),
            _to_segment_m(a, p, q),
            _to_segment_m(b, p, q),
        ]
        return np.where(self.blocks(start_m, end_m), 0.0, np.min(each, axis=(0, 2)))


def _to_segment_m(point: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Distance of points from segments, broadcast over all but the last axis."""
    along, off = end - start, point - start
    share = (off * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-300)
    rest = off - np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.hypot(rest[..., 0], rest[..., 1]))


def _side(origin: FloatArray, towards: FloatArray, point: FloatArray) -> FloatArray:
    """Sign of the turn from origin-towards to origin-point: which side the point lies on."""
    d, e = towards - origin, point - origin
    return np.asarray(np.sign(d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]))


NOWHERE = KeepOut()
"""No ground is forbidden."""
