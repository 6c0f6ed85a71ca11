"""Emulated radios for the robots of a mission file: each hears hidden transmitters from where its vehicle really is.

Vehicles are real, or an autopilot's own simulator: a copy of their telemetry says where they are. What a mission
rehearses so is everything but the radios. The mission file is read as it is; nothing of `mission` is imported.
"""

import asyncio
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.emulators.defaults import PROFILE, SOURCES
from drivers.emulators.field import FOREIGN_ADDRESS, ROBOT_ADDRESS, SOURCE_ADDRESS, STEP_S
from drivers.emulators.wires import PluggedModule, PtyWire, TcpWire, Wire
from drivers.emulators.xbee import PROFILES, Module
from drivers.links import host_and_port
from drivers.mavlink.codec import AUTOPILOT, Message, Parser
from drivers.mavlink.modes import flies
from drivers.mavlink.transport import MAX_PEERS, Peer, make_transport
from fieldkit.channel.antenna_file import read_antenna, with_pattern
from fieldkit.channel.model import Antenna
from fieldkit.clock import Clock
from fieldkit.errors import ConfigError
from fieldkit.geo import FieldFrame
from fieldkit.world.sources import TransientSource, Transmissions, random_sources
from fieldkit.world.surroundings import NOTHING_AROUND, Surroundings

STALE_S = 2.0
"""A robot whose place is older hears nothing: nobody knows where it is."""


@dataclass(frozen=True, slots=True)
class Rehearsed:
    """One robot of the mission file."""

    name: str
    system_id: int
    port: str


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """What is to be rehearsed."""

    frame: FieldFrame
    antenna: Antenna
    robots: tuple[Rehearsed, ...]
    sources: tuple[TransientSource, ...]
    profile: str = PROFILE
    size_m: float = 10.0
    """The longer side of the field."""
    around: Surroundings = NOTHING_AROUND


@dataclass
class HeardPositions:
    """Where vehicles are, from a copy of their telemetry."""

    frame: FieldFrame
    clock: Clock
    places: dict[int, tuple[float, tuple[float, float, float, float]]] = field(default_factory=dict)
    """System id to (elapsed time, (east, north, up, heading))."""
    _flying: dict[int, bool] = field(default_factory=dict)
    _parsers: dict[Peer, Parser] = field(default_factory=dict)

    def hear(self, data: bytes, peer: Peer) -> None:
        """Bytes of a copy."""
        if peer not in self._parsers and len(self._parsers) >= MAX_PEERS:
            self._parsers.clear()
        for message in self._parsers.setdefault(peer, Parser()).parse(data):
            if message.get_srcComponent() != AUTOPILOT:
                continue
            if message.get_type() == "HEARTBEAT":
                self._flying[message.get_srcSystem()] = flies(message)
            elif message.get_type() == "GLOBAL_POSITION_INT":
                self._place(message)

    def _place(self, message: Message) -> None:
        system_id = message.get_srcSystem()
        east_m, north_m, _ = self.frame.to_local(message.lat / 1e7, message.lon / 1e7)
        heading_deg = 0.0 if message.hdg == 65535 else message.hdg / 100.0
        # A rover's relative altitude is no height above the ground: see `drivers.mavlink.vehicle`.
        up_m = message.relative_alt / 1000.0 if self._flying.get(system_id, False) else 0.0
        self.places[system_id] = (self.clock.elapsed_s(), (east_m, north_m, up_m, heading_deg))

    def of(self, system_id: int) -> tuple[float, float, float, float] | None:
        """East, north, up, heading; None where it is not heard, or not any more."""
        heard_s, place = self.places.get(system_id, (-math.inf, (0.0, 0.0, 0.0, 0.0)))
        return place if self.clock.elapsed_s() - heard_s <= STALE_S else None


def read_rehearsal(
    path: Path,
    *,
    sources: Sequence[TransientSource] = (),
    count: int = SOURCES,
    seed: int = 1,
    profile: str = PROFILE,
    around: Surroundings = NOTHING_AROUND,
) -> Rehearsal:
    """What a mission file has of robots, field and antenna. `sources` empty: `count` are hidden at random.

    Raises `ConfigError` where the file cannot be rehearsed with.
    """
    if around.wander_m:
        raise ConfigError(
            "--with wander_m: positions here are those of your vehicles; expected nothing of it"
        )
    if profile not in PROFILES:
        raise ConfigError(f"--profile: no '{profile}'; there are: {', '.join(PROFILES)}")
    try:
        raw = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error
    try:
        table, known = raw["field"], raw["sources"]
        origin = (table["origin_lat_deg"], table["origin_lon_deg"], table.get("origin_alt_m", 0.0))
        frame = FieldFrame(*(float(number) for number in origin))
        size = (float(table["size_east_m"]), float(table["size_north_m"]))
        robots = tuple(_robot(path, robot) for robot in raw["robot"])
        antenna = path.parent / str(raw["antenna"]["file"])
        rng = np.random.default_rng(seed)
        levels = tuple(float(level) for level in known.get("power_levels_db", (0.0,)))
        hidden = tuple(sources) or tuple(
            random_sources(
                count, *size, levels, float(known["rate_hz"]), rng, min_separation_m=min(size) / 10
            )
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: {error!r}: is it a mission file? see 'fieldkit check'") from error
    file = read_antenna(antenna, allow_refused=True, allow_pattern=True)
    radio = with_pattern(file) if file.pattern else file.antenna
    return Rehearsal(frame, radio, robots, hidden, profile, max(size), around)


def named_sources(texts: Sequence[str], rate_hz: float) -> tuple[TransientSource, ...]:
    """Transmitters from EAST,NORTH or EAST,NORTH,POWER_DB. Raises `ConfigError`."""
    if not 0 < rate_hz < 1000:
        raise ConfigError(f"--rate-hz: expected a positive number, got {rate_hz:g}")
    sources = []
    for text in texts:
        try:
            east_m, north_m, *power = (float(number) for number in text.split(","))
            (power_db,) = power or [0.0]
        except ValueError:
            raise ConfigError(f"--source: expected EAST,NORTH or EAST,NORTH,POWER_DB, got {text!r}") from None
        if not all(map(math.isfinite, (east_m, north_m, power_db))):
            raise ConfigError(f"--source: expected finite numbers, got {text!r}")
        sources.append(TransientSource(east_m, north_m, power_db, rate_hz))
    return tuple(sources)


def _robot(path: Path, table: Mapping[str, Any]) -> Rehearsed:
    name, receiver, vehicle = str(table["name"]), table["receiver"], table["vehicle"]
    if receiver["driver"] != "xbee":
        raise ConfigError(
            f"{path}: robot {name}: radios of driver {receiver['driver']!r} are not emulated here"
        )
    if not isinstance(vehicle.get("system_id"), int):
        raise ConfigError(
            f"{path}: robot {name}: its vehicle has no system_id: whose telemetry is its place?"
        )
    return Rehearsed(name, vehicle["system_id"], str(receiver["port"]))


def wire_for(port: str, robot: str) -> Wire:
    """The device's end of the port that the mission file names. Raises `ConfigError` for one that is a real one's."""
    if port.startswith("socket://"):
        host, number = host_and_port(port.removeprefix("socket://"))
        if host not in ("127.0.0.1", "localhost"):
            raise ConfigError(
                f"{robot}: port {port}: emulated radios listen on this computer: socket://127.0.0.1:N"
            )
        return TcpWire(host, number)
    path = Path(port)
    if path.is_absolute() and path.parts[1:2] == ("dev",):
        raise ConfigError(
            f"{robot}: port {port} is a real radio's name. For a rehearsal give it one that can be made: "
            'port = "socket://127.0.0.1:7001", or a path outside /dev'
        )
    if path.exists() and not path.is_symlink():
        raise ConfigError(f"{robot}: port {port}: there is a file of that name")
    path.parent.mkdir(parents=True, exist_ok=True)
    return PtyWire(path)


class Radios:
    """The emulated radios, while used as an async context manager."""

    def __init__(self, what: Rehearsal, telemetry: str, clock: Clock, seed: int) -> None:
        self.what = what
        self.positions = HeardPositions(what.frame, clock)
        self.heard = dict.fromkeys((robot.name for robot in what.robots), 0)
        """Packets that each radio has heard."""
        self._clock = clock
        self._rng = np.random.default_rng([seed, 1])
        self._air = what.around.air(what.antenna, what.sources, len(what.robots), what.size_m, seed)
        self._transmissions = Transmissions(list(what.sources), np.random.default_rng([seed, 2]))
        self._sent = [0] * len(what.sources)
        self._transport = make_transport(telemetry)
        known = PROFILES[what.profile]
        ceiling = known.saturation_dbm if what.antenna.saturation_dbm is None else what.antenna.saturation_dbm
        # Hearing is the channel's business (the antenna's threshold), not a second threshold's.
        profile = replace(known, saturation_dbm=ceiling, sensitivity_dbm=-254.0)
        self.radios = {
            robot.name: PluggedModule(
                Module(profile, ROBOT_ADDRESS + robot.system_id), wire_for(robot.port, robot.name)
            )
            for robot in what.robots
        }

    async def __aenter__(self) -> "Radios":
        await self._transport.open(self.positions.hear)
        for radio in self.radios.values():
            await radio.plug()
        self._task = asyncio.create_task(self._live(), name="emulated radios")
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.wait({self._task})
        for radio in self.radios.values():
            radio.unplug()
        await self._transport.close()

    async def _live(self) -> None:
        t_s = self._clock.elapsed_s()
        self._transmissions.until(t_s)
        while True:
            before_s, t_s = t_s, self._clock.elapsed_s()
            for index, rss_dbm in self._air.foreign(t_s - before_s, len(self.what.robots), self._rng):
                self._hear(self.what.robots[index], rss_dbm, FOREIGN_ADDRESS, 0)
            for _, source in self._transmissions.until(t_s):
                self._transmit(source, t_s)
            await self._clock.sleep(STEP_S)

    def _transmit(self, source: TransientSource, t_s: float) -> None:
        """One packet: every robot whose place is known draws its own noise."""
        index = self.what.sources.index(source)
        number, self._sent[index] = self._sent[index], self._sent[index] + 1
        unknown = (math.nan, math.nan, math.nan, 0.0)
        places = np.array([self.positions.of(robot.system_id) or unknown for robot in self.what.robots])
        levels = self._air.heard_dbm(index, t_s, places[:, :2], places[:, 2], places[:, 3], self._rng)
        for robot, level in zip(self.what.robots, levels.tolist(), strict=True):
            self._hear(robot, level, SOURCE_ADDRESS + index, number)

    def _hear(self, robot: Rehearsed, rss_dbm: float, sender: int, number: int) -> None:
        if math.isfinite(rss_dbm):
            self.heard[robot.name] += self.radios[robot.name].hear(rss_dbm, sender, number.to_bytes(4, "big"))


async def run_radios(
    what: Rehearsal, telemetry: str, clock: Clock, seed: int, say: Callable[[str], None]
) -> None:
    """The radios, until cancelled. Says where they are, and which robots are not heard from."""
    async with Radios(what, telemetry, clock, seed) as radios:
        for robot in what.robots:
            say(f'{robot.name}: system {robot.system_id}, port = "{robot.port}"')
        for number, source in enumerate(what.sources, start=1):
            say(f"hidden transmitter {number}: {source.east_m:.2f} m east, {source.north_m:.2f} m north")
        say(f"places come from telemetry on {telemetry}   (Ctrl-C ends it)")
        missing: set[str] = {robot.name for robot in what.robots}
        while True:
            await clock.sleep(1.0)
            now = {robot.name for robot in what.robots if radios.positions.of(robot.system_id) is None}
            for name in sorted(missing - now):
                say(f"{name} is heard: its radio hears from where it is")
            for name in sorted(now - missing):
                say(f"{name} is not heard any more: its radio hears nothing")
            missing = now
