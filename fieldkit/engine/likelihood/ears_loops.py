"""What is lost by elevation and azimuth, compiled; `ears.Ears.attenuation_db` is its plain form, with the distance."""

import math

from fieldkit.channel.law import Law
from fieldkit.engine.compiled import njit
from fieldkit.messages import FloatArray

EAST, NORTH, UP, HEADING, THRESHOLD, SIGMA, ROBOT, OFFSET = range(8)
"""Columns of an ear: metres (up: above the sources), radians clockwise from north, dBm, metres, whose it is, dB^2."""
COLUMNS = 8
LEAST_COS = 0.1


@njit(cache=True, nogil=True, inline="always")
def square_m2(east: float, north: float, ears: FloatArray, q: int, min_range: float) -> float:
    """The squared 3-D distance from a point to ear `q`, no less than that of the least range."""
    de, dn, up = east - ears[q, 0], north - ears[q, 1], ears[q, 2]
    result: float = max(de * de + dn * dn + up * up, min_range * min_range)
    return result


@njit(cache=True, nogil=True, inline="always")
def beyond_distance_db(
    east: float, north: float, ears: FloatArray, q: int, d2: float, law: Law, pattern: FloatArray
) -> float:
    """What is lost by elevation and azimuth, on top of the loss by distance."""
    loss = 0.0
    de, dn = east - ears[q, 0], north - ears[q, 1]
    if ears[q, 2] != 0.0 and law.elevation != 0.0:
        cos2 = max((de * de + dn * dn) / d2, 0.01)
        loss -= law.elevation * 10.0 * math.log10(cos2)
    count = pattern.shape[0]
    if count > 0:
        if d2 <= law.alike_within_m * law.alike_within_m:
            loss -= pattern.max()
        else:
            at = ((math.atan2(de, dn) - ears[q, 3]) / (2.0 * math.pi)) % 1.0 * count
            k = int(at)
            low, high = pattern[k % count], pattern[(k + 1) % count]
            loss -= low + (at - k) * (high - low)
    return loss
