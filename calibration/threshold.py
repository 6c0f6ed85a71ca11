"""The strongest integer reading that is NOT received, from what was heard and what was missed.

The weakest reading ever heard is a poor guide: it falls with the number of readings, and where the threshold
jitters one lucky packet drags it down. Here reading z is received with probability
Phi((z - 1/2 - zeta)/jitter), and zeta is what best explains the weak readings and the misses together.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtr

from calibration.dataset import Readings
from fieldkit.messages import FloatArray

HARD_JITTER_DB = 0.2
"""Below this a threshold cannot be distinguished from a sharp one with integer readings."""


@dataclass(frozen=True, slots=True)
class Threshold:
    """The estimate. `jitter_db` 0: sharp. `identified` False: nothing was missed, it lies below `dbm`."""

    dbm: float
    jitter_db: float
    interval_95: tuple[float, float]
    identified: bool


def estimate_threshold(mean_dbm: FloatArray, sigma_db: float, readings: Readings, missed: str) -> Threshold:
    """`mean_dbm` (n,) is the fitted level of each packet. The interval takes packets as independent."""
    weakest = float(np.nanmin(readings.rss_dbm))
    if missed != "counted" or not readings.missed.any():
        return Threshold(weakest - 1.0, 0.0, (weakest - 10.0, weakest), identified=False)
    sharp = _sharp(mean_dbm, sigma_db, readings, weakest)
    soft = _soft(mean_dbm, sigma_db, readings, weakest)
    # A jitter is one more parameter: it must earn 2 units of log-likelihood, as by Akaike's rule.
    if soft is None or sharp.value >= soft.value - 2.0:
        low = weakest - 1.0 - sharp.slack
        return Threshold(weakest - 1.0, 0.0, (low, weakest - 1.0), identified=True)
    half = 1.96 * soft.error
    return Threshold(soft.zeta, soft.jitter, (soft.zeta - half, soft.zeta + half), identified=True)


@dataclass(frozen=True, slots=True)
class _Try:
    zeta: float
    jitter: float
    value: float
    """Log-likelihood."""
    error: float = 0.0
    slack: float = 0.0


class _Counts:
    """Misses and weak readings by level, the only things a threshold shows in. Means are binned to 1/8 dB."""

    def __init__(self, mean_dbm: FloatArray, sigma_db: float, readings: Readings, weakest: float) -> None:
        step = 8.0
        bins, index = np.unique(np.round(mean_dbm * step), return_inverse=True)
        self.missed = np.bincount(index.reshape(-1), weights=readings.missed.astype(float))
        self.levels = np.arange(np.floor(weakest) - 14.0, np.floor(weakest) + 26.0)
        centre = (bins / step)[:, None]
        upper = ndtr((self.levels + 0.5 - centre) / sigma_db)
        lower = ndtr((self.levels - 0.5 - centre) / sigma_db)
        self.p_level = upper - lower
        """(bins, levels) probability that a packet has this level."""
        self.p_below = lower[:, 0]
        heard = readings.rss_dbm[~readings.missed]
        self.heard = np.array([(heard == level).sum() for level in self.levels], dtype=float)

    def value(self, zeta: float, jitter: float) -> float:
        """Log-likelihood of the misses and of the weak readings having been received."""
        if jitter <= 0.0:
            log_received = np.where(self.levels > zeta, 0.0, -np.inf)
        else:
            log_received = log_ndtr((self.levels - 0.5 - zeta) / jitter)
        p_missed = self.p_below + self.p_level @ (-np.expm1(log_received))
        with np.errstate(divide="ignore", invalid="ignore"):
            seen = np.where(self.heard > 0, self.heard * log_received, 0.0).sum()
            lost = np.where(self.missed > 0, self.missed * np.log(np.maximum(p_missed, 1e-300)), 0.0).sum()
        return float(seen + lost)


def _sharp(mean_dbm: FloatArray, sigma_db: float, readings: Readings, weakest: float) -> _Try:
    """A sharp threshold must lie below every reading: the highest such integer explains the misses best."""
    counts = _Counts(mean_dbm, sigma_db, readings, weakest)
    best = counts.value(weakest - 1.0, 0.0)
    slack = 0.0
    while slack < 10.0 and counts.value(weakest - 2.0 - slack, 0.0) > best - 1.92:
        slack += 1.0
    return _Try(weakest - 1.0, 0.0, best, slack=slack)


def _soft(mean_dbm: FloatArray, sigma_db: float, readings: Readings, weakest: float) -> _Try | None:
    from scipy.optimize import minimize

    counts = _Counts(mean_dbm, sigma_db, readings, weakest)
    found = minimize(
        lambda p: -counts.value(p[0], HARD_JITTER_DB + np.exp(p[1])),
        np.array([weakest + 2.0, 0.0]),
        method="Nelder-Mead",
        options={"xatol": 1e-3, "fatol": 1e-4, "maxiter": 300},
    )
    zeta, jitter = float(found.x[0]), float(HARD_JITTER_DB + np.exp(found.x[1]))
    value = -float(found.fun)
    error = _error(counts, zeta, jitter)
    if error is None or jitter > 8.0:
        return None
    return _Try(zeta, jitter, value, error=error)


def _error(counts: _Counts, zeta: float, jitter: float, step: float = 0.25) -> float | None:
    """Standard error of zeta from the likelihood's curvature, the jitter not being known either."""
    h = step * np.array([1.0, min(1.0, jitter / (2.0 * step))])

    def at(i: int, k: int) -> float:
        return counts.value(zeta + i * h[0], jitter + k * h[1])

    middle = at(0, 0)
    bend = np.array(
        [
            [(at(1, 0) - 2.0 * middle + at(-1, 0)) / h[0] ** 2, 0.0],
            [0.0, (at(0, 1) - 2.0 * middle + at(0, -1)) / h[1] ** 2],
        ]
    )
    bend[0, 1] = bend[1, 0] = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / (4.0 * h[0] * h[1])
    information = -bend
    if not np.all(np.isfinite(information)) or np.linalg.eigvalsh(information).min() <= 0.0:
        return None
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))
