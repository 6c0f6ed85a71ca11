"""The vehicles on one MAVLink link as a `VehicleLink`: heartbeat, take-over, steered, hold, return."""

import asyncio
import contextlib
import logging
import math
import zlib
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.handover import Handover
from drivers.mavlink import inspect, parameters, timesync
from drivers.mavlink.codec import AUTOPILOT, GROUND_STATION, Message, Packer, Parser, mavlink
from drivers.mavlink.commands import Commander
from drivers.mavlink.modes import PX4, set_mode
from drivers.mavlink.orders import Orders
from drivers.mavlink.plans import FENCE, KINDS, Inbox, PlanItem, PlanTalk, polygon_fence
from drivers.mavlink.signing import Signer, read_key
from drivers.mavlink.steered import RATES_HZ, Steered, interval, refuse_double, reposition
from drivers.mavlink.tapped import TappedTransport
from drivers.mavlink.transport import Peer, make_transport
from drivers.mavlink.vehicle import Vehicle
from drivers.options import checked
from fieldkit.checks import Check
from fieldkit.clock import Clock
from fieldkit.errors import ConfigError, DeviceError, DeviceTimeout, VehicleRefused
from fieldkit.messages import Pose, VehicleState, Waypoint
from fieldkit.ports import Surroundings

logger = logging.getLogger(__name__)

SYSTEM_ID = 245
"""Our own system id. Not 255: that is QGroundControl's, and a second 255 masks the vehicles' failsafe."""
MAX_PEERS = 64
"""Addresses remembered per link; forged ones must not fill the memory."""
HOUSEKEEPING_S = 0.5
POSITION_STALE_S = 2.0
RIVAL_S = 10.0
UNSIGNED_TRIES = 3
REFUSED_MANY = 20
"""Frames refused before the operator is told: some seconds of one vehicle."""
SETTLE_S = 2.5
"""How long a vehicle has to say everything that was asked for once."""


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
        self._steered: dict[int, Steered] = {}
        for name, option in options.items():
            self._add(name, option)
        self._packer = Packer(self._own_id, GROUND_STATION, self._signer)
        self._parsers: dict[Peer, Parser] = {}
        self._commander = Commander(self._clock, self._own_id, self._send)
        self._orders = Orders(self._commander, self._clock, self._frame, self.beat, address)
        transport = make_transport(address)
        self._transport = transport if around.tap is None else TappedTransport(transport, address, around.tap)
        self._is_open = False
        self._rival_s = -math.inf
        """When another ground station with our system id was last heard."""

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
        self._steered[option.system_id] = Steered(vehicle, asyncio.Lock())

    async def __aenter__(self) -> Self:
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
            steered = self._steered.get(message.get_srcSystem())
            if message.get_srcSystem() == self._own_id and message.get_type() == "HEARTBEAT":
                self._rival_s = now_s  # routers and autopilots forward: ours would not come back to us
            if steered is None or message.get_srcComponent() != AUTOPILOT:
                continue
            steered.vehicle.count(peer, message.get_seq())
            if message.get_type() == "COMMAND_ACK":
                self._commander.heard(message, message.get_srcSystem())
                continue
            for inbox in steered.inboxes:
                if message.get_type() in inbox.kinds:
                    inbox.put(message)
            self._put(steered.vehicle.heard(message, peer, now_s, now_ns))
            if message.get_type() == "HEARTBEAT":
                self._orders.heartbeat()

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
        peers = {steered.vehicle.peer for steered in self._steered.values()} | {self._transport.default_peer}
        for peer in peers - {None}:
            self._transport.send(data, peer)

    async def _keep_house(self) -> None:
        last_s = self._clock.elapsed_s()
        warned = False
        while True:
            await self._clock.sleep(HOUSEKEEPING_S)
            if not warned and self._hears_only_what_it_refuses():
                warned = True
                logger.warning(
                    "%s: %d frames have come that are not signed with this link's key, and none that are: is it the "
                    "vehicles' key, have they signing set up on this port, is their clock right?",
                    self._address,
                    self._signer.refused if self._signer is not None else 0,
                )
            now_s, now_ns = self._clock.elapsed_s(), self._clock.now_ns()
            stalled, last_s = now_s - last_s > 1.0 + HOUSEKEEPING_S, now_s
            for steered in self._steered.values():
                if not stalled:  # after a stall of our own, silence is not the vehicles' fault
                    self._put(steered.vehicle.passed(now_s, now_ns))
                self._ask_rates(steered, now_s)
                self._watch_target(steered, now_s)
                self._hold_on(steered)

    def _hears_only_what_it_refuses(self) -> bool:
        """A wrong key looks like a link on which nobody speaks."""
        silent = all(steered.vehicle.heartbeats == 0 for steered in self._steered.values())
        return self._signer is not None and silent and self._signer.refused >= REFUSED_MANY

    def _ask_rates(self, steered: Steered, now_s: float) -> None:
        """Ask for positions where none come: after first contact, and after a reboot."""
        vehicle = steered.vehicle
        stale = now_s - vehicle.position_s > POSITION_STALE_S
        if vehicle.link_up and not vehicle.doubles and stale and now_s - steered.rates_asked_s > 3.0:
            steered.rates_asked_s = now_s
            self._ask_all_rates(vehicle)

    def _ask_all_rates(self, vehicle: Vehicle) -> None:
        for number, rate_hz in RATES_HZ.items():
            self._send(vehicle, interval(vehicle, number, rate_hz, 0))

    def _hold_on(self, steered: Steered) -> None:
        """A hold that was lost on the way is sent again, also long after whoever asked for it has given up."""
        vehicle = steered.vehicle
        if vehicle.firmware is not None and not steered.lock.locked() and steered.drives_on():
            self._send(vehicle, set_mode(vehicle.system_id, vehicle.firmware, "hold", 0))

    def _watch_target(self, steered: Steered, now_s: float) -> None:
        """Send a way-point again if the vehicle says it is going elsewhere."""
        if steered.goes_elsewhere(now_s) and steered.target is not None and steered.waypoint is not None:
            steered.resent += 1
            steered.target_s = now_s
            logger.warning("%s: goes elsewhere: sending the way-point again", steered.vehicle.robot)
            self._send(steered.vehicle, reposition(steered.vehicle, *steered.target, steered.waypoint))

    # Commands

    async def take_over(self, robot: str, *, arm: bool = True) -> None:
        """Set message rates, GUIDED, armed; each confirmed by the vehicle's own heartbeat."""
        self._refuse_rival(robot)
        await self._orders.take_over(self._of(robot), arm=arm)

    def release(self, robot: str) -> None:
        """Send it nothing more; whoever takes it has it."""
        steered = self._of(robot)
        steered.stop()
        steered.vehicle.owner = "lost"

    async def goto(self, robot: str, waypoint: Waypoint) -> None:
        """DO_REPOSITION in a global frame, acknowledged; watched and sent again while under way."""
        await self._orders.goto(self._of(robot), waypoint)

    async def hold(self, robot: str) -> None:
        """Asked again and again until the heartbeat shows it; needs no ownership."""
        await self._orders.hold(self._of(robot))

    async def return_home(self, robot: str) -> None:
        """The firmware's own return mode, shown by the heartbeat."""
        await self._orders.return_home(self._of(robot))

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
        steered = self._of(robot)
        vehicle = steered.vehicle
        with self._inbox(steered, ("PARAM_VALUE",)) as inbox:
            return await parameters.read(
                lambda message: self._send(vehicle, message),
                inbox,
                self._clock,
                vehicle.system_id,
                vehicle.firmware,
                names,
            )

    async def set_parameter(self, robot: str, name: str, value: float) -> bool:
        """Set a parameter; whether the vehicle says that it has it."""
        steered = self._of(robot)
        vehicle = steered.vehicle
        with self._inbox(steered, ("PARAM_VALUE",)) as inbox:
            return await parameters.write(
                lambda message: self._send(vehicle, message),
                inbox,
                self._clock,
                vehicle.system_id,
                name,
                value,
            )

    async def synchronise(self, robot: str) -> timesync.ClockOffset | None:
        """The vehicle's clock against ours, with its bound; None if it does not answer."""
        steered = self._of(robot)
        with self._inbox(steered, ("TIMESYNC",)) as inbox:
            return await timesync.exchange(
                lambda message: self._send(steered.vehicle, message), inbox, self._clock, self._own_id
            )

    async def _unsigned(self, steered: Steered) -> timesync.ClockOffset | None:
        """Its answer to unsigned frames on a signed link: there should be none. A refusal is silence."""
        packer, peer = Packer(self._own_id, GROUND_STATION), steered.vehicle.peer
        with self._inbox(steered, ("TIMESYNC",)) as inbox:
            return await timesync.exchange(
                lambda message: self._transport.send(packer.pack(message), peer),
                inbox,
                self._clock,
                self._own_id,
                UNSIGNED_TRIES,
            )

    async def inspect(self, robot: str, fence_m: Sequence[tuple[float, float]] = ()) -> list[Check]:
        """Whether the vehicle is fit for a mission. With `fence_m` (east, north) that fence is uploaded first.

        Nothing is armed and nothing moves. The only parameter written is FENCE_ENABLE, and only with a fence.
        """
        steered = self._of(robot)
        vehicle = steered.vehicle
        self.beat()
        await self._orders.until_heard(vehicle)
        checks = inspect.condition(vehicle, self._clock.elapsed_s())
        if not vehicle.link_up or vehicle.doubles or vehicle.firmware is None:
            return checks
        self._ask_all_rates(vehicle)
        values = await self.parameters(robot, inspect.NAMES[vehicle.firmware])
        await self._clock.sleep(SETTLE_S)
        checks = inspect.condition(vehicle, self._clock.elapsed_s())
        if vehicle.doubles:
            return checks
        if words := self._rival():
            checks.append(Check(robot, "identity", "red", words, "end the other mission"))
        checks += inspect.failsafes(robot, vehicle.firmware, values, self._own_id)
        if fence_m:
            checks.append(await self._put_fence(robot, fence_m))
        offset = await self.synchronise(robot)
        checks.append(inspect.clock(robot, offset))
        checks += inspect.time_of_day(vehicle, self._signer is not None)
        if self._signer is not None:
            checks.append(inspect.signing(robot, offset, await self._unsigned(steered)))
        return checks

    async def _put_fence(self, robot: str, fence_m: Sequence[tuple[float, float]]) -> Check:
        try:
            await self.upload_fence(robot, fence_m)
        except DeviceError as error:
            return Check(robot, "fence", "red", str(error), "try again; is another ground station uploading?")
        if self._of(robot).vehicle.firmware is PX4:
            return Check(robot, "fence", "green", f"{len(fence_m)} corners, read back")
        if not await self.set_parameter(robot, "FENCE_ENABLE", 1.0):
            return Check(
                robot, "fence", "amber", "uploaded, but FENCE_ENABLE stays off", "set FENCE_ENABLE 1"
            )
        return Check(robot, "fence", "green", f"{len(fence_m)} corners, read back and enabled")

    @contextlib.contextmanager
    def _talk(self, robot: str, kind: int) -> Iterator[PlanTalk]:
        steered = self._of(robot)
        vehicle = steered.vehicle
        if not vehicle.link_up:
            raise DeviceTimeout(f"{robot}: its link is lost")
        refuse_double(vehicle)
        with self._inbox(steered, KINDS) as inbox:
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
    def _inbox(self, steered: Steered, kinds: Sequence[str]) -> Iterator[Inbox]:
        inbox = Inbox(self._clock, kinds)
        steered.inboxes.append(inbox)
        try:
            yield inbox
        finally:
            steered.inboxes.remove(inbox)

    # Guards

    def _rival(self) -> str:
        """Words on another station that steers with our id; empty where there is none."""
        if self._clock.elapsed_s() - self._rival_s > RIVAL_S:
            return ""
        return f"another ground station has our system id {self._own_id}: is a second mission running?"

    def _refuse_rival(self, robot: str) -> None:
        if words := self._rival():
            raise VehicleRefused(
                f"{robot}: {words} End it, or give this one an own_system_id of its own in the mission file"
            )

    def _of(self, robot: str) -> Steered:
        for steered in self._steered.values():
            if steered.vehicle.robot == robot:
                return steered
        raise ConfigError(f"no robot {robot!r} on {self._address}; there are: {', '.join(self.robots)}")


def _signer(key_path: str, address: str, clock: Clock) -> Signer:
    """The link's signer. Its time is kept beside the key, and its link id comes from the address."""
    path = Path(key_path).expanduser()
    link_id = zlib.crc32(address.encode()) & 0xFF
    return Signer(read_key(path), clock.now_ns, link_id=link_id, store=path.with_suffix(".time"))
