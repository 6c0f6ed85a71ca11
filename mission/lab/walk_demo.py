"""A walk on emulated devices: one transmitter hidden in a field of 300 m, a person, and a radio of some kind."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldkit import plugins
from fieldkit import settings as given
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import ChannelSpread
from fieldkit.clock import ScaledClock
from fieldkit.errors import ConfigError
from fieldkit.files import write_whole
from fieldkit.geo import FieldFrame
from fieldkit.ports import VehicleLink
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import Mission, read_mission
from mission.core.walk_text import WalkOptions, walk_text
from mission.lab.demo import calibrate
from mission.lab.yagi_turns import turned_readings
from mission.shell.setups import Setup, live

SIZE_M = 300.0
RANGE_M = 80.0
"""How far the hidden transmitter is heard."""
RATE_HZ = 0.2
ORIGIN_DEG = (47.397700, 8.545600)
RADIO = Antenna(
    path_loss_exponent=2.8,
    power_at_1m_dbm=-95.0 + 28.0 * float(np.log10(RANGE_M)),
    sigma_db=4.0,
    threshold_dbm=-95.0,
)
KINDS = {
    "ble": "esp32-ble",
    "wifi": "esp32-wifi",
    "lora": "rylr",
    "meshtastic": "meshtastic",
    "wildlife": "ctt",
    "json": "json",
    "xbee": "xbee",
    "yagi": "ctt",
}
"""Kind of walk to the words its radio prints in."""
BEHIND_DB = 8.0
"""What a body takes from a signal that comes from behind."""


def yagi_gain_db() -> list[float]:
    """Of three elements or so, by heading from its front: 60 degrees wide, 15 dB less behind; its mean is nothing."""
    half = np.radians(np.arange(0.0, 360.0, 10.0) / 2.0)
    gain = np.maximum(200.0 * np.log10(np.maximum(np.abs(np.cos(half)), 1e-6)), -15.0)
    return [round(float(value), 2) for value in gain - gain.mean()]


def with_yagi() -> Antenna:
    """The radio with a yagi held in front, as it truly is."""
    return replace(RADIO, pattern_db=tuple(yagi_gain_db()))


def calibrate_yagi(folder: Path, seed: int) -> str:
    """Turn round with the emulated yagi, and calibrate from that as a person does; what the calibration said.

    Leaves readings.csv and antenna.toml in the folder: the mission knows of the yagi what they say.
    """
    write_whole(folder / "readings.csv", turned_readings(with_yagi(), seed))
    how = ("--pattern", "auto", "--missed", "counted")
    return calibrate(folder / "readings.csv", folder / "antenna.toml", how)


def believed() -> AntennaFile:
    """What a calibration by walking gives: the body's mean loss is in the power, what it scatters in the noise.

    Transmitters of the kind differ by 3 dB; the hidden one does not, which nobody knows.
    """
    off_deg = np.arange(0.0, 360.0)
    loss_db = BEHIND_DB * 0.5 * (1.0 - np.cos(np.radians(off_deg)))
    antenna = Antenna(
        RADIO.path_loss_exponent,
        RADIO.power_at_1m_dbm - float(loss_db.mean()),
        float(np.hypot(RADIO.sigma_db, loss_db.std())),
        RADIO.threshold_dbm,
    )
    spread = ChannelSpread(
        RADIO.sigma_db,
        float(loss_db.std()),
        2.0,
        transmitter_db=3.0,
        transmitter_exponent=0.1,
        lobe_db=0.5,
        transmitters=5,
    )
    return AntennaFile(antenna, spread=spread)


def hidden(seed: int) -> tuple[TransientSource, ...]:
    """One transmitter anywhere in the field."""
    rng = np.random.default_rng([seed, 0x7A1D])
    east_m, north_m = rng.uniform(0.05 * SIZE_M, 0.95 * SIZE_M, 2)
    return (TransientSource(float(east_m), float(north_m), 0.0, RATE_HZ),)


@contextmanager
def demo_walk(
    folder: Path,
    kind: str,
    seed: int,
    rate: float,
    say: Callable[[str], None] = lambda _: None,
    *,
    background: str = "",
) -> Iterator[tuple[Mission, Setup, tuple[TransientSource, ...]]]:
    """The mission, its devices on emulated wires, and what is hidden. Raises `ConfigError`."""
    if kind not in KINDS:
        raise ConfigError(f"--walk: expected one of {', '.join(KINDS)}, got {kind!r}")
    style, sources, clock = KINDS[kind], hidden(seed), ScaledClock(rate)
    radio = with_yagi() if kind == "yagi" else RADIO
    links: list[VehicleLink] = []

    def advice() -> tuple[float, float] | None:
        """As a person reads it from the page."""
        where = getattr(links[0], "advice", {}).get(given.WALKER) if links else None
        return None if where is None else (where.east_m, where.north_m)

    emulated = plugins.load("fieldkit.emulators", "walk")(
        advice, clock=clock, frame=FieldFrame(*ORIGIN_DEG), antenna=radio, sources=sources, size_m=(SIZE_M, SIZE_M),
        start_m=(SIZE_M / 2.0, 10.0), style=style, seed=seed, behind_db=0.0 if kind == "yagi" else BEHIND_DB,
    )  # fmt: skip
    if kind == "yagi":
        say("calibrating the yagi from turns at some distances from a few tags, emulated ...")
        say(calibrate_yagi(folder, seed).rstrip())
    else:
        write_whole(folder / "antenna.toml", dump_antenna(believed()))
    with emulated as walk:
        receiver = {"driver": "xbee", "port": walk.radio_port}
        if style != "xbee":
            receiver = {"driver": "lines", "port": walk.radio_port, "map": style}
        text = walk_text(
            WalkOptions(
                receiver, walk.gnss_port, "antenna.toml", ORIGIN_DEG, SIZE_M, RATE_HZ,
                seed=seed, name=f"walk-{kind}", rate=rate, background=background,
            )
        )  # fmt: skip
        write_whole(folder / "mission.toml", text)
        mission = read_mission(folder / "mission.toml")
        setup = live(mission, clock)
        links += setup.links
        yield mission, setup, sources
