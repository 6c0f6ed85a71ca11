"""Conversations with one vehicle that take a while: its plans, parameters, clock; and whether it is fit for a mission.

They never stand in an order's way: each has an inbox of its own, and a hold passes between any two of its frames.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from drivers.mavlink import failsafes, inspect, parameters, timesync
from drivers.mavlink.codec import AUTOPILOT, GROUND_STATION, Message, Packer, mavlink
from drivers.mavlink.commands import Commander
from drivers.mavlink.modes import COPTER, PX4, ROVER
from drivers.mavlink.plans import FENCE, KINDS, Inbox, PlanItem, PlanTalk, polygon_fence
from drivers.mavlink.steered import Steered, refuse_double
from drivers.mavlink.vehicle import Vehicle
from fieldkit.checks import Check
from fieldkit.clock import Clock
from fieldkit.errors import DeviceError, DeviceTimeout, VehicleRefused
from fieldkit.geo import FieldFrame
from fieldkit.geometry.polygons import margin_m
from fieldkit.ports import Demands, StoredFence, Traits

UNSIGNED_TRIES = 3
SETTLE_S = 2.5
"""How long a vehicle has to say everything that was asked for once, and to look at its pre-arm checks again."""
STALLS_M = 3.5
"""How far before its own fence a rover stops, in guided and without a word (measured: 2 to 3.5 m)."""
ENABLED = "FENCE_ENABLE"
VERTICES = (
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)


@dataclass
class Talks:
    """Talks with the vehicles of one link. `send` and `send_raw` put messages on the wire."""

    clock: Clock
    frame: FieldFrame
    own_id: int
    commander: Commander
    send: Callable[[Vehicle, Message], None]
    send_raw: Callable[[Vehicle, bytes], None]

    # Plans

    async def upload(self, steered: Steered, kind: int, items: Sequence[PlanItem]) -> None:
        """Put a mission, fence or rally points into the vehicle, and read them back."""
        with self._talk(steered, kind) as talk:
            await talk.upload(items)

    async def download(self, steered: Steered, kind: int) -> list[PlanItem]:
        """What the vehicle holds."""
        with self._talk(steered, kind) as talk:
            return await talk.download()

    def fence_of(self, corners_m: Sequence[tuple[float, float]]) -> list[PlanItem]:
        """Corners (east, north) as a fence to stay inside."""
        corners = [self.frame.to_geodetic(east_m, north_m) for east_m, north_m in corners_m]
        return polygon_fence([(round(a * 1e7), round(o * 1e7)) for a, o, _ in corners])

    async def stored_fence(self, steered: Steered) -> StoredFence:
        """What is there, and whether it is enabled."""
        robot, px4 = steered.vehicle.robot, steered.vehicle.firmware is PX4
        held = await self.download(steered, FENCE)
        enabled = None if px4 else (await self.parameters(steered, (ENABLED,)))[ENABLED]
        if enabled is None and not px4:
            raise DeviceTimeout(f"{robot}: {ENABLED} cannot be read: its fence is left as it is")
        return StoredFence(robot, enabled, tuple(_row(item) for item in held))

    async def put_fence(self, steered: Steered, corners_m: Sequence[tuple[float, float]]) -> None:
        """Put ours in the place of what is there, and enable it."""
        robot, px4 = steered.vehicle.robot, steered.vehicle.firmware is PX4
        await self.upload(steered, FENCE, self.fence_of(corners_m))
        if not px4 and not await self.set_parameter(steered, ENABLED, 1.0):
            raise VehicleRefused(f"{robot}: its fence is put, but {ENABLED} stays off")

    async def restore_fence(self, steered: Steered, stored: StoredFence) -> None:
        """First off, then the old one in place, then as it was."""
        robot = steered.vehicle.robot
        await self.upload(steered, FENCE, [_item(row) for row in stored.items])
        if stored.enabled is not None and not await self.set_parameter(steered, ENABLED, stored.enabled):
            raise VehicleRefused(f"{robot}: its fence is back, but {ENABLED} is not {stored.enabled:g} again")

    # Parameters and clock

    async def parameters(self, steered: Steered, names: Sequence[str]) -> dict[str, float | None]:
        """Parameters as the vehicle has them; None where it does not answer: unknown, or a poor link."""
        vehicle = steered.vehicle
        with self._inbox(steered, ("PARAM_VALUE",)) as inbox:
            return await parameters.read(
                lambda message: self.send(vehicle, message),
                inbox,
                self.clock,
                vehicle.system_id,
                vehicle.firmware,
                names,
            )

    async def set_parameter(self, steered: Steered, name: str, value: float) -> bool:
        """Set a parameter; whether the vehicle says that it has it."""
        vehicle = steered.vehicle
        with self._inbox(steered, ("PARAM_VALUE",)) as inbox:
            return await parameters.write(
                lambda message: self.send(vehicle, message),
                inbox,
                self.clock,
                vehicle.system_id,
                name,
                value,
            )

    async def traits(self, steered: Steered) -> Traits:
        """How it moves."""
        vehicle = steered.vehicle
        names: tuple[str, ...] = ("WP_RADIUS", "TURN_RADIUS", "WP_SPEED", "RTL_SPEED")
        if vehicle.firmware is COPTER:
            names = ("WPNAV_RADIUS", "WPNAV_SPEED", "RTL_SPEED", "RTL_ALT")
        elif vehicle.firmware is PX4:
            names = ("NAV_ACC_RAD", "MPC_XY_CRUISE", "RTL_RETURN_ALT")
        values = await self.parameters(steered, names)
        if vehicle.firmware is PX4:
            return Traits(
                vehicle.flies,
                values["NAV_ACC_RAD"],
                None,
                values["MPC_XY_CRUISE"],
                None,
                values["RTL_RETURN_ALT"],
            )
        if vehicle.firmware is COPTER:  # in centimetres
            metres = {name: None if value is None else value / 100.0 for name, value in values.items()}
            home_m_s = metres["RTL_SPEED"] or metres["WPNAV_SPEED"]
            return Traits(
                True, metres["WPNAV_RADIUS"], None, metres["WPNAV_SPEED"], home_m_s, metres["RTL_ALT"]
            )
        home_m_s = values["RTL_SPEED"] or values["WP_SPEED"]
        return Traits(vehicle.flies, values["WP_RADIUS"], values["TURN_RADIUS"], values["WP_SPEED"], home_m_s)

    async def synchronise(self, steered: Steered) -> timesync.ClockOffset | None:
        """The vehicle's clock against ours, with its bound; None if it does not answer."""
        with self._inbox(steered, ("TIMESYNC",)) as inbox:
            return await timesync.exchange(
                lambda message: self.send(steered.vehicle, message), inbox, self.clock, self.own_id
            )

    async def unsigned(self, steered: Steered) -> timesync.ClockOffset | None:
        """Its answers to unsigned frames on a signed link: a vehicle that refuses them is silent."""
        packer = Packer(self.own_id, GROUND_STATION)
        with self._inbox(steered, ("TIMESYNC",)) as inbox:
            return await timesync.exchange(
                lambda message: self.send_raw(steered.vehicle, packer.pack(message)),
                inbox,
                self.clock,
                self.own_id,
                UNSIGNED_TRIES,
            )

    # Fit for a mission

    async def inspect(self, steered: Steered, demands: Demands, signs: bool) -> list[Check]:
        """Everything that the vehicle can be asked. What was put into it before counts: its fence above all."""
        vehicle, robot = steered.vehicle, steered.vehicle.robot
        assert vehicle.firmware is not None
        values = await self.parameters(steered, failsafes.NAMES[vehicle.firmware])
        checks = failsafes.judge(robot, vehicle.firmware, values, self.own_id, demands)
        fence = await self._own_fence(steered, demands, bool(values.get(ENABLED)))
        asked_s = self.clock.elapsed_s()
        await self._run_prearm_checks(vehicle)
        await self.clock.sleep(SETTLE_S)
        condition = inspect.condition(vehicle, self.clock.elapsed_s(), asked_s)
        if vehicle.doubles:
            return condition
        offset = await self.synchronise(steered)
        checks = [*condition, *checks, *fence, inspect.clock(robot, offset)]
        checks += inspect.time_of_day(vehicle, signs)
        if signs:
            checks.append(inspect.signing(robot, offset, await self.unsigned(steered)))
        return checks

    async def _run_prearm_checks(self, vehicle: Vehicle) -> None:
        """Ask it to say now why it would not arm: by itself it does so every 30 s."""
        with contextlib.suppress(DeviceError):
            await self.commander.ask(
                vehicle,
                "run its pre-arm checks",
                lambda n: mavlink.MAVLink_command_long_message(
                    vehicle.system_id, AUTOPILOT, mavlink.MAV_CMD_RUN_PREARM_CHECKS, n, 0, 0, 0, 0, 0, 0, 0
                ),
                tries=3,
            )

    async def _own_fence(self, steered: Steered, demands: Demands, enabled: bool) -> list[Check]:
        """The fence that it holds: the one it was given, or one of its own that leaves room for the mission."""
        robot = steered.vehicle.robot
        if not (enabled or demands.put_fence or steered.vehicle.firmware is PX4):
            return []
        try:
            held = await self.download(steered, FENCE)
        except DeviceError as error:
            return [Check(robot, "fence", "red" if demands.put_fence else "amber", str(error), "try again")]
        if demands.put_fence:
            return [self._is_ours(robot, held, demands)]
        corners = [self._local(item) for item in held if item.command == VERTICES[0]]
        if len(corners) < 3:
            found = f"holds no polygon to stay inside ({len(held)} items)"
            return [Check(robot, "fence", "amber", found, "upload one with your ground station")]
        room_m = min((margin_m(place, corners) for place in demands.field_m), default=0.0)
        if room_m < 0:
            found = f"its own fence ends {-room_m:.1f} m inside the mission's field"
            return [
                Check(robot, "fence", "red", found, "mend one of the two, or safety.vehicle_fence = true")
            ]
        found = f"its own, {len(corners)} corners, {room_m:.1f} m round the field"
        if steered.vehicle.firmware is ROVER and room_m < STALLS_M:
            remedy = (
                f"a rover stops up to {STALLS_M:g} m before its own fence, and stays there: give it more room"
            )
            return [Check(robot, "fence", "amber", found, remedy)]
        return [Check(robot, "fence", "green", found)]

    def _is_ours(self, robot: str, held: Sequence[PlanItem], demands: Demands) -> Check:
        wanted = self.fence_of(demands.fence_m)
        if len(held) == len(wanted) and all(a.agrees(b) for a, b in zip(wanted, held, strict=True)):
            return Check(robot, "fence", "green", f"{len(wanted)} corners, read back and enabled")
        found = f"holds {len(held)} items that are not the fence it was given"
        return Check(robot, "fence", "red", found, "is another ground station uploading? check again")

    def _local(self, item: PlanItem) -> tuple[float, float]:
        east_m, north_m, _ = self.frame.to_local(item.lat_e7 / 1e7, item.lon_e7 / 1e7)
        return east_m, north_m

    # Below

    @contextlib.contextmanager
    def _talk(self, steered: Steered, kind: int) -> Iterator[PlanTalk]:
        vehicle = steered.vehicle
        if not vehicle.link_up:
            raise DeviceTimeout(f"{vehicle.robot}: its link is lost")
        refuse_double(vehicle)
        with self._inbox(steered, KINDS) as inbox:
            yield PlanTalk(
                vehicle.robot,
                vehicle.system_id,
                kind,
                lambda message: self.send(vehicle, message),
                inbox,
                self.clock,
                self.own_id,
            )

    @contextlib.contextmanager
    def _inbox(self, steered: Steered, kinds: Sequence[str]) -> Iterator[Inbox]:
        inbox = Inbox(self.clock, kinds)
        steered.inboxes.append(inbox)
        try:
            yield inbox
        finally:
            steered.inboxes.remove(inbox)


def _row(item: PlanItem) -> tuple[float, ...]:
    return (item.command, item.lat_e7, item.lon_e7, item.up_m, *item.params)


def _item(row: Sequence[float]) -> PlanItem:
    command, lat_e7, lon_e7, up_m, *params = row
    first, second, third, fourth = params
    return PlanItem(int(command), int(lat_e7), int(lon_e7), up_m, (first, second, third, fourth))
