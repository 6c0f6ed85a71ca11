"""What one robot with a directional antenna learns from a reading (RWA section IV.A, RWA-2009 section IV.A).

The mean reading at a cell is mu = level - 10 beta log10 d + gain(bearing off the antenna's front). A reading z is an
integer; how probable it is under mu is chosen:

- `interval` (RWA eq 9): Phi((z + 1/2 - mu)/sigma) - Phi((z - 1/2 - mu)/sigma); sums to less than 1 near the ends;
- `density` (RWA eq 10): the normal density at z, normalised over the integers z_min..z_max;
- `truncated` (RWA-2009 eq 4): the interval of the normal distribution truncated to [z_min, z_max];
- `censored` (default): the interval inside, and at the ends all that lies beyond: what a receiver that reports
  no more than z_max does. Sums to 1 for every mu.

All are computed in logs: printed as they stand they are 0/0 some 27 dB out. RWA assumes one power level; where several
are given they are averaged. Silence says nothing in these papers.

Bearings: RWA eq 3 as printed points from the cell to the robot (180 degrees off) and RWA-2009 also swaps the arguments;
the bearing of the cell from the robot is used. Both printed forms are in `bearing_rad` for the reference values.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, logsumexp

from fieldkit import settings as given
from fieldkit.channel.model import Antenna
from fieldkit.errors import ConfigError
from fieldkit.messages import Detection, FloatArray

Form = Literal["interval", "density", "truncated", "censored"]
FORMS: tuple[Form, ...] = ("interval", "density", "truncated", "censored")
WEAKEST_BELOW_DB = 40.0
"""Readings reach this far below the threshold in the sums over z where the antenna names no weakest one."""


def bearing_rad(
    x: ArrayLike, y: ArrayLike, theta_rad: float, x_cell: ArrayLike, y_cell: ArrayLike, *, printed: str = ""
) -> FloatArray:
    """Bearing of a cell off the antenna's front, counter-clockwise, in (-pi, pi]; theta is counter-clockwise from x.

    `printed` gives what a paper prints instead: "rwa" (eq 3) or "rwa-2009"; those are not wrapped.
    """
    east = np.asarray(x_cell, dtype=float) - np.asarray(x, dtype=float)
    north = np.asarray(y_cell, dtype=float) - np.asarray(y, dtype=float)
    if printed == "rwa":
        return np.asarray(np.arctan2(-north, -east) - theta_rad)
    if printed == "rwa-2009":
        return np.asarray(np.arctan2(-east, -north) - theta_rad)
    return np.asarray((np.arctan2(north, east) - theta_rad + np.pi) % (2.0 * np.pi) - np.pi)


def log_interval(low: ArrayLike, high: ArrayLike) -> FloatArray:
    """log(Phi(high) - Phi(low)) for low < high, exact far out in either tail."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    flip = low > 0.0  # in the right tail the complements are the small, exact ones
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    log_a, log_b = log_ndtr(a), log_ndtr(b)
    return np.asarray(log_b + np.log1p(-np.exp(np.minimum(log_a - log_b, -1e-300))))


def log_reading(
    z: float, mean: ArrayLike, sigma: float, z_min: float, z_max: float, form: Form = given.DIRECTIONAL_FORM
) -> FloatArray:
    """log P(Z = z) for an integer reading in z_min..z_max of mean `mean` (any shape), in the given form."""
    mu = np.asarray(mean, dtype=float)
    if form == "censored" and z >= z_max:
        return np.asarray(log_ndtr(-(z_max - 0.5 - mu) / sigma))
    if form == "censored" and z <= z_min:
        return np.asarray(log_ndtr((z_min + 0.5 - mu) / sigma))
    if form == "density":
        every = np.arange(z_min, z_max + 1.0)
        log_all = logsumexp(-0.5 * ((every - mu[..., None]) / sigma) ** 2, axis=-1)
        return np.asarray(-0.5 * ((z - mu) / sigma) ** 2 - log_all)
    low, high = z - 0.5, z + 0.5
    if form == "truncated":
        low, high = max(low, z_min), min(high, z_max)
    inside = log_interval((low - mu) / sigma, (high - mu) / sigma)
    if form == "truncated":
        inside = inside - log_interval((z_min - mu) / sigma, (z_max - mu) / sigma)
    return np.asarray(inside)


def separation_m(sigma_db: float, path_loss_exponent: float, front_over_floor_db: float) -> float:
    """The 2-sigma rule for the size of a cell (RWA eq 12 and 13), in the antenna's unit of distance.

    Two adjacent cells' mean readings differ by two sigma when one is right at the saturated robot and the other is
    heard from the side: 10^((0.2 sigma + log10 of the floor's gain) / beta).
    """
    return float(10.0 ** ((0.2 * sigma_db - front_over_floor_db / 10.0) / path_loss_exponent))


class DirectionalModel:
    """Log-likelihood over the cells of what robots with directional antennas heard."""

    def __init__(
        self,
        antenna: Antenna,
        power_levels_db: tuple[float, ...],
        points_m: FloatArray,
        min_range_m: float,
        form: Form = given.DIRECTIONAL_FORM,
    ) -> None:
        """`points_m` (n, 2). Raises `ConfigError` for an antenna without a pattern, or an unknown form."""
        if not antenna.pattern_db:
            raise ConfigError(
                "sensing 'directional' needs an antenna with a radiation pattern, and this one is the same all round: "
                "calibrate with headings, or choose sensing 'levels'"
            )
        if form not in FORMS:
            raise ConfigError(f"form: expected one of {', '.join(FORMS)}, got {form!r}")
        self.antenna, self.points_m, self.min_range_m, self.form = antenna, points_m, min_range_m, form
        self.levels_db = np.asarray(power_levels_db, dtype=float)
        self.z_min = float(np.floor(antenna.threshold_dbm) + 1.0)
        top = antenna.saturation_dbm
        strongest = antenna.power_at_1m_dbm + float(self.levels_db.max()) + max(antenna.pattern_db)
        self.z_max = float(top if top is not None else np.ceil(strongest + WEAKEST_BELOW_DB))

    def mean_dbm(self, place_m: FloatArray, heading_deg: float) -> FloatArray:
        """(n,) mean reading of a robot at `place_m` (2,), antenna clockwise from north, from the middle level."""
        way = self.points_m - place_m
        distance = np.hypot(way[:, 0], way[:, 1])
        off_front = np.degrees(np.arctan2(way[:, 0], way[:, 1])) - heading_deg
        gain = self.antenna.gain_db(off_front, distance)
        return np.asarray(self.antenna.mean_rss_dbm(np.maximum(distance, self.min_range_m)) + gain)

    def log_likelihood(self, detection: Detection) -> FloatArray:
        """(n,) log p(readings | the cell sent), averaged over the power levels; who heard nothing is left out."""
        logs = np.zeros((self.levels_db.size, len(self.points_m)))
        for index in np.flatnonzero(detection.heard):
            mean = self.mean_dbm(detection.position_m[index], float(detection.heading_deg[index]))
            z = float(np.clip(detection.rss_dbm[index], self.z_min, self.z_max))
            if detection.saturated[index]:
                z = self.z_max
            logs += log_reading(
                z, mean + self.levels_db[:, None], self.antenna.sigma_db, self.z_min, self.z_max, self.form
            )
        return np.asarray(logsumexp(logs, axis=0) - np.log(self.levels_db.size))
