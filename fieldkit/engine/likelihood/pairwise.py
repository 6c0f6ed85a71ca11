"""Pairwise sensing from RSS ratios (PRWA section IV): the source's power cancels between two robots.

For robots p and q, a cell at distances d_p, d_q and readings z_p, z_q, both terms depend on one number in dB,
x = D - delta with D = 10 beta log10(d_q / d_p) and delta = z_p - z_q:

- both heard (Lemma 2, eq 11):      E11(x) = Phi((1 - x) / s) - Phi((-1 - x) / s),  s = sqrt(2) sigma;
- p heard, q silent (Lemma 3, eq 12): E10(x) = 1 - integral over t in [0, 1] of Phi((t - x) / s), z_q := zeta.

Lemma 3's limits drop half of the difference's interval (about 1 dB); kept as printed. Pairs that both stayed
silent say nothing (Lemma 4). Theorem 1 (eq 19) multiplies all pairs, each unordered pair once. Its "normalising
factors" depend on the cell, so it counts evidence several times: regions are too small by half with six robots.
"""

import math
from functools import lru_cache

import numpy as np
from scipy.special import log_ndtr, logsumexp

from fieldkit.channel import law
from fieldkit.channel.model import Antenna
from fieldkit.engine.likelihood import pairwise_loops
from fieldkit.messages import Detection, FloatArray

STEP_DB = 1.0 / 32.0
RANGE_DB = 160.0
"""Half width of the tables, at least; x beyond it is clamped."""
MOST_OCTAVES = 256
"""Tables end there where distance hardly matters (exponents below 0.42): no ratio of distances is so large."""
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
    points_m: FloatArray, robots_m: FloatArray, antenna: Antenna, min_range_m: float
) -> FloatArray:
    """(m, n): what is lost from points (n, 2) to robots (m, 2), whose distance is clamped below."""
    offset = points_m[None, :, :] - robots_m[:, None, :]
    distance = np.maximum(np.hypot(offset[..., 0], offset[..., 1]), min_range_m)
    return law.loss_db(np.log10(distance), antenna.law)


def log_likelihood_exact(
    points_m: FloatArray, robots_m: FloatArray, rss_dbm: FloatArray, antenna: Antenna, min_range_m: float
) -> FloatArray:
    """(n,) log of Theorem 1's product without its constant. `rss_dbm` (m,) is nan where nothing was heard."""
    a = attenuation_db(points_m, robots_m, antenna, min_range_m)
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
    """log E11 and log E10 at x = -RANGE_DB, -RANGE_DB + STEP_DB, ... Linear in between is right to 5e-5."""
    x = np.arange(-RANGE_DB, RANGE_DB + STEP_DB, STEP_DB)
    return log_e11(x, sigma_db), log_e10(x, sigma_db)


@lru_cache(maxsize=16)
def ratio_tables(
    sigma_db: float, path_loss_exponent: float
) -> tuple[int, FloatArray, FloatArray, FloatArray]:
    """Powers of two by which the table reaches either side of 1; the ratios (k,) of its nodes; log E11, log E10 there.

    It covers +-RANGE_DB. Linear in the ratio in between, the sum over all pairs of six robots is right to 1e-4 where
    a cell is within 40 of the best.
    """
    octaves = min(MOST_OCTAVES, math.ceil(RANGE_DB / (5.0 * path_loss_exponent * math.log10(2.0))))
    ratio = pairwise_loops.nodes(octaves)
    x_db = 5.0 * path_loss_exponent * np.log10(ratio)
    return octaves, ratio, log_e11(x_db, sigma_db), log_e10(x_db, sigma_db)


class PairwiseModel:
    """Theorem 1 over a fixed set of points, by table."""

    def __init__(self, antenna: Antenna, points_m: FloatArray, min_range_m: float) -> None:
        self.antenna = antenna
        self._east_m, self._north_m = (
            np.ascontiguousarray(points_m[:, 0]),
            np.ascontiguousarray(points_m[:, 1]),
        )
        self._floor_m2 = min_range_m**2
        self._octaves, ratio, both, one = ratio_tables(antenna.sigma_db, antenna.path_loss_exponent)
        self._both, self._one = pairwise_loops.lines(ratio, both), pairwise_loops.lines(ratio, one)
        self._per_db = math.log(10.0) / (5.0 * antenna.path_loss_exponent)

    def log_likelihood(self, detection: Detection) -> FloatArray:
        """(n,) log of Theorem 1's product without its constant."""
        out = np.empty(self._east_m.size)
        pairwise_loops.theorem_1(
            self._east_m,
            self._north_m,
            detection.position_m,
            detection.rss_dbm - self.antenna.threshold_dbm,
            self._floor_m2,
            self._per_db,
            self._octaves,
            self._both,
            self._one,
            out,
        )
        return out
