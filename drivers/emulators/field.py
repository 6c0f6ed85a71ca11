"""A whole emulated field in a child process: hidden transmitters, and robots with their radios and links.

A process of its own, so that the mission's computing never delays a frame on the wire, nor the other way
round. It shares the mission's scaled clock: source schedules, motion and telemetry run in mission time, only
the XBee's answers take wall time. World time 0 is the clock's `start_ns`.
"""

import asyncio
import contextlib
import multiprocessing
import random
import signal
import tempfile
import threading
from collections.abc import Iterable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from drivers.emulators.autopilot import Autopilot
from drivers.emulators.defaults import FIRMWARE
from drivers.emulators.faults import FAULTS
from drivers.emulators.profiles import COPTER
from drivers.emulators.profiles import PROFILES as FIRMWARES
from drivers.emulators.rover import make_autopilot
from drivers.emulators.running import RunningField
from drivers.emulators.sniffers import NrfDongle
from drivers.emulators.wires import PluggedModule, make_wire
from drivers.emulators.xbee import PROFILES, Module
from drivers.links import host_and_port
from fieldkit import settings as given
from fieldkit.channel.model import Antenna
from fieldkit.clock import ScaledClock
from fieldkit.errors import DeviceError
from fieldkit.geo import FieldFrame
from fieldkit.world.bodies import Car, Copter, car_for
from fieldkit.world.sources import TransientSource, Transmissions
from fieldkit.world.surroundings import NOTHING_AROUND, Surroundings
from fieldkit.world.wander import Wander

STEP_S = 0.05
"""World seconds between looks at sources and robots, unless that is less than `STEP_WALL_S`."""
STEP_WALL_S = 0.002
START_TIMEOUT_S = 60.0
SOURCE_ADDRESS = 0x0013A20041000000
FOREIGN_ADDRESS = 0x0013A20042000000
ROBOT_ADDRESS = 0x0013A20040000000


@dataclass(frozen=True, slots=True)
class EmulatedRobot:
    """A robot at the start: its MAVLink system id and where it stands."""

    name: str
    system_id: int
    east_m: float
    north_m: float
    heading_deg: float = 0.0
    firmware: str = FIRMWARE
    """rover, copter or px4."""
    address: str = ""
    """host:port to which it sends, where that is its own."""


@dataclass(frozen=True, slots=True)
class FieldSpec:
    """What to emulate. Picklable."""

    clock: ScaledClock
    frame: FieldFrame
    antenna: Antenna
    sources: tuple[TransientSource, ...]
    robots: tuple[EmulatedRobot, ...]
    vehicle_address: str
    """host:port to which the rovers send."""
    seed: int
    pose_noise_m: float = 0.0
    max_speed_m_s: float = given.MAX_SPEED_M_S.default
    xbee_profile: str = "s2c"
    dongles: bool = False
    """Robots carry nRF52840 dongles with the sniffer firmware, not XBees."""
    size_m: float = 10.0
    around: Surroundings = NOTHING_AROUND
    gcs_failsafe_s: float | None = None
    """Age of the ground station's heartbeat at which rovers hold; None: 6.5 s, or a wall second if longer."""


def start(spec: FieldSpec) -> RunningField:
    """Emulate a field until closed; returns when every wire is there. Takes about a second."""
    if spec.xbee_profile not in PROFILES:
        raise ValueError(f"no XBee profile {spec.xbee_profile!r}; there are: {', '.join(PROFILES)}")
    for address in (spec.vehicle_address, *(robot.address for robot in spec.robots if robot.address)):
        host_and_port(address)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_child, args=(spec, theirs), name="emulated-field", daemon=True)
    process.start()
    theirs.close()
    try:
        ports = ours.recv() if ours.poll(START_TIMEOUT_S) else DeviceError("the emulated field did not start")
    except EOFError:
        ports = DeviceError("the emulated field ended while starting; its own words are above")
    if isinstance(ports, Exception):
        process.kill()
        process.join()
        raise ports
    return RunningField(process, ours, ports)


def emulate(robots: Iterable[tuple[Any, ...]], **spec: Any) -> RunningField:
    """`start` for callers that find it by name: robots as the fields of `EmulatedRobot`, the spec by keyword.

    What the keywords are is said at `FieldSpec`.
    """
    return start(FieldSpec(robots=tuple(EmulatedRobot(*robot) for robot in robots), **spec))


def _child(spec: FieldSpec, connection: Connection) -> None:
    # Ctrl-C reaches the whole process group; the field must outlive the mission's orderly end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        asyncio.run(_Field(spec).run(connection))
    except DeviceError as error:
        connection.send(error)


class _Telemetry(asyncio.DatagramProtocol):
    """One rover's UDP socket."""

    def __init__(self, robot: "_Robot", clock: ScaledClock) -> None:
        self._robot = robot
        self._clock = clock

    def connection_made(self, transport: Any) -> None:
        self._robot.transport = transport

    def datagram_received(self, data: bytes, address: Any) -> None:
        if not self._robot.silenced:
            self._robot.send(self._robot.autopilot.receive(data, _world_s(self._clock)))

    def error_received(self, error: Exception) -> None:
        """Ignored: a radio would not know that nobody listens yet at the vehicle address."""


class _Robot:
    """One robot's devices."""

    def __init__(self, autopilot: Autopilot, radio: PluggedModule[Any]) -> None:
        self.autopilot = autopilot
        self.radio = radio
        self.transport: asyncio.DatagramTransport | None = None
        self.silenced = False
        self.heard = 0
        self.plugged = True

    def send(self, data: bytes) -> None:
        if data and self.transport is not None and not self.silenced:
            self.transport.sendto(data)


class _Faults:
    """What can be made to happen to a robot: one method per fault."""

    async def unplug(self, robot: _Robot, _: Any) -> None:
        robot.radio.unplug()
        robot.plugged = False

    async def replug(self, robot: _Robot, _: Any) -> None:
        if not robot.plugged:
            await robot.radio.plug()
            robot.plugged = True

    async def mute_radio(self, robot: _Robot, mute: Any) -> None:
        robot.radio.module.dead = bool(mute)

    async def damage_next_frame(self, robot: _Robot, prefix: Any) -> None:
        robot.radio.rewrite = lambda data: bytes(prefix) + data

    async def fault_next_frame(self, robot: _Robot, fault: Any) -> None:
        """One of `faults.FAULTS`, by name."""
        robot.radio.rewrite = FAULTS[str(fault)](random.Random(robot.radio.module.serial_number))

    async def pause_radio(self, robot: _Robot, paused: Any) -> None:
        if paused:
            robot.radio.pause()
        else:
            robot.radio.resume()

    async def reboot_radio(self, robot: _Robot, _: Any) -> None:
        robot.radio.reboot()

    async def silence_vehicle(self, robot: _Robot, _: Any) -> None:
        robot.silenced = True

    async def restore_vehicle(self, robot: _Robot, _: Any) -> None:
        robot.silenced = False

    async def gps_lost(self, robot: _Robot, lost: Any) -> None:
        robot.autopilot.lose_gps(bool(lost))

    async def stuck(self, robot: _Robot, stuck: Any) -> None:
        robot.autopilot.trouble.stuck = bool(stuck)

    async def refuses_hold(self, robot: _Robot, refuses: Any) -> None:
        robot.autopilot.trouble.refuses_hold = bool(refuses)

    async def rolls_on(self, robot: _Robot, rolls: Any) -> None:
        robot.autopilot.trouble.rolls_on = bool(rolls)

    async def battery(self, robot: _Robot, percent: Any) -> None:
        robot.autopilot.battery_pct = float(percent)

    async def voltage(self, robot: _Robot, volts: Any) -> None:
        robot.autopilot.trouble.battery_v = None if volts is None else float(volts)

    async def parameter(self, robot: _Robot, name_and_value: Any) -> None:
        name, value = name_and_value
        robot.autopilot.parameters[str(name)] = float(value)

    async def prearm(self, robot: _Robot, words: Any) -> None:
        robot.autopilot.trouble.prearm = str(words or "")

    async def operator(self, robot: _Robot, mode: Any) -> None:
        robot.autopilot.operator_sets(int(mode))


def _world_s(clock: ScaledClock) -> float:
    return (clock.now_ns() - clock.start_ns) * 1e-9


class _Field:
    """The child's side: one event loop for all devices."""

    def __init__(self, spec: FieldSpec) -> None:
        self._spec = spec
        seeds = np.random.SeedSequence(spec.seed).spawn(2 + len(spec.robots))
        self._schedule = Transmissions(list(spec.sources), np.random.default_rng(seeds[0]))
        self._channel_rng = np.random.default_rng(seeds[1])
        self._air = spec.around.air(spec.antenna, spec.sources, len(spec.robots), spec.size_m, spec.seed)
        self._wander = Wander(spec.around.wander_m, spec.seed) if spec.around.wander_m else None
        self._sent = [0] * len(spec.sources)
        self._robots: dict[str, _Robot] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="fieldkit-")
        for robot, seed in zip(spec.robots, seeds[2:], strict=True):
            self._robots[robot.name] = self._make(robot, np.random.default_rng(seed))

    def _make(self, robot: EmulatedRobot, rng: np.random.Generator) -> _Robot:
        spec = self._spec
        firmware = FIRMWARES[robot.firmware]
        place = (robot.east_m, robot.north_m, robot.heading_deg)
        body: Car | Copter = car_for(*place, spec.max_speed_m_s)
        if firmware is COPTER:
            body = Copter(*place, max_speed_m_s=spec.max_speed_m_s)
        failsafe_s = max(6.5, spec.clock.rate) if spec.gcs_failsafe_s is None else spec.gcs_failsafe_s
        autopilot = make_autopilot(
            firmware,
            robot.system_id,
            body,
            spec.frame,
            rng,
            pose_noise_m=spec.pose_noise_m,
            gcs_failsafe_s=failsafe_s,
        )
        autopilot.wander = self._wander
        wire = make_wire(Path(self._folder.name) / f"radio-{robot.name}")
        return _Robot(autopilot, PluggedModule(self._radio(robot), wire))

    def _radio(self, robot: EmulatedRobot) -> Module | NrfDongle:
        spec = self._spec
        if spec.dongles:
            return NrfDongle(lambda: spec.clock.now_ns() // 1_000, serial_number=robot.system_id)
        known = PROFILES[spec.xbee_profile]
        saturation = (
            known.saturation_dbm if spec.antenna.saturation_dbm is None else spec.antenna.saturation_dbm
        )
        # Hearing is the channel's business (the antenna's threshold), not a second threshold's.
        profile = replace(known, saturation_dbm=saturation, sensitivity_dbm=-254.0)
        return Module(profile, ROBOT_ADDRESS + robot.system_id)

    async def run(self, connection: Connection) -> None:
        loop = asyncio.get_running_loop()
        ended = asyncio.Event()
        try:
            await self._open()
            connection.send({name: robot.radio.wire.port for name, robot in self._robots.items()})
            threading.Thread(target=self._listen, args=(connection, loop, ended), daemon=True).start()
            living = asyncio.create_task(self._live())
            waiting = asyncio.create_task(ended.wait())
            await asyncio.wait({living, waiting}, return_when=asyncio.FIRST_COMPLETED)
            living.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await living
        finally:
            for robot in self._robots.values():
                if robot.plugged:
                    robot.radio.unplug()
            self._folder.cleanup()

    async def _open(self) -> None:
        loop = asyncio.get_running_loop()
        for spec, robot in zip(self._spec.robots, self._robots.values(), strict=True):
            address = host_and_port(spec.address or self._spec.vehicle_address)
            await robot.radio.plug()
            await loop.create_datagram_endpoint(
                lambda robot=robot: _Telemetry(robot, self._spec.clock),  # type: ignore[misc]
                remote_addr=address,
            )

    def _listen(self, connection: Connection, loop: asyncio.AbstractEventLoop, ended: asyncio.Event) -> None:
        """Answer the parent; when it goes away, whatever the reason, the field ends."""
        try:
            while True:
                question = connection.recv()
                future = asyncio.run_coroutine_threadsafe(self._answer(*question), loop)
                try:
                    connection.send(future.result())
                except (ValueError, KeyError, TypeError, OSError) as error:
                    connection.send(ValueError(f"{question}: {error!r}"))
        except (EOFError, OSError):
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(ended.set)

    async def _answer(self, what: str, *rest: Any) -> Any:
        if what == "fault":
            fault, name, value = rest
            handler = getattr(_Faults(), fault, None) if not fault.startswith("_") else None
            if handler is None and fault != "reboot":
                raise ValueError("no such fault")
            if fault == "reboot":
                self._robots[name].autopilot.reboot(_world_s(self._spec.clock))
            elif handler is not None:
                await handler(self._robots[name], value)
            return None
        if what == "truth":
            bodies = {name: robot.autopilot.body for name, robot in self._robots.items()}
            return {name: (body.east_m, body.north_m, body.heading_deg) for name, body in bodies.items()}
        if what == "altitude":
            return {name: robot.autopilot.body.up_m for name, robot in self._robots.items()}
        return {
            "transmissions": list(self._sent),
            "robots": {
                name: {
                    "frames": robot.heard,
                    "frames_lost": robot.radio.lost_writes,
                    "bytes_from_host": getattr(robot.radio.module, "bytes_in", 0),
                    "transmitted": getattr(robot.radio.module, "transmitted", 0),
                    "mode": robot.autopilot.mode,
                    "armed": robot.autopilot.armed,
                }
                for name, robot in self._robots.items()
            },
        }

    async def _live(self) -> None:
        clock = self._spec.clock
        step_s = max(STEP_S, STEP_WALL_S * clock.rate)
        self._schedule.until(_world_s(clock))  # sent before anybody was there to hear
        t_s = next_s = _world_s(clock)
        while True:
            before_s, t_s = t_s, _world_s(clock)
            for index, rss_dbm in self._air.foreign(t_s - before_s, len(self._robots), self._channel_rng):
                self._hear(index, rss_dbm, FOREIGN_ADDRESS, 0)
            for robot in self._robots.values():
                robot.send(robot.autopilot.update(t_s))
            for _, source in self._schedule.until(t_s):
                self._transmit(source)
            next_s = max(next_s + step_s, t_s)
            await clock.sleep(next_s - _world_s(clock))

    def _transmit(self, source: TransientSource) -> None:
        """One packet: every robot draws its own noise; those that hear it have it on their wire at once."""
        index = self._spec.sources.index(source)
        number, self._sent[index] = self._sent[index], self._sent[index] + 1
        bodies = [robot.autopilot.body for robot in self._robots.values()]
        places_m = np.array([(body.east_m, body.north_m) for body in bodies])
        up_m, heading_deg = np.array([(body.up_m, body.heading_deg) for body in bodies]).T
        rss_dbm = self._air.heard_dbm(
            index, _world_s(self._spec.clock), places_m, up_m, heading_deg, self._channel_rng
        )
        for robot, strength in enumerate(rss_dbm.tolist()):
            self._hear(robot, strength, SOURCE_ADDRESS + index, number)

    def _hear(self, index: int, rss_dbm: float, sender: int, number: int) -> None:
        robot = list(self._robots.values())[index]
        if robot.plugged and np.isfinite(rss_dbm):
            robot.heard += robot.radio.hear(rss_dbm, sender, number.to_bytes(4, "big"))
