"""Whole missions on ArduPilot's simulators with emulated radios: `fieldkit preflight` and `run`, as a user does it.

Everything that a recording tells is looked at: what was found, how fast the vehicles went, where they were.
"""

import asyncio
import json
import math
import os
import signal
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "contract"))
from benches import FRAME, around, free_udp_port, until
from sitl import READY_S, Simulated, simulators

from drivers.mavlink.fleet import open_link
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.clock import RealClock
from fieldkit.messages import Operator, Pose, VehicleState
from fieldkit.recording.reader import Recording, open_recording

pytestmark = pytest.mark.timeout(1500)

SIZE_M = 60.0
LIMIT_M_S = 1.5
WITHIN_M = 3.0
ANTENNA = Antenna(path_loss_exponent=2.5, power_at_1m_dbm=-50.0, sigma_db=3.0, threshold_dbm=-85.0)
HIDDEN_M = ((14.0, 44.0), (45.0, 38.0), (31.0, 18.0))
MISSION = """\
schema = 1
name = "on the simulators"
seed = 3
[field]
origin_lat_deg = {lat:.7f}
origin_lon_deg = {lon:.7f}
size_east_m = {size}
size_north_m = {size}
cell_m = 1.0
[antenna]
file = "antenna.toml"
[sources]
power_levels_db = [0.0]
rate_hz = 0.2
expected = 3.0
[engine]
belief = "intensity"
planner = "infogain"
found_probability = 0.9
planning_period_s = 20.0
pose_sigma_m = 0.5
[end]
max_duration_s = 900.0
sources_found = 3
[safety]
fence_margin_m = 5.0
max_speed_m_s = {limit}
min_separation_m = 5.0
overrun_s = {overrun_s}
stall_s = 30.0
vehicle_fence = true
vehicle_fence_beyond_m = 8.0
{teams}
{robots}
"""
ROBOT = """\
[[robot]]
name = "r{number}"
{flies}receiver = {{ driver = "xbee", port = "socket://127.0.0.1:{radio}" }}
[robot.vehicle]
driver = "mavlink"
address = "udpin:127.0.0.1:{port}"
system_id = {number}
forward = "127.0.0.1:{copy}"
"""


def mission_file(folder: Path, kinds: Sequence[str], port: int, copy: int, overrun_s: float = 10.0) -> Path:
    count = len(kinds)
    (folder / "antenna.toml").write_text(dump_antenna(AntennaFile(ANTENNA)))
    names = [f"r{k}" for k in range(1, count + 1)]
    teams = "\n".join(f"[[team]]\nrobots = {json.dumps(names[k : k + 2])}" for k in range(0, count, 2))
    robots = "\n".join(
        ROBOT.format(
            number=k,
            radio=free_udp_port(),
            port=port,
            copy=copy,
            flies=f"altitude_m = {7.0 + 3.0 * (k - 2):.1f}\n" if kind == "copter" else "",
        )
        for k, kind in enumerate(kinds, start=1)
    )
    path = folder / "mission.toml"
    path.write_text(
        MISSION.format(
            lat=FRAME.origin_lat_deg, lon=FRAME.origin_lon_deg, size=SIZE_M, limit=LIMIT_M_S, overrun_s=overrun_s,
            teams=teams, robots=robots,
        )
    )  # fmt: skip
    return path


async def fieldkit(folder: Path, *arguments: str) -> tuple[int, str]:
    """The program as a user starts it; its exit code and what it printed."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "fieldkit", *arguments, cwd=folder, stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE, stderr=(folder / "stderr.txt").open("w"),
    )  # fmt: skip
    try:
        out, _ = await process.communicate()
    finally:
        if process.returncode is None:
            process.terminate()
            await process.wait()
    return process.returncode or 0, out.decode()


@asynccontextmanager
async def field(folder: Path, kinds: Sequence[str], **changed: float) -> AsyncIterator[tuple[Path, int]]:
    """Simulators and emulated radios for a mission file; its path, and the port that the vehicles send to."""
    port, copy = free_udp_port(), free_udp_port()
    path = mission_file(folder, kinds, port, copy)
    places = [((k + 0.5) * SIZE_M / len(kinds), 8.0) for k in range(len(kinds))]
    vehicles = [
        Simulated(kind, number, *FRAME.to_geodetic(*place)[:2])
        for number, (kind, place) in enumerate(zip(kinds, places, strict=True), start=1)
    ]
    named = [word for east_m, north_m in HIDDEN_M for word in ("--source", f"{east_m},{north_m}")]
    speeds = {"WP_SPEED": LIMIT_M_S, "WPNAV_SPEED": 100 * LIMIT_M_S}
    async with simulators(vehicles, folder, port, **(speeds | changed)):
        telemetry = f"udpin:127.0.0.1:{copy}"
        radios = asyncio.create_task(
            fieldkit(folder, "emulate", "radios", "--mission", str(path), "--telemetry", telemetry, *named)
        )
        try:
            yield path, port
        finally:
            radios.cancel()
            await asyncio.wait({radios})


async def fly(folder: Path, kinds: Sequence[str]) -> tuple[dict[str, Any], Recording]:
    """Preflight until it is green, then the mission; its result and its recording."""
    async with field(folder, kinds) as (path, _):
        await until_green(folder, path)
        code, out = await fieldkit(folder, "run", str(path), "--no-page", "--json")
    assert code == 0, (out, (folder / "stderr.txt").read_text()[-2000:])
    result = json.loads(out)
    return result, open_recording(Path(folder / result["recording"]))


async def checks_of(folder: Path, path: Path) -> list[dict[str, Any]]:
    """What `fieldkit preflight` says."""
    _, out = await fieldkit(folder, "preflight", str(path), "--json", "--listen-s", "5")
    checks: list[dict[str, Any]] = json.loads(out)["checks"]
    return checks


async def until_green(folder: Path, path: Path) -> None:
    """Vehicles set up as docs/hardware.md says are green once their EKF is; nothing else is waited for."""
    checks: list[dict[str, Any]] = []
    for _ in range(int(READY_S / 10)):
        checks = await checks_of(folder, path)
        if not [check for check in checks if check["level"] == "red"]:
            break
    unfit = [
        check
        for check in checks
        if check["level"] != "green"
        and check["robot"] != "mission"
        and check["name"] not in ("radio", "place")
    ]
    assert not unfit, unfit


def recording_in(folder: Path) -> Path:
    """The one recording there is."""
    (log,) = folder.glob("runs/*/mission.mcap")
    return log


def judge(result: dict[str, Any], recording: Recording, name: str) -> None:
    """What holds of every mission; its numbers go to FIELDKIT_SITL_REPORT."""
    events = [step.event for step in recording.steps()]
    poses = [event for event in events if isinstance(event, Pose)]
    states = [event for event in events if isinstance(event, VehicleState)]
    speeds = [state.speed_m_s for state in states if state.speed_m_s is not None]
    out_m = max(max(-p.east_m, p.east_m - SIZE_M, -p.north_m, p.north_m - SIZE_M, 0.0) for p in poses)
    withdrawn = [(e.robot, e.reason) for e in events if isinstance(e, Operator) and e.action == "withdraw"]
    finds = [source for source in result["sources"] if source["state"] == "found"]
    # Each hidden one has a find of its own: two finds of one source would else pass for two sources.
    errors = [
        min((math.dist((s["east_m"], s["north_m"]), place) for s in finds), default=math.inf)
        for place in HIDDEN_M
    ]
    measured = {
        "ended": result["end_reason"], "found": len(finds), "errors_m": errors, "found_at_s": result["found_at_s"],
        "fastest_m_s": max(speeds), "outside_m": out_m, "withdrawn": withdrawn,
        "interventions": result["interventions"],
    }  # fmt: skip
    if path := os.environ.get("FIELDKIT_SITL_REPORT"):
        with Path(path).open("a") as file:
            file.write(json.dumps({"mission": name} | measured) + "\n")
    assert not withdrawn, measured
    assert len(finds) == len(HIDDEN_M), measured
    assert max(errors) < WITHIN_M, measured
    assert out_m == 0.0, measured
    assert max(speeds) <= 1.02 * LIMIT_M_S, measured


async def test_four_rovers_find_what_is_hidden(tmp_path: Path) -> None:
    result, recording = await fly(tmp_path, ["rover"] * 4)
    judge(result, recording, "four rovers")


async def test_two_rovers_and_two_copters_find_what_is_hidden(tmp_path: Path) -> None:
    result, recording = await fly(tmp_path, ["rover", "rover", "copter", "copter"])
    judge(result, recording, "two rovers and two copters")
    heights = {robot: [] for robot in ("r3", "r4")}  # type: dict[str, list[float]]
    for step in recording.steps():
        if isinstance(step.event, Pose) and step.event.robot in heights:
            heights[step.event.robot].append(step.event.up_m)
    assert min(max(each) for each in heights.values()) > 2.0, "copters fly"
    assert all(each[-1] < 1.5 for each in heights.values()), "and are down again at the end"


async def test_a_killed_mission_leaves_every_vehicle_held_and_is_resumed(tmp_path: Path) -> None:
    """kill -9 in mid-mission: the vehicles' own failsafe holds them, the recording opens, the mission goes on."""
    async with field(tmp_path, ["rover"] * 2) as (path, port):
        await until_green(tmp_path, path)
        arguments = [sys.executable, "-m", "fieldkit", "run", str(path), "--no-page"]
        quiet = asyncio.subprocess.DEVNULL
        running = await asyncio.create_subprocess_exec(
            *arguments, cwd=tmp_path, stdin=quiet, stdout=quiet, stderr=quiet
        )
        await asyncio.sleep(60.0)
        running.kill()
        await running.wait()
        robots = {"r1": {"system_id": 1}, "r2": {"system_id": 2}}
        async with open_link(f"udpin:127.0.0.1:{port}", robots, around(RealClock())) as link:
            vehicles = [steered.vehicle for steered in link._steered.values()]
            await until(lambda: all(vehicle.actual_mode == "hold" for vehicle in vehicles), 20.0)
        log = recording_in(tmp_path)
        found = len(list(open_recording(log).steps()))
        assert found > 100
        resumed = await asyncio.create_subprocess_exec(
            *arguments[:4], "--resume", str(log), "--no-page", "--json", cwd=tmp_path, stdin=quiet,
            stdout=asyncio.subprocess.PIPE, stderr=(tmp_path / "resumed.txt").open("w"),
        )  # fmt: skip
        await asyncio.sleep(60.0)
        resumed.send_signal(signal.SIGINT)
        out, _ = await resumed.communicate()
    result = json.loads(out)
    assert result["events"] > found + 100, (tmp_path / "resumed.txt").read_text()[-2000:]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"FS_ACTION": 0}, "FS_ACTION is 0"),
        ({"FS_TIMEOUT": 60}, "waits 65 s"),
        ({"FENCE_ACTION": 0, "FENCE_TYPE": 0}, "FENCE_ACTION is 0"),
    ],
)
async def test_a_vehicle_that_would_drive_on_is_red(
    tmp_path: Path, changed: dict[str, float], words: str
) -> None:
    async with field(tmp_path, ["rover"], **changed) as (path, _):
        red = [check for check in await checks_of(tmp_path, path) if check["level"] == "red"]
    assert any(words in check["found"] for check in red), red
