"""The compiled loops of the likelihood under correlated shadowing. Their plain numpy twins are in the tests.

Shapes: places (n, 3) and points (c, 3) are east, north, up in metres; neighbours (n, m) are indices of earlier places,
-1 where there are no more.
"""

import math

import numpy as np

from fieldkit.engine.compiled import njit
from fieldkit.messages import FloatArray, IntArray

FEATURES = 5
"""1, distance, east and north of the direction, elevation: what a mean level is linear in."""


@njit(cache=True, nogil=True)
def nearest_earlier(places: FloatArray, wanted: int, out: IntArray) -> None:
    """out (n, wanted): of each place the nearest ones before it, nearest first; the earlier of two as near."""
    best = np.empty(wanted)
    for k in range(places.shape[0]):
        count = 0
        for j in range(k):
            away = 0.0
            for axis in range(3):
                away += (places[k, axis] - places[j, axis]) ** 2
            if count == wanted and away >= best[wanted - 1]:
                continue
            at = count if count < wanted else wanted - 1
            while at > 0 and best[at - 1] > away:
                best[at] = best[at - 1]
                out[k, at] = out[k, at - 1]
                at -= 1
            best[at] = away
            out[k, at] = j
            count = min(count + 1, wanted)
        for rest in range(count, wanted):
            out[k, rest] = -1


@njit(cache=True, nogil=True)
def condition(
    places: FloatArray,
    neighbours: IntArray,
    noise_var: FloatArray,
    place_var: float,
    correlation_m: float,
    weights: FloatArray,
    deviation: FloatArray,
) -> None:
    """weights (n, m) and deviation (n,): each reading given its neighbours is normal about their weighted sum.

    `noise_var` (n,) is each reading's own variance, `place_var` that of the shadowing, whose correlation is
    exp(-distance / `correlation_m`); none at all where that is 0.
    """
    n, m = neighbours.shape
    cov = np.empty((m, m))
    cross = np.empty(m)
    for k in range(n):
        count = 0
        while count < m and neighbours[k, count] >= 0:
            count += 1
        if correlation_m <= 0.0:
            count = 0
        for i in range(count):
            a = neighbours[k, i]
            cross[i] = place_var * math.exp(-_away(places, a, k) / correlation_m)
            for j in range(i + 1):
                cov[i, j] = place_var * math.exp(-_away(places, a, neighbours[k, j]) / correlation_m)
            cov[i, i] += noise_var[a]
        _cholesky(cov, count)
        variance = place_var + noise_var[k]
        # Forward and backward substitution; the forward one gives what the neighbours explain.
        for i in range(count):
            value = cross[i]
            for j in range(i):
                value -= cov[i, j] * cross[j]
            cross[i] = value / cov[i, i]
            variance -= cross[i] ** 2
        for i in range(count - 1, -1, -1):
            value = cross[i]
            for j in range(i + 1, count):
                value -= cov[j, i] * cross[j]
            cross[i] = value / cov[i, i]
        for i in range(m):
            weights[k, i] = cross[i] if i < count else 0.0
        deviation[k] = math.sqrt(variance)


@njit(cache=True, nogil=True)
def _away(places: FloatArray, a: int, b: int) -> float:
    return math.sqrt(
        (places[a, 0] - places[b, 0]) ** 2
        + (places[a, 1] - places[b, 1]) ** 2
        + (places[a, 2] - places[b, 2]) ** 2
    )


@njit(cache=True, nogil=True)
def _cholesky(matrix: FloatArray, size: int) -> float:
    """The lower factor in place of the lower triangle; the log of the determinant."""
    log_det = 0.0
    for i in range(size):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[i, i] = math.sqrt(value)
                log_det += 2.0 * math.log(matrix[i, i])
            else:
                matrix[i, j] = value / matrix[j, j]
    return log_det


@njit(cache=True, nogil=True)
def features(
    point_east: float,
    point_north: float,
    point_up: float,
    places: FloatArray,
    min_range_m: float,
    out: FloatArray,
) -> None:
    """out (n, FEATURES): what the mean level at each place is linear in, for a source at the point."""
    for k in range(places.shape[0]):
        east, north, up = places[k, 0] - point_east, places[k, 1] - point_north, places[k, 2] - point_up
        away = max(math.sqrt(east * east + north * north + up * up), min_range_m)
        out[k, 0] = 1.0
        out[k, 1] = -10.0 * math.log10(away)
        out[k, 2] = east / away
        out[k, 3] = north / away
        level = max(math.sqrt(east * east + north * north) / away, 0.1) if up != 0.0 else 1.0
        out[k, 4] = 20.0 * math.log10(level)


@njit(cache=True, nogil=True)
def log_marginal(
    points: FloatArray,
    places: FloatArray,
    level: FloatArray,
    neighbours: IntArray,
    weights: FloatArray,
    deviation: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    min_range_m: float,
    out: FloatArray,
    best: FloatArray,
) -> None:
    """out (c,): log p(level | a source at the point), its coefficients integrated; best (c, p): their mean.

    `weights` and `deviation` as of `condition`; `mean` (p,) and `precision` (p, p) are the coefficients' prior.
    """
    n, m = neighbours.shape
    p = mean.shape[0]
    feature = np.empty((n, p))
    prior = precision.copy()
    log_prior = _cholesky(prior, p)
    constant = 0.0
    whitened = np.empty(n)
    for k in range(n):
        value = level[k]
        for i in range(m):
            if neighbours[k, i] >= 0:
                value -= weights[k, i] * level[neighbours[k, i]]
        whitened[k] = value / deviation[k]
        constant += 2.0 * math.log(deviation[k]) + math.log(2.0 * math.pi)
    matrix = np.empty((p, p))
    right = np.empty(p)
    white = np.empty(p)
    for c in range(points.shape[0]):
        features(points[c, 0], points[c, 1], points[c, 2], places, min_range_m, feature)
        total = constant
        for i in range(p):
            right[i] = 0.0
            for j in range(p):
                matrix[i, j] = precision[i, j]
        for k in range(n):
            for i in range(p):
                white[i] = feature[k, i]
            for q in range(m):
                other = neighbours[k, q]
                if other >= 0:
                    for i in range(p):
                        white[i] -= weights[k, q] * feature[other, i]
            # Against the prior's mean: differences of large numbers would lose precision.
            off = whitened[k]
            for i in range(p):
                white[i] /= deviation[k]
                off -= white[i] * mean[i]
            total += off * off
            for i in range(p):
                right[i] += white[i] * off
                for j in range(i + 1):
                    matrix[i, j] += white[i] * white[j]
        log_det = _cholesky(matrix, p)
        explained = 0.0
        for i in range(p):
            value = right[i]
            for j in range(i):
                value -= matrix[i, j] * right[j]
            right[i] = value / matrix[i, i]
            explained += right[i] ** 2
        for i in range(p - 1, -1, -1):
            value = right[i]
            for j in range(i + 1, p):
                value -= matrix[j, i] * right[j]
            right[i] = value / matrix[i, i]
            best[c, i] = mean[i] + right[i]
        out[c] = 0.5 * (explained - total + log_prior - log_det)
