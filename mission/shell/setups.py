"""What a mission runs on: which clock, which radios, which vehicles. Live and emulated differ in nothing else.

The emulated setup starts a field of devices on this machine (`fieldkit.emulators`), and then opens them with the
same drivers, through the same wires, as the live one.
"""

import asyncio
import random
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fieldkit import plugins
from fieldkit import settings as given
from fieldkit.channel.antenna_file import with_pattern
from fieldkit.channel.model import Antenna
from fieldkit.clock import Clock, RealClock, ScaledClock
from fieldkit.errors import ConfigError
from fieldkit.ports import DriverContext, PositionSource, Receiver, VehicleLink
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import Mission
from mission.core.tables import RobotTable

_NOBODYS_PORTS = range(20_000, 30_000)


class RawTap:
    """Hands over a radio's bytes to whoever records them, in its event loop; while nobody does they are dropped."""

    def __init__(self) -> None:
        self._listener: tuple[asyncio.AbstractEventLoop, Callable[[str, bytes], None]] | None = None

    def listen(self, record: Callable[[str, bytes], None]) -> None:
        """From now on `record` gets (robot, bytes), in the loop that runs now."""
        self._listener = asyncio.get_running_loop(), record

    def __call__(self, robot: str, data: bytes) -> None:
        if self._listener is not None:
            loop, record = self._listener
            with suppress(RuntimeError):  # the mission is over, its loop closed
                loop.call_soon_threadsafe(record, robot, data)


@dataclass(frozen=True, slots=True)
class Setup:
    """Devices that have been made, not opened."""

    clock: Clock
    receivers: tuple[Receiver, ...]
    links: tuple[VehicleLink, ...]
    positions: tuple[PositionSource, ...] = ()
    """Other sources of positions; the robots they know are not taken from telemetry."""
    emulator: Any = None
    """The emulated field, for injecting faults; None on a live setup."""
    tap: RawTap | None = None
    """Where the radios' raw bytes come out, if the mission file wants them recorded."""


def live(mission: Mission, clock: Clock | None = None) -> Setup:
    """The radios and vehicles the mission file names. Raises `ConfigError` for options a driver does not know."""
    return _build(mission, mission.file.robot, clock or RealClock())


def of_robot(mission: Mission, name: str, clock: Clock | None = None) -> Setup:
    """One robot's devices alone, and its own positions where the file has a source for each robot by name."""
    file = mission.file
    robots = tuple(robot for robot in file.robot if robot.name == name)
    positions = []
    for table in file.positions:
        options = table.model_extra or {}
        if isinstance(options.get("robots"), dict):
            if name not in options["robots"]:
                continue
            table = replace_options(table, {"robots": {name: options["robots"][name]}})
        positions.append(table)
    own = replace(mission, file=file.model_copy(update={"positions": tuple(positions)}))
    return _build(own, robots, clock or RealClock())


def _build(mission: Mission, robots: tuple[RobotTable, ...], clock: Clock, emulator: Any = None) -> Setup:
    tap = RawTap() if mission.file.recording.raw else None
    around = DriverContext(clock, mission.frame, tap)
    receivers = []
    for robot in robots:
        make = plugins.load("fieldkit.receivers", robot.receiver.driver)
        receivers.append(make(robot.name, dict(robot.receiver.model_extra or {}), around))
    links = with_vehicles(mission, robots, clock)
    positions = []
    for table in () if emulator is not None else mission.file.positions:
        positions.append(
            plugins.load("fieldkit.positions", table.driver)(dict(table.model_extra or {}), around)
        )
    if emulator is None:
        _check_places(mission, positions)
    return Setup(clock, tuple(receivers), links, tuple(positions), emulator, tap)


def _check_places(mission: Mission, positions: Sequence[PositionSource]) -> None:
    """Raises `ConfigError` for a source that places nobody of this mission, and for a person whom none places."""
    names = mission.kernel.engine.robots
    ports = {(robot.receiver.model_extra or {}).get("port"): robot.name for robot in mission.file.robot}
    for number, table in enumerate(mission.file.positions):
        placed = (table.model_extra or {}).get("robots")
        for robot, port in placed.items() if isinstance(placed, dict) else ():
            where = f"{mission.where}: positions.{number}.robots.{robot}"
            if robot not in names:
                raise ConfigError(f"{where}: there is no such robot; robots are: {', '.join(names)}")
            if isinstance(port, str) and port in ports:
                raise ConfigError(f"{where}: {port} is the port of robot {ports[port]!r}'s radio already")
    placed_at_all = {robot for source in positions for robot in source.robots}
    for robot in sorted(mission.safety.on_foot - placed_at_all):
        raise ConfigError(
            f"{mission.where}: robot {robot!r}: nothing says where this person is; add "
            f'[[positions]] driver = "gnss", robots = {{ {robot} = "/dev/ttyACM0" }}'
        )


def with_vehicles(mission: Mission, robots: tuple[RobotTable, ...], clock: Clock) -> tuple[VehicleLink, ...]:
    """The links to the robots' vehicles: robots at one address share one."""
    around = DriverContext(clock, mission.frame)
    grouped: dict[tuple[str, str], dict[str, dict[str, Any]]] = {}
    for robot in robots:
        key = (robot.vehicle.driver, robot.vehicle.address)
        grouped.setdefault(key, {})[robot.name] = dict(robot.vehicle.model_extra or {})
    return tuple(
        plugins.load("fieldkit.vehicles", driver)(address, options, around)
        for (driver, address), options in grouped.items()
    )


def radio_of(mission: Mission) -> Antenna:
    """The robots' antenna as the file has it, with its pattern where it has one: what emulated radios hear with."""
    return with_pattern(mission.antenna) if mission.antenna.pattern else mission.antenna.antenna


@contextmanager
def emulated(
    mission: Mission,
    sources: tuple[TransientSource, ...],
    *,
    seed: int,
    rate: float,
    pose_noise_m: float = given.POSE_NOISE_M,
    dongles: bool = False,
) -> Iterator[Setup]:
    """An emulated field for the mission's robots, on a clock `rate` times as fast as the wall's.

    Robots start in pairs along the south border. The mission file's ports and addresses are replaced by the
    emulated ones; everything else of it is used as it is. `dongles`: robots carry sniffer dongles, not XBees.
    """
    emulate = plugins.load("fieldkit.emulators", "field")
    clock = ScaledClock(rate)
    port = free_udp_port()
    starts = start_places(mission)
    flying = mission.safety.altitude_m
    radio = "nrf-sniffer" if dongles else "xbee"
    emulator = emulate(
        clock=clock,
        frame=mission.frame,
        antenna=radio_of(mission),
        sources=sources,
        robots=tuple(
            (name, number, float(east), float(north), 0.0, "copter" if name in flying else "rover")
            for number, (name, (east, north)) in enumerate(starts.items(), start=1)
        ),
        vehicle_address=f"127.0.0.1:{port}",
        seed=seed,
        pose_noise_m=pose_noise_m,
        max_speed_m_s=mission.safety.max_speed_m_s,
        # A vehicle's own 5 s, as wall time: on a scaled clock a busy machine would look like a dead one.
        gcs_failsafe_s=max(6.5, 5.0 * rate),
        dongles=dongles,
    )
    with emulator as field:
        robots = tuple(
            robot.model_copy(
                update={
                    "receiver": replace_options(
                        robot.receiver, {"driver": radio, "port": field.receiver_ports[robot.name]}
                    ),
                    "vehicle": replace_options(
                        robot.vehicle,
                        {
                            "driver": "mavlink",
                            "address": f"udpin:127.0.0.1:{port}",
                            "system_id": list(starts).index(robot.name) + 1,
                        },
                    ),
                }
            )
            for robot in mission.file.robot
        )
        yield _build(mission, robots, clock, field)


def replace_options(table: Any, changes: dict[str, Any]) -> Any:
    """A driver's table with some options replaced."""
    return type(table).model_validate({**table.model_dump(), **changes})


def start_places(mission: Mission) -> dict[str, tuple[float, float]]:
    """Where emulated robots start: teams spread along the south border, robots of a team a separation apart."""
    teams = mission.kernel.engine.teams
    gap = max(mission.safety.min_separation_m, 0.02 * mission.safety.size_east_m)
    places = {}
    for index, team in enumerate(teams):
        centre = (index + 0.5) / len(teams) * mission.safety.size_east_m
        for slot, robot in enumerate(team):
            east = centre + (slot - (len(team) - 1) / 2) * gap
            places[robot] = (
                float(np.clip(east, 0.0, mission.safety.size_east_m)),
                mission.safety.fence_margin_m + gap,
            )
    return places


def free_udp_port() -> int:
    """A port of this machine that nobody has open, of those that no system gives to who asks for any.

    One of the others may be somebody else's before it is opened: another mission's on a busy machine.
    """
    while True:
        port = random.SystemRandom().choice(_NOBODYS_PORTS)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
