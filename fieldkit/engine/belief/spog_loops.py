"""The compiled loops of the SPOG update and of its EM rule. Their plain numpy twins are in the tests."""

import math

import numpy as np

from fieldkit.engine.compiled import njit
from fieldkit.messages import FloatArray

SMALL = 1e-4
"""Shares below this are taken by series."""


@njit(cache=True, nogil=True, fastmath=True)
def em_sweeps(likelihood: FloatArray, floor: FloatArray, total: float, sweeps: int, pi: FloatArray) -> None:
    """EM for mixture weights, in place: pi <- (floor + sum over events of their shares) / total, `sweeps` times.

    `likelihood` (k, n) of events over cells, `pi` and `floor` (n,); an event's share of cell i is L_i pi_i / sum L pi.
    """
    events, n = likelihood.shape
    sums = np.empty(n)
    for _ in range(sweeps):
        for i in range(n):
            sums[i] = floor[i]
        for k in range(events):
            row = likelihood[k]
            norm = 0.0
            for i in range(n):
                norm += row[i] * pi[i]
            scale = 1.0 / max(norm, 1e-300)
            for i in range(n):
                sums[i] += row[i] * pi[i] * scale
        for i in range(n):
            pi[i] = sums[i] / total


@njit(cache=True, nogil=True)
def em_absent(likelihood: FloatArray, pi: FloatArray, settled: FloatArray, out: FloatArray) -> None:
    """out (n,): `settled` plus the sum over events of log(1 - share): SPOG's log(1 - P(C_i)) under the weights `pi`."""
    events, n = likelihood.shape
    out[:] = settled
    for k in range(events):
        row = likelihood[k]
        norm = 0.0
        for i in range(n):
            norm += row[i] * pi[i]
        scale = 1.0 / max(norm, 1e-300)
        for i in range(n):
            share = row[i] * pi[i] * scale
            if share < 1e-4:  # the series is right to 1e-13 there
                out[i] -= share + 0.5 * share * share
            else:
                out[i] += math.log1p(-min(share, 1.0 - 1e-16))


@njit(cache=True, nogil=True, error_model="numpy")
def add_shares(weight: FloatArray, total: float, log_absent: FloatArray, sum_shares: FloatArray) -> None:
    """Turn weights (n,) into shares P1 of `total`, in place, add them up and take log(1 - P1) from `log_absent`."""
    scale = 1.0 / total
    for i in range(weight.shape[0]):
        share = weight[i] * scale
        weight[i] = share
        sum_shares[i] += share
        # The series is right to 1e-16 where it is used, which is nearly everywhere.
        series = share * (1.0 + share * (0.5 + share / 3.0))
        log_absent[i] -= series if share < SMALL else 0.0
    for i in range(weight.shape[0]):
        if weight[i] >= SMALL:
            log_absent[i] += math.log1p(-min(weight[i], 1.0 - 1e-16))
