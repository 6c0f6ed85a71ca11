"""A closed tour as a circle in time, on which teams start apart and swing between their neighbours (DPRWA section V.B).

The circle says where the robots of a team are at every moment of a lap. A lap lasts tau0: legs take what the team's
slowest robot needs, and what is left of tau0 is spent on the ridges, by their weights. A tour that takes longer than
tau0 makes a larger circle. All teams use one circle, so that teams at one moment of it are at one place.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from fieldkit.engine.decentralised.ring import Meeting, initial_positions_s, ring_time_s, swing
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning.base import abreast
from fieldkit.messages import FloatArray

LEAST_LEG_S = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Circle:
    """See the module."""

    t_s: FloatArray
    """(k + 1,) when a team is at each corner; the last is the circumference."""
    place_m: dict[int, FloatArray]
    """Number of robots m to their places (k + 1, m, 2); the last corner is the first, robots perhaps exchanged."""
    _closing: dict[int, NDArray[np.intp]] = field(init=False)

    def __post_init__(self) -> None:
        closing = {}
        for size, place in self.place_m.items():
            distance = np.hypot(*(place[-1][:, None] - place[0][None]).transpose(2, 0, 1))
            closing[size] = linear_sum_assignment(distance)[1]
        object.__setattr__(self, "_closing", closing)

    @property
    def tau_s(self) -> float:
        """The circumference."""
        return float(self.t_s[-1])

    def at(self, phi_s: float, size: int) -> FloatArray:
        """(size, 2): where a team of `size` robots is; laps count, as its robots may have changed places in each."""
        lap = math.floor(phi_s / self.tau_s)
        within = phi_s - lap * self.tau_s
        index = int(np.clip(np.searchsorted(self.t_s, within, side="right") - 1, 0, len(self.t_s) - 2))
        share = (within - self.t_s[index]) / (self.t_s[index + 1] - self.t_s[index])
        place = self.place_m[size]
        here = place[index] + share * (place[index + 1] - place[index])
        closing = self._closing[size] if lap >= 0 else np.argsort(self._closing[size])
        order = np.arange(size)
        for _ in range(abs(lap)):
            order = closing[order]
        return np.asarray(here[order])

    def corners_s(self, from_s: float, to_s: float) -> list[float]:
        """The moments of corners strictly between two moments, in the order in which they are passed."""
        low, high = min(from_s, to_s), max(from_s, to_s)
        laps = range(math.floor(low / self.tau_s), math.floor(high / self.tau_s) + 1)
        between = [
            float(lap * self.tau_s + t)
            for lap in laps
            for t in self.t_s[:-1]
            if low + 1e-9 < lap * self.tau_s + t < high - 1e-9
        ]
        return between if to_s >= from_s else between[::-1]


def make_circle(
    corners_m: FloatArray,
    spare_weight: FloatArray,
    tau0_s: float,
    speed_m_s: float,
    spacing_m: float,
    sizes: set[int],
    grid: Grid,
    margin_m: float,
) -> Circle:
    """The circle of a closed way through corners (k, 2), for teams of the given numbers of robots.

    `spare_weight` (k,) shares out what is left of tau0 over the legs, each from its corner to the next. Raises
    `ValueError` for fewer than two corners.
    """
    if len(corners_m) < 2:
        raise ValueError(f"corners_m: expected at least 2, got {len(corners_m)}")
    path = np.roll(corners_m, -1, axis=0)
    places: dict[int, FloatArray] = {}
    least_s = np.full(len(corners_m), LEAST_LEG_S)
    for size in sorted(sizes):
        start = np.repeat(corners_m[:1], size, axis=0)
        start = abreast(path, start, spacing_m, grid, margin_m)[-1]  # as they come to the first corner
        place = np.concatenate([start[None], abreast(path, start, spacing_m, grid, margin_m)])
        places[size] = place
        legs = np.diff(place, axis=0)
        least_s = np.maximum(least_s, np.hypot(legs[..., 0], legs[..., 1]).max(axis=1) / speed_m_s)
    spare_s = max(0.0, tau0_s - float(least_s.sum()))
    total = float(spare_weight.sum())
    share = np.full(len(least_s), 1.0 / len(least_s)) if total <= 0.0 else spare_weight / total
    return Circle(np.concatenate([[0.0], np.cumsum(least_s + share * spare_s)]), places)


@dataclass(frozen=True, slots=True, eq=False)
class Period:
    """One planning period of all teams on one circle; times count from its beginning."""

    t_s: list[FloatArray]
    """For each team (k,) when it is at each of its corners."""
    place_m: list[FloatArray]
    """For each team (k, m, 2): from where it is, to its place on the circle, waiting there, swinging to the end."""
    ring_start_s: float
    """D_max: when the last team has arrived and all begin to swing."""
    duration_s: float
    """D_max + T."""
    meetings: list[Meeting]


def plan_period(circle: Circle, here_m: list[FloatArray], speed_m_s: float) -> Period:
    """Inter-ring and intra-ring movements (DPRWA Algorithm 1, lines 4 to 13) of teams at `here_m`, each (m, 2).

    A team alone goes round the circle.
    """
    teams = len(here_m)
    first_s = initial_positions_s(teams, circle.tau_s)
    starts, orders, arrive_s = [], [], []
    for phi, here in zip(first_s, here_m, strict=True):
        start = circle.at(phi, len(here))
        distance = np.hypot(*(here[:, None] - start[None]).transpose(2, 0, 1))
        order = linear_sum_assignment(distance)[1]
        starts.append(start[order])
        orders.append(order)
        arrive_s.append(float(distance[np.arange(len(here)), order].max()) / speed_m_s)
    ring_start_s = max(arrive_s)
    lasts_s = ring_time_s(teams, circle.tau_s)
    meetings, turns = swing(teams, circle.tau_s, lasts_s)
    times, places = [], []
    for team, here in enumerate(here_m):
        t, place = [0.0, arrive_s[team], ring_start_s], [here, starts[team], starts[team]]
        phi, now = turns[team][0].at_s, 0.0
        for turn, until in zip(turns[team], [*(x.t_s for x in turns[team][1:]), lasts_s], strict=True):
            end = phi + turn.way * (until - turn.t_s)
            for corner in [*circle.corners_s(phi, end), end]:
                t.append(ring_start_s + now + abs(corner - phi))
                place.append(circle.at(corner, len(here))[orders[team]])
            phi, now = end, until
        times.append(np.array(t))
        places.append(np.array(place))
    return Period(times, places, ring_start_s, ring_start_s + lasts_s, meetings)
