"""Orders to vehicles: acquire control, take off, go, hold, return, land; done only when the vehicle itself shows it.

Orders wait for nothing of each other: a newer one makes an older one give up at once. A hold is on the wire before
anything is awaited, and is repeated until the vehicle shows it or another order takes its place.
"""

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterator

from drivers.mavlink.codec import mavlink
from drivers.mavlink.commands import Commander, wait_for
from drivers.mavlink.modes import PX4, set_mode, stop_here
from drivers.mavlink.steered import (
    RATES_HZ,
    Steered,
    change_speed,
    degrees_e7,
    interval,
    must_be_high_enough,
    must_be_ours,
    refuse_double,
    reposition,
)
from drivers.mavlink.vehicle import Vehicle
from fieldkit.clock import Clock
from fieldkit.errors import DeviceTimeout, VehicleRefused
from fieldkit.geo import FieldFrame
from fieldkit.messages import VehicleMode, Waypoint
from fieldkit.settings import STANDS_M_S

CONFIRM_S = 5.0
"""How long a heartbeat may take to show what was commanded."""
FIND_S = 10.0
"""How long a vehicle may take to be heard at all."""
HOLD_EVERY_S = 0.25
"""How often a hold goes out again until the vehicle shows it."""
MODE_WAIT_S = 0.5
STOPPING_S = 1.0
"""One that stands so long after the order to, stands."""
CLIMB_S, CLIMB_M_S = 20.0, 0.5
"""A take-off may take so long, and longer the higher it goes."""
HIGH_ENOUGH = 0.9
"""Share of the altitude at which a take-off counts as done."""


class Orders:
    """Gives orders to the vehicles of one link. `beat` sends our heartbeat, `address` names the link in errors."""

    def __init__(
        self, commander: Commander, clock: Clock, frame: FieldFrame, beat: Callable[[], None], address: str
    ) -> None:
        self._commander = commander
        self._clock = clock
        self._frame = frame
        self._beat = beat
        self._address = address
        self._waiters: list[asyncio.Future[int]] = []

    def heartbeat(self, steered: Steered) -> None:
        """A vehicle's heartbeat came in: a hold that it shows need not be repeated."""
        if self._shows_hold(steered):
            steered.hold_unseen_until_s = -math.inf
        self.wake()

    def wake(self) -> None:
        """Whoever waits for a heartbeat looks again."""
        waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            if not waiter.done():
                waiter.set_result(0)

    async def until_heard(self, vehicle: Vehicle) -> bool:
        """Wait for a vehicle's heartbeat; False if none comes."""
        return await self._until(lambda: vehicle.link_up, FIND_S)

    # Hold

    def stop(self, steered: Steered) -> int:
        """Have it hold: the first frame has left when this returns. The number of this order."""
        mine = self._newer(steered)
        steered.must_hold = True
        steered.hold_ordered_s = self._clock.elapsed_s()
        steered.hold_unseen_until_s = steered.hold_ordered_s + CONFIRM_S
        steered.speed_m_s = None
        steered.hold_seen = steered.vehicle.heartbeats
        steered.vehicle.command("hold")
        if steered.vehicle.firmware is PX4:
            self._commander.note(steered.vehicle, mavlink.MAV_CMD_DO_REPOSITION)
        self._send_hold(steered)
        return mine

    def repeat_hold(self, steered: Steered) -> None:
        """Send a hold again that has not been shown yet, or that was lost though we have given up on it."""
        if steered.must_be_ordered_to_hold(self._clock.elapsed_s()):
            self._send_hold(steered)

    async def hold(self, steered: Steered) -> None:
        """Returns when a heartbeat that came after shows it; needs no ownership. Cancelled, it is repeated on."""
        mine, vehicle = self.stop(steered), steered.vehicle
        shown = await self._until(lambda: self._shows_hold(steered) or steered.orders != mine, CONFIRM_S)
        if steered.orders != mine:
            raise VehicleRefused(f"{vehicle.robot}: hold: a newer command came in between")
        if not shown:
            raise DeviceTimeout(self._not_shown(vehicle, "hold"))

    def _shows_hold(self, steered: Steered) -> bool:
        vehicle = steered.vehicle
        if vehicle.heartbeats <= steered.hold_seen or vehicle.actual_mode != "hold":
            return False
        if vehicle.firmware is not PX4:
            return True
        # PX4 goes to way-points inside its hold mode: there the mode alone shows nothing.
        paused = self._commander.noted(vehicle, mavlink.MAV_CMD_DO_REPOSITION) == mavlink.MAV_RESULT_ACCEPTED
        stands = (
            vehicle.position_s > steered.hold_ordered_s + STOPPING_S
            and (vehicle.speed_m_s or 0.0) < STANDS_M_S
        )
        return paused or stands

    def _send_hold(self, steered: Steered) -> None:
        vehicle = steered.vehicle
        if vehicle.firmware is None:
            return
        if vehicle.firmware is PX4:
            self._commander.send(vehicle, stop_here(vehicle.system_id))
        self._commander.send(vehicle, set_mode(vehicle.system_id, vehicle.firmware, "hold", 0))

    # Taking over

    async def acquire_control(self, steered: Steered, *, arm: bool = True) -> None:
        """GUIDED and armed, each confirmed by the vehicle's own heartbeat. Message rates are asked for beside that."""
        vehicle, was_to_hold = steered.vehicle, steered.must_hold
        mine = self._newer(steered)
        steered.must_hold = was_to_hold
        if not await self.until_heard(vehicle):
            raise DeviceTimeout(
                f"{vehicle.robot}: no heartbeat from system {vehicle.system_id} on {self._address}; is it "
                "switched on, is its system id right, does it send to this address?"
            )
        self._still(steered, mine, "acquire control")
        refuse_double(vehicle)
        self._beat()  # its failsafe watches for our heartbeat only from the first one on
        if vehicle.firmware is None:
            raise VehicleRefused(f"{vehicle.robot}: neither ArduRover, ArduCopter nor PX4: cannot steer it")
        self.ask_rates(vehicle)
        vehicle.take()
        steered.must_hold, steered.speed_m_s = False, None
        with self._under_way(steered):
            try:
                await self._mode(steered, "guided", mine)
                if arm:
                    await self._arm(steered, mine)
            except BaseException:
                if steered.orders == mine:
                    vehicle.owner = "nobody"
                raise

    def ask_rates(self, vehicle: Vehicle) -> None:
        """Ask for what we want to hear, and wait for no answer: what does not come is asked for again."""
        for number, rate_hz in RATES_HZ.items():
            self._commander.send(vehicle, interval(vehicle, number, rate_hz, 0))

    async def _arm(self, steered: Steered, mine: int) -> None:
        vehicle = steered.vehicle
        if vehicle.armed:
            return
        arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        await self._commander.ask(
            vehicle,
            "arm",
            lambda n: mavlink.MAVLink_command_long_message(vehicle.system_id, 1, arm, n, 1, 0, 0, 0, 0, 0, 0),
            still=lambda: steered.orders == mine,
        )
        if not await self._until(lambda: vehicle.armed or steered.orders != mine, CONFIRM_S):
            raise DeviceTimeout(
                f"{vehicle.robot}: accepted the command to arm but its heartbeat does not show it"
            )
        self._still(steered, mine, "arm")

    # Under way

    async def goto(self, steered: Steered, waypoint: Waypoint) -> None:
        """DO_REPOSITION in a global frame and the speed behind it, both acknowledged; watched while under way."""
        vehicle = steered.vehicle
        lat, lon = degrees_e7(vehicle.robot, waypoint, self._frame)
        must_be_high_enough(vehicle, waypoint.up_m)
        must_be_ours(vehicle)
        if vehicle.flies and vehicle.on_ground:
            raise VehicleRefused(f"{vehicle.robot}: stands on the ground: it has to take off first")
        await self._reposition(steered, lat, lon, waypoint)

    async def _reposition(self, steered: Steered, lat: int, lon: int, waypoint: Waypoint) -> None:
        vehicle, before = steered.vehicle, steered.vehicle.commanded
        speed_m_s = waypoint.speed_m_s / (vehicle.firmware.overshoot if vehicle.firmware is not None else 1.0)
        new_speed = vehicle.actual_mode != "guided" or steered.speed_m_s != speed_m_s
        mine = self._newer(steered)
        vehicle.command("guided")
        with self._under_way(steered):
            self._commander.note(vehicle, mavlink.MAV_CMD_DO_CHANGE_SPEED)
            try:
                await self._commander.ask(
                    vehicle,
                    "go to a way-point",
                    lambda _: reposition(vehicle, lat, lon, waypoint.up_m),
                    still=lambda: steered.orders == mine and vehicle.owner == "us",
                    behind=change_speed(vehicle, speed_m_s, 0) if new_speed else None,
                )
            except VehicleRefused:
                if steered.orders == mine and before is not None:
                    vehicle.command(before)
                raise
            self._still(steered, mine, "go to a way-point")
            steered.target, steered.target_s, steered.resent = (lat, lon), self._clock.elapsed_s(), 0
            steered.waypoint = waypoint
            if new_speed:
                await self._set_speed(steered, speed_m_s, mine)

    async def _set_speed(self, steered: Steered, speed_m_s: float, mine: int) -> None:
        """Most often it was taken behind the way-point already. PX4 may refuse it."""
        vehicle, command = steered.vehicle, mavlink.MAV_CMD_DO_CHANGE_SPEED
        if self._commander.noted(vehicle, command) != mavlink.MAV_RESULT_ACCEPTED:
            try:
                await self._commander.ask(
                    vehicle,
                    f"drive at {speed_m_s:.2g} m/s",
                    lambda n: change_speed(vehicle, speed_m_s, n),
                    still=lambda: steered.orders == mine and vehicle.owner == "us",
                )
            except VehicleRefused:
                if vehicle.firmware is not PX4:
                    raise
        if steered.orders == mine:
            steered.speed_m_s = speed_m_s

    async def take_off(self, steered: Steered, up_m: float) -> None:
        """Climb to an altitude above home; one that flies already goes there above the place it is at."""
        vehicle = steered.vehicle
        if not vehicle.flies:
            raise VehicleRefused(f"{vehicle.robot}: does not fly")
        must_be_high_enough(vehicle, up_m)
        must_be_ours(vehicle)
        mine = self._newer(steered)
        vehicle.command("guided")
        with self._under_way(steered):
            if vehicle.on_ground is False and vehicle.place is not None:
                lat, lon = vehicle.place
                await self._commander.ask(
                    vehicle,
                    f"climb to {up_m:g} m",
                    lambda _: reposition(vehicle, lat, lon, up_m),
                    still=lambda: steered.orders == mine,
                )
            else:
                await self._commander.ask(
                    vehicle,
                    f"take off to {up_m:g} m",
                    lambda n: take_off(vehicle, up_m, n),
                    still=lambda: steered.orders == mine,
                )
            climbed = await self._until(
                lambda: steered.orders != mine or vehicle.owner != "us" or reaches(vehicle, up_m),
                CLIMB_S + up_m / CLIMB_M_S,
            )
        self._still(steered, mine, "take off")
        must_be_ours(vehicle)
        if not climbed:
            raise DeviceTimeout(
                f"{vehicle.robot}: took off and is only {vehicle.up_m or 0.0:.1f} m up, not {up_m:g} m"
            )

    async def return_home(self, steered: Steered) -> None:
        """The firmware's own return mode, shown by the heartbeat."""
        mine = self._newer(steered)
        steered.speed_m_s = None
        with self._under_way(steered):
            await self._mode(steered, "return", mine)

    async def land(self, steered: Steered) -> None:
        """Land where it is: the firmware's own mode, shown by the heartbeat. It disarms itself on the ground."""
        vehicle = steered.vehicle
        if not vehicle.flies:
            raise VehicleRefused(f"{vehicle.robot}: does not fly")
        mine = self._newer(steered)
        steered.speed_m_s = None
        with self._under_way(steered):
            await self._mode(steered, "land", mine)

    async def _mode(self, steered: Steered, mode: VehicleMode, mine: int) -> None:
        """Ask for a mode until a heartbeat that came after shows it."""
        vehicle = steered.vehicle
        vehicle.command(mode)
        deadline_s = self._clock.elapsed_s() + CONFIRM_S
        while self._clock.elapsed_s() < deadline_s:
            seen = vehicle.heartbeats
            await self._ask_mode(vehicle, mode)
            self._still(steered, mine, f"change mode to {mode}")
            shown = await self._until(
                lambda seen=seen: (
                    (vehicle.heartbeats > seen and vehicle.actual_mode == mode)  # type: ignore[misc]
                    or steered.orders != mine
                ),
                1.5,
            )
            self._still(steered, mine, f"change mode to {mode}")
            if shown:
                return
        raise DeviceTimeout(self._not_shown(vehicle, mode))

    async def _ask_mode(self, vehicle: Vehicle, mode: VehicleMode) -> None:
        """Ask once. No answer is no error here: the heartbeat shows it."""
        firmware = vehicle.firmware
        if firmware is None:
            return
        with contextlib.suppress(DeviceTimeout):
            await self._commander.ask(
                vehicle,
                f"change mode to {mode}",
                lambda n: set_mode(vehicle.system_id, firmware, mode, n),
                tries=1,
                wait_s=MODE_WAIT_S,
            )

    # Below

    def _newer(self, steered: Steered) -> int:
        """The order before it is cancelled, and whoever waits for it gives up now."""
        mine = steered.newer_order()
        self._commander.abandon(steered.vehicle)
        self.wake()
        return mine

    @staticmethod
    def _still(steered: Steered, mine: int, what: str) -> None:
        """Raise `VehicleRefused` where a newer order has come."""
        if steered.orders != mine:
            raise VehicleRefused(f"{steered.vehicle.robot}: {what}: a newer command came in between")

    @staticmethod
    @contextlib.contextmanager
    def _under_way(steered: Steered) -> Iterator[None]:
        steered.under_way += 1
        try:
            yield
        finally:
            steered.under_way -= 1

    @staticmethod
    def _not_shown(vehicle: Vehicle, mode: VehicleMode) -> str:
        return (
            f"{vehicle.robot} (system {vehicle.system_id}): did not show mode {mode} within {CONFIRM_S:g} s"
            + ("" if vehicle.link_up else "; its link is lost")
        )

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for heartbeats until one makes `condition` true; False if none did in time."""
        deadline_s = self._clock.elapsed_s() + timeout_s
        while not condition():
            left_s = deadline_s - self._clock.elapsed_s()
            if left_s <= 0:
                return False
            waiter: asyncio.Future[int] = asyncio.get_running_loop().create_future()
            self._waiters.append(waiter)
            await wait_for(waiter, self._clock, left_s)
        return True


def reaches(vehicle: Vehicle, up_m: float) -> bool:
    """Whether it is about as high as it was ordered to climb."""
    return vehicle.up_m is not None and abs(vehicle.up_m - up_m) <= max(0.5, (1.0 - HIGH_ENOUGH) * up_m)


def take_off(vehicle: Vehicle, up_m: float, attempt: int) -> "mavlink.MAVLink_command_long_message":
    """ArduCopter counts the altitude from home, PX4 from the sea."""
    height_m = up_m
    if vehicle.firmware is PX4:
        height_m += vehicle.home_alt_m or 0.0
    nowhere = (float("nan"),) * 3 if vehicle.firmware is PX4 else (0.0,) * 3
    command = mavlink.MAV_CMD_NAV_TAKEOFF
    return mavlink.MAVLink_command_long_message(
        vehicle.system_id, 1, command, attempt, 0, 0, 0, *nowhere, height_m
    )
