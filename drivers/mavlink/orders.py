"""What we have vehicles do: take over, go, hold, return; each done only when the vehicle itself shows it."""

import asyncio
import contextlib
from collections.abc import Callable

from drivers.mavlink.codec import mavlink
from drivers.mavlink.commands import Commander, wait_for
from drivers.mavlink.modes import set_mode
from drivers.mavlink.steered import (
    RATES_HZ,
    Steered,
    degrees_e7,
    interval,
    must_be_ours,
    refuse_double,
    reposition,
)
from drivers.mavlink.vehicle import Vehicle
from fieldkit.clock import Clock
from fieldkit.errors import DeviceTimeout, VehicleRefused
from fieldkit.geo import FieldFrame
from fieldkit.messages import VehicleMode, Waypoint

CONFIRM_S = 5.0
"""How long a heartbeat may take to show what was commanded."""
FIND_S = 10.0
"""How long a vehicle may take to be heard at all."""


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

    def heartbeat(self) -> None:
        """A vehicle's heartbeat came in: whoever waits for one may look again."""
        waiters, self._waiters = self._waiters, []
        for waiter in waiters:
            if not waiter.done():
                waiter.set_result(0)

    async def until_heard(self, vehicle: Vehicle) -> bool:
        """Wait for a vehicle's heartbeat; False if none comes."""
        return await self._until(lambda: vehicle.link_up, FIND_S)

    async def take_over(self, steered: Steered, *, arm: bool = True) -> None:
        """Set message rates, GUIDED, armed; each confirmed by the vehicle's own heartbeat."""
        vehicle = steered.vehicle
        async with steered.lock:
            if not await self.until_heard(vehicle):
                raise DeviceTimeout(
                    f"{vehicle.robot}: no heartbeat from system {vehicle.system_id} on {self._address}; is it "
                    "switched on, is its system id right, does it send to this address?"
                )
            refuse_double(vehicle)
            self._beat()  # its failsafe watches for our heartbeat only from the first one on
            if vehicle.firmware is None:
                raise VehicleRefused(
                    f"{vehicle.robot}: neither ArduRover, ArduCopter nor PX4: cannot steer it"
                )
            for number, rate_hz in RATES_HZ.items():
                # One rate that it does not know, or that is lost on the way, is no reason to stop: it is asked again.
                with contextlib.suppress(VehicleRefused, DeviceTimeout):
                    await self._commander.ask(
                        vehicle,
                        f"set the rate of message {number}",
                        lambda n, number=number, rate_hz=rate_hz: interval(vehicle, number, rate_hz, n),  # type: ignore[misc]
                    )
            vehicle.owner, vehicle.commanded, steered.must_hold = "us", None, False
            try:
                await self._mode(steered, "guided")
                if arm:
                    await self._arm(vehicle)
            except BaseException:
                vehicle.owner = "nobody"
                raise
            steered.speed_m_s = None

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

    async def goto(self, steered: Steered, waypoint: Waypoint) -> None:
        """DO_REPOSITION in a global frame, acknowledged; watched and sent again while under way."""
        vehicle = steered.vehicle
        lat, lon = degrees_e7(vehicle.robot, waypoint, self._frame)
        steered.orders += 1
        steered.must_hold = False
        mine = steered.orders
        async with steered.lock:
            must_be_ours(vehicle)
            before = vehicle.commanded
            entering = vehicle.actual_mode != "guided"
            vehicle.command("guided")
            try:
                await self._commander.ask(
                    vehicle,
                    "go to a way-point",
                    lambda _: reposition(vehicle, lat, lon, waypoint),
                    still=lambda: steered.orders == mine and vehicle.owner == "us",
                )
            except VehicleRefused:
                if steered.orders == mine and before is not None:
                    vehicle.command(before)
                raise
            if steered.orders != mine:
                raise VehicleRefused(f"{vehicle.robot}: go to a way-point: a newer command came in between")
            steered.target, steered.target_s, steered.resent = (lat, lon), self._clock.elapsed_s(), 0
            steered.waypoint = waypoint
            if entering or steered.speed_m_s != waypoint.speed_m_s:
                await self._set_speed(steered, waypoint.speed_m_s)

    async def _set_speed(self, steered: Steered, speed_m_s: float) -> None:
        """Firmwares that take the speed from the reposition itself may refuse this: harmless."""
        vehicle, command = steered.vehicle, mavlink.MAV_CMD_DO_CHANGE_SPEED
        with contextlib.suppress(VehicleRefused):
            await self._commander.ask(
                vehicle,
                "set the speed",
                lambda n: mavlink.MAVLink_command_long_message(
                    vehicle.system_id, 1, command, n, 1, speed_m_s, -1, 0, 0, 0, 0
                ),
            )
        steered.speed_m_s = speed_m_s

    async def hold(self, steered: Steered) -> None:
        """Asked again and again until the heartbeat shows it; needs no ownership."""
        steered.stop()
        steered.must_hold = True
        await self._mode(steered, "hold")

    async def return_home(self, steered: Steered) -> None:
        """The firmware's own return mode, shown by the heartbeat."""
        steered.stop()
        await self._mode(steered, "return")

    async def _mode(self, steered: Steered, mode: VehicleMode) -> None:
        """Ask for a mode until a heartbeat that came after shows it."""
        vehicle = steered.vehicle
        vehicle.command(mode)
        deadline_s = self._clock.elapsed_s() + CONFIRM_S
        mine, refusal = steered.orders, ""
        while self._clock.elapsed_s() < deadline_s:
            seen = vehicle.heartbeats
            try:
                await self._ask_mode(vehicle, mode)
            except VehicleRefused as error:
                if mode != "hold":
                    raise
                refusal = f"; {error}"  # a vehicle that will not hold is told again
            if await self._until(
                lambda seen=seen: vehicle.heartbeats > seen and vehicle.actual_mode == mode,  # type: ignore[misc]
                1.5,
            ):
                return
            if steered.orders != mine:
                raise VehicleRefused(
                    f"{vehicle.robot}: change mode to {mode}: a newer command came in between"
                )
        raise DeviceTimeout(
            f"{vehicle.robot} (system {vehicle.system_id}): did not show mode {mode} within {CONFIRM_S:g} s"
            + ("" if vehicle.link_up else "; its link is lost")
            + refusal
        )

    async def _ask_mode(self, vehicle: Vehicle, mode: VehicleMode) -> None:
        """Ask once. No answer is no error here: the heartbeat tells."""
        firmware = vehicle.firmware
        if firmware is None:
            return
        with contextlib.suppress(DeviceTimeout):
            await self._commander.ask(
                vehicle,
                f"change mode to {mode}",
                lambda n: set_mode(vehicle.system_id, firmware, mode, n),
                tries=1,
                wait_s=0.5,
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
