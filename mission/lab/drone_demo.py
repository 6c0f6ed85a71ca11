"""One emulated drone with a sniffer dongle, and one transmitter hidden in a field of 120 m."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import tomlkit

from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import ChannelSpread
from fieldkit.files import write_whole
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import Mission, read_mission
from mission.lab.walk_demo import RATE_HZ
from mission.shell import setups
from mission.shell.setups import Setup

SIZE_M = 120.0
ALTITUDE_M = 10.0
SPEED_M_S = 4.0
RADIO = Antenna(path_loss_exponent=2.5, power_at_1m_dbm=-55.0, sigma_db=4.0, threshold_dbm=-95.0)
"""Heard to 40 m."""


def hidden(seed: int) -> tuple[TransientSource, ...]:
    """One transmitter anywhere in the field."""
    east_m, north_m = np.random.default_rng([seed, 0xD107E]).uniform(0.1 * SIZE_M, 0.9 * SIZE_M, 2)
    return (TransientSource(float(east_m), float(north_m), 0.0, RATE_HZ),)


def drone_text(seed: int, rate: float) -> str:
    """The mission file."""
    return tomlkit.dumps(
        {
            "schema": 1,
            "name": "drone",
            "seed": seed,
            "field": {
                "origin_lat_deg": 47.3977,
                "origin_lon_deg": 8.5456,
                "size_east_m": SIZE_M,
                "size_north_m": SIZE_M,
                "cell_m": 2.5,
            },
            "antenna": {"file": "antenna.toml"},
            "sources": {"rate_hz": RATE_HZ, "expected": 1.0},
            "engine": {"found_within_m": 6.0, "pose_sigma_m": 0.5, "planning_period_s": 20.0},
            "association": {"window_s": 0.25},
            "end": {"max_duration_s": 1800.0, "sources_found": 1},
            "safety": {
                "max_speed_m_s": SPEED_M_S,
                "pose_timeout_s": min(60.0, max(2.0, 3.0 * rate)),
                "overrun_s": min(60.0, 3.0 * rate),
            },
            "team": [{"robots": ["drone"]}],
            "robot": [
                {
                    "name": "drone",
                    "altitude_m": ALTITUDE_M,
                    "receiver": {"driver": "nrf-sniffer", "port": "/dev/ttyACM0"},
                    "vehicle": {"driver": "mavlink", "address": "udpin:0.0.0.0:14550", "system_id": 1},
                }
            ],
        }
    )


@contextmanager
def demo_drone(
    folder: Path, seed: int, rate: float
) -> Iterator[tuple[Mission, Setup, tuple[TransientSource, ...]]]:
    """The mission, its devices on emulated wires, and what is hidden."""
    spread = ChannelSpread(
        RADIO.sigma_db, 1.0, 2.0, transmitter_db=3.0, transmitter_exponent=0.1, transmitters=5
    )
    write_whole(folder / "antenna.toml", dump_antenna(AntennaFile(RADIO, spread=spread)))
    write_whole(folder / "mission.toml", drone_text(seed, rate))
    mission, sources = read_mission(folder / "mission.toml"), hidden(seed)
    with setups.emulated(mission, sources, seed=seed, rate=rate, pose_noise_m=0.3, dongles=True) as setup:
        yield mission, setup, sources
