"""The compiled hot loop behind a pair's spacing (PRWA eq 24 to 26). Its plain numpy twin is in the tests."""

import math

import numpy as np

from fieldkit.channel.law import Law
from fieldkit.engine.bits import fast_log
from fieldkit.engine.compiled import njit
from fieldkit.engine.likelihood.law_loops import loss_db
from fieldkit.messages import FloatArray

LEAST = 1e-300
"""Probabilities below this are nothing."""


@njit(cache=True, nogil=True)
def _sum(x: FloatArray) -> float:
    """Sum of x (n,) in four parts, which does not wait for each addition."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    whole = x.shape[0] // 4 * 4
    for i in range(0, whole, 4):
        a += x[i]
        b += x[i + 1]
        c += x[i + 2]
        d += x[i + 3]
    for i in range(whole, x.shape[0]):
        a += x[i]
    return (a + b) + (c + d)


@njit(cache=True, nogil=True, error_model="numpy")
def _minus_p_log_p(p: FloatArray, out: FloatArray) -> None:
    for i in range(p.shape[0]):
        out[i] = -p[i] * fast_log(p[i] if p[i] > LEAST else LEAST)


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh(
    apart: FloatArray, shift: float, level: FloatArray, slope: FloatArray, prior: FloatArray, post: FloatArray
) -> None:
    """post (n,): prior times the table's value at `apart` + `shift`, both in steps of the table."""
    most = level.shape[0] - 1e-6
    for i in range(apart.shape[0]):
        at = apart[i] + shift
        at = at if at > 0.0 else 0.0
        at = at if at < most else most
        k = np.uint32(at)
        post[i] = prior[i] * (level[k] + at * slope[k])


@njit(cache=True, nogil=True, error_model="numpy")
def _entropy_after(
    post: FloatArray, presence: FloatArray, normalised: bool, p: FloatArray, room: FloatArray
) -> float:
    """Eq 25 with P(C_i) as the update leaves it, or with P(C_i^1)."""
    scale = 1.0 / max(_sum(post), LEAST)
    for i in range(post.shape[0]):
        p1 = post[i] * scale
        p[i] = p1 if normalised else p1 + presence[i] * (1.0 - p1)
    _minus_p_log_p(p, room)
    return _sum(room)


@njit(cache=True, nogil=True, error_model="numpy")
def spacing_entropy(
    cells: FloatArray,
    presence: FloatArray,
    prior: FloatArray,
    pairs: FloatArray,
    levels: FloatArray,
    law: Law,
    threshold: float,
    min_range: float,
    e11: FloatArray,
    e10: FloatArray,
    half_width: float,
    per_db: float,
    normalised: bool,
) -> float:
    """PRWA eq 26 for one spacing: the entropy (eq 25) summed over pair positions, power levels and source cells.

    `cells` (n, 2) of the cluster, `presence` P(C_i) and `prior` P(C_i^1) there (n,), `pairs` (t, 2, 2) where the
    two robots are, `levels` (g,) received dBm at 1 m; `e11`, `e10` (2, k) are E11 and E10 themselves, as straight lines
    over steps of 1 / `per_db` dB from -`half_width`. Where neither robot hears the source, the belief stays as it is. A
    reading does not depend on the level where both hear (delta is a difference), so that term is computed once.
    """
    n, g = cells.shape[0], levels.shape[0]
    a, apart = np.empty((2, n)), np.empty((2, n))
    post, p, room = np.empty(n), np.empty(n), np.empty(n)
    known = max(_sum(prior), LEAST)
    for i in range(n):
        p[i] = prior[i] / known if normalised else presence[i]
    _minus_p_log_p(p, room)
    unchanged = _sum(room)
    zero = half_width * per_db
    total = 0.0
    for t in range(pairs.shape[0]):
        for r in range(2):
            for i in range(n):
                de = cells[i, 0] - pairs[t, r, 0]
                dn = cells[i, 1] - pairs[t, r, 1]
                decades = 0.5 * math.log10(max(de * de + dn * dn, min_range * min_range))
                a[r, i] = loss_db(decades, law)
        for i in range(n):
            apart[0, i] = (a[1, i] - a[0, i]) * per_db
            apart[1, i] = -apart[0, i]
        for v in range(n):
            both = -1.0
            for w in range(g):
                z0 = math.floor(levels[w] - a[0, v] + 0.5)
                z1 = math.floor(levels[w] - a[1, v] + 0.5)
                hear0 = z0 > threshold
                hear1 = z1 > threshold
                if hear0 and hear1:
                    if both < 0.0:
                        _weigh(apart[0], zero - apart[0, v], e11[0], e11[1], prior, post)
                        both = _entropy_after(post, presence, normalised, p, room)
                    total += both
                elif hear0:
                    _weigh(apart[0], zero - (z0 - threshold) * per_db, e10[0], e10[1], prior, post)
                    total += _entropy_after(post, presence, normalised, p, room)
                elif hear1:
                    _weigh(apart[1], zero - (z1 - threshold) * per_db, e10[0], e10[1], prior, post)
                    total += _entropy_after(post, presence, normalised, p, room)
                else:
                    total += unchanged
    return total
