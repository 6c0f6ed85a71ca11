"""The emulated field in its own process, with the real drivers on its wires."""

import asyncio
import multiprocessing
import subprocess
import sys
import textwrap
import time
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benches import FRAME, around, free_udp_port, until

from drivers.emulators.field import EmulatedRobot, FieldSpec, emulate, start
from drivers.mavlink.fleet import open_link
from drivers.xbee.receiver import open_receiver
from fieldkit import plugins
from fieldkit.channel.model import Antenna
from fieldkit.channel.pattern import lobe_gain_db
from fieldkit.clock import ScaledClock
from fieldkit.errors import DeviceError
from fieldkit.messages import Pose, ReceiverState, RssReading, Waypoint
from fieldkit.world.sources import TransientSource

ANTENNA = Antenna(path_loss_exponent=2.0, power_at_1m_dbm=-50.0, sigma_db=2.0, threshold_dbm=-92.0)
ROBOTS = tuple(EmulatedRobot(f"r{n}", n + 1, 2.5 * n, 0.0) for n in range(4))


def spec(rate=20.0, **change) -> FieldSpec:
    standard = {
        "clock": ScaledClock(rate),
        "frame": FRAME,
        "antenna": ANTENNA,
        "sources": (TransientSource(2.0, 5.0, 0.0, 1.0), TransientSource(8.0, 5.0, 3.0, 1.0)),
        "robots": ROBOTS,
        "vehicle_address": f"127.0.0.1:{free_udp_port()}",
        "seed": 7,
        "pose_noise_m": 0.03,
    }
    return FieldSpec(**(standard | change))


def test_the_field_is_found_by_name():
    assert plugins.load("fieldkit.emulators", "field") is emulate


class Joined:
    """A field's radios and vehicles behind their real drivers, and everything they have given."""

    def __init__(self, made, field, link):
        self.made, self.field, self.link = made, field, link
        self.readings, self.states, self.poses = [], [], {}

    async def listen(self, receiver):
        async for item in receiver.readings():
            (self.readings if isinstance(item, RssReading) else self.states).append(item)

    async def follow(self):
        async for item in self.link.events():
            if isinstance(item, Pose):
                self.poses[item.robot] = item

    async def beat(self):
        while True:
            self.link.beat()
            await self.made.clock.sleep(1.0)


@asynccontextmanager
async def joined():
    made = spec()
    field = await asyncio.to_thread(start, made)
    async with AsyncExitStack() as stack:
        stack.callback(field.close)
        receivers = [
            await stack.enter_async_context(open_receiver(name, {"port": port}, around(made.clock)))
            for name, port in field.receiver_ports.items()
        ]
        ids = {robot.name: {"system_id": robot.system_id} for robot in ROBOTS}
        address = f"udpin:{made.vehicle_address}"
        link = await stack.enter_async_context(open_link(address, ids, around(made.clock)))
        team = Joined(made, field, link)
        jobs = (*map(team.listen, receivers), team.follow(), team.beat())
        tasks = [asyncio.create_task(job) for job in jobs]
        try:
            yield team
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
    field.close()
    assert not multiprocessing.active_children()


async def test_four_robots_hear_drive_and_are_heard():
    async with joined() as team:
        field = team.field
        opening = {name: each["bytes_from_host"] for name, each in field.counts()["robots"].items()}
        await asyncio.gather(*(team.link.acquire_control(robot.name) for robot in ROBOTS))
        goals = {robot.name: (robot.east_m, 3.0) for robot in ROBOTS}
        await asyncio.gather(
            *(team.link.goto(name, Waypoint(*goal, speed_m_s=0.4)) for name, goal in goals.items())
        )

        def arrived():
            truth = field.truth()
            return all(
                np.hypot(truth[n][0] - e, truth[n][1] - north) < 0.15 for n, (e, north) in goals.items()
            )

        await until(arrived)
        await team.made.clock.sleep(1.0)
        truth = field.truth()
        for name, pose in team.poses.items():
            assert np.hypot(pose.east_m - truth[name][0], pose.north_m - truth[name][1]) < 0.25
        counts = field.counts()
        await until(lambda: len(team.readings) >= sum(each["frames"] for each in counts["robots"].values()))
        assert {reading.robot for reading in team.readings} == set(goals)
        assert all(each["frames_lost"] == each["transmitted"] == 0 for each in counts["robots"].values())
        assert {name: each["bytes_from_host"] for name, each in counts["robots"].items()} == opening


async def test_an_unplugged_radio_and_a_silent_vehicle_are_told_from_the_others():
    async with joined() as team:
        await asyncio.gather(*(team.link.acquire_control(robot.name) for robot in ROBOTS))
        states = team.states
        team.field.unplug("r1")
        await until(lambda: states[-1].robot == "r1" and not states[-1].up)
        team.field.replug("r1")
        await until(lambda: states[-1] == ReceiverState(states[-1].t_ns, "r1", True, states[-1].reason))
        team.field.silence_vehicle("r2")
        await asyncio.gather(*(team.link.hold(robot.name) for robot in ROBOTS if robot.name != "r2"))
        with pytest.raises(DeviceError):
            await team.link.hold("r2")


async def test_levels_fall_off_with_distance_as_the_antenna_says(listening):
    source = TransientSource(0.0, 0.0, 0.0, 40.0)
    robots = (EmulatedRobot("near", 1, 2.0, 0.0), EmulatedRobot("far", 2, 20.0, 0.0))
    with await asyncio.to_thread(start, spec(rate=1.0, sources=(source,), robots=robots)) as field:
        ports = field.receiver_ports
        async with listening(ports["near"]) as near, listening(ports["far"]) as far:
            await until(lambda: min(len(near.readings), len(far.readings)) >= 60)
    mean_dbm = [np.mean([reading.rss_dbm for reading in heard.readings]) for heard in (near, far)]
    # Ten times the distance at exponent 2: 20 dB.
    assert mean_dbm[0] - mean_dbm[1] == pytest.approx(20.0, abs=1.5)


async def test_an_unknown_fault_or_robot_is_refused():
    with await asyncio.to_thread(start, spec()) as field:
        for fault, robot in (("melt", "r0"), ("unplug", "nobody"), ("_x", "r0")):
            with pytest.raises(ValueError, match=fault):
                field.inject(fault, robot)
        field.close()
        field.close()
        with pytest.raises(DeviceError):
            field.truth()


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_the_field_dies_with_a_killed_parent(tmp_path):
    program = tmp_path / "parent.py"
    program.write_text(
        textwrap.dedent("""
        import multiprocessing, time
        from drivers.emulators.field import EmulatedRobot, FieldSpec, start
        from fieldkit.channel.model import Antenna
        from fieldkit.clock import ScaledClock
        from fieldkit.geo import FieldFrame

        if __name__ == "__main__":
            robots = (EmulatedRobot("a", 1, 0.0, 0.0),)
            antenna = Antenna(2.0, -50.0, 2.0, -92.0)
            start(FieldSpec(ScaledClock(1.0), FieldFrame(0.0, 0.0), antenna, (), robots, "127.0.0.1:9", 1))
            print(multiprocessing.active_children()[0].pid, flush=True)
            time.sleep(60)
        """)
    )
    with subprocess.Popen([sys.executable, str(program)], stdout=subprocess.PIPE, text=True) as parent:
        child = int(parent.stdout.readline())
        parent.kill()
        for _ in range(100):
            if not is_alive(child):
                return
            time.sleep(0.05)
    raise AssertionError("the emulated field outlived its parent")


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except FileNotFoundError:
        return False


async def test_a_radio_with_a_directional_antenna_hears_what_its_robot_faces():
    gains = tuple(float(g) for g in lobe_gain_db(np.arange(360.0), 0.0, 4.0, -20.0))
    beam = replace(ANTENNA, sigma_db=1.0, pattern_db=gains)
    robots = (EmulatedRobot("front", 1, 0.0, 0.0, 0.0), EmulatedRobot("back", 2, 0.0, 0.0, 180.0))
    made = spec(antenna=beam, sources=(TransientSource(0.0, 5.0, 0.0, 2.0),), robots=robots)
    field = await asyncio.to_thread(start, made)
    heard = {robot.name: [] for robot in robots}
    async with AsyncExitStack() as stack:
        stack.callback(field.close)
        receivers = [
            await stack.enter_async_context(open_receiver(name, {"port": port}, around(made.clock)))
            for name, port in field.receiver_ports.items()
        ]

        async def listen(receiver):
            async for item in receiver.readings():
                if isinstance(item, RssReading):
                    heard[item.robot].append(item.rss_dbm)

        tasks = [asyncio.create_task(listen(receiver)) for receiver in receivers]
        await until(lambda: min(map(len, heard.values())) >= 12)
        for task in tasks:
            task.cancel()
    assert np.mean(heard["front"]) - np.mean(heard["back"]) == pytest.approx(20.0, abs=2.0)
