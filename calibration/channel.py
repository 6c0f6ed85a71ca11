"""Noise in time and in place, the correlation length, and how transmitters differ: what a belief needs beyond a fit."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from calibration.fit import FitResult
from fieldkit.channel.reml import Reml, Transmitter, estimate
from fieldkit.channel.spread import ChannelSpread, assumed
from fieldkit.errors import CalibrationRefused

CENSORED_SHARE = 0.02
"""Of packets missed (or at the ceiling) above which the means come from the censored fit alone."""


@lru_cache(maxsize=4)
def measured(result: FitResult) -> tuple[ChannelSpread, Reml | None, str]:
    """The spread; the estimate it is from, None where positions are not known; and why not, in words."""
    readings = result.readings
    if readings.tx_m is None or readings.rx_m is None:
        data = {"sigma_time_db": result.sigma_time_db, "sigma_place_db": result.sigma_place_db}
        spread = assumed(result.antenna, data)
        return spread, None, "no positions in the file: the correlation length is assumed, not measured"
    height = np.zeros(readings.distance_m.size) if readings.climb_m is None else readings.climb_m
    heard = ~readings.missed
    level = readings.rss_dbm - (0.0 if readings.gain_db is None else readings.gain_db)
    if readings.receiver is not None and result.receiver_offsets_db:
        offset = np.array(
            [result.receiver_offsets_db.get(name, (0.0, 0.0))[0] for name in readings.receivers]
        )
        level = level - offset[readings.receiver]
    keys, index = np.unique(np.round(readings.tx_m, 3), axis=0, return_inverse=True)
    groups = []
    for number in range(len(keys)):
        mine = heard & (index.ravel() == number)
        place = np.column_stack([readings.rx_m[mine], height[mine]])
        if mine.any():
            groups.append(Transmitter(place, level[mine], np.append(readings.tx_m[mine][0], 0.0)))
    try:
        found = estimate(groups)
    except CalibrationRefused as error:
        return assumed(result.antenna), None, str(error)
    lost = result.n_missed + result.n_saturated
    if lost > CENSORED_SHARE * (result.n_readings + lost):
        return found.spread, found, ""
    return (
        replace(
            found.spread,
            power_at_1m_dbm=found.power_at_1m_dbm,
            path_loss_exponent=found.path_loss_exponent,
        ),
        found,
        "",
    )


def _metres(length_m: float) -> str:
    """A length in two digits; `.2g` would write 190 m as 1.9e+02."""
    return f"{float(f'{length_m:.2g}'):.12g}"


def words(spread: ChannelSpread, found: Reml | None, why_not: str) -> list[str]:
    """For people."""
    if found is None:
        return [f"place noise: {why_not}"]
    low, high = found.correlation_95_m
    lines = [
        f"over time {spread.sigma_time_db:.1f} dB, from place to place {spread.sigma_place_db:.1f} dB over "
        f"{_metres(spread.correlation_m)} m (95 %: {_metres(low)} to {_metres(high)} m)"
    ]
    if spread.transmitters > 1:
        lines.append(
            f"{spread.transmitters} transmitters differ by {spread.transmitter_db:.1f} dB and "
            f"{spread.transmitter_exponent:.2f} in their exponents, lobes of {spread.lobe_db:.1f} dB"
        )
    else:
        lines.append("one transmitter: by how much others differ is not known, and taken as unknown power")
    return lines
