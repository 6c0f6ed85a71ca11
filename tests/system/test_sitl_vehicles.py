"""The emulated vehicles' scenarios on ArduPilot's simulators: `FIELDKIT_SITL=<folder> pytest tests/system`."""

import asyncio
import json
import os
import random
import signal
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "contract"))
from benches import FRAME, around, free_udp_port
from scenarios import SCENARIOS, Drive, driving
from sitl import READY_S, Simulated, binary, simulators

from drivers.mavlink.fleet import MavlinkLink, open_link
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceTimeout, VehicleRefused
from fieldkit.messages import Waypoint

pytestmark = pytest.mark.timeout(900)


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
@pytest.mark.parametrize("kind", ["rover", "copter"])
async def test_a_simulated_vehicle_does_what_the_emulated_one_does(
    kind: str, scenario: Callable[[Drive], Awaitable[None]], tmp_path: Path
) -> None:
    if scenario.__name__.startswith("a_copter") and kind != "copter":
        pytest.skip("for copters")
    binary(kind)
    clock, port = RealClock(), free_udp_port()
    vehicle = Simulated(kind, 1, FRAME.origin_lat_deg, FRAME.origin_lon_deg)
    async with simulators([vehicle], tmp_path, port):
        link = open_link(f"udpin:127.0.0.1:{port}", {"ada": {"system_id": 1}}, around(clock))
        async with driving(link, clock, READY_S) as drive:
            try:
                await drive.until(lambda: drive.vehicle.healthy_to_arm)
                await scenario(drive)
            finally:
                report(kind, scenario.__name__, drive)


async def test_a_vehicle_that_froze_and_goes_on_is_not_old_for_good(tmp_path: Path) -> None:
    """Stopped by a signal for 14 s, its clock stands still: a round trip tells what the time is."""
    clock, port = RealClock(), free_udp_port()
    vehicle = Simulated("rover", 1, FRAME.origin_lat_deg, FRAME.origin_lon_deg)
    async with simulators([vehicle], tmp_path, port) as (process,):
        link = open_link(f"udpin:127.0.0.1:{port}", {"ada": {"system_id": 1}}, around(clock))
        async with driving(link, clock, READY_S) as drive:
            process.send_signal(signal.SIGSTOP)
            await clock.sleep(14.0)
            process.send_signal(signal.SIGCONT)
            began_s = clock.elapsed_s()
            await drive.until(lambda: drive.poses[-1].t_ns > clock.now_ns() - 1e9)
            drive.measured["fresh again after s"] = clock.elapsed_s() - began_s
            report("rover", "froze", drive)


async def test_four_rovers_hold_over_links_that_lose_every_answer_and_a_third_of_the_frames(
    tmp_path: Path,
) -> None:
    """While their next way-points are being confirmed; ten times over."""
    clock, port, rng = RealClock(), free_udp_port(), random.Random(7)
    places = [FRAME.to_geodetic(10.0 * number, 0.0) for number in range(4)]
    rovers = [Simulated("rover", number, lat, lon) for number, (lat, lon, _) in enumerate(places, start=1)]
    names = ["ada", "bob", "cyd", "dan"]
    robots = {name: {"system_id": number} for number, name in enumerate(names, start=1)}
    async with simulators(rovers, tmp_path, port):
        link = open_link(f"udpin:127.0.0.1:{port}", robots, around(clock))
        async with driving(link, clock, READY_S) as drive:
            vehicles = [steered.vehicle for steered in link._steered.values()]
            for name in names:
                await ready(link, name, clock)
            send, heard, taken_s = link._transport.send, link._commander.heard, []
            for attempt in range(10):
                north_m = 60.0 if attempt % 2 == 0 else 0.0
                aims = {name: Waypoint(10.0 * k, north_m, 1.5) for k, name in enumerate(names)}
                await asyncio.gather(*(link.goto(name, aim) for name, aim in aims.items()))
                await clock.sleep(3.0)
                link._transport.send = lambda data, peer: send(data, peer) if rng.random() > 0.3 else None
                link._commander.heard = lambda *_: None  # type: ignore[method-assign]
                busy = [asyncio.create_task(link.goto(name, aim)) for name, aim in aims.items()]
                await clock.sleep(0.2)
                began_s = clock.elapsed_s()
                for name in names:
                    link.stop(name)
                waiting = list(vehicles)
                while waiting:
                    await asyncio.sleep(0.005)
                    taken_s += [clock.elapsed_s() - began_s for v in waiting if v.actual_mode == "hold"]
                    waiting = [vehicle for vehicle in waiting if vehicle.actual_mode != "hold"]
                await asyncio.gather(*busy, return_exceptions=True)
                link._transport.send, link._commander.heard = send, heard  # type: ignore[method-assign]
            taken_s.sort()
            drive.measured |= {"holds": len(taken_s), "median s": taken_s[20], "longest s": taken_s[-1]}
            report("rover", "four hold over a bad link", drive)
    assert len(taken_s) == 40


async def ready(link: MavlinkLink, name: str, clock: RealClock) -> None:
    """Ours and armed; a simulator takes its time until it would arm."""
    for _ in range(60):
        try:
            await link.acquire_control(name)
            return
        except (VehicleRefused, DeviceTimeout):
            link.beat()
            await clock.sleep(1.0)
    raise AssertionError(f"{name} does not arm")


def report(kind: str, name: str, drive: Drive) -> None:
    """What was measured, one line of JSON a scenario, where FIELDKIT_SITL_REPORT names a file for it."""
    if path := os.environ.get("FIELDKIT_SITL_REPORT"):
        texts = [text for _, text, _ in drive.vehicle.texts]
        line = {"vehicle": kind, "scenario": name, "measured": drive.measured, "texts": texts}
        with Path(path).open("a") as file:
            file.write(json.dumps(line) + "\n")
