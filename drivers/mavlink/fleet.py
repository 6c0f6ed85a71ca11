"""The vehicles on one MAVLink link as a `VehicleLink`: heartbeat, take-over, steering, hold, return."""

import asyncio
import contextlib
import logging
import math
import zlib
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.handover import Handover
from drivers.mavlink.codec import AUTOPILOT, GROUND_STATION, Message, Packer, Parser, mavlink
from drivers.mavlink.commands import Commander, wait_for
from drivers.mavlink.modes import COPTER, set_mode
from drivers.mavlink.plans import FENCE, KINDS, Inbox, PlanItem, PlanTalk, polygon_fence
from drivers.mavlink.signing import Signer, read_key
from drivers.mavlink.transport import Peer, make_transport
from drivers.mavlink.vehicle import Vehicle
from drivers.options import checked
from fieldkit.clock import Clock
from fieldkit.errors import ConfigError, DeviceTimeout, VehicleRefused
from fieldkit.messages import Pose, VehicleMode, VehicleState, Waypoint
from fieldkit.ports import Surroundings

logger = logging.getLogger(__name__)

SYSTEM_ID = 245
"""Our own system id. Not 255: that is QGroundControl's, and a second 255 masks the vehicles' failsafe."""
MAX_PEERS = 64
"""Addresses remembered per link; forged ones must not fill the memory."""
RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 1.0,
}
HOUSEKEEPING_S = 0.5
CONFIRM_S = 5.0
"""How long a heartbeat may take to show what was commanded."""
POSITION_STALE_S = 2.0
TARGET_TOLERANCE = 10
"""Degrees times 1e7: the vehicle echoes its target exactly; a centimetre of slack."""


@dataclass(frozen=True, slots=True)
class RobotOptions:
    """What a mission file says of a vehicle."""

    system_id: int
    sigma_m: float = 0.0
    """Standard deviation of its positions; 0: take the GPS's own word."""
    own_system_id: int = SYSTEM_ID
    """Our system id on this link; the vehicles must accept it (MAV_GCS_SYSID)."""
    signing_key: str = ""
    """Path of the link's signing key; empty: nothing is signed."""


def open_link(address: str, robots: Mapping[str, Mapping[str, Any]], around: Surroundings) -> "MavlinkLink":
    """A link, not opened yet. Raises `ConfigError` for options that cannot be."""
    return MavlinkLink(address, robots, around)


@dataclass
class _Steering:
    """What we are doing with one vehicle."""

    vehicle: Vehicle
    lock: asyncio.Lock
    orders: int = 0
    """Counts commands that change what it should do: an older one gives up."""
    target: tuple[int, int] | None = None
    target_s: float = -math.inf
    speed_m_s: float | None = None
    resent: int = 0
    rates_asked_s: float = -math.inf
    waypoint: Waypoint | None = None
    inboxes: list[Inbox] = field(default_factory=list)


class MavlinkLink:
    """Entering opens the link; vehicles appear in `events` as they are heard."""

    def __init__(self, address: str, robots: Mapping[str, Mapping[str, Any]], around: Surroundings) -> None:
        self.robots = tuple(robots)
        self._address = address
        self._clock = around.clock
        self._frame = around.frame
        options = {
            name: checked(RobotOptions, given, f"vehicle of {name} (mavlink)")
            for name, given in robots.items()
        }
        shared = {(option.own_system_id, option.signing_key) for option in options.values()} or {
            (SYSTEM_ID, "")
        }
        if len(shared) > 1:
            raise ConfigError(
                f"vehicle link {address}: robots on one link disagree on 'own_system_id' or 'signing_key'"
            )
        ((self._own_id, key_path),) = shared
        self._signer = _signer(key_path, address, self._clock) if key_path else None
        self._steered: dict[int, _Steering] = {}
        for name, option in options.items():
            self._add(name, option)
        self._packer = Packer(self._own_id, GROUND_STATION, self._signer)
        self._parsers: dict[Peer, Parser] = {}
        self._commander = Commander(self._clock, self._own_id, self._send)
        self._transport = make_transport(address)
        self._is_open = False

    def _add(self, name: str, option: RobotOptions) -> None:
        if not 1 <= option.system_id <= 254 or option.system_id == self._own_id:
            raise ConfigError(
                f"vehicle of {name} (mavlink): option 'system_id': expected 1 to 254 and not our own "
                f"{self._own_id}, got {option.system_id}"
            )
        if (other := self._steered.get(option.system_id)) is not None:
            raise ConfigError(
                f"vehicles of {other.vehicle.robot} and {name} have the same system_id {option.system_id}; "
                "give each its own (MAV_SYSID or SYSID_THISMAV on the vehicle)"
            )
        vehicle = Vehicle(name, option.system_id, self._frame, option.sigma_m)
        self._steered[option.system_id] = _Steering(vehicle, asyncio.Lock())

    async def __aenter__(self) -> Self:
        self._heartbeat_waiters: list[asyncio.Future[int]] = []
        self._out: Handover[Pose | VehicleState] = Handover(limit=20_000)
        await self._transport.open(self._on_data)
        self._is_open = True
        self._housekeeper = asyncio.create_task(self._keep_house(), name=f"mavlink-{self._address}")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._is_open:
            return
        self._is_open = False
        self._housekeeper.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._housekeeper
        await self._transport.close()
        if self._signer is not None:
            self._signer.close()
        self._out.close()

    async def events(self) -> AsyncIterator[Pose | VehicleState]:
        """Poses, and states on change and about once a second. For one consumer."""
        async for item in self._out.items():
            yield item

    # What comes in

    def _on_data(self, data: bytes, peer: Peer) -> None:
        parser = self._parsers.get(peer)
        if parser is None:
            if len(self._parsers) >= MAX_PEERS:
                self._parsers.clear()
            parser = self._parsers[peer] = Parser(self._signer)
        now_s, now_ns = self._clock.elapsed_s(), self._clock.now_ns()
        for message in parser.parse(data):
            steering = self._steered.get(message.get_srcSystem())
            if steering is None or message.get_srcComponent() != AUTOPILOT:
                continue
            if message.get_type() == "COMMAND_ACK":
                self._commander.heard(message, message.get_srcSystem())
                continue
            for inbox in steering.inboxes:
                if message.get_type() in inbox.kinds:
                    inbox.put(message)
            self._put(steering.vehicle.heard(message, peer, now_s, now_ns))
            if message.get_type() == "HEARTBEAT":
                waiters, self._heartbeat_waiters = self._heartbeat_waiters, []
                for waiter in waiters:
                    if not waiter.done():
                        waiter.set_result(0)

    def _put(self, happenings: list[Pose | VehicleState]) -> None:
        for item in happenings:
            self._out.put(item, always=isinstance(item, VehicleState))

    # What goes out

    def _send(self, vehicle: Vehicle, message: Message) -> None:
        """To the vehicle's own address, and to any impostor's when it matters: a hold must reach both."""
        peer = vehicle.peer if vehicle.peer is not None else self._transport.default_peer
        data = self._packer.pack(message)
        for address in {peer, *vehicle.doubles} - {None}:
            self._transport.send(data, address)

    def beat(self) -> None:
        """Send our heartbeat to every vehicle heard on this link."""
        if not self._is_open:
            return
        message = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )
        data = self._packer.pack(message)
        peers = {steering.vehicle.peer for steering in self._steered.values()} | {
            self._transport.default_peer
        }
        for peer in peers - {None}:
            self._transport.send(data, peer)

    async def _keep_house(self) -> None:
        last_s = self._clock.elapsed_s()
        while True:
            await self._clock.sleep(HOUSEKEEPING_S)
            now_s, now_ns = self._clock.elapsed_s(), self._clock.now_ns()
            stalled, last_s = now_s - last_s > 1.0 + HOUSEKEEPING_S, now_s
            for steering in self._steered.values():
                if not stalled:  # after a stall of our own, silence is not the vehicles' fault
                    self._put(steering.vehicle.passed(now_s, now_ns))
                self._ask_rates(steering, now_s)
                self._watch_target(steering, now_s)

    def _ask_rates(self, steering: _Steering, now_s: float) -> None:
        """Ask for positions where none come: after first contact, and after a reboot."""
        vehicle = steering.vehicle
        stale = now_s - vehicle.position_s > POSITION_STALE_S
        if vehicle.link_up and not vehicle.doubles and stale and now_s - steering.rates_asked_s > 3.0:
            steering.rates_asked_s = now_s
            for number, rate_hz in RATES_HZ.items():
                self._send(vehicle, _interval(vehicle, number, rate_hz, 0))

    def _watch_target(self, steering: _Steering, now_s: float) -> None:
        """Send a way-point again if the vehicle says it is going elsewhere."""
        vehicle, target = steering.vehicle, steering.target
        if (
            target is None
            or vehicle.owner != "us"
            or vehicle.actual_mode != "guided"
            or steering.lock.locked()
        ):
            return
        said = vehicle.position_target
        if said is None or vehicle.position_target_s < steering.target_s + 1.5:
            return
        if max(abs(said[0] - target[0]), abs(said[1] - target[1])) <= TARGET_TOLERANCE:
            return
        if steering.resent < 3 and steering.waypoint is not None:
            steering.resent += 1
            steering.target_s = now_s
            logger.warning(
                "%s: goes to %s, not to %s: sending the way-point again", vehicle.robot, said, target
            )
            self._send(vehicle, _reposition(vehicle, *target, steering.waypoint))

    # Commands

    async def take_over(self, robot: str) -> None:
        """Set message rates, GUIDED, armed; each confirmed by the vehicle's own heartbeat."""
        steering = self._of(robot)
        vehicle = steering.vehicle
        async with steering.lock:
            if not await self._until(lambda: vehicle.link_up, 10.0):
                raise DeviceTimeout(
                    f"{robot}: no heartbeat from system {vehicle.system_id} on {self._address}; is it "
                    "switched on, is its system id right, does it send to this address?"
                )
            self._refuse_double(vehicle)
            self.beat()  # its failsafe watches for our heartbeat only from the first one on
            if vehicle.firmware is None:
                raise VehicleRefused(f"{robot}: neither ArduRover, ArduCopter nor PX4: cannot steer it")
            for number, rate_hz in RATES_HZ.items():
                with contextlib.suppress(VehicleRefused):  # one rate it does not know is no reason to stop
                    await self._commander.ask(
                        vehicle,
                        f"set the rate of message {number}",
                        lambda n, number=number, rate_hz=rate_hz: _interval(vehicle, number, rate_hz, n),  # type: ignore[misc]
                    )
            vehicle.owner, vehicle.commanded = "us", None
            try:
                await self._mode(steering, "guided")
                await self._arm(vehicle)
            except BaseException:
                vehicle.owner = "nobody"
                raise
            steering.speed_m_s = None

    async def _arm(self, vehicle: Vehicle) -> None:
        if vehicle.armed:
            return
        arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        await self._commander.ask(
            vehicle,
            "arm",
            lambda n: mavlink.MAVLink_command_long_message(vehicle.system_id, 1, arm, n, 1, 0, 0, 0, 0, 0, 0),
        )
        if not await self._until(lambda: vehicle.armed, CONFIRM_S):
            raise DeviceTimeout(
                f"{vehicle.robot}: accepted the command to arm but its heartbeat does not show it"
            )

    async def goto(self, robot: str, waypoint: Waypoint) -> None:
        """DO_REPOSITION in a global frame, acknowledged; watched and sent again while under way."""
        steering = self._of(robot)
        vehicle = steering.vehicle
        lat, lon = self._degrees_e7(robot, waypoint)
        steering.orders += 1
        mine = steering.orders
        async with steering.lock:
            self._must_be_ours(vehicle)
            before = vehicle.commanded
            entering = vehicle.actual_mode != "guided"
            vehicle.command("guided")
            try:
                await self._commander.ask(
                    vehicle,
                    "go to a way-point",
                    lambda _: _reposition(vehicle, lat, lon, waypoint),
                    still=lambda: steering.orders == mine and vehicle.owner == "us",
                )
            except VehicleRefused:
                if steering.orders == mine and before is not None:
                    vehicle.command(before)
                raise
            steering.target, steering.target_s, steering.resent = (lat, lon), self._clock.elapsed_s(), 0
            steering.waypoint = waypoint
            if entering or steering.speed_m_s != waypoint.speed_m_s:
                await self._set_speed(steering, waypoint.speed_m_s)

    async def _set_speed(self, steering: _Steering, speed_m_s: float) -> None:
        """Firmwares that take the speed from the reposition itself may refuse this: harmless."""
        vehicle, command = steering.vehicle, mavlink.MAV_CMD_DO_CHANGE_SPEED
        with contextlib.suppress(VehicleRefused):
            await self._commander.ask(
                vehicle,
                "set the speed",
                lambda n: mavlink.MAVLink_command_long_message(
                    vehicle.system_id, 1, command, n, 1, speed_m_s, -1, 0, 0, 0, 0
                ),
            )
        steering.speed_m_s = speed_m_s

    async def hold(self, robot: str) -> None:
        """Asked again and again until the heartbeat shows it; needs no ownership."""
        steering = self._of(robot)
        vehicle = steering.vehicle
        steering.orders += 1
        steering.target = None
        await self._mode(steering, "hold")
        steering.speed_m_s = None
        logger.info("%s: holds", vehicle.robot)

    async def return_home(self, robot: str) -> None:
        """The firmware's own return mode, shown by the heartbeat."""
        steering = self._of(robot)
        steering.orders += 1
        steering.target = None
        await self._mode(steering, "return")
        steering.speed_m_s = None

    async def _mode(self, steering: _Steering, mode: VehicleMode) -> None:
        """Ask for a mode until a heartbeat that came after shows it."""
        vehicle = steering.vehicle
        vehicle.command(mode)
        deadline_s = self._clock.elapsed_s() + CONFIRM_S
        mine = steering.orders
        while self._clock.elapsed_s() < deadline_s:
            firmware = vehicle.firmware
            seen = vehicle.heartbeats
            if firmware is not None:
                with contextlib.suppress(DeviceTimeout):
                    await self._commander.ask(
                        vehicle,
                        f"change mode to {mode}",
                        lambda n, firmware=firmware: set_mode(vehicle.system_id, firmware, mode, n),  # type: ignore[misc]
                        tries=1,
                        wait_s=0.5,
                    )
            if await self._until(
                lambda seen=seen: vehicle.heartbeats > seen and vehicle.actual_mode == mode,  # type: ignore[misc]
                1.5,
            ):
                return
            if steering.orders != mine:
                raise VehicleRefused(
                    f"{vehicle.robot}: change mode to {mode}: given up, a newer command came"
                )
        raise DeviceTimeout(
            f"{vehicle.robot} (system {vehicle.system_id}): did not show mode {mode} within {CONFIRM_S:g} s"
            + ("" if vehicle.link_up else "; its link is lost")
        )

    # Before a mission

    async def upload_fence(self, robot: str, corners_m: Sequence[tuple[float, float]]) -> None:
        """Put a polygon (east, north) into the vehicle as the fence it must stay in, and read it back.

        Whether the vehicle acts on it is for its parameters: see `parameters`.
        """
        corners = [self._frame.to_geodetic(east_m, north_m) for east_m, north_m in corners_m]
        await self.upload(
            robot, FENCE, polygon_fence([(round(a * 1e7), round(o * 1e7)) for a, o, _ in corners])
        )

    async def upload(self, robot: str, kind: int, items: Sequence[PlanItem]) -> None:
        """Put a mission, fence or rally points (`plans.MISSION`, `FENCE`, `RALLY`) into the vehicle."""
        with self._talk(robot, kind) as talk:
            await talk.upload(items)

    async def download(self, robot: str, kind: int) -> list[PlanItem]:
        """What the vehicle holds."""
        with self._talk(robot, kind) as talk:
            return await talk.download()

    async def parameters(self, robot: str, names: Sequence[str]) -> dict[str, float | None]:
        """Parameters as the vehicle has them; None where it does not answer: unknown, or a poor link."""
        steering = self._of(robot)
        vehicle = steering.vehicle
        found: dict[str, float | None] = {}
        with self._inbox(steering, ("PARAM_VALUE",)) as inbox:
            for name in names:
                found[name] = None
                ask = mavlink.MAVLink_param_request_read_message(
                    vehicle.system_id, AUTOPILOT, name.encode(), -1
                )
                for _ in range(3):
                    self._send(vehicle, ask)
                    message = await inbox.next(1.0)
                    if message is not None and message.param_id == name:
                        found[name] = message.param_value
                        break
        return found

    @contextlib.contextmanager
    def _talk(self, robot: str, kind: int) -> Iterator[PlanTalk]:
        steering = self._of(robot)
        vehicle = steering.vehicle
        if not vehicle.link_up:
            raise DeviceTimeout(f"{robot}: its link is lost")
        self._refuse_double(vehicle)
        with self._inbox(steering, KINDS) as inbox:
            yield PlanTalk(
                robot,
                vehicle.system_id,
                kind,
                lambda message: self._send(vehicle, message),
                inbox,
                self._clock,
                self._own_id,
            )

    @contextlib.contextmanager
    def _inbox(self, steering: _Steering, kinds: Sequence[str]) -> Iterator[Inbox]:
        inbox = Inbox(self._clock, kinds)
        steering.inboxes.append(inbox)
        try:
            yield inbox
        finally:
            steering.inboxes.remove(inbox)

    # Guards

    def _of(self, robot: str) -> _Steering:
        for steering in self._steered.values():
            if steering.vehicle.robot == robot:
                return steering
        raise ConfigError(f"no robot {robot!r} on {self._address}; there are: {', '.join(self.robots)}")

    def _refuse_double(self, vehicle: Vehicle) -> None:
        if vehicle.doubles:
            raise VehicleRefused(
                f"{vehicle.robot}: two vehicles have system id {vehicle.system_id}; give each its own "
                "(MAV_SYSID or SYSID_THISMAV) and start again"
            )

    def _must_be_ours(self, vehicle: Vehicle) -> None:
        self._refuse_double(vehicle)
        if not vehicle.link_up:
            raise DeviceTimeout(f"{vehicle.robot}: its link is lost")
        if vehicle.owner != "us":
            why = (
                vehicle.texts[-1][1] if vehicle.owner == "lost" and vehicle.texts else "it was not taken over"
            )
            raise VehicleRefused(f"{vehicle.robot}: not ours to steer: {why}")
        if not vehicle.armed:
            raise VehicleRefused(f"{vehicle.robot}: is disarmed")

    def _degrees_e7(self, robot: str, waypoint: Waypoint) -> tuple[int, int]:
        numbers = (waypoint.east_m, waypoint.north_m, waypoint.up_m, waypoint.speed_m_s)
        if not all(math.isfinite(number) for number in numbers) or waypoint.speed_m_s <= 0:
            raise VehicleRefused(f"{robot}: {waypoint} is no place to go")
        lat_deg, lon_deg, _ = self._frame.to_geodetic(waypoint.east_m, waypoint.north_m, waypoint.up_m)
        lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
        # ArduRover takes 0, 0 from a position target and sets off for the Gulf of Guinea.
        if (lat, lon) == (0, 0) or abs(lat) > 900_000_000:
            raise VehicleRefused(
                f"{robot}: {waypoint} is at latitude {lat_deg}, longitude {lon_deg}: refused"
            )
        return lat, lon

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for heartbeats until one makes `condition` true; False if none did in time."""
        deadline_s = self._clock.elapsed_s() + timeout_s
        while not condition():
            left_s = deadline_s - self._clock.elapsed_s()
            if left_s <= 0:
                return False
            waiter: asyncio.Future[int] = asyncio.get_running_loop().create_future()
            self._heartbeat_waiters.append(waiter)
            await wait_for(waiter, self._clock, left_s)
        return True


def _signer(key_path: str, address: str, clock: Clock) -> Signer:
    """The link's signer. Its time is kept beside the key, and its link id comes from the address."""
    path = Path(key_path).expanduser()
    link_id = zlib.crc32(address.encode()) & 0xFF
    return Signer(read_key(path), clock.now_ns, link_id=link_id, store=path.with_suffix(".time"))


def _interval(vehicle: Vehicle, number: int, rate_hz: float, attempt: int) -> Message:
    command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    return mavlink.MAVLink_command_long_message(
        vehicle.system_id, 1, command, attempt, number, 1e6 / rate_hz, 0, 0, 0, 0, 0
    )


def _reposition(vehicle: Vehicle, lat: int, lon: int, waypoint: Waypoint) -> Message:
    """Integers, never COMMAND_LONG: a float32 longitude is off by metres. Altitude is above home."""
    return mavlink.MAVLink_command_int_message(
        vehicle.system_id,
        1,
        mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        mavlink.MAV_CMD_DO_REPOSITION,
        0,
        0,
        waypoint.speed_m_s,
        mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE,
        0,
        math.nan,
        lat,
        lon,
        waypoint.up_m if vehicle.firmware is COPTER else 0.0,
    )
