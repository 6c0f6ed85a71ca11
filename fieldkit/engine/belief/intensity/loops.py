"""The compiled loops of the default belief. Each has a plain numpy twin in the tests.

They read many rows of unlike sizes at once, from one array (`arena`): log-likelihoods of detections over the clouds of
candidates, or over the cells near where they were heard.
"""

import math

import numpy as np

from fieldkit.engine.belief.intensity.arena import Kept
from fieldkit.engine.compiled import njit
from fieldkit.messages import FloatArray, IntArray

UNCLAIMED = 1e-6
"""A responsibility so small leaves what the others say of a candidate as it is."""
MOVED = 1e-6
"""A responsibility that changes by less stays as it is, and the evidence with it."""
SMALL = 1e-3
"""Responsibilities so near to 0 or 1, and changes so small, tilt a posterior by a series instead of an exponential."""
SERIES = 0.1
"""exp(x) by four terms is right to 4e-6 for |x| up to this."""
NEGLIGIBLE = -25.0
"""Entries so many nats under the best one count for nothing."""
_WHOLE = np.exp(-np.arange(746.0))
_PARTS = np.exp(-np.arange(256.0) / 256.0)


@njit(cache=True, nogil=True, inline="always")
def _exp(x: float) -> float:
    """exp(x), right to 1e-11, for x up to 0: two tables and a series, at a third of the library's time."""
    y = -x
    if y >= 745.0:
        return 0.0
    if y < 0.0:
        return math.exp(x)
    whole = int(y)
    fine = (y - whole) * 256.0
    part = int(fine)
    r = (fine - part) / 256.0
    result: float = _WHOLE[whole] * _PARTS[part] * (1.0 - r * (1.0 - r * (0.5 - r / 6.0)))
    return result


@njit(cache=True, nogil=True, inline="always")
def _exp_small(x: float) -> float:
    """exp(x), by a series where |x| is small."""
    if abs(x) < SERIES:
        return 1.0 + x * (1.0 + x * (0.5 + x / 6.0))
    return math.exp(x)


@njit(cache=True, nogil=True)
def add_rows(values: Kept, rows: IntArray, factor: FloatArray, out: FloatArray) -> None:
    """out (n,) plus the sum over k of factor[k] times the n values from rows[k] on."""
    for k in range(rows.shape[0]):
        row = values[rows[k] : rows[k] + out.shape[0]]
        for i in range(out.shape[0]):
            out[i] += factor[k] * row[i]


@njit(cache=True, nogil=True)
def attribute(
    values: Kept,
    rows: IntArray,
    responsibility: FloatArray,
    whole: FloatArray,
    active: IntArray,
    start: IntArray,
    post: FloatArray,
    log_exposure: FloatArray,
    receptions: FloatArray,
    mean_exposure: FloatArray,
    rate_shape: float,
    rate_prior: float,
    log_unknown: FloatArray,
    log_clutter: FloatArray,
    skip_settled: bool,
    unclaimed: FloatArray,
    explained: FloatArray,
) -> None:
    """Share each detection out among the candidates that know it, the unknown and clutter, one after another.

    Candidate c's log-likelihoods of detection k, over its entries, stand in `values` from `rows` (k, c) on, which is
    negative where it has none. `responsibility` (k, c), `post`, `receptions` (c,), `unclaimed` and `explained` (k,) are
    brought up to date; `whole` (k,) is what there is to attribute. `active` lists the entries of candidate c that
    count, from `start[c]`; `post` and `log_exposure` stand beside it.

    What a candidate predicts leaves the detection itself out: its posterior without its responsibility for it.
    """
    k_all, c_all = rows.shape
    terms = np.empty(c_all + 2)
    weights = np.empty(post.shape[0])  # of a candidate's entries, by all it claims, over that of the best one
    summed = np.empty(c_all)
    top_post = np.empty(c_all)
    stale = np.ones(c_all, dtype=np.bool_)
    for k in range(k_all):
        near = 0
        settled = False
        for c in range(c_all):
            if rows[k, c] >= 0:
                near += 1
                settled = settled or responsibility[k, c] > 0.999
        if near == 0:
            unclaimed[k] = 1.0
            explained[k] = log_clutter[k]
            continue
        if settled and skip_settled:
            continue
        terms[0] = log_unknown[k]
        terms[1] = log_clutter[k]
        top = max(terms[0], terms[1])
        top_known = terms[1]
        for c in range(c_all):
            if rows[k, c] < 0:
                continue
            first, end = start[c], start[c + 1]
            log_like = values[rows[k, c] : rows[k, c] + active[end - 1] + 1]
            weight = responsibility[k, c]
            if stale[c] and (weight < SMALL or weight > 1.0 - SMALL):
                stale[c] = False
                top_post[c] = post[first:end].max()
                summed[c] = _weigh(post[first:end], top_post[c], weights[first:end])
            predicted = _log_predicted(
                log_like,
                weight,
                active[first:end],
                post[first:end],
                weights[first:end],
                summed[c],
                top_post[c],
            )
            rate = (rate_shape + max(0.0, receptions[c] - weight)) / (rate_prior + mean_exposure[c])
            terms[c + 2] = math.log(rate) + predicted
            top = max(top, terms[c + 2])
            top_known = max(top_known, terms[c + 2])
        all_ways = math.exp(terms[0] - top) + math.exp(terms[1] - top)
        known_ways = math.exp(terms[1] - top_known)
        for c in range(c_all):
            if rows[k, c] >= 0:
                all_ways += math.exp(terms[c + 2] - top)
                known_ways += math.exp(terms[c + 2] - top_known)
        unclaimed[k] = math.exp(terms[0] - top) / all_ways
        explained[k] = top_known + math.log(known_ways)
        for c in range(c_all):
            if rows[k, c] < 0:
                continue
            change = whole[k] * math.exp(terms[c + 2] - top) / all_ways - responsibility[k, c]
            if abs(change) <= MOVED:
                continue
            responsibility[k, c] += change
            receptions[c] += change
            stale[c] = stale[c] or abs(change) > SMALL
            first, end = start[c], start[c + 1]
            log_like = values[rows[k, c] : rows[k, c] + active[end - 1] + 1]
            total = 0.0
            for a in range(first, end):
                tilt = change * (log_like[active[a]] - log_exposure[a])
                post[a] += tilt
                if not stale[c] and weights[a] > 0.0:
                    weights[a] *= _exp_small(tilt)
                    total += weights[a]
            summed[c] = total


@njit(cache=True, nogil=True)
def _weigh(post: FloatArray, top: float, weights: FloatArray) -> float:
    """Fill the weights (n,) with exp(post - top), 0 where that is negligible; their sum."""
    total = 0.0
    for a in range(post.shape[0]):
        rest = post[a] - top
        weights[a] = _exp(rest) if rest > NEGLIGIBLE else 0.0
        total += weights[a]
    return total


@njit(cache=True, nogil=True)
def _log_predicted(
    log_like: Kept,
    weight: float,
    active: IntArray,
    post: FloatArray,
    weights: FloatArray,
    summed: float,
    top_post: float,
) -> float:
    """log of what a candidate predicts of a detection that it claims with `weight`, which is left out of its posterior.

    log of sum p L over sum p, with p = exp(post - weight log L). `weights`, `summed` and `top_post` are as of `_weigh`,
    up to date unless the weight is neither near 0 nor near 1.
    """
    total = 0.0
    total_with = 0.0
    n = post.shape[0]
    if weight < UNCLAIMED:
        for a in range(n):
            if weights[a] > 0.0:
                total_with += weights[a] * _exp(np.float64(log_like[active[a]]))
        return math.log(max(total_with, 1e-300)) - math.log(summed)
    if weight < SMALL:
        for a in range(n):
            if weights[a] > 0.0:
                like = np.float64(log_like[active[a]])
                p = weights[a] * _exp_small(-weight * like)
                total += p
                total_with += p * _exp(like)
        return math.log(max(total_with, 1e-300)) - math.log(total)
    best = -1e300
    for a in range(n):
        best = max(best, post[a] - weight * log_like[active[a]])
    if weight > 1.0 - SMALL:
        for a in range(n):
            like = np.float64(log_like[active[a]])
            rest = post[a] - weight * like - best
            if rest > NEGLIGIBLE:
                total += _exp(rest)
            if weights[a] > 0.0:
                total_with += weights[a] * _exp_small((1.0 - weight) * like)
        return math.log(max(total_with, 1e-300)) - math.log(total) + top_post - best
    for a in range(n):
        like = np.float64(log_like[active[a]])
        rest = post[a] - weight * like - best
        if rest > NEGLIGIBLE:
            p = _exp(rest)
            total += p
            total_with += p * _exp(like)
    return math.log(max(total_with, 1e-300)) - math.log(total)


@njit(cache=True, nogil=True)
def log_expected(
    values: Kept, rows: IntArray, box: IntArray, levels: int, rate: FloatArray, out: FloatArray
) -> None:
    """out (k,): log of the sum over the cells of a box of `rate` (n_north, n_east) times a detection's mean likelihood.

    The likelihood stands in `values` from rows[k] on: (levels, cells of its box (row0, row1, column0, column1) row by
    row); all levels count alike.
    """
    by_level = np.empty(rate.shape[1])
    for k in range(rows.shape[0]):
        width = box[k, 3] - box[k, 2]
        cells = (box[k, 1] - box[k, 0]) * width
        total = 0.0
        for r in range(box[k, 0], box[k, 1]):
            by_level[:width] = 0.0
            for h in range(levels):
                at = rows[k] + h * cells + (r - box[k, 0]) * width
                its = values[at : at + width]
                for c in range(width):
                    by_level[c] += its[c]
            for c in range(width):
                total += rate[r, box[k, 2] + c] * by_level[c]
        out[k] = math.log(total / levels + 1e-300)


@njit(cache=True, nogil=True)
def another_source_llr(
    values: Kept,
    rows: IntArray,
    box: IntArray,
    factor: FloatArray,
    exposure: FloatArray,
    rate: float,
    out: FloatArray,
) -> None:
    """out (levels, n_north, n_east): log likelihood ratio of one more source of that power in the cell, over none.

    -rate * exposure + sum over detections of log(1 + factor * L), the Poisson process likelihood ratio, where
    `factor` (k,) is the rate over the intensity that already explains detection k. Its L, at most 1, stands in
    `values` from rows[k] on: (levels, cells of its box (row0, row1, column0, column1) row by row).
    """
    levels, n_north, n_east = exposure.shape
    # Factors are multiplied up and their logarithm taken now and then, before they can overflow.
    product = np.empty((n_north, n_east))
    for h in range(levels):
        for r in range(n_north):
            for c in range(n_east):
                out[h, r, c] = -rate * exposure[h, r, c]
                product[r, c] = 1.0
        size = 0.0
        for k in range(rows.shape[0]):
            if factor[k] < 1e-9:  # at most 1e-9 nats a detection
                continue
            size += math.log1p(factor[k])
            if size > 600.0:
                _take_log(product, out[h])
                size = math.log1p(factor[k])
            width = box[k, 3] - box[k, 2]
            cells = (box[k, 1] - box[k, 0]) * width
            like = values[rows[k] : rows[k] + levels * cells]
            at = h * cells
            for r in range(box[k, 0], box[k, 1]):
                near = product[r, box[k, 2] : box[k, 3]]
                its = like[at : at + width]
                for c in range(width):
                    near[c] *= 1.0 + factor[k] * its[c]
                at += width
        _take_log(product, out[h])


@njit(cache=True, nogil=True)
def _take_log(product: FloatArray, out: FloatArray) -> None:
    """Add the logarithm of `product` to `out`, both (rows, columns), and begin anew."""
    for r in range(product.shape[0]):
        for c in range(product.shape[1]):
            if product[r, c] != 1.0:
                out[r, c] += math.log(product[r, c])
                product[r, c] = 1.0
