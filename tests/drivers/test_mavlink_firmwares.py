"""The same orders to three firmwares, each with its own quirks; and to a real simulator where there is one."""

import asyncio
import os
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest
from benches import FRAME, around, free_udp_port, rovers_on_udp, until

from drivers.emulators.fence import edge_ahead_m
from drivers.emulators.profiles import COPTER, PROFILES, ROVER, Profile
from drivers.emulators.rover import RoverAutopilot
from drivers.mavlink.codec import Packer, Parser, mavlink
from drivers.mavlink.fleet import MavlinkLink, open_link
from drivers.mavlink.plans import polygon_fence
from fieldkit.clock import RealClock, ScaledClock
from fieldkit.errors import VehicleRefused
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose, VehicleState, Waypoint
from fieldkit.ports import Surroundings
from fieldkit.world.rover import Rover

SQUARE_M = [(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)]


class Told:
    """What a link has said of its one vehicle."""

    def __init__(self) -> None:
        self.pose: Pose | None = None
        self.state: VehicleState | None = None

    def is_at(self, east_m: float, north_m: float, within_m: float = 0.3) -> bool:
        pose = self.pose
        return pose is not None and np.hypot(pose.east_m - east_m, pose.north_m - north_m) < within_m


@asynccontextmanager
async def steering(link: MavlinkLink, beat_s: float = 0.1) -> AsyncIterator[Told]:
    """An open link whose events are taken and whose heartbeat goes out."""
    told = Told()

    async def listen() -> None:
        async for item in link.events():
            if isinstance(item, Pose):
                told.pose = item
            else:
                told.state = item

    async def beat() -> None:
        while True:
            link.beat()
            await asyncio.sleep(beat_s)

    async with link:
        tasks = [asyncio.create_task(listen()), asyncio.create_task(beat())]
        try:
            yield told
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)


async def scenario(link: MavlinkLink, told: Told, up_m: float, timeout_s: float) -> None:
    """Discover, check, take over, go, hold, go on, return: what every firmware must do for us."""
    await until(lambda: told.pose is not None, timeout_s)
    assert told.pose is not None
    home = (told.pose.east_m, told.pose.north_m)
    checks = await link.inspect("ada")
    assert not [check for check in checks if check.level == "red"], checks
    await link.take_over("ada")
    await until(lambda: told.state is not None and told.state.armed, timeout_s)
    there = (home[0] + 3.0, home[1] + 4.0)
    await link.goto("ada", Waypoint(*there, 1.0, up_m))
    await until(lambda: told.is_at(*there, within_m=1.0), timeout_s)
    await link.hold("ada")
    await until(lambda: told.state is not None and told.state.mode == "hold", timeout_s)
    await link.goto("ada", Waypoint(home[0], home[1] + 4.0, 1.0, up_m))
    await until(lambda: told.is_at(home[0], home[1] + 4.0, within_m=1.0), timeout_s)
    await link.return_home("ada")
    await until(lambda: told.is_at(*home, within_m=1.0), timeout_s)
    with pytest.raises(VehicleRefused):
        await link.goto("ada", Waypoint(float("nan"), 0.0, 1.0))


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
async def test_every_firmware_takes_the_same_orders(profile: Profile) -> None:
    clock, port = ScaledClock(10.0), free_udp_port()
    async with rovers_on_udp({1: (0.0, 0.0)}, clock, port, gcs_failsafe_s=40.0, profile=profile):
        link = open_link(f"udpin:127.0.0.1:{port}", {"ada": {"system_id": 1}}, around(clock))
        async with steering(link) as told:
            await scenario(link, told, 2.0, 20.0)


async def test_on_a_real_simulator(tmp_path: Path) -> None:
    """`FIELDKIT_SITL=/path/to/ardurover` runs the same scenario on ArduPilot's own simulator."""
    binary = os.environ.get("FIELDKIT_SITL", "")
    if not binary or shutil.which(binary) is None:
        pytest.skip("no simulator: set FIELDKIT_SITL to an ardurover binary")
    lat_deg, lon_deg = 47.3977, 8.5456
    (tmp_path / "extra.parm").write_text("FS_GCS_ENABLE 1\nFS_ACTION 2\nMAV_GCS_SYSID 245\n")
    simulator = await asyncio.create_subprocess_exec(
        binary, "--model", "rover", "--home", f"{lat_deg},{lon_deg},0,0", "--speedup", "1", "--wipe",
        "--defaults", str(tmp_path / "extra.parm"),
        cwd=tmp_path, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL,
    )  # fmt: skip
    try:
        await asyncio.sleep(3.0)
        around_it = Surroundings(RealClock(), FieldFrame(lat_deg, lon_deg))
        link = open_link("tcp:127.0.0.1:5760", {"ada": {"system_id": 1}}, around_it)
        async with steering(link, 1.0) as told:
            await scenario(link, told, 0.0, 120.0)
    finally:
        simulator.kill()
        await simulator.wait()


# Quirks measured on the simulators


class Bench:
    """One autopilot without a wire."""

    def __init__(self, profile: Profile) -> None:
        body = Rover(0.0, 0.0, max_speed_m_s=2.0)
        self.rover = RoverAutopilot(1, body, FRAME, np.random.default_rng(1), profile=profile)
        self.packer, self.parser, self.t_s = Packer(245, 190), Parser(), 0.0
        self.tell(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        self.rover._change_mode(profile.guided)

    def tell(self, message: object) -> list[object]:
        return list(self.parser.parse(self.rover.receive(self.packer.pack(message), self.t_s)))

    def run(self, duration_s: float) -> list[object]:
        heard: list[object] = []
        for _ in range(int(duration_s * 10)):
            self.t_s += 0.1
            heard += self.parser.parse(self.rover.update(self.t_s))
        return heard

    def fence(self) -> None:
        corners = [FRAME.to_geodetic(east, north)[:2] for east, north in SQUARE_M]
        items = polygon_fence([(round(a * 1e7), round(o * 1e7)) for a, o in corners])
        self.rover.plans.items[1] = [
            mavlink.MAVLink_mission_item_int_message(
                1, 1, n, 0, item.command, 0, 1, *item.params, item.lat_e7, item.lon_e7, 0, 1
            )
            for n, item in enumerate(items)
        ]
        self.rover.parameters["FENCE_ENABLE"] = 1.0

    def reposition(self, east_m: float, north_m: float) -> int:
        lat, lon, _ = FRAME.to_geodetic(east_m, north_m)
        message = mavlink.MAVLink_command_int_message(
            1, 1, 6, 192, 0, 0, 2.0, 1, 0, float("nan"), round(lat * 1e7), round(lon * 1e7), 0
        )
        return next(m.result for m in self.tell(message) if m.get_type() == "COMMAND_ACK")  # type: ignore[attr-defined]


def test_a_rover_stops_before_its_own_fence_and_says_nothing() -> None:
    bench = Bench(ROVER)
    bench.fence()
    assert bench.reposition(0.0, 40.0) == 0, "accepted: a rover takes targets outside its fence"
    said = bench.run(60.0)
    assert 16.0 < bench.rover.body.north_m < 18.0
    assert bench.rover.mode == ROVER.guided
    assert not [m for m in said if m.get_type() == "STATUSTEXT"]  # type: ignore[attr-defined]
    bench.reposition(0.0, 0.0)
    bench.run(30.0)
    assert bench.rover.body.north_m < 1.0, "away from the fence it drives"


def test_a_copter_fails_a_target_outside_its_fence() -> None:
    bench = Bench(COPTER)
    bench.fence()
    assert bench.reposition(0.0, 40.0) == 4
    assert bench.reposition(0.0, 10.0) == 0


def test_a_copter_drops_a_position_target_without_height() -> None:
    lat, lon, _ = FRAME.to_geodetic(0.0, 10.0)
    for profile, mask, moves in ((COPTER, 0x0DFC, False), (COPTER, 0x0DF8, True), (ROVER, 0x0DFC, True)):
        bench = Bench(profile)
        numbers = [0.0] * 9
        bench.tell(
            mavlink.MAVLink_set_position_target_global_int_message(
                0, 1, 1, 6, mask, round(lat * 1e7), round(lon * 1e7), *numbers
            )
        )
        bench.run(5.0)
        assert (bench.rover.body.north_m > 1.0) == moves


def test_mode_four_holds_a_rover_and_sets_a_copter_free() -> None:
    """Why nothing is ever broadcast: one DO_SET_MODE 4 means opposite things."""
    for profile, mode in ((ROVER, ROVER.hold), (COPTER, COPTER.guided)):
        bench = Bench(profile)
        bench.tell(mavlink.MAVLink_command_long_message(0, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0))
        assert bench.rover.mode == mode == 4


def test_the_edge_ahead_is_where_the_way_leaves_the_fence() -> None:
    assert edge_ahead_m((0.0, 0.0), (0.0, 5.0), SQUARE_M) == pytest.approx(20.0)
    assert edge_ahead_m((5.0, 0.0), (9.0, 0.0), SQUARE_M) == pytest.approx(15.0)
    assert edge_ahead_m((5.0, 0.0), (5.0, 0.0), SQUARE_M) == pytest.approx(15.0)
    assert edge_ahead_m((30.0, 0.0), (0.0, 0.0), SQUARE_M) == pytest.approx(-10.0)
