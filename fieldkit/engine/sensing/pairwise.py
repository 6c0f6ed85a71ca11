"""Pairwise sensing from RSS ratios (PRWA section IV): the source's power cancels between two robots.

For robots p and q, a cell at distances d_p, d_q and readings z_p, z_q, both terms depend on one number in dB,
x = D - delta with D = 10 beta log10(d_q / d_p) and delta = z_p - z_q:

- both heard (Lemma 2, eq 11):      E11(x) = Phi((1 - x) / s) - Phi((-1 - x) / s),  s = sqrt(2) sigma;
- p heard, q silent (Lemma 3, eq 12): E10(x) = 1 - integral over t in [0, 1] of Phi((t - x) / s), z_q := zeta.

Lemma 3's limits drop half of the difference's interval (about 1 dB); kept as printed. Pairs that both stayed
silent say nothing (Lemma 4). Theorem 1 (eq 19) multiplies all pairs, each unordered pair once. Its "normalising
factors" depend on the cell, so it counts evidence several times: regions are too small by half with six robots.
"""

from functools import lru_cache

import numpy as np
from scipy.special import log_ndtr, logsumexp

from fieldkit.antenna.model import Antenna
from fieldkit.engine import kernels
from fieldkit.messages import Detection, FloatArray

STEP_DB = 1.0 / 32.0
RANGE_DB = 160.0
"""Half width of the tables; x beyond it is clamped."""
BLOCK = 4096
"""Points taken at a time."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)


def log_e11(x_db: FloatArray, sigma_db: float) -> FloatArray:
    """log of E11 at x (any shape), accurate in the far tails too."""
    scale = np.sqrt(2.0) * sigma_db
    upper, lower = (
        (1.0 - np.abs(x_db)) / scale,
        (-1.0 - np.abs(x_db)) / scale,
    )  # even in x; left tail is exact
    high, low = log_ndtr(upper), log_ndtr(lower)
    return np.asarray(high + np.log1p(-np.exp(low - high)))


def log_e10(x_db: FloatArray, sigma_db: float) -> FloatArray:
    """log of E10 at x (any shape): the log of the integral over t in [0, 1] of Phi((x - t) / s)."""
    scale = np.sqrt(2.0) * sigma_db
    t = 0.5 * (_NODES + 1.0)
    logs = log_ndtr((np.asarray(x_db)[..., None] - t) / scale)
    return np.asarray(logsumexp(logs + np.log(0.5 * _WEIGHTS), axis=-1))


def attenuation_db(
    points_m: FloatArray, robots_m: FloatArray, path_loss_exponent: float, min_range_m: float
) -> FloatArray:
    """(m, n): 10 beta log10 of the distance from robots (m, 2) to points (n, 2), clamped below."""
    offset = points_m[None, :, :] - robots_m[:, None, :]
    distance = np.maximum(np.hypot(offset[..., 0], offset[..., 1]), min_range_m)
    return np.asarray(10.0 * path_loss_exponent * np.log10(distance))


def log_likelihood_exact(
    points_m: FloatArray, robots_m: FloatArray, rss_dbm: FloatArray, antenna: Antenna, min_range_m: float
) -> FloatArray:
    """(n,) log of Theorem 1's product without its constant. `rss_dbm` (m,) is nan where nothing was heard."""
    a = attenuation_db(points_m, robots_m, antenna.path_loss_exponent, min_range_m)
    heard = ~np.isnan(rss_dbm)
    total = np.zeros(points_m.shape[0])
    for p in range(len(rss_dbm)):
        for q in range(len(rss_dbm)):
            if heard[p] and heard[q] and p < q:
                total += log_e11(a[q] - a[p] - (rss_dbm[p] - rss_dbm[q]), antenna.sigma_db)
            elif heard[p] and not heard[q]:
                total += log_e10(a[q] - a[p] - (rss_dbm[p] - antenna.threshold_dbm), antenna.sigma_db)
    return total


@lru_cache(maxsize=16)
def tables(sigma_db: float) -> tuple[FloatArray, FloatArray]:
    """log E11 and log E10 at x = -RANGE_DB, -RANGE_DB + STEP_DB, ... Linear in between is right to 5e-5 fused."""
    x = np.arange(-RANGE_DB, RANGE_DB + STEP_DB, STEP_DB)
    return log_e11(x, sigma_db), log_e10(x, sigma_db)


class PairwiseModel:
    """Theorem 1 over a fixed set of points, by table."""

    def __init__(self, antenna: Antenna, points_m: FloatArray, min_range_m: float) -> None:
        self.antenna = antenna
        self._east_m, self._north_m = (
            np.ascontiguousarray(points_m[:, 0]),
            np.ascontiguousarray(points_m[:, 1]),
        )
        self._floor_m2 = min_range_m**2
        self._tables = tables(antenna.sigma_db)
        self._steps_per_log = 5.0 * antenna.path_loss_exponent / np.log(10.0) / STEP_DB

    def log_likelihood(self, detection: Detection) -> FloatArray:
        """(n,) log of Theorem 1's product without its constant."""
        # numpy's logarithm is vectorised, a compiled loop's is not; in blocks, so that large fields stay in the cache.
        n, m = self._east_m.size, detection.position_m.shape[0]
        out = np.zeros(n)
        room = np.empty(m * min(n, BLOCK))
        for start in range(0, n, BLOCK):
            block = slice(start, min(n, start + BLOCK))
            size = block.stop - start
            log_d2 = room[: m * size].reshape(m, size)
            kernels.squared_ranges(
                self._east_m[block], self._north_m[block], detection.position_m, self._floor_m2, log_d2
            )
            np.log(log_d2, out=log_d2)
            kernels.pair_lookups(
                log_d2,
                detection.rss_dbm,
                self.antenna.threshold_dbm,
                self._steps_per_log,
                RANGE_DB,
                1.0 / STEP_DB,
                *self._tables,
                out[block],
            )
        return out
