"""The shortest tour that walks every ridge once (RWA section V.B), and how long to stay on each (eq 28 and 29)."""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from fieldkit.messages import FloatArray

EXACT_RIDGES = 4


def ridge_tour(start_m: FloatArray, ends_m: FloatArray, *, closed: bool = False) -> list[tuple[int, bool]]:
    """Order and direction of ridges (k, 2, 2) for a tour from `start_m`, and back if `closed`: (index, reversed).

    Exact up to `EXACT_RIDGES`, else by local search. (A solver that searches for so many milliseconds finds another
    tour on a busy machine: then a replay would differ, and robots that plan apart would not agree.)
    """
    if len(ends_m) <= EXACT_RIDGES:
        return _exact(start_m, ends_m, closed)
    return _improved(start_m, ends_m, closed)


def _improved(start_m: FloatArray, ends_m: FloatArray, closed: bool) -> list[tuple[int, bool]]:
    """Nearest ridge first, then stretches turned round and single ridges moved while that makes the tour shorter."""
    nodes = np.concatenate([start_m[None], ends_m.reshape(-1, 2)])
    distance = np.hypot(*(nodes[:, None, :] - nodes[None, :, :]).transpose(2, 0, 1)).tolist()

    def length(tour: list[tuple[int, bool]]) -> float:
        here, total = 0, 0.0
        for ridge, flip in tour:
            total += distance[here][1 + 2 * ridge + flip]
            here = 2 + 2 * ridge - flip
        return total + (distance[here][0] if closed else 0.0)

    best: list[tuple[int, bool]] = []
    here, left = 0, set(range(len(ends_m)))
    while left:
        ridge, flip = min(
            ((r, f) for r in sorted(left) for f in (False, True)),
            key=lambda rf: distance[here][1 + 2 * rf[0] + rf[1]],
        )
        best.append((ridge, flip))
        left.remove(ridge)
        here = 2 + 2 * ridge - flip
    shortest = length(best)
    better = True
    while better:
        better = False
        for tour in _neighbours(best):
            if (found := length(tour)) < shortest - 1e-9:
                best, shortest, better = tour, found, True
                break
    return best


def _neighbours(tour: list[tuple[int, bool]]) -> Iterator[list[tuple[int, bool]]]:
    """Tours with one stretch walked the other way round, or one ridge elsewhere, in either direction."""
    count = len(tour)
    for i in range(count):
        for j in range(i, count):
            yield tour[:i] + [(r, not f) for r, f in reversed(tour[i : j + 1])] + tour[j + 1 :]
    for i in range(count):
        ridge, flip = tour[i]
        rest = tour[:i] + tour[i + 1 :]
        for j in range(count):
            for turned in (flip, not flip):
                yield [*rest[:j], (ridge, turned), *rest[j:]]


def _exact(start_m: FloatArray, ends_m: FloatArray, closed: bool) -> list[tuple[int, bool]]:
    best: list[tuple[int, bool]] = []
    best_length = np.inf
    for order in permutations(range(len(ends_m))):
        for flips in product((False, True), repeat=len(order)):
            here, length = start_m, 0.0
            for ridge, flip in zip(order, flips, strict=True):
                entry, leave = ends_m[ridge][::-1] if flip else ends_m[ridge]
                length += float(np.hypot(*(entry - here)))
                here = leave
            length += float(np.hypot(*(start_m - here))) if closed else 0.0
            if length < best_length:
                best, best_length = list(zip(order, flips, strict=True)), length
    return best


def off_ridge_m(
    start_m: FloatArray, ends_m: FloatArray, order: list[tuple[int, bool]], *, closed: bool = False
) -> float:
    """Length of the tour between ridges, with the way back to the start if `closed`."""
    here, length = start_m, 0.0
    for ridge, flip in order:
        entry, leave = ends_m[ridge][::-1] if flip else ends_m[ridge]
        length += float(np.hypot(*(entry - here)))
        here = leave
    return length + (float(np.hypot(*(start_m - here))) if closed else 0.0)


def time_on_ridges_s(
    weights: FloatArray, period_s: float, off_ridge_length_m: float, speed_m_s: float
) -> FloatArray:
    """(k,) seconds on each ridge: what travel leaves of the period, shared by weight (RWA eq 28 and 29).

    Negative when travel alone takes longer than the period: nothing is left, all are 0.
    """
    left_s = max(0.0, period_s - off_ridge_length_m / speed_m_s)
    total = float(np.sum(weights))
    share = np.full(len(weights), 1.0 / len(weights)) if total <= 0.0 else np.asarray(weights) / total
    return np.asarray(share * left_s)
