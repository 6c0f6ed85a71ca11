"""The compiled choice of earlier readings that one is conditioned on; its plain numpy twin is in the tests."""

import math

import numpy as np

from fieldkit.engine.compiled import njit
from fieldkit.messages import FloatArray, IntArray


@njit(cache=True, nogil=True)
def condition_on_neighbours(
    order: IntArray,
    ears: FloatArray,
    rss: FloatArray,
    use: FloatArray,
    earlier: FloatArray,
    earlier_rss: FloatArray,
    place_var: float,
    noise_var: float,
    length: float,
    reach: float,
    near: FloatArray,
    near_rss: FloatArray,
    weights: FloatArray,
    explained: FloatArray,
) -> None:
    """Of each ear (m, columns) the nearest readings before it, their weights, and what variance each explains.

    Robots take their turn in `order` (m,); whoever has a reading (`use`) is known to those that follow, as are the
    `earlier` (n, columns). `near` (m, k, columns), `near_rss`, `weights` and `explained` (m, k) are filled; weights
    of 0 stay where there are fewer. Readings further away than `reach` are no neighbours; of two as near the earlier
    is one.
    """
    m, wanted = weights.shape
    n = earlier.shape[0]
    best = np.empty(wanted)
    which = np.empty(wanted, dtype=np.int64)
    cov = np.empty((wanted, wanted))
    cross = np.empty(wanted)
    part = np.empty(wanted)
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
        for a in range(count):
            j = which[a]
            row = earlier[j] if j < n else ears[j - n]
            near[q, a] = row
            near_rss[q, a] = earlier_rss[j] if j < n else rss[j - n]
            cross[a] = place_var * math.exp(-math.sqrt(best[a]) / length)
            for b in range(a + 1):
                apart2 = 0.0
                for axis in range(3):
                    apart2 += (near[q, a, axis] - near[q, b, axis]) ** 2
                cov[a, b] = place_var * math.exp(-math.sqrt(apart2) / length)
            cov[a, a] += noise_var
        for a in range(count):
            for b in range(a + 1):
                value = cov[a, b]
                for k in range(b):
                    value -= cov[a, k] * cov[b, k]
                cov[a, b] = math.sqrt(value) if a == b else value / cov[b, b]
            value = cross[a]
            for k in range(a):
                value -= cov[a, k] * part[k]
            part[a] = value / cov[a, a]
        for a in range(count - 1, -1, -1):
            value = part[a]
            for k in range(a + 1, count):
                value -= cov[k, a] * weights[q, k]
            weights[q, a] = value / cov[a, a]
        for a in range(count):
            explained[q, a] = max(weights[q, a] * cross[a], 0.0)
        if use[q] > 0.0:
            known[count_known] = n + q
            count_known += 1
