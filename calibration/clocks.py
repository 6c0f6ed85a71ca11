"""Do the clock of the receiver and the clock of the position log agree? The readings themselves show it.

A receiver on the move that is stamped late seems to hear loudest after it has passed the transmitter. The
offset under which level falls most regularly with distance is the one there is.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fieldkit.messages import FloatArray

LAGS_S = np.arange(-30.0, 30.01, 0.5)
SMALLEST_S = 1.0
"""Offsets below this move a walking receiver by less than a distance is known."""
SURE_NATS = 8.0
CELL_M = 0.5
"""Readings within one cell share their shadowing: they count as one."""
_MOST_READINGS = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where one receiver was: time (n,) in s, in any order, and east and north (n, 2) in m."""

    t_s: FloatArray
    place_m: FloatArray

    def at(self, t_s: FloatArray) -> FloatArray:
        """(m, 2) by linear interpolation; the ends go on."""
        order = np.argsort(self.t_s, kind="stable")
        t, place = self.t_s[order], self.place_m[order]
        return np.column_stack([np.interp(t_s, t, place[:, axis]) for axis in (0, 1)])


@dataclass(frozen=True, slots=True)
class Offset:
    """`seconds` to add to the readings' times to get those of the positions."""

    seconds: float
    nats: float
    """Evidence for it against none."""

    def warning(self) -> str:
        way = "behind" if self.seconds > 0 else "ahead of"
        return (
            f"the receiver's clock looks {abs(self.seconds):.1f} s {way} the positions' clock: the readings fit "
            f"much better so; import again with --positions and --clock-offset-s {self.seconds:.1f}, or set both "
            "clocks by one"
        )


def estimate_offset(
    t_s: FloatArray,
    rss_dbm: FloatArray,
    who: np.ndarray,
    tracks: Mapping[int, Track],
    source_m: FloatArray,
    lags_s: FloatArray = LAGS_S,
) -> Offset | None:
    """The offset of readings (n,) by receivers `who` (n,) against their tracks; None where none is certain.

    Readings that were missed are left out: least squares is good enough to compare lags with.
    """
    use = np.flatnonzero(~np.isnan(rss_dbm) & np.isfinite(t_s))
    use = use[:: max(1, len(use) // _MOST_READINGS)]
    if len(use) < 20:
        return None
    t, z, whose = t_s[use], rss_dbm[use], who[use]

    def places(lag_s: float) -> FloatArray:
        place = np.empty((len(t), 2))
        for k, track in tracks.items():
            place[whose == k] = track.at(t[whose == k] + lag_s)
        return place

    cells = len(np.unique(np.floor(places(0.0) / CELL_M), axis=0))
    if cells < 10:
        return None
    spread = np.array([_spread(places(lag), z, source_m) for lag in lags_s])
    here = _spread(places(0.0), z, source_m)
    best = int(np.argmin(spread))
    nats = cells * float(np.log(here / max(spread[best], 1e-6)))
    if nats < SURE_NATS or abs(lags_s[best]) < SMALLEST_S or best in (0, len(lags_s) - 1):
        return None
    return Offset(float(lags_s[best] + _vertex(spread[best - 1 : best + 2]) * (lags_s[1] - lags_s[0])), nats)


def _spread(place_m: FloatArray, rss_dbm: FloatArray, source_m: FloatArray) -> float:
    """What is left over of a straight line against log distance; rising with distance counts as no line."""
    x = np.log10(np.maximum(np.hypot(*(place_m - source_m).T), 0.05))
    slope = np.cov(x, rss_dbm)[0, 1] / max(float(np.var(x)), 1e-9)
    slope = min(float(slope), 0.0)
    return float(np.std(rss_dbm - slope * x))


def _vertex(three: FloatArray) -> float:
    """Where a parabola through three even points is lowest, in steps from the middle one."""
    bend = three[0] - 2.0 * three[1] + three[2]
    return float(0.5 * (three[0] - three[2]) / bend) if bend > 0.0 else 0.0
