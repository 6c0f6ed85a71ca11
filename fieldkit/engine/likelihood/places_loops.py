"""The compiled choice of earlier readings that one is conditioned on, and their weights; twins are in the tests."""

import math

import numpy as np

from fieldkit.engine.compiled import njit
from fieldkit.engine.likelihood.ears_loops import OFFSET, ROBOT, SIGMA
from fieldkit.messages import FloatArray, IntArray

MEAN_ERROR2 = math.pi / 2.0
"""Square of the mean length of a normal error in the plane, in squares of its deviation in each coordinate."""


@njit(cache=True, nogil=True)
def choose_neighbours(
    order: IntArray,
    ears: FloatArray,
    rss: FloatArray,
    use: FloatArray,
    earlier: FloatArray,
    earlier_rss: FloatArray,
    place_var: float,
    length: float,
    reach: float,
    near: FloatArray,
    near_rss: FloatArray,
    near_count: IntArray,
    cross: FloatArray,
    cov: FloatArray,
) -> None:
    """Of each ear (m, columns) the nearest readings before it, and what shadow and offset it and they have in common.

    Robots take their turn in `order` (m,); whoever has a reading (`use`) is known to those that follow, as are the
    `earlier` (n, columns). Filled are `near` (m, k, columns), `near_rss` (m, k), `near_count` (m,), `cross` (m, k) with
    the ear's own reading and `cov` (m, k, k; lower half) among them, in dB^2. Readings further away than `reach` are no
    neighbours; of two as near the earlier is one. At another time a robot was off by another error: by how much two
    places are not known counts as distance between them.
    """
    m, wanted = near_rss.shape
    n = earlier.shape[0]
    best = np.empty(wanted)
    which = np.empty(wanted, dtype=np.int64)
    known = np.empty(n + m, dtype=np.int64)  # rows of earlier, then m + robot
    count_known = n
    for i in range(n):
        known[i] = i
    for turn in range(m):
        q = order[turn]
        count = 0
        for i in range(count_known):
            j = known[i]
            row = earlier[j] if j < n else ears[j - n]
            away2 = (row[0] - ears[q, 0]) ** 2 + (row[1] - ears[q, 1]) ** 2 + (row[2] - ears[q, 2]) ** 2
            if away2 >= reach * reach or (count == wanted and away2 >= best[wanted - 1]):
                continue
            at = count if count < wanted else wanted - 1
            while at > 0 and best[at - 1] > away2:
                best[at] = best[at - 1]
                which[at] = which[at - 1]
                at -= 1
            best[at] = away2
            which[at] = j
            count = min(count + 1, wanted)
        near_count[q] = count
        for a in range(count):
            j = which[a]
            row = earlier[j] if j < n else ears[j - n]
            near[q, a] = row
            near_rss[q, a] = earlier_rss[j] if j < n else rss[j - n]
            away2 = best[a]
            if j < n:
                away2 += MEAN_ERROR2 * (row[SIGMA] ** 2 + ears[q, SIGMA] ** 2)
            cross[q, a] = place_var * math.exp(-math.sqrt(away2) / length)
            if row[ROBOT] == ears[q, ROBOT]:
                cross[q, a] += row[OFFSET]
            for b in range(a):
                apart2 = 0.0
                for axis in range(3):
                    apart2 += (near[q, a, axis] - near[q, b, axis]) ** 2
                if j < n or which[b] < n:
                    apart2 += MEAN_ERROR2 * (near[q, a, SIGMA] ** 2 + near[q, b, SIGMA] ** 2)
                cov[q, a, b] = place_var * math.exp(-math.sqrt(apart2) / length)
                if near[q, a, ROBOT] == near[q, b, ROBOT]:
                    cov[q, a, b] += near[q, a, OFFSET]
            cov[q, a, a] = place_var + near[q, a, OFFSET]
        if use[q] > 0.0:
            known[count_known] = n + q
            count_known += 1


@njit(cache=True, nogil=True)
def weigh(
    count: int,
    cov: FloatArray,
    cross: FloatArray,
    noise: FloatArray,
    work: FloatArray,
    part: FloatArray,
    weights: FloatArray,
) -> float:
    """The variance (dB^2) that `count` neighbours explain; `weights` (k,) is what each counts for.

    `cov` (k, k; lower half) and `cross` (k,) are of their shadows, `noise` (k,) is the variance of what else each has;
    `work` (k, k) and `part` (k,) are overwritten.
    """
    # Cholesky's factor, with the inverses of its diagonal in their place: a division costs as much as ten products.
    explained = 0.0
    for a in range(count):
        value = cross[a]
        own = cov[a, a] + noise[a]
        for b in range(a):
            entry = cov[a, b]
            for k in range(b):
                entry -= work[a, k] * work[b, k]
            entry *= work[b, b]
            work[a, b] = entry
            own -= entry * entry
            value -= entry * part[b]
        inverse = 1.0 / math.sqrt(own)
        value *= inverse
        work[a, a], part[a] = inverse, value
        explained += value * value
    for a in range(count - 1, -1, -1):
        value = part[a]
        for k in range(a + 1, count):
            value -= work[k, a] * weights[k]
        weights[a] = value * work[a, a]
    return explained
