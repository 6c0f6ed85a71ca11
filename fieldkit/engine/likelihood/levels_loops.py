"""The compiled loops of the exact likelihood and of exposure. Their plain numpy twins are in the tests.

Shapes: points (n, 2) and robots (m, 2) are east, north in metres; ears (m, columns) as `ears_loops` has them; `rss`
(m,) is nan where a robot listened and heard nothing; `levels` (h,) are received powers at 1 m in dBm.
"""

import math

import numpy as np

from fieldkit.channel.law import Law
from fieldkit.engine.compiled import njit
from fieldkit.engine.likelihood.ears_loops import (
    EAST,
    NORTH,
    OFFSET,
    SIGMA,
    THRESHOLD,
    beyond_distance_db,
    square_m2,
)
from fieldkit.engine.likelihood.law_loops import as_far_m2, loss_db, slope_db
from fieldkit.engine.likelihood.places_loops import weigh
from fieldkit.messages import FloatArray, IntArray

_SQRT2 = math.sqrt(2.0)


@njit(cache=True, nogil=True)
def _upper(x: float) -> float:
    """1 - Phi(x)."""
    return 0.5 * math.erfc(x / _SQRT2)


@njit(cache=True, nogil=True)
def levels_loglik(
    points: FloatArray,
    ears: FloatArray,
    rss: FloatArray,
    saturated: FloatArray,
    levels: FloatArray,
    law: Law,
    pattern: FloatArray,
    sigma: float,
    loss: float,
    outlier: float,
    outlier_width: float,
    log_silent: FloatArray,
    log_heard: FloatArray,
    silent_from: float,
    per_sigma: float,
    out: FloatArray,
) -> None:
    """out (h, n): log p(readings | source at the point with that level). See `likelihood.levels`.

    `log_silent` holds log P(silent) at x = silent_from, silent_from + 1 / per_sigma, ... standard deviations of the
    mean above the threshold; `log_heard` the log of the density's shape at |t| = 0, 1 / per_sigma, ... .
    """
    n = points.shape[0]
    m = ears.shape[0]
    n_levels = levels.shape[0]
    silent_top = log_silent.shape[0] - 1.000001
    heard_top = log_heard.shape[0] - 1.000001
    for i in range(n):
        for h in range(n_levels):
            out[h, i] = 0.0
        east, north = points[i, 0], points[i, 1]
        for q in range(m):
            d2 = square_m2(east, north, ears, q, law.least_range_m)
            decades = 0.5 * math.log10(d2)
            slope = slope_db(decades, law)
            attenuation = loss_db(decades, law)
            attenuation += beyond_distance_db(east, north, ears, q, d2, law, pattern)
            unsure2 = ears[q, SIGMA] * ears[q, SIGMA]
            spread = math.sqrt(sigma * sigma + slope * slope * unsure2 / (d2 + unsure2))
            if math.isnan(rss[q]):
                scale = per_sigma / spread
                shift = (-ears[q, THRESHOLD] - 0.5 - attenuation) * scale - silent_from * per_sigma
                for h in range(n_levels):
                    at = min(max(levels[h] * scale + shift, 0.0), silent_top)
                    k = int(at)
                    out[h, i] += log_silent[k] + (at - k) * (log_silent[k + 1] - log_silent[k])
            elif saturated[q] > 0.0:
                for h in range(n_levels):
                    t = (rss[q] - 0.5 - (levels[h] - attenuation)) / spread
                    p = (1.0 - loss) * ((1.0 - outlier) * _upper(t) + outlier * _upper(t / outlier_width))
                    out[h, i] += math.log(max(p, 1e-300))
            else:
                wide = math.sqrt(spread * spread + 1.0 / 12.0)
                norm = math.log((1.0 - loss) / (wide * math.sqrt(2.0 * math.pi)))
                scale = per_sigma / wide
                for h in range(n_levels):
                    at = min(abs(rss[q] + attenuation - levels[h]) * scale, heard_top)
                    k = int(at)
                    out[h, i] += norm + log_heard[k] + (at - k) * (log_heard[k + 1] - log_heard[k])


@njit(cache=True, nogil=True)
def add_exposure(
    exposure: FloatArray,
    cell: float,
    robots: FloatArray,
    hear: FloatArray,
    step2: float,
    limit2: FloatArray,
    duration: float,
) -> None:
    """Add `duration` times P(some robot hears a source in the cell) to exposure (levels, n_north, n_east).

    `hear` (levels, k) is the probability of one robot hearing at squared distance k * step2; beyond the squared
    distance `limit2` (levels,) nothing is added.
    """
    n_levels, rows, columns = exposure.shape
    m = robots.shape[0]
    last = hear.shape[1] - 1
    per_step2 = 1.0 / step2
    widest = math.sqrt(limit2.max())
    row0 = max(0, int(math.floor((robots[:, 1].min() - widest) / cell)))
    row1 = min(rows, int(math.floor((robots[:, 1].max() + widest) / cell)) + 1)
    # Where a cell stands in the table is the same for all levels: found once a row and robot.
    at = np.empty((m, columns), dtype=np.int32)
    silent = np.empty(columns)
    for r in range(row0, row1):
        north = (r + 0.5) * cell
        for q in range(m):
            dn2 = (north - robots[q, 1]) ** 2
            for c in range(columns):
                de = (c + 0.5) * cell - robots[q, 0]
                at[q, c] = min(int((de * de + dn2) * per_step2), last)
        for h in range(n_levels):
            table = hear[h]
            left, right = columns, 0
            silent[:] = 1.0
            for q in range(m):
                room2 = limit2[h] - (north - robots[q, 1]) ** 2
                if room2 <= 0.0:
                    continue
                half = math.sqrt(room2)
                column0 = max(0, int(math.floor((robots[q, 0] - half) / cell)))
                column1 = min(columns, int(math.floor((robots[q, 0] + half) / cell)) + 1)
                left, right = min(left, column0), max(right, column1)
                index = at[q]
                for c in range(column0, column1):
                    silent[c] *= 1.0 - table[index[c]]
            for c in range(left, right):
                exposure[h, r, c] += duration * (1.0 - silent[c])


SILENT_BELOW = 0.8
"""So many deviations under the threshold a reading would have been that was not heard, where it was expected at it.

The mean of a normal density cut off at its own mean, sqrt(2 / pi) deviations below it, stands for all below.
"""


@njit(cache=True, nogil=True)
def conditional_loglik(
    points: FloatArray,
    ears: FloatArray,
    rss: FloatArray,
    saturated: FloatArray,
    near: FloatArray,
    near_rss: FloatArray,
    near_count: IntArray,
    cross: FloatArray,
    cov: FloatArray,
    place_var: float,
    time_var: float,
    lobe_var: float,
    deepest: float,
    levels: FloatArray,
    law: Law,
    pattern: FloatArray,
    loss: float,
    outlier: float,
    outlier_width: float,
    log_silent: FloatArray,
    log_heard: FloatArray,
    silent_from: float,
    per_sigma: float,
    out: FloatArray,
) -> None:
    """out (h, n): as `levels_loglik`, each robot's mean moved by what the same source's earlier readings were off.

    `near` (m * k, columns of an ear), `near_rss` (m, k; -inf where nothing was heard) and `near_count` (m,) are those
    readings, `cross` (m, k) and
    `cov` (m, k, k) as `choose_neighbours` has them; `lobe_var` (dB^2) is that of each coordinate of the transmitter's
    lobe, which readings in one direction from it have in common. A reading made so near the point that an unsure place
    alone moves it by decibels says less of the shadow, and no shadow is believed that is deeper than `deepest` of its
    deviations: those who heard another source are no reason to expect one.
    """
    n, m, n_levels, most = points.shape[0], ears.shape[0], levels.shape[0], cross.shape[1]
    noise, off_dbm, weights, part = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    work, alike, toward = np.empty((most, most)), np.empty((most, most)), np.empty((most, 2))
    alike_here, silent, missed = np.empty(most), np.empty(most, dtype=np.bool_), np.empty(n_levels)
    typical = SILENT_BELOW * math.sqrt(place_var + time_var)
    silent_top = log_silent.shape[0] - 1.000001
    heard_top = log_heard.shape[0] - 1.000001
    for i in range(n):
        for h in range(n_levels):
            out[h, i] = 0.0
        east, north = points[i, 0], points[i, 1]
        for q in range(m):
            d2 = square_m2(east, north, ears, q, law.least_range_m)
            decades = 0.5 * math.log10(d2)
            slope = slope_db(decades, law)
            attenuation = loss_db(decades, law)
            attenuation += beyond_distance_db(east, north, ears, q, d2, law, pattern)
            # Neighbours were off by moved - levels[h] * taken in all, each as much as it counts.
            for j in range(near_count[q]):
                row = q * most + j
                away2 = square_m2(east, north, near, row, law.least_range_m)
                away = 0.5 * math.log10(away2)
                steep = slope_db(away, law)
                fainter = loss_db(away, law)
                fainter += beyond_distance_db(east, north, near, row, away2, law, pattern)
                silent[j] = math.isinf(near_rss[q, j])
                # Silence is taken for what it mostly is, and for no more than that where less is expected anyway.
                off_dbm[j] = fainter + (near[row, THRESHOLD] + 0.5 - typical if silent[j] else near_rss[q, j])
                its2 = near[row, SIGMA] * near[row, SIGMA]
                noise[j] = time_var + 1.0 / 12.0 + steep * steep * its2 / (away2 + its2)
                # Where the place is unsure beside the distance, so is the direction.
                scale = 1.0 / math.sqrt(away2 + its2)
                toward[j, 0], toward[j, 1] = (
                    (near[row, EAST] - east) * scale,
                    (near[row, NORTH] - north) * scale,
                )
            scale = 1.0 / math.sqrt(d2 + ears[q, SIGMA] * ears[q, SIGMA])
            de, dn = (ears[q, EAST] - east) * scale, (ears[q, NORTH] - north) * scale
            for j in range(near_count[q]):
                alike_here[j] = cross[q, j] + lobe_var * (toward[j, 0] * de + toward[j, 1] * dn)
                for k in range(j + 1):
                    alike[j, k] = cov[q, j, k] + lobe_var * (
                        toward[j, 0] * toward[k, 0] + toward[j, 1] * toward[k, 1]
                    )
            own_var = place_var + ears[q, OFFSET] + lobe_var * (de * de + dn * dn)
            furthest = deepest * math.sqrt(own_var)
            left = own_var + time_var - weigh(near_count[q], alike, alike_here, noise, work, part, weights)
            moved = 0.0
            taken = 0.0
            for h in range(n_levels):
                missed[h] = 0.0
            for j in range(near_count[q]):
                if silent[j]:
                    for h in range(n_levels):
                        missed[h] += weights[j] * min(off_dbm[j] - levels[h], 0.0)
                    continue
                moved += weights[j] * off_dbm[j]
                taken += weights[j]
            unsure2 = ears[q, SIGMA] * ears[q, SIGMA]
            spread = math.sqrt(left + slope * slope * unsure2 / (d2 + unsure2))
            if math.isnan(rss[q]):
                scale = per_sigma / spread
                for h in range(n_levels):
                    off = min(max(moved + missed[h] - levels[h] * taken, -furthest), furthest)
                    margin = levels[h] - attenuation + off - ears[q, THRESHOLD] - 0.5
                    at = min(max(margin * scale - silent_from * per_sigma, 0.0), silent_top)
                    k = int(at)
                    out[h, i] += log_silent[k] + (at - k) * (log_silent[k + 1] - log_silent[k])
            elif saturated[q] > 0.0:
                for h in range(n_levels):
                    off = min(max(moved + missed[h] - levels[h] * taken, -furthest), furthest)
                    t = (rss[q] - 0.5 - (levels[h] - attenuation + off)) / spread
                    p = (1.0 - loss) * ((1.0 - outlier) * _upper(t) + outlier * _upper(t / outlier_width))
                    out[h, i] += math.log(max(p, 1e-300))
            else:
                wide = math.sqrt(spread * spread + 1.0 / 12.0)
                norm = math.log((1.0 - loss) / (wide * math.sqrt(2.0 * math.pi)))
                scale = per_sigma / wide
                for h in range(n_levels):
                    off = min(max(moved + missed[h] - levels[h] * taken, -furthest), furthest)
                    at = min(abs(rss[q] - levels[h] + attenuation - off) * scale, heard_top)
                    k = int(at)
                    out[h, i] += norm + log_heard[k] + (at - k) * (log_heard[k + 1] - log_heard[k])


@njit(cache=True, nogil=True)
def add_exposure_of_ears(
    exposure: FloatArray,
    cell: float,
    ears: FloatArray,
    which: IntArray,
    hear: FloatArray,
    step2: float,
    limit2: FloatArray,
    threshold: float,
    law: Law,
    pattern: FloatArray,
    best: float,
    duration: float,
) -> None:
    """As `add_exposure`, for ears (m, columns), each with the table `hear[which]` (tables, levels, k) of its place.

    `hear` is of a receiver with `threshold` on the sources' own ground: a loss besides distance, or a higher threshold,
    counts as so much more distance. Nobody gains more than `best` dB.
    """
    n_levels, rows, columns = exposure.shape
    last = hear.shape[2] - 1
    m = ears.shape[0]
    widest = math.sqrt(as_far_m2(limit2.max(), best, law))
    furthest2 = limit2.max()
    row0 = max(0, int(math.floor((ears[:, NORTH].min() - widest) / cell)))
    row1 = min(rows, int(math.floor((ears[:, NORTH].max() + widest) / cell)) + 1)
    column0 = max(0, int(math.floor((ears[:, EAST].min() - widest) / cell)))
    column1 = min(columns, int(math.floor((ears[:, EAST].max() + widest) / cell)) + 1)
    as_far2 = np.empty(m)
    for r in range(row0, row1):
        north = (r + 0.5) * cell
        for c in range(column0, column1):
            east = (c + 0.5) * cell
            nearest2 = math.inf
            for q in range(m):
                d2 = square_m2(east, north, ears, q, law.least_range_m)
                more = beyond_distance_db(east, north, ears, q, d2, law, pattern)
                more += ears[q, THRESHOLD] - threshold
                if more != 0.0:
                    d2 = as_far_m2(d2, more, law)
                as_far2[q] = d2
                nearest2 = min(nearest2, d2)
            if nearest2 >= furthest2:
                continue
            for h in range(n_levels):
                if nearest2 >= limit2[h]:
                    continue
                silent = 1.0
                for q in range(m):
                    if as_far2[q] < limit2[h]:
                        silent *= 1.0 - hear[which[q], h, min(int(as_far2[q] / step2), last)]
                exposure[h, r, c] += duration * (1.0 - silent)
