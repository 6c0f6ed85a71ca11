"""The vehicles on one MAVLink link as a `VehicleLink`: what comes in, what goes out, and who is asked for what.

Orders are `orders`' business, longer conversations `talks`'.
"""

import asyncio
import contextlib
import logging
import math
import zlib
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.bounded_queue import BoundedQueue
from drivers.mavlink import inspect, timesync
from drivers.mavlink.codec import AUTOPILOT, GROUND_STATION, Message, Packer, Parser, mavlink
from drivers.mavlink.commands import Commander
from drivers.mavlink.orders import HOLD_EVERY_S, Orders
from drivers.mavlink.plans import FENCE, PlanItem
from drivers.mavlink.signing import Signer, read_key
from drivers.mavlink.steered import Steered, reposition
from drivers.mavlink.talks import Talks
from drivers.mavlink.tapped import TappedTransport
from drivers.mavlink.transport import MAX_PEERS, Copy, Peer, make_transport
from drivers.mavlink.vehicle import Vehicle
from drivers.options import REMEDY, checked
from fieldkit.checks import Check
from fieldkit.clock import Clock
from fieldkit.errors import ConfigError, DeviceTimeout, VehicleRefused
from fieldkit.messages import Pose, VehicleState, Waypoint
from fieldkit.ports import Demands, DriverContext, StoredFence, Traits

logger = logging.getLogger(__name__)

SYSTEM_ID = 245
"""Our own system id. Not 255: that is QGroundControl's, and a second 255 masks the vehicles' failsafe."""
HOUSEKEEPING_S = 0.5
POSITION_STALE_S = 2.0
ASK_TIME_EVERY_NS = 5_000_000_000
"""A link that is slow for good is not asked more often."""
SECOND_STATION_S = 10.0
REFUSED_MANY = 20
"""Frames refused before the operator is informed: some seconds of one vehicle."""


@dataclass(frozen=True, slots=True)
class RobotOptions:
    """What a mission file says of a vehicle."""

    system_id: int = field(
        metadata={
            REMEDY: 'write the vehicle\'s own number, as in system_id = 1; "fieldkit vehicles" lists who is heard'
        }
    )
    sigma_m: float = 0.0
    """Standard deviation of its positions; 0: take the GPS's own word."""
    own_system_id: int = SYSTEM_ID
    """Our system id on this link; the vehicles must accept it (MAV_GCS_SYSID)."""
    signing_key: str = ""
    """Path of the link's signing key; empty: nothing is signed."""
    forward: str = ""
    """host:port to which everything that the vehicles send is copied over UDP: for a rehearsal's radios, or a map."""


def open_link(address: str, robots: Mapping[str, Mapping[str, Any]], around: DriverContext) -> "MavlinkLink":
    """A link, not opened yet. Raises `ConfigError` for options that cannot be."""
    return MavlinkLink(address, robots, around)


class MavlinkLink:
    """Entering opens the link; vehicles appear in `events` as they are heard."""

    def __init__(self, address: str, robots: Mapping[str, Mapping[str, Any]], around: DriverContext) -> None:
        self.robots = tuple(robots)
        self._address = address
        self._clock = around.clock
        self._frame = around.frame
        options = {
            name: checked(RobotOptions, given, f"vehicle of {name} (mavlink)")
            for name, given in robots.items()
        }
        shared = {
            (option.own_system_id, option.signing_key, option.forward) for option in options.values()
        } or {(SYSTEM_ID, "", "")}
        if len(shared) > 1:
            raise ConfigError(
                f"vehicle link {address}: robots on one link disagree on 'own_system_id', 'signing_key' or 'forward'"
            )
        ((self._own_id, key_path, forward),) = shared
        self._copy = Copy(forward) if forward else None
        self._signer = _signer(key_path, address, self._clock) if key_path else None
        self._steered: dict[int, Steered] = {}
        for name, option in options.items():
            self._add(name, option)
        self._packer = Packer(self._own_id, GROUND_STATION, self._signer)
        self._parsers: dict[Peer, Parser] = {}
        self._commander = Commander(self._clock, self._own_id, self._send)
        self._orders = Orders(self._commander, self._clock, self._frame, self.beat, address)
        self._talks = Talks(
            self._clock, self._frame, self._own_id, self._commander, self._send, self._send_raw
        )
        transport = make_transport(address)
        self._transport = transport if around.tap is None else TappedTransport(transport, address, around.tap)
        self._is_open = False
        self._second_station_s = -math.inf
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
        self._steered[option.system_id] = Steered(vehicle)

    async def __aenter__(self) -> Self:
        self._out: BoundedQueue[Pose | VehicleState] = BoundedQueue(limit=20_000)
        if self._copy is not None:
            self._copy.open()
        await self._transport.open(self._on_data)
        self._is_open = True
        self._tasks = [
            asyncio.create_task(work, name=f"mavlink-{self._address}")
            for work in (self._keep_house(), self._keep_holding())
        ]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._is_open:
            return
        self._is_open = False
        for task in self._tasks:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
        await self._transport.close()
        if self._copy is not None:
            self._copy.close()
        if self._signer is not None:
            self._signer.close()
        self._out.close()

    async def events(self) -> AsyncIterator[Pose | VehicleState]:
        """Poses, and states on change and about once a second. For one consumer."""
        async for item in self._out.items():
            yield item

    # What comes in

    def _on_data(self, data: bytes, peer: Peer) -> None:
        if self._copy is not None:
            self._copy.send(data)
        parser = self._parsers.get(peer)
        if parser is None:
            if len(self._parsers) >= MAX_PEERS:
                self._parsers.clear()
            parser = self._parsers[peer] = Parser(self._signer)
        now_s, now_ns = self._clock.elapsed_s(), self._clock.now_ns()
        for message in parser.parse(data):
            steered = self._steered.get(message.get_srcSystem())
            if message.get_srcSystem() == self._own_id and message.get_type() == "HEARTBEAT":
                # Routers and autopilots forward: ours would not come back to us.
                self._second_station_s = now_s
            if steered is None or message.get_srcComponent() != AUTOPILOT:
                continue
            steered.vehicle.count(peer, message.get_seq())
            if message.get_type() == "COMMAND_ACK":
                self._commander.heard(message, message.get_srcSystem())
                continue
            if message.get_type() == "TIMESYNC" and message.ts1 == steered.time_asked and message.tc1:
                steered.vehicle.clock_measured(message.ts1, message.tc1, now_ns)
            for inbox in steered.inboxes:
                if message.get_type() in inbox.kinds:
                    inbox.put(message)
            self._put(steered.vehicle.heard(message, peer, now_s, now_ns))
            if message.get_type() == "HEARTBEAT":
                self._orders.heartbeat(steered)

    def _put(self, happenings: list[Pose | VehicleState]) -> None:
        for item in happenings:
            self._out.put(item, always=isinstance(item, VehicleState))

    # What goes out

    def _send(self, vehicle: Vehicle, message: Message) -> None:
        """To the vehicle's own address, and to any impostor's when it matters: a hold must reach both."""
        self._send_raw(vehicle, self._packer.pack(message))

    def _send_raw(self, vehicle: Vehicle, data: bytes) -> None:
        if not self._is_open:
            return
        peer = vehicle.peer if vehicle.peer is not None else self._transport.default_peer
        for address in {peer, *vehicle.doubles} - {None}:
            self._transport.send(data, address)

    def beat(self) -> None:
        """Send our heartbeat to every vehicle heard on this link."""
        if not self._is_open:
            return
        now_s = self._clock.elapsed_s()
        for steered in self._steered.values():
            steered.vehicle.beaten(now_s)
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
                self._settle_clock(steered, now_ns)

    async def _keep_holding(self) -> None:
        """Holds are repeated beside everything else, whoever asked for them and whether or not he still waits."""
        while True:
            await self._clock.sleep(HOLD_EVERY_S)
            for steered in self._steered.values():
                self._orders.repeat_hold(steered)

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
            self._orders.ask_rates(vehicle)

    def _settle_clock(self, steered: Steered, now_ns: int) -> None:
        """A vehicle that froze and goes on has an old clock; one round trip separates that from a slow link."""
        due = now_ns - (steered.time_asked or 0) > ASK_TIME_EVERY_NS
        if due and steered.vehicle.clock_in_doubt and steered.vehicle.link_up:
            steered.time_asked = now_ns // 256 * 256 + self._own_id
            self._send(steered.vehicle, mavlink.MAVLink_timesync_message(0, steered.time_asked))

    def _watch_target(self, steered: Steered, now_s: float) -> None:
        """Send a way-point again if the vehicle says it is going elsewhere."""
        if steered.goes_elsewhere(now_s) and steered.target is not None and steered.waypoint is not None:
            steered.resent += 1
            steered.target_s = now_s
            logger.warning("%s: goes elsewhere: sending the way-point again", steered.vehicle.robot)
            self._send(steered.vehicle, reposition(steered.vehicle, *steered.target, steered.waypoint.up_m))

    # Commands

    async def acquire_control(self, robot: str, *, arm: bool = True) -> None:
        """Set message rates, GUIDED, armed; each confirmed by the vehicle's own heartbeat."""
        self._refuse_second_station(robot)
        await self._orders.acquire_control(self._of(robot), arm=arm)

    def release(self, robot: str) -> None:
        """Send it nothing more; whoever takes it has it."""
        steered = self._of(robot)
        steered.newer_order()
        steered.vehicle.give_up("it was given up")

    def stop(self, robot: str) -> None:
        """The first frame of a hold has left when this returns; it is repeated until the vehicle shows it."""
        self._orders.stop(self._of(robot))

    async def hold(self, robot: str) -> None:
        """Asked again and again until the heartbeat shows it; needs no ownership."""
        await self._orders.hold(self._of(robot))

    async def take_off(self, robot: str, up_m: float) -> None:
        """Climb to an altitude above home; returns when it is there."""
        await self._orders.take_off(self._of(robot), up_m)

    async def goto(self, robot: str, waypoint: Waypoint) -> None:
        """DO_REPOSITION in a global frame, acknowledged; watched and sent again while under way."""
        await self._orders.goto(self._of(robot), waypoint)

    async def return_home(self, robot: str) -> None:
        """The firmware's own return mode, shown by the heartbeat."""
        await self._orders.return_home(self._of(robot))

    async def land(self, robot: str) -> None:
        """The firmware's own landing mode, shown by the heartbeat."""
        await self._orders.land(self._of(robot))

    # Before a mission, and after it

    async def inspect(self, robot: str, demands: Demands = Demands()) -> list[Check]:
        """Whether the vehicle is fit for a mission. Nothing is armed, moved or changed."""
        steered = self._of(robot)
        vehicle = steered.vehicle
        self.beat()
        await self._orders.until_heard(vehicle)
        if not vehicle.link_up or vehicle.doubles or vehicle.firmware is None:
            return inspect.condition(vehicle, self._clock.elapsed_s())
        words = self._second_station()
        self._orders.ask_rates(vehicle)
        checks = await self._talks.inspect(steered, demands, self._signer is not None)
        if words := words or self._second_station():
            checks.append(Check(robot, "identity", "red", words, "end the other mission"))
        return checks

    async def traits(self, robot: str) -> Traits:
        """How the vehicle moves, from its parameters."""
        return await self._talks.traits(await self._heard(robot))

    async def stored_fence(self, robot: str) -> StoredFence:
        """The fence that the vehicle has."""
        return await self._talks.stored_fence(await self._heard(robot))

    async def put_fence(self, robot: str, corners_m: Sequence[tuple[float, float]]) -> None:
        """Put corners (east, north) into the vehicle as the fence to stay in, and enable it."""
        await self._talks.put_fence(await self._heard(robot), corners_m)

    async def restore_fence(self, stored: StoredFence) -> None:
        """Put back what `stored_fence` read."""
        await self._talks.restore_fence(await self._heard(stored.robot), stored)

    async def upload_fence(self, robot: str, corners_m: Sequence[tuple[float, float]]) -> None:
        """Put a polygon (east, north) into the vehicle as the fence it must stay in, and read it back.

        Whether the vehicle acts on it is for its parameters: see `parameters`.
        """
        await self.upload(robot, FENCE, self._talks.fence_of(corners_m))

    async def upload(self, robot: str, kind: int, items: Sequence[PlanItem]) -> None:
        """Put a mission, fence or rally points (`plans.MISSION`, `FENCE`, `RALLY`) into the vehicle."""
        await self._talks.upload(self._of(robot), kind, items)

    async def download(self, robot: str, kind: int) -> list[PlanItem]:
        """What the vehicle holds."""
        return await self._talks.download(self._of(robot), kind)

    async def parameters(self, robot: str, names: Sequence[str]) -> dict[str, float | None]:
        """Parameters as the vehicle has them; None where it does not answer: unknown, or a poor link."""
        return await self._talks.parameters(self._of(robot), names)

    async def set_parameter(self, robot: str, name: str, value: float) -> bool:
        """Set a parameter; whether the vehicle says that it has it."""
        return await self._talks.set_parameter(self._of(robot), name, value)

    async def synchronise(self, robot: str) -> timesync.ClockOffset | None:
        """The vehicle's clock against ours, with its bound; None if it does not answer."""
        return await self._talks.synchronise(self._of(robot))

    # Guards

    def _second_station(self) -> str:
        """Words on another station that steers with our id; empty where there is none."""
        if self._clock.elapsed_s() - self._second_station_s > SECOND_STATION_S:
            return ""
        return f"another ground station has our system id {self._own_id}: is a second mission running?"

    def _refuse_second_station(self, robot: str) -> None:
        if words := self._second_station():
            raise VehicleRefused(
                f"{robot}: {words} End it, or give this one an own_system_id of its own in the mission file"
            )

    async def _heard(self, robot: str) -> Steered:
        """One that is heard; a link that was opened just now is given its time. Raises `DeviceTimeout`."""
        steered = self._of(robot)
        self.beat()
        if not await self._orders.until_heard(steered.vehicle):
            raise DeviceTimeout(
                f"{robot}: no heartbeat from system {steered.vehicle.system_id} on {self._address}"
            )
        return steered

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
