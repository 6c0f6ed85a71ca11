"""A fix, and whether it may be believed. Pure: no wire, no clock.

One that is frozen, jumps or says nothing of its quality is absent, not wrong.
"""

import math
from dataclasses import dataclass

EARTH_M = 6_371_000.0
UERE_M = {1: 2.5, 2: 1.0, 3: 2.5, 4: 0.02, 5: 0.3}
"""Standard deviation of a coordinate at HDOP 1 by GGA's quality: single, differential, PPS, RTK fixed, RTK float.

Estimated, dead-reckoned, manual and simulated positions (6 to 8) are none.
"""
FROZEN_S = 10.0
"""A receiver that says it moves and gives the very same place for so long is frozen."""
MOVING_M_S = 0.5
JUMP_SIGMAS = 6.0
SETTLED = 3
"""After a jump so many fixes in a row must agree with each other."""


@dataclass(frozen=True, slots=True)
class Fix:
    """What a receiver says of where it is."""

    lat_deg: float
    lon_deg: float
    sigma_m: float | None
    """Standard deviation of each horizontal coordinate; None where the receiver says nothing of it."""
    time_s: float | None = None
    """UTC, by the satellites."""
    alt_m: float | None = None
    """Above the sea."""
    speed_m_s: float | None = None
    course_deg: float | None = None
    """Of motion over ground, from true north."""
    why_absent: str = ""
    """What the receiver itself says against it."""


def distance_m(first: Fix, second: Fix) -> float:
    """Over ground, for distances far under the earth's size."""
    north = math.radians(second.lat_deg - first.lat_deg)
    east = math.radians((second.lon_deg - first.lon_deg + 180.0) % 360.0 - 180.0)
    return EARTH_M * math.hypot(north, east * math.cos(math.radians(first.lat_deg)))


class FixJudge:
    """Looks at one receiver's fixes in order."""

    def __init__(self, max_speed_m_s: float, worst_sigma_m: float) -> None:
        self._max_speed_m_s, self._worst_m = max_speed_m_s, worst_sigma_m
        self._last: tuple[float, Fix] | None = None
        """The fix before, believed or not, and when it came."""
        self._believed: tuple[float, Fix] | None = None
        self._agreeing = SETTLED
        self._same_since_s = 0.0

    def doubt(self, fix: Fix, at_s: float) -> str:
        """Why a fix that came at `at_s` is not to be believed; empty where it is."""
        why = self._doubt(fix, at_s)
        if not why:
            self._believed = (at_s, fix)
        if math.isfinite(fix.lat_deg) and math.isfinite(fix.lon_deg):
            self._last = (at_s, fix)
        return why

    def _doubt(self, fix: Fix, at_s: float) -> str:
        if fix.why_absent:
            return fix.why_absent
        if not (abs(fix.lat_deg) <= 90.0 and abs(fix.lon_deg) <= 180.0):
            return f"latitude {fix.lat_deg}, longitude {fix.lon_deg} is nowhere"
        if fix.lat_deg == 0.0 and fix.lon_deg == 0.0:
            return "latitude and longitude are 0: no position yet"
        if fix.sigma_m is None:
            return "the receiver says nothing of its quality (no HDOP, no error estimate)"
        if not 0.0 < fix.sigma_m <= self._worst_m:
            return f"its position is good to {fix.sigma_m:.0f} m only (limit {self._worst_m:g} m)"
        return self._frozen(fix, at_s) or self._jumped(fix, at_s)

    def _frozen(self, fix: Fix, at_s: float) -> str:
        if self._last is None:
            self._same_since_s = at_s
            return ""
        before = self._last[1]
        if fix.time_s is not None and before.time_s is not None and fix.time_s <= before.time_s:
            return "its time stands still: frozen"
        if (fix.lat_deg, fix.lon_deg) != (before.lat_deg, before.lon_deg):
            self._same_since_s = at_s
        moving = fix.speed_m_s is not None and fix.speed_m_s > MOVING_M_S
        if moving and at_s - self._same_since_s >= FROZEN_S:
            return (
                f"says that it moves, and is at the same place for {at_s - self._same_since_s:.0f} s: frozen"
            )
        return ""

    def _jumped(self, fix: Fix, at_s: float) -> str:
        if self._believed is not None and self._near(self._believed, fix, at_s):
            self._agreeing = SETTLED
            return ""
        if self._believed is None and self._agreeing >= SETTLED:
            return ""
        agrees = self._last is not None and self._near(self._last, fix, at_s)
        self._agreeing = self._agreeing + 1 if agrees and self._agreeing < SETTLED else 1
        if self._agreeing >= SETTLED:
            return ""
        return (
            f"it jumped by {distance_m(self._believed[1], fix):.0f} m" if self._believed is not None else ""
        )

    def _near(self, before: tuple[float, Fix], fix: Fix, at_s: float) -> bool:
        reach_m = self._max_speed_m_s * max(at_s - before[0], 0.1)
        noise_m = JUMP_SIGMAS * math.hypot(fix.sigma_m or 0.0, before[1].sigma_m or 0.0)
        return distance_m(before[1], fix) <= reach_m + noise_m
