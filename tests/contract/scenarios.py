"""What a vehicle does, whoever plays it: run against the emulated vehicles always, and against ArduPilot's simulators.

The emulated ones cannot drift from the real ones unnoticed: the same expectations hold for both.
"""

import asyncio
import math
import random
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

import pytest
from benches import until

from drivers.mavlink.codec import mavlink
from drivers.mavlink.fleet import MavlinkLink
from drivers.mavlink.modes import COPTER, PX4, ROVER
from drivers.mavlink.plans import FENCE
from drivers.mavlink.steered import change_speed
from fieldkit.clock import Clock
from fieldkit.errors import DeviceTimeout, VehicleRefused
from fieldkit.messages import Pose, VehicleState, Waypoint
from fieldkit.ports import Demands

ROBOT = "ada"
UP_M = 5.0


@dataclass
class Drive:
    """One vehicle on an open link, and everything that it has told."""

    link: MavlinkLink
    clock: Clock
    patience_s: float
    """Wall seconds for anything to happen."""
    poses: list[Pose] = field(default_factory=list)
    states: list[VehicleState] = field(default_factory=list)
    beats: bool = True
    measured: dict[str, float] = field(default_factory=dict)

    @property
    def vehicle(self):
        return next(iter(self.link._steered.values())).vehicle

    @property
    def at(self) -> tuple[float, float]:
        return self.poses[-1].east_m, self.poses[-1].north_m

    @property
    def state(self) -> VehicleState:
        return self.states[-1]

    @property
    def speed_m_s(self) -> float:
        return self.vehicle.speed_m_s or 0.0

    @property
    def up_m(self) -> float:
        return UP_M if self.vehicle.flies else 0.0

    async def until(self, condition: Callable[[], object]) -> None:
        await until(condition, self.patience_s)

    async def stands(self) -> None:
        """Wait until it has stopped moving."""
        await self.until(lambda: self.speed_m_s < 0.05)
        await self.clock.sleep(1.0)
        await self.until(lambda: self.speed_m_s < 0.05)

    async def ready(self) -> None:
        """Ours, armed, and in the air where it flies. A simulator takes its time until it would arm."""
        for _ in range(60):
            with suppress(VehicleRefused, DeviceTimeout):
                await self.link.acquire_control(ROBOT)
                break
            await self.clock.sleep(2.0)
        if self.vehicle.flies:
            await self.until(lambda: self.vehicle.on_ground is not None)
            await self.link.take_off(ROBOT, self.up_m)

    async def go(self, east_m: float, north_m: float, speed_m_s: float = 1.0) -> None:
        await self.link.goto(ROBOT, Waypoint(east_m, north_m, speed_m_s, self.up_m))

    async def raw(self, message) -> int | None:
        """A command as it is, and its answer."""
        commander, vehicle = self.link._commander, self.vehicle
        commander.note(vehicle, message.command)
        self.link._send(vehicle, message)
        for _ in range(40):
            await self.clock.sleep(0.1)
            if (answer := commander.noted(vehicle, message.command)) is not None:
                return answer
        return None

    def reposition(self, east_m: float, north_m: float, up_m: float, speed_m_s: float):
        lat_deg, lon_deg, _ = self.link._frame.to_geodetic(east_m, north_m)
        return mavlink.MAVLink_command_int_message(
            self.vehicle.system_id, 1, 6, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, speed_m_s, 1, 0, math.nan,
            round(lat_deg * 1e7), round(lon_deg * 1e7), up_m,
        )  # fmt: skip


@asynccontextmanager
async def driving(link: MavlinkLink, clock: Clock, patience_s: float) -> AsyncIterator[Drive]:
    """An open link whose events are taken and whose heartbeat goes out, its vehicle heard."""
    drive = Drive(link, clock, patience_s)

    async def listen() -> None:
        async for item in link.events():
            (drive.poses if isinstance(item, Pose) else drive.states).append(item)  # type: ignore[arg-type]

    async def beat() -> None:
        while True:
            if drive.beats:
                link.beat()
            await clock.sleep(1.0)

    async with link:
        tasks = [asyncio.create_task(listen()), asyncio.create_task(beat())]
        try:
            await drive.until(lambda: drive.poses and drive.states)
            yield drive
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)


async def goes_holds_goes_on_and_returns(drive: Drive) -> None:
    """The whole of what a mission asks of a vehicle."""
    await drive.ready()
    east_m, north_m = drive.at
    await drive.go(east_m + 20.0, north_m)
    fastest = 0.0

    def arrives() -> bool:
        nonlocal fastest
        fastest = max(fastest, drive.speed_m_s)
        return math.dist(drive.at, (east_m + 20.0, north_m)) < 1.0

    await drive.until(arrives)
    assert fastest > 0.6, "it drives"
    drive.measured["fastest at 1 m/s"] = fastest
    await drive.stands()
    drive.measured["rests from its way-point m"] = math.dist(drive.at, (east_m + 20.0, north_m))
    await drive.go(east_m, north_m)
    await drive.until(lambda: drive.speed_m_s > 0.7)
    began_s, there = drive.clock.elapsed_s(), drive.at
    await drive.link.hold(ROBOT)
    drive.measured["hold shown s"] = drive.clock.elapsed_s() - began_s
    await drive.until(lambda: drive.state.mode == "hold")
    await drive.stands()
    drive.measured["stands after hold s"] = drive.clock.elapsed_s() - began_s - 1.0
    drive.measured["rolls on m"] = math.dist(drive.at, there)
    await drive.go(east_m, north_m)
    await drive.until(lambda: drive.state.mode == "guided" and drive.speed_m_s > 0.5)
    with pytest.raises(VehicleRefused):
        await drive.link.goto(ROBOT, Waypoint(math.nan, 0.0, 1.0, drive.up_m))
    await drive.link.return_home(ROBOT)
    await drive.until(lambda: drive.state.mode == "return" or not drive.state.armed)
    await drive.until(lambda: math.dist(drive.at, (east_m, north_m)) < 4.0)
    await drive.stands()
    drive.measured["home within m"] = math.dist(drive.at, (east_m, north_m))
    if drive.vehicle.flies:
        await drive.until(lambda: not drive.state.armed)


async def takes_no_speed_before_it_has_a_way_point(drive: Drive) -> None:
    """ArduRover in Guided's stop submode: a reposition with a speed fails and is not taken; without one it goes."""
    await drive.ready()
    if drive.vehicle.firmware is not ROVER:
        return
    east_m, north_m = drive.at
    assert await drive.raw(change_speed(drive.vehicle, 1.0, 0)) == mavlink.MAV_RESULT_FAILED
    answer = await drive.raw(drive.reposition(east_m + 10.0, north_m, 0.0, 1.0))
    assert answer == mavlink.MAV_RESULT_FAILED
    await drive.clock.sleep(3.0)
    assert math.dist(drive.at, (east_m, north_m)) < 0.3, "and it did not set out"
    assert await drive.raw(drive.reposition(east_m + 10.0, north_m, 0.0, -1.0)) == mavlink.MAV_RESULT_ACCEPTED
    assert await drive.raw(change_speed(drive.vehicle, 1.0, 0)) == mavlink.MAV_RESULT_ACCEPTED
    await drive.until(lambda: drive.speed_m_s > 0.5)
    await drive.link.hold(ROBOT)


async def a_copter_needs_an_altitude(drive: Drive) -> None:
    """Altitude 0 is denied; on the ground it takes a place, does nothing, and disarms itself."""
    if drive.vehicle.firmware is not COPTER:
        return
    for _ in range(60):
        with suppress(VehicleRefused, DeviceTimeout):
            await drive.link.acquire_control(ROBOT)
            break
        await drive.clock.sleep(2.0)
    assert drive.state.armed
    east_m, north_m = drive.at
    assert await drive.raw(drive.reposition(east_m + 10.0, north_m, 0.0, -1.0)) == mavlink.MAV_RESULT_DENIED
    with pytest.raises(VehicleRefused, match="no height"):
        await drive.link.goto(ROBOT, Waypoint(east_m + 10.0, north_m, 1.0))
    with pytest.raises(VehicleRefused, match="take off first"):
        await drive.link.goto(ROBOT, Waypoint(east_m + 10.0, north_m, 1.0, UP_M))
    began_s = drive.clock.elapsed_s()
    await drive.until(lambda: not drive.state.armed)
    drive.measured["disarms itself on the ground s"] = drive.clock.elapsed_s() - began_s
    assert math.dist(drive.at, (east_m, north_m)) < 1.0


async def a_copter_takes_off_flies_level_and_lands(drive: Drive) -> None:
    if drive.vehicle.firmware is not COPTER:
        return
    await drive.ready()
    await drive.until(lambda: abs(drive.poses[-1].up_m - UP_M) < 0.6)
    await drive.link.take_off(ROBOT, UP_M + 2.0)
    # One that flies climbs; the pose that says so may come after the order has ended.
    await drive.until(lambda: drive.poses[-1].up_m == pytest.approx(UP_M + 2.0, abs=0.8))
    east_m, north_m = drive.at
    begin = len(drive.poses)
    await drive.link.goto(ROBOT, Waypoint(east_m + 10.0, north_m, 1.5, UP_M + 2.0))
    await drive.until(lambda: math.dist(drive.at, (east_m + 10.0, north_m)) < 0.5)
    heights = [pose.up_m for pose in drive.poses[begin:]]
    assert max(heights) < UP_M + 3.5 and min(heights) > UP_M + 0.5
    await drive.link.land(ROBOT)
    await drive.until(lambda: drive.state.mode == "land" or not drive.state.armed)
    await drive.until(lambda: not drive.state.armed)
    assert drive.poses[-1].up_m < 1.0


async def says_why_it_would_not_arm_when_asked(drive: Drive) -> None:
    """A fence enabled and none loaded is a reason; asked, it says so at once."""
    if drive.vehicle.firmware is PX4:
        return
    await drive.until(lambda: drive.vehicle.healthy_to_arm)
    assert await drive.link.set_parameter(ROBOT, "FENCE_TYPE", 4.0)
    await drive.link.upload(ROBOT, FENCE, [])
    assert await drive.link.set_parameter(ROBOT, "FENCE_ENABLE", 1.0)
    await drive.until(lambda: drive.vehicle.healthy_to_arm is False)
    checks = {check.name: check for check in await drive.link.inspect(ROBOT)}
    assert checks["arming"].level == "red", checks["arming"]
    assert "fence" in checks["arming"].found.lower(), checks["arming"]
    assert await drive.link.set_parameter(ROBOT, "FENCE_ENABLE", 0.0)


async def a_fence_is_put_and_put_back(drive: Drive) -> None:
    """What was in the vehicle before is there again afterwards."""
    east_m, north_m = drive.at
    own = square(east_m, north_m, 60.0)
    before = await drive.link.stored_fence(ROBOT)
    await drive.link.put_fence(ROBOT, own)
    kept = await drive.link.download(ROBOT, FENCE)
    ours = square(east_m, north_m, 40.0)
    stored = await drive.link.stored_fence(ROBOT)
    await drive.link.put_fence(ROBOT, ours)
    assert len(stored.items) == 4 and stored.enabled in (1.0, None)
    demands = Demands(10.0, ours, True, square(east_m, north_m, 30.0))
    checks = {check.name: check for check in await drive.link.inspect(ROBOT, demands)}
    assert checks["fence"].level == "green", checks["fence"]
    await drive.link.restore_fence(stored)
    assert await drive.link.download(ROBOT, FENCE) == kept
    await drive.link.restore_fence(before)
    assert len(await drive.link.download(ROBOT, FENCE)) == len(before.items)


async def holds_by_itself_when_we_fall_silent(drive: Drive) -> None:
    """What preflight calls green is what the vehicle does. PX4 cannot be seen to: it holds and goes in one mode."""
    if drive.vehicle.firmware is PX4:
        return
    await drive.ready()
    checks = [check for check in await drive.link.inspect(ROBOT) if check.name == "failsafe"]
    assert [check.level for check in checks] == ["green"], checks
    east_m, north_m = drive.at
    await drive.go(east_m + 60.0, north_m, 2.0)
    await drive.until(lambda: drive.speed_m_s > 1.0)
    drive.beats = False
    began_s = drive.clock.elapsed_s()
    await drive.until(lambda: drive.state.mode in ("hold", "other", "land"))
    drive.measured["failsafe acts after s"] = drive.clock.elapsed_s() - began_s
    await drive.until(lambda: drive.vehicle.actual_mode in ("hold", "land"))
    await drive.stands()
    assert math.dist(drive.at, (east_m + 60.0, north_m)) > 5.0, "it stopped on the way"
    drive.beats = True


async def holds_though_answers_and_frames_are_lost(drive: Drive) -> None:
    """Every acknowledgement and 30 % of what is sent is lost, while a way-point is being confirmed."""
    await drive.ready()
    east_m, north_m = drive.at
    await drive.go(east_m + 40.0, north_m)
    await drive.until(lambda: drive.speed_m_s > 0.7)
    rng, send, heard = random.Random(5), drive.link._transport.send, drive.link._commander.heard
    taken_s = []
    for _ in range(5):
        drive.link._transport.send = lambda data, peer: send(data, peer) if rng.random() > 0.3 else None
        drive.link._commander.heard = lambda *_: None  # type: ignore[method-assign]
        going = asyncio.create_task(drive.go(east_m + 40.0, north_m + 1.0))
        await drive.clock.sleep(0.7)
        began_s = drive.clock.elapsed_s()
        await drive.link.hold(ROBOT)
        taken_s.append(drive.clock.elapsed_s() - began_s)
        assert drive.vehicle.actual_mode == "hold"
        with suppress(VehicleRefused, DeviceTimeout):
            await going
        drive.link._transport.send, drive.link._commander.heard = send, heard  # type: ignore[method-assign]
        await drive.go(east_m, north_m)
        await drive.until(lambda: drive.state.mode == "guided")
    drive.measured["longest of five holds over a bad link s"] = max(taken_s)


async def returns_at_a_speed_of_its_own(drive: Drive) -> None:
    """RTL takes WP_SPEED or RTL_SPEED, whatever the mission drove at: why preflight names them."""
    await drive.ready()
    traits = await drive.link.traits(ROBOT)
    east_m, north_m = drive.at
    await drive.go(east_m + 30.0, north_m)
    await drive.until(lambda: math.dist(drive.at, (east_m + 30.0, north_m)) < 2.0)
    await drive.stands()
    await drive.link.return_home(ROBOT)
    fastest = 0.0

    def home() -> bool:
        nonlocal fastest
        fastest = max(fastest, drive.speed_m_s)
        return math.dist(drive.at, (east_m, north_m)) < 4.0

    await drive.until(home)
    drive.measured["returns at m/s"] = fastest
    if drive.vehicle.firmware is not PX4:
        assert traits.return_m_s is not None and fastest > 0.7 * traits.return_m_s > 1.0


def square(east_m: float, north_m: float, half_m: float) -> tuple[tuple[float, float], ...]:
    return tuple((east_m + x * half_m, north_m + y * half_m) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))


SCENARIOS = {
    each.__name__: each
    for each in (
        goes_holds_goes_on_and_returns,
        takes_no_speed_before_it_has_a_way_point,
        a_copter_needs_an_altitude,
        a_copter_takes_off_flies_level_and_lands,
        says_why_it_would_not_arm_when_asked,
        a_fence_is_put_and_put_back,
        holds_by_itself_when_we_fall_silent,
        holds_though_answers_and_frames_are_lost,
        returns_at_a_speed_of_its_own,
    )
}
