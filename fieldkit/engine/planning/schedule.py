"""A tour of ridges as a schedule in time: at which place and heading a robot is at every moment (RWA section V).

Off the ridges it drives at full speed; each ridge takes its share of what time is left (eq 28 and 29), driven
evenly once, or swept back and forth at full speed by robots that cannot crawl. What the paper leaves open: a ridge
never takes less than its length at full speed; no travel time left means no time on ridges; the schedule ends with
the period.
"""

import math
from dataclasses import dataclass

import numpy as np

from fieldkit.engine.planning.tour import off_ridge_m, time_on_ridges_s
from fieldkit.messages import FloatArray


@dataclass(frozen=True, slots=True)
class Piece:
    """A straight, even stretch of the way; a robot that waits stays where it is, its heading kept."""

    t0_s: float
    t1_s: float
    start_m: tuple[float, float]
    end_m: tuple[float, float]
    ridge: int | None = None
    """Index of the ridge it walks on; None between ridges."""

    def at(self, t_s: float) -> tuple[float, float]:
        """Where the robot is at `t_s` within the piece."""
        share = 0.0 if self.t1_s <= self.t0_s else (t_s - self.t0_s) / (self.t1_s - self.t0_s)
        (e0, n0), (e1, n1) = self.start_m, self.end_m
        return e0 + share * (e1 - e0), n0 + share * (n1 - n0)


@dataclass(frozen=True, slots=True)
class Schedule:
    """Pieces one after another, from time 0 of the period."""

    pieces: tuple[Piece, ...]

    def pose_at(self, t_s: float) -> tuple[float, float, float]:
        """East, north, and the heading counter-clockwise from east in radians; after the end, where it ended."""
        theta = 0.0
        for piece in self.pieces:
            (e0, n0), (e1, n1) = piece.start_m, piece.end_m
            if math.hypot(e1 - e0, n1 - n0) > 0.0:
                theta = math.atan2(n1 - n0, e1 - e0)
            if t_s <= piece.t1_s:
                return (*piece.at(t_s), theta)
        return (*self.pieces[-1].end_m, theta) if self.pieces else (math.nan, math.nan, math.nan)

    def corners_m(self) -> FloatArray:
        """(k, 2) ends of all pieces: the way-points of the tour."""
        return np.array([piece.end_m for piece in self.pieces]).reshape(-1, 2)


def ridge_schedule(
    start_m: FloatArray,
    ends_m: FloatArray,
    order: list[tuple[int, bool]],
    weights: FloatArray,
    period_s: float,
    speed_m_s: float,
    *,
    sweeps: bool = False,
) -> Schedule:
    """The tour `order` (index, reversed) over ridges (k, 2, 2) within one period.

    `sweeps`: ridges are driven back and forth at full speed, an odd number of times, instead of once and slowly.
    """
    tau_s = time_on_ridges_s(weights, period_s, off_ridge_m(start_m, ends_m, order), speed_m_s)
    pieces: list[Piece] = []
    t_s = 0.0
    here = (float(start_m[0]), float(start_m[1]))

    def go(to: FloatArray, duration_s: float, ridge: int | None) -> None:
        nonlocal t_s, here
        there = (float(to[0]), float(to[1]))
        piece = Piece(t_s, t_s + duration_s, here, there, ridge)
        if piece.t1_s > period_s:  # the period ends on the way
            there = piece.at(period_s)
            piece = Piece(t_s, period_s, here, there, ridge)
        pieces.append(piece)
        t_s, here = piece.t1_s, there

    for index, flip in order:
        entry, leave = ends_m[index][::-1] if flip else ends_m[index]
        length = float(np.hypot(*(leave - entry)))
        if t_s >= period_s:
            break
        go(entry, float(np.hypot(*(entry - np.array(here)))) / speed_m_s, None)
        least_s = length / speed_m_s
        stay_s = max(float(tau_s[index]), least_s)
        if not sweeps or least_s <= 0.0:
            if t_s < period_s:
                go(leave, stay_s, index)
            continue
        count = max(1, int(stay_s / least_s))
        count -= 1 - count % 2  # an odd number of sweeps ends at the far end
        for sweep in range(count):
            if t_s < period_s:
                go(leave if sweep % 2 == 0 else entry, least_s, index)
    return Schedule(tuple(pieces))
