"""The compiled loops of pairwise sensing. Their plain numpy twins are in the tests.

Both pair terms depend on x = 10 beta log10(d_q / d_p) - delta alone, that is on the ratio r = (d_q / d_p)^2 c with
c = 10^(-delta / (5 beta)). So the tables lie over r, linear in r between nodes that are even within each power of
two: exponent and leading bits of r are the index, and there is no logarithm to take for any cell.
"""

import math

import numpy as np

from fieldkit.engine.bits import bits_of
from fieldkit.engine.compiled import njit
from fieldkit.messages import FloatArray

BITS = 8
"""Every power of two of the ratio is cut into 2^BITS pieces."""
BLOCK = 1024
"""Cells taken at a time, so that the squared distances of all robots stay in the cache."""
_SHIFT = 52 - BITS
_BIAS = 1023


def nodes(octaves: int) -> FloatArray:
    """(2 * octaves * 2^BITS + 1,) ratios at which tables of so many powers of two either side of 1 are given."""
    within = 1.0 + np.arange(2**BITS) / 2**BITS
    powers = np.ldexp(1.0, np.arange(-octaves, octaves))
    return np.append((powers[:, None] * within).ravel(), np.ldexp(1.0, octaves))


def lines(ratio: FloatArray, value: FloatArray) -> FloatArray:
    """(2, k): level at 0 and slope of the straight line in each of the k intervals between nodes (k + 1,)."""
    slope = np.diff(value) / np.diff(ratio)
    return np.ascontiguousarray([value[:-1] - ratio[:-1] * slope, slope])


@njit(cache=True, nogil=True, error_model="numpy")
def _add_term(
    above: FloatArray,
    below: FloatArray,
    least: float,
    most: float,
    first: np.uint64,
    level: FloatArray,
    slope: FloatArray,
    out: FloatArray,
) -> None:
    """Add to out (n,) the table's value at `above` * `below`, clamped to the table (which also catches nan)."""
    for i in range(out.shape[0]):
        ratio = above[i] * below[i]
        ratio = ratio if ratio > least else least
        ratio = ratio if ratio < most else most
        index = (bits_of(ratio) >> np.uint64(_SHIFT)) - first
        out[i] += level[index] + ratio * slope[index]


@njit(cache=True, nogil=True, error_model="numpy")
def _scaled_squares(
    east: FloatArray,
    north: FloatArray,
    robot_east: float,
    robot_north: float,
    floor2: float,
    factor: float,
    out: FloatArray,
) -> None:
    """The first of out (k,): squared distance from a robot to cells (n,), at least `floor2`, times `factor`."""
    for i in range(east.shape[0]):
        de = east[i] - robot_east
        dn = north[i] - robot_north
        d2 = de * de + dn * dn
        out[i] = factor * (d2 if d2 > floor2 else floor2)


@njit(cache=True, nogil=True, error_model="numpy")
def theorem_1(
    east: FloatArray,
    north: FloatArray,
    robots: FloatArray,
    above_db: FloatArray,
    floor2: float,
    per_db: float,
    octaves: int,
    both: FloatArray,
    one: FloatArray,
    out: FloatArray,
) -> None:
    """out (n,): log of PRWA Theorem 1's product (eq 19) at cells (n,), each unordered pair once.

    `above_db` (m,) are the readings above the threshold, nan where nothing was heard. Squared distances are at least
    `floor2`; `per_db` is the natural logarithm of c for each dB of delta; `both` and `one` are the `lines` of log E11
    and log E10 over the ratio.
    """
    n, m = east.shape[0], robots.shape[0]
    room = np.empty((m, min(n, BLOCK)))
    below = np.empty(min(n, BLOCK))
    least, most = math.ldexp(1.0, -octaves), math.ldexp(1.0 - 2.0**-53, octaves)
    first = np.uint64((_BIAS - octaves) << BITS)
    for start in range(0, n, BLOCK):
        stop = min(n, start + BLOCK)
        total = out[start:stop]
        total[:] = 0.0
        for q in range(m):
            # Each robot's distance carries its own reading, so that the ratio of two carries delta; z_q := zeta.
            factor = 1.0 if math.isnan(above_db[q]) else math.exp(per_db * above_db[q])
            _scaled_squares(
                east[start:stop], north[start:stop], robots[q, 0], robots[q, 1], floor2, factor, room[q]
            )
        for p in range(m):
            if math.isnan(above_db[p]):
                continue
            np.divide(1.0, room[p], below)
            for q in range(m):
                if math.isnan(above_db[q]):
                    _add_term(room[q], below, least, most, first, one[0], one[1], total)
                elif q > p:
                    _add_term(room[q], below, least, most, first, both[0], both[1], total)
