"""Make the readings log in examples/: a simulated XBee calibration, missed packets as empty readings.

python -m calibration.example_log --seed 1 -o examples/readings.csv
"""

import argparse
from pathlib import Path

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.files import write_whole
from fieldkit.world.channel import sample_rss_dbm

#: The radio of the demo: exponent and noise as in the papers' calibration, thresholds in whole dBm.
TRUTH = Antenna(
    path_loss_exponent=2.53, power_at_1m_dbm=-62.0, sigma_db=3.3, threshold_dbm=-70.0, saturation_dbm=-36.0
)
PLACES, PACKETS = 40, 20
RANGE_M = (0.15, 4.0)
BEACON_S = 0.5
HEADER = "place,rx_east_m,rx_north_m,tx_east_m,tx_north_m,distance_m,receiver,sequence,time_s,rss_dbm"


def example_csv(seed: int) -> str:
    """The log as text: places at distances even in the logarithm, in directions all round the transmitter."""
    rng = np.random.default_rng(seed)
    lines = [HEADER]
    sequence, now_s = 0, 0.0
    for number, wanted_m in enumerate(np.geomspace(*RANGE_M, PLACES)):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        east, north = np.round(5.0 + wanted_m * np.array([np.sin(angle), np.cos(angle)]), 3)
        distance = round(float(np.hypot(east - 5.0, north - 5.0)), 4)
        readings = sample_rss_dbm(TRUTH, np.full(PACKETS, distance), 0.0, rng)
        for rss in readings:
            level = "" if np.isnan(rss) else f"{rss:.0f}"
            place = f"p{number + 1:02d},{east:.3f},{north:.3f},5.000,5.000,{distance:.4f}"
            lines.append(f"{place},xbee-1,{sequence},{now_s:.1f},{level}")
            sequence, now_s = sequence + 1, now_s + BEACON_S
        now_s += 20.0
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the example log of readings.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--out", type=Path, default=Path("examples/readings.csv"))
    options = parser.parse_args()
    write_whole(options.out, example_csv(options.seed))


if __name__ == "__main__":
    main()
