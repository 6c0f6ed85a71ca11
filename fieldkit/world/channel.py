"""What a radio hears of a transmission, in the simulated world."""

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.messages import FloatArray


def sample_rss_dbm(
    antenna: Antenna,
    range_m: FloatArray,
    power_db: FloatArray | float,
    rng: np.random.Generator,
    off_front_deg: FloatArray | float = 0.0,
) -> FloatArray:
    """(m,) integer readings at `range_m` (m,), nan where the packet is not received, capped at saturation.

    `off_front_deg` (m,) is where the source lies, clockwise from the front of each robot's antenna.
    """
    mean = antenna.mean_rss_dbm(range_m, power_db) + antenna.gain_db(off_front_deg, range_m)
    reading = np.floor(mean + rng.normal(0.0, antenna.sigma_db, range_m.shape) + 0.5)
    heard = reading > antenna.threshold_dbm
    if antenna.saturation_dbm is not None:
        reading = np.minimum(reading, antenna.saturation_dbm)
    return np.where(heard, reading, np.nan)
