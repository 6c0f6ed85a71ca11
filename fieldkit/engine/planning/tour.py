"""The shortest tour that walks every ridge once (RWA section V.B), and how long to stay on each (eq 28 and 29)."""

from itertools import permutations, product

import fast_tsp
import numpy as np

from fieldkit.messages import FloatArray

EXACT_RIDGES = 4
_SCALE_LIMIT = 20_000
"""fast_tsp takes distances up to 65,535; free edges cost this much more than the longest, so that ridges are walked."""


def ridge_tour(start_m: FloatArray, ends_m: FloatArray, *, closed: bool = False) -> list[tuple[int, bool]]:
    """Order and direction of ridges (k, 2, 2) for a tour from `start_m`, and back if `closed`: (index, reversed).

    Exact up to `EXACT_RIDGES`, else by fast_tsp with each ridge a mandatory edge.
    """
    count = len(ends_m)
    if count <= EXACT_RIDGES:
        return _exact(start_m, ends_m, closed)
    # Nodes: start, both ends of each ridge, and a dummy that closes the tour for nothing.
    nodes = np.concatenate([start_m[None], ends_m.reshape(-1, 2)])
    distance = np.hypot(*(nodes[:, None, :] - nodes[None, :, :]).transpose(2, 0, 1))
    scaled = np.rint(distance / max(distance.max(), 1e-9) * _SCALE_LIMIT).astype(int) + _SCALE_LIMIT
    for ridge in range(count):
        scaled[1 + 2 * ridge, 2 + 2 * ridge] = scaled[2 + 2 * ridge, 1 + 2 * ridge] = 0
    full = np.full((len(nodes) + 1, len(nodes) + 1), _SCALE_LIMIT, dtype=int)
    full[:-1, :-1] = scaled
    # An open tour may end anywhere; a closed one ends where it began: the dummy lies on the start.
    if closed:
        full[-1, :-1] = full[:-1, -1] = scaled[0]
    full[-1, 0] = full[0, -1] = 0
    np.fill_diagonal(full, 0)
    route = fast_tsp.find_tour(full.tolist(), duration_seconds=0.02)
    at = route.index(0)
    route = route[at:] + route[:at]
    if route[1] == len(nodes):  # the dummy must come last
        route = [route[0], *reversed(route[1:])]
    order: list[tuple[int, bool]] = []
    for node in route[1:]:
        if node != len(nodes) and (node - 1) // 2 not in [ridge for ridge, _ in order]:
            order.append(((node - 1) // 2, (node - 1) % 2 == 1))
    return order


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
