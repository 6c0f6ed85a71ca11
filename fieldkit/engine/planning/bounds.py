"""What the papers prove of search times, and where the proofs do not hold.

Distances in metres (the papers' unit disk is scaled by the field's radius), times in seconds.
"""

import math
from typing import Literal

import numpy as np
from scipy.integrate import quad


def missed_tours(rate_hz: float, sensing_radius_m: float, speed_m_s: float) -> float:
    """E[e^-lt / (1 - e^-lt)] for crossing a sensing circle at random: how often a tour goes by unheard (RWA eq 38).

    The integral over theta of sin theta / (exp(2 lambda d_a sin theta / v) - 1), from 0 to pi/2.
    """

    def integrand(theta: float) -> float:
        exponent = 2.0 * rate_hz * sensing_radius_m * math.sin(theta) / speed_m_s
        # As theta falls to 0 so do sine and exponent: their ratio is what stays.
        return (
            math.sin(theta) / math.expm1(exponent)
            if exponent > 0.0
            else speed_m_s / (2 * rate_hz * sensing_radius_m)
        )

    return float(quad(integrand, 0.0, math.pi / 2.0, epsabs=1e-12, epsrel=1e-12)[0])


def rwa_search_time_bound_s(
    rate_hz: float,
    period_s: float,
    sensing_radius_m: float,
    speed_m_s: float,
    field_radius_m: float,
    *,
    vertices: int | None = None,
    form: Literal["printed", "corrected"] = "printed",
) -> float:
    """RWA Theorem 1 (eq 31): expected time until a source of `rate_hz` is found is at most this.

    The proof does not hold: eq 41 is false for more than two edges (the square of a sum is bounded by the NUMBER of
    edges times the sum of squares), so the printed tour bound 4 sqrt(3) R is too small for many ridges. `corrected`
    takes 2 sqrt(6 (N - 1)) R, which grows with the number of vertices N: the claim that the bound does not depend
    on the number of sources goes with it. The theorem also takes a source for found at the first packet heard
    within `sensing_radius_m`, and neglects tours that come across it by chance before it was ever heard.
    """
    if form == "printed":
        tour_m = 4.0 * math.sqrt(3.0) * field_radius_m
    else:
        if vertices is None or vertices < 2:
            raise ValueError(f"vertices: the corrected bound needs at least 2, got {vertices}")
        tour_m = 2.0 * math.sqrt(6.0 * (vertices - 1)) * field_radius_m
    first_s = period_s / -math.expm1(-rate_hz * period_s)
    again = 0.5 + missed_tours(rate_hz, sensing_radius_m, speed_m_s)
    return first_s + 1.0 / rate_hz + tour_m / speed_m_s * again


def mst_tour_bound_m(points_m: np.ndarray) -> float:
    """Twice the minimum spanning tree of points (k, 2): no shortest tour through them is longer (RWA section V.B)."""
    from scipy.sparse.csgraph import minimum_spanning_tree
    from scipy.spatial.distance import pdist, squareform

    if len(points_m) < 2:
        return 0.0
    return 2.0 * float(minimum_spanning_tree(squareform(pdist(points_m))).sum())
