"""The emulated vehicles' scenarios on ArduPilot's simulators: `FIELDKIT_SITL=<folder> pytest tests/system`."""

import json
import os
import signal
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "contract"))
from benches import FRAME, around, free_udp_port
from scenarios import SCENARIOS, Drive, driving
from sitl import READY_S, Simulated, binary, simulators

from drivers.mavlink.fleet import open_link
from fieldkit.clock import RealClock

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


def report(kind: str, name: str, drive: Drive) -> None:
    """What was measured, one line of JSON a scenario, where FIELDKIT_SITL_REPORT names a file for it."""
    if path := os.environ.get("FIELDKIT_SITL_REPORT"):
        texts = [text for _, text, _ in drive.vehicle.texts]
        line = {"vehicle": kind, "scenario": name, "measured": drive.measured, "texts": texts}
        with Path(path).open("a") as file:
            file.write(json.dumps(line) + "\n")
