"""Emulated calibration of a yagi: a person stands at some distances from tags of the kind and turns round at each.

What comes out is the file of readings that `fieldkit calibrate collect --turns` fills, missed packets and all.
"""

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.world.channel import sample_rss_dbm

TAGS = 4
TAG_SIGMA_DB = 2.0
"""By which tags of one kind differ in power."""
DISTANCES_M = (5.0, 8.0, 13.0, 20.0, 32.0, 50.0, 75.0)
TURNS = 8
PACKETS = 3
HEADER = "place,transmitter,tx_east_m,tx_north_m,rx_east_m,rx_north_m,heading_deg,sequence,rss_dbm"


def turned_readings(radio: Antenna, seed: int) -> str:
    """The readings as CSV. `radio` is the truth: its `pattern_db` is by heading from the antenna's front."""
    rng = np.random.default_rng([seed, 0x7A61])
    rows, sequence = [HEADER], 0
    for tag in range(TAGS):
        power_db = float(rng.normal(0.0, TAG_SIGMA_DB))
        for distance_m in DISTANCES_M:
            bearing = rng.uniform(0.0, 2.0 * np.pi)
            east_m, north_m = distance_m * np.sin(bearing), distance_m * np.cos(bearing)
            for heading_deg in np.arange(TURNS) * 360.0 / TURNS:
                rss_dbm = sample_rss_dbm(
                    radio, np.full(PACKETS, distance_m), power_db, rng, np.full(PACKETS, heading_deg)
                )
                for rss in rss_dbm:
                    level = "" if np.isnan(rss) else f"{rss:.0f}"
                    where = f"{100.0 * tag:.1f},0.0,{100.0 * tag + east_m:.2f},{north_m:.2f}"
                    rows.append(
                        f"t{tag}-{distance_m:g}m-{heading_deg:.0f},tag-{tag},{where},{heading_deg:.0f},{sequence},{level}"
                    )
                    sequence += 1
    return "\n".join(rows) + "\n"
