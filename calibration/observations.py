"""Readings as the distinct intervals that the likelihood counts, and the mean level of each."""

from typing import Any, Literal

import numpy as np

from calibration.dataset import Readings
from calibration.likelihood import Rows
from fieldkit.messages import FloatArray

Missed = Literal["auto", "counted", "none", "uncounted"]


def design(readings: Readings, receiver_offsets: bool = False) -> FloatArray:
    """(n, p): columns for the power at 1 m, the exponent, and each receiver after the first."""
    columns = [np.ones(len(readings.rss_dbm)), -10.0 * np.log10(readings.distance_m)]
    if receiver_offsets and readings.receiver is not None:
        columns += [(readings.receiver == i).astype(float) for i in range(1, len(readings.receivers))]
    return np.column_stack(columns)


def fitted_mean(theta: FloatArray, readings: Readings, receiver_offsets: bool = False) -> FloatArray:
    """(n,) mean level of each packet."""
    mean = design(readings, receiver_offsets) @ theta[:-1]
    return mean if readings.gain_db is None else mean + readings.gain_db


def make_rows(
    readings: Readings,
    missed: Missed,
    censor_dbm: float | None,
    saturation_dbm: float | None,
    receiver_offsets: bool = False,
    more: FloatArray | None = None,
) -> Rows:
    """Readings as distinct intervals. `censor_dbm`: at or below it packets may not have been received.

    `more` (n, k) are further columns of the design, for patterns and tests of structure.
    """
    z = readings.rss_dbm
    low, high = z - 0.5, z + 0.5
    if saturation_dbm is not None:
        high = np.where(z >= saturation_dbm, np.inf, high)
        low = np.where(z >= saturation_dbm, saturation_dbm - 0.5, low)
    seen_above = None
    if missed == "counted" and censor_dbm is not None:
        hidden = np.isnan(z) | (z <= censor_dbm)
        low, high = np.where(hidden, -np.inf, low), np.where(hidden, censor_dbm + 0.5, high)
        keep = np.ones(len(z), dtype=bool)
    else:
        keep = ~np.isnan(z)
    if missed == "uncounted" and censor_dbm is not None:
        keep &= z > censor_dbm
        seen_above = censor_dbm + 0.5
    matrix = design(readings, receiver_offsets)
    receiver = readings.receiver if receiver_offsets and readings.receiver is not None else np.zeros(len(z))
    keys = np.column_stack([readings.place, readings.distance_m, receiver, low, high])
    if more is not None:
        matrix, keys = np.column_stack([matrix, more]), np.column_stack([keys, more])
    offset = np.zeros(len(z)) if readings.gain_db is None else readings.gain_db
    keys = np.column_stack([keys, offset])[keep]
    first, count = _distinct(keys)
    chosen = np.flatnonzero(keep)[first]
    return Rows(
        matrix[chosen], low[chosen], high[chosen], count, readings.place[chosen], offset[chosen], seen_above
    )


def first_guess(rows: Rows) -> FloatArray:
    """Least squares on what was received; crude, but the likelihood is well-behaved from there."""
    heard = np.isfinite(rows.low_dbm) & np.isfinite(rows.high_dbm)
    level = np.where(heard, 0.5 * (rows.low_dbm + rows.high_dbm), 0.0)
    level = np.where(np.isinf(rows.high_dbm), rows.low_dbm, level)
    use = np.isfinite(rows.low_dbm)
    root = np.sqrt(rows.count[use])
    x, *_ = np.linalg.lstsq(
        rows.design[use] * root[:, None], (level - rows.offset_dbm)[use] * root, rcond=None
    )
    residual = (level - rows.offset_dbm)[use] - rows.design[use] @ x
    spread = np.sqrt(np.average(residual**2, weights=rows.count[use]))
    return np.append(x, np.log(np.clip(spread, 0.5, 20.0)))


def _distinct(keys: Any) -> tuple[np.ndarray, FloatArray]:
    """First index and count of each distinct row of (n, k); np.unique(axis=0) is far slower."""
    order = np.lexsort(keys.T)
    new = np.ones(len(order), dtype=bool)
    new[1:] = np.any(keys[order[1:]] != keys[order[:-1]], axis=1)
    starts = np.flatnonzero(new)
    return order[starts], np.diff(np.append(starts, len(order))).astype(float)
