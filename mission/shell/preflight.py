"""Before the start: a table robot by check, each red, amber or green with what to do. Nothing is armed or moved.

`judge_*` are pure; `preflight` opens the setup's devices one by one, listens for a while, and asks the vehicles. Where
the mission file asks for a fence in the vehicles they get it first, for it may be what arming waits for; they get
their own back at the end.
"""

import asyncio
import contextlib
import logging
import math
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from fieldkit.checks import Check, Level
from fieldkit.errors import DeviceError
from fieldkit.geometry.polygons import margin_m
from fieldkit.messages import Pose, ReceiverState, RssReading, VehicleState
from fieldkit.ports import PositionSource, Receiver, VehicleLink
from mission.core.mission_file import Mission
from mission.shell.setups import Setup
from mission.shell.vehicle_fences import VehicleFences, demands_of

logger = logging.getLogger(__name__)

MISSION = "mission"
NEAR_FIELD_M = 200.0
"""A robot further from the field than this is at another one."""
OUTSIDE_M = 1.0
"""A robot further outside the fence than its position may be off: either stands in the wrong place."""
COARSE = 0.5
"""Positions less certain than this share of what a find is asked for make finds slow or impossible."""
OLD_CALIBRATION_S = 90 * 86_400.0
DISK_RED_BYTES, DISK_AMBER_BYTES = 500_000_000, 5_000_000_000
CPU_AMBER_SHARE = 0.7
GAP_SPARE = 1.5
"""Positions come now and then a little late: the longest gap that is bridged must be so many times the usual one."""
BEAT_S = 1.0


@dataclass
class Heard:
    """What came in while listening."""

    poses: dict[str, Pose] = field(default_factory=dict)
    readings: dict[str, list[float]] = field(default_factory=dict)
    receiver_down: dict[str, str] = field(default_factory=dict)
    """Robot to why its radio is down."""
    flies: dict[str, bool] = field(default_factory=dict)
    """Robot to whether its vehicle says that it flies."""
    gaps_s: dict[str, list[float]] = field(default_factory=dict)
    """Robot to the times between its positions."""

    def place(self, pose: Pose) -> None:
        """Take in a position."""
        before = self.poses.get(pose.robot)
        if before is not None and pose.t_ns > before.t_ns:
            self.gaps_s.setdefault(pose.robot, []).append((pose.t_ns - before.t_ns) * 1e-9)
        self.poses[pose.robot] = pose


async def preflight(mission: Mission, setup: Setup, folder: Path, listen_s: float) -> list[Check]:
    """Everything that can be checked with the devices on, robots standing. `folder` gets the recordings."""
    heard = Heard()
    checks = [*judge_calibration(mission, setup.clock.now_ns()), judge_disk(folder), judge_cpu()]
    async with contextlib.AsyncExitStack() as stack:
        opened: list[VehicleLink] = []
        devices: list[Receiver | VehicleLink | PositionSource] = [
            *setup.receivers,
            *setup.links,
            *setup.positions,
        ]
        for device in devices:
            try:
                await stack.enter_async_context(device)
            except DeviceError as error:
                checks += _unopened(device, error)
                continue
            task = asyncio.create_task(_listen(device, heard))
            stack.push_async_callback(_end, task)
            if isinstance(device, VehicleLink):
                opened.append(device)
        fences = VehicleFences(mission, {name: link for link in opened for name in link.robots}, _say)
        checks += await _ask_all(fences, mission, setup, listen_s)
    silent = {check.robot for check in checks if check.name == "radio"}
    for receiver in setup.receivers:
        if receiver.robot not in silent:
            checks.append(judge_hearing(receiver.robot, heard, listen_s))
    checks += judge_gaps(mission, heard.gaps_s)
    return [*checks, *judge_places(mission, heard.poses), *judge_heights(mission, heard.flies)]


async def _ask_all(fences: VehicleFences, mission: Mission, setup: Setup, listen_s: float) -> list[Check]:
    """What the vehicles say, once they have the fence that the mission gives them.

    They hear our heartbeat meanwhile: ArduCopter does not arm while its ground station is silent.
    """
    beating = asyncio.create_task(_beat(set(fences.link_of.values()), setup))
    try:
        checks = await fences.put(list(fences.link_of))
        asked = [_ask(link, robot, mission) for robot, link in fences.link_of.items()]
        inspected, _ = await asyncio.gather(asyncio.gather(*asked), setup.clock.sleep(listen_s))
    finally:
        await fences.restore()
        await _end(beating)
    for found in inspected:
        checks += found
    return checks


async def _beat(links: Iterable[VehicleLink], setup: Setup) -> None:
    while True:
        for link in links:
            link.beat()
        await setup.clock.sleep(BEAT_S)


def _say(level: str, text: str) -> None:
    """There is no recording here: what cannot be put back is said."""
    (logger.error if level == "error" else logger.info)("%s", text)


async def _ask(link: VehicleLink, robot: str, mission: Mission) -> list[Check]:
    try:
        return await link.inspect(robot, demands_of(mission))
    except DeviceError as error:
        return [Check(robot, "vehicle", "red", str(error), "mend that and check again")]


def _unopened(device: Receiver | VehicleLink | PositionSource, error: DeviceError) -> list[Check]:
    if isinstance(device, VehicleLink):
        return [Check(robot, "link", "red", str(error), "see there") for robot in device.robots]
    if isinstance(device, PositionSource):
        return [Check(robot, "position", "red", str(error), "see there") for robot in device.robots]
    return [Check(device.robot, "radio", "red", str(error), "see docs/hardware.md")]


async def _listen(device: Receiver | VehicleLink | PositionSource, heard: Heard) -> None:
    if isinstance(device, VehicleLink):
        async for event in device.events():
            if isinstance(event, VehicleState) and event.link_up:
                heard.flies[event.robot] = event.flies
            if isinstance(event, Pose) and heard.poses.get(event.robot, event).origin == event.origin:
                heard.place(event)
    elif isinstance(device, PositionSource):
        async for pose in device.poses():
            heard.place(pose)
    else:
        async for item in device.readings():
            if isinstance(item, RssReading):
                heard.readings.setdefault(item.robot, []).append(item.rss_dbm)
            elif isinstance(item, ReceiverState) and not item.up:
                heard.receiver_down[item.robot] = item.reason
            elif isinstance(item, ReceiverState):
                heard.receiver_down.pop(item.robot, None)


async def _end(task: "asyncio.Task[None]") -> None:
    task.cancel()
    await asyncio.wait({task})


def judge_hearing(robot: str, heard: Heard, listen_s: float) -> Check:
    """Whether a radio hears anything: the test that finds a wrong channel, network id or encryption."""
    if robot in heard.receiver_down:
        return Check(robot, "radio", "red", heard.receiver_down[robot], "is it plugged in?")
    levels = heard.readings.get(robot, [])
    if not levels:
        return Check(
            robot,
            "radio",
            "amber",
            f"set up; heard nothing in {listen_s:.0f} s",
            "switch a transmitter of the searched kind on beside it, and check again",
        )
    return Check(
        robot, "radio", "green", f"{len(levels)} packets, {min(levels):.0f} to {max(levels):.0f} dBm"
    )


def judge_calibration(mission: Mission, now_ns: int) -> list[Check]:
    """The antenna file's own verdict, and its age."""
    verdict = mission.antenna.verdict
    level: Level = "green" if verdict == "accepted" else "red" if verdict == "refused" else "amber"
    remedy = "" if level == "green" else "; ".join(mission.antenna.reasons) or "calibrate again"
    checks = [Check(MISSION, "calibration", level, verdict, remedy)]
    spread = mission.kernel.engine.spread
    if spread is not None and spread.assumed:
        remedy = "calibrate with positions of both radios at 20 places or more"
        checks.append(Check(MISSION, "place noise", "amber", spread.assumed, remedy))
    engine = mission.kernel.engine
    known = {robot for robot, radio in engine.receivers.items() if radio.offset_measured}
    apart = [robot for robot in engine.robots if robot not in known]
    if spread is not None and spread.receiver_db > 0.0 and apart:
        found = f"not compared: {', '.join(apart)}. Each may be off by {spread.receiver_db:g} dB; finds allow for it"
        remedy = "for sharper finds: fieldkit calibrate fit --receiver-offsets, or a robot's rss_offset_db"
        checks.append(Check(MISSION, "receivers", "amber", found, remedy))
    asked_m = engine.find_radius_m or engine.grid.cell_m
    if engine.pose_sigma_m > COARSE * asked_m:
        found = f"known to {engine.pose_sigma_m:g} m, and a find is asked for within {asked_m:.2g} m"
        remedy = (
            "ask for less (engine.found_within_m), or take better positions: finds will take long or fail"
        )
        checks.append(Check(MISSION, "positions", "amber", found, remedy))
    file = Path(mission.where).parent / mission.file.antenna.file
    if file.exists():
        age_s = now_ns * 1e-9 - file.stat().st_mtime
        old = age_s > OLD_CALIBRATION_S
        remedy = (
            "are radios, antennas and their height still the same? fieldkit calibrate check" if old else ""
        )
        found = f"{max(age_s, 0.0) / 86_400:.0f} days old"
        checks.append(Check(MISSION, "calibration age", "amber" if old else "green", found, remedy))
    return checks


def judge_disk(folder: Path) -> Check:
    """Room for the recording."""
    place = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
    free = shutil.disk_usage(place).free
    level: Level = "red" if free < DISK_RED_BYTES else "amber" if free < DISK_AMBER_BYTES else "green"
    remedy = "" if level == "green" else "make room, or record elsewhere with --out"
    return Check(MISSION, "disk", level, f"{free / 1e9:.1f} GB free in {place}", remedy)


def judge_cpu() -> Check:
    """Whether this computer has time for a mission."""
    if not hasattr(os, "getloadavg"):
        return Check(MISSION, "CPU", "green", "not measured on this system")
    busy = os.getloadavg()[0] / (os.cpu_count() or 1)
    level: Level = "amber" if busy > CPU_AMBER_SHARE else "green"
    return Check(MISSION, "CPU", level, f"{busy:.0%} busy", "end other programs" if level == "amber" else "")


def judge_places(mission: Mission, poses: dict[str, Pose]) -> list[Check]:
    """Where the robots stand: in the field of this mission file, inside its fence, apart from each other."""
    checks = []
    corners = mission.fence_m
    for robot in mission.kernel.engine.robots:
        pose = poses.get(robot)
        if pose is None:
            checks.append(Check(robot, "place", "red", "no position", "wait for its position source"))
            continue
        inside_m = margin_m((pose.east_m, pose.north_m), corners)
        if inside_m < -NEAR_FIELD_M:
            found = f"{-inside_m:.0f} m from the field"
            remedy = "is this the mission file of another field? set origin_lat_deg and origin_lon_deg"
            checks.append(Check(robot, "place", "red", found, remedy))
        elif inside_m < 0:
            level: Level = "red" if -inside_m > OUTSIDE_M + 3.0 * pose.sigma_m else "amber"
            found = f"{-inside_m:.1f} m outside the fence"
            remedy = "carry it into the field, or mend field.fence in the mission file"
            checks.append(Check(robot, "place", level, found, remedy))
        else:
            checks.append(_apart(robot, pose, poses, mission, inside_m))
    return checks


def judge_gaps(mission: Mission, gaps_s: Mapping[str, Sequence[float]]) -> list[Check]:
    """Whether positions come often enough: between two that are too far apart neither silence nor a reading counts."""
    bridged_s = mission.kernel.max_pose_gap_s
    checks = []
    for robot, gaps in gaps_s.items():
        usual_s = median(gaps)
        if usual_s * GAP_SPARE <= bridged_s:
            continue
        found = f"one in {usual_s:.1f} s, and gaps of {bridged_s:g} s at most are bridged"
        enough_s = math.ceil(5.0 * usual_s)
        remedy = f"set association.max_pose_gap_s to {enough_s}, or what is not heard counts for little"
        checks.append(Check(robot, "positions", "amber", found, remedy))
    return checks


def judge_heights(mission: Mission, flies: Mapping[str, bool]) -> list[Check]:
    """Whether those that fly have a height in the mission file, and those that have one fly."""
    checks = []
    heights_m = mission.safety.altitude_m
    for robot, does in flies.items():
        if does and robot not in heights_m:
            remedy = "write flies = true, or altitude_m, into its [[robot]] table"
            checks.append(
                Check(robot, "height", "red", "it flies, and the mission file gives it no height", remedy)
            )
        elif not does and robot in heights_m:
            found = f"the mission file sends it to {heights_m[robot]:g} m, and its vehicle does not fly"
            checks.append(Check(robot, "height", "red", found, "take flies and altitude_m out of its table"))
        elif does:
            checks.append(Check(robot, "height", "green", f"flies at {heights_m[robot]:g} m above home"))
    return checks


def _apart(robot: str, pose: Pose, poses: dict[str, Pose], mission: Mission, inside_m: float) -> Check:
    others = [
        (math.hypot(pose.east_m - other.east_m, pose.north_m - other.north_m), name)
        for name, other in poses.items()
        if name != robot
    ]
    gap_m, nearest = min(others, default=(math.inf, ""))
    if gap_m < mission.safety.near_m:
        return Check(robot, "place", "amber", f"{gap_m:.1f} m from {nearest}", "carry them apart")
    return Check(robot, "place", "green", f"{inside_m:.1f} m inside the fence")


def refused(checks: Sequence[Check]) -> str:
    """What forbids a start, one red check a line; empty when nothing does."""
    return "\n".join(
        f"  {check.robot}: {check.name}: {check.found}" + (f"; {check.remedy}" if check.remedy else "")
        for check in checks
        if check.level == "red"
    )
