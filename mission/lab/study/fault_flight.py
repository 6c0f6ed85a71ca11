"""One mission flown under faults: the real runner, safety, recorder and driver on emulated vehicles.

An operator is played too: a while after a fault has gone, the robot is resumed. What the vehicles did meanwhile is
noted for the judge (`fault_judge`).
"""

import asyncio
import json
import math
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit import jumploop, plugins
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.files import write_whole
from fieldkit.messages import Operator
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.channel import sample_rss_dbm
from fieldkit.world.fakes import FakeReceiver
from fieldkit.world.sources import TransientSource, Transmissions, random_sources
from mission.core.mission_file import Mission, read_mission
from mission.core.template import TemplateRobot, mission_text
from mission.lab.study.fault_judge import measure
from mission.lab.study.fault_kinds import ACTS, POLYGON, RESUMED, STOPS, Fault, Job, draw_faults
from mission.lab.synthetic import ANTENNA, LEVELS_DB
from mission.replay.replay import resumable
from mission.safety.limits import SafetySettings
from mission.shell.runner import Runner
from mission.shell.setups import Setup, free_udp_port, replace_options, start_places, with_vehicles

START_NS = 1_760_000_000 * 1_000_000_000
REACTION_S = 15.0
"""From a fault to its robot standing: a vehicle's own failsafe takes 6.5 s, ours less."""
RESUME_S = 15.0
"""From the end of a fault to the operator's resume."""
KILLED_S = 20.0
"""How long a killed mission is away."""
NEVER_S = 1e9
HOME_M = 1.0
"""A way-point so near to where a robot started leads home: round closed ground it is the last of several."""


@dataclass
class Flight:
    """One mission flown: what the judge looks at afterwards."""

    folder: Path
    mission: Mission
    fleet: Any
    clock: jumploop.LoopClock
    radios: dict[str, FakeReceiver]
    faults: list[Fault]
    runner: Runner | None = None
    recordings: list[Path] = field(default_factory=list)
    not_held: list[str] = field(default_factory=list)
    resumed_wrongly: list[str] = field(default_factory=list)
    running: "asyncio.Task[str] | None" = None
    ended_s: float = NEVER_S

    def operator(self, action: str, robot: str | None) -> None:
        """The operator's word."""
        if self.runner is not None and not self.runner.end_reason:
            self.runner.put(Operator(self.clock.now_ns(), action, robot))  # type: ignore[arg-type]


def _prepare(job: Job, folder: Path) -> tuple[Mission, tuple[TransientSource, ...]]:
    size = job.size
    folder.mkdir(parents=True)
    write_whole(folder / "antenna.toml", dump_antenna(AntennaFile(ANTENNA)))
    key = folder / "link.key"
    key.write_bytes(np.random.default_rng([job.seed, 0xCE]).bytes(32))
    key.chmod(0o600)
    text = mission_text(
        name="faults",
        seed=job.seed,
        size_m=size.field_m,
        cell_m=size.cell_m,
        power_levels_db=LEVELS_DB,
        rate_hz=0.1,
        expected=float(size.sources),
        planning_period_s=20.0,
        max_duration_s=size.duration_s,
        sources_found=size.sources,
        fence_margin_m=0.2,
        min_separation_m=0.5,
        robots=[
            TemplateRobot(f"r{k}", f"radio{k}", "udpin:127.0.0.1:0", k) for k in range(1, size.robots + 1)
        ],
    )
    if job.has_polygon:
        corners = [[size.field_m * east, size.field_m * north] for east, north in POLYGON]
        text = text.replace("\n[antenna]", f"\nfence = {json.dumps(corners)}\n\n[antenna]", 1)
    write_whole(folder / "mission.toml", text)
    mission = read_mission(folder / "mission.toml")
    rng = np.random.default_rng([job.seed, 0x50])
    while True:
        sources = random_sources(
            size.sources, size.field_m, size.field_m, LEVELS_DB, 0.1, rng, min_separation_m=1.5
        )
        if all(mission.safety.bounds.clearance_m((s.east_m, s.north_m)) > 0.0 for s in sources):
            return mission, tuple(sources)


async def fly(job: Job, folder: Path, *, with_faults: bool) -> dict[str, Any]:
    """The whole mission; what it looked like from outside."""
    mission, sources = _prepare(job, folder)
    clock = jumploop.LoopClock(START_NS)
    factory = plugins.load("fieldkit.emulators", "fleet")
    port = free_udp_port()
    key = (folder / "link.key").read_bytes()
    spec = factory.spec_type(
        mission.frame, start_places(mission), ("127.0.0.1", port), job.seed, signing_key=key
    )
    faults = draw_faults(job, mission.kernel.engine.robots) if with_faults else []
    async with factory(spec, clock) as fleet:
        radios = {name: FakeReceiver(name, clock) for name in fleet.rovers}
        flight = Flight(folder, mission, fleet, clock, radios, faults)
        tasks = [asyncio.create_task(_transmit(flight, sources, job.seed))]
        tasks += [asyncio.create_task(_happen(flight, fault, port)) for fault in faults]
        flight.running = asyncio.create_task(_run(flight, port, None))
        while flight.running is not None and not flight.running.done():
            await asyncio.wait({flight.running})
            await asyncio.sleep(0)
            if any(fault.kind.startswith("kill") for fault in faults) and flight.ended_s == NEVER_S:
                await clock.sleep(KILLED_S + 1.0)  # it may have been killed, and come again
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return measure(flight, sources)


async def _run(flight: Flight, port: int, past: Path | None) -> str:
    """One life of the mission: until it ends, or is killed."""
    key = str(flight.folder / "link.key")
    robots = tuple(
        robot.model_copy(
            update={
                "vehicle": replace_options(
                    robot.vehicle, {"address": f"udpin:127.0.0.1:{port}", "signing_key": key}
                )
            }
        )
        for robot in flight.mission.file.robot
    )
    links = with_vehicles(flight.mission, robots, flight.clock)
    setup = Setup(flight.clock, tuple(flight.radios.values()), links)
    path = flight.folder / f"mission-{len(flight.recordings)}.mcap"
    flight.recordings.append(path)
    with RecordingWriter(
        path,
        mission_toml=flight.mission.text,
        antenna_toml=flight.mission.antenna_text,
        start_ns=0 if past is not None else flight.clock.now_ns(),
    ) as recorder:
        runner = flight.runner = Runner(flight.mission, setup, recorder)
        if past is not None:
            recording = open_recording(past)
            resumable(recording)
            runner.rebuild(recording.steps())
        reason = await runner.run()
    flight.ended_s = flight.clock.elapsed_s()
    return reason


async def _kill(flight: Flight, port: int) -> None:
    """As kill -9 would: what is on the disk is all there is, nobody is informed, vehicles are on their own."""
    if flight.running is None or flight.running.done() or flight.runner is None:
        return
    left = flight.folder / "left.mcap"
    shutil.copy(flight.recordings[-1], left)
    flight.recordings[-1] = left
    flight.runner._steered = False  # a killed process sends no last hold
    flight.running.cancel()
    await asyncio.wait({flight.running})
    await flight.clock.sleep(KILLED_S)
    flight.not_held += [
        f"{name} after the kill" for name, rover in flight.fleet.rovers.items() if rover.drives_for_us
    ]
    flight.running = asyncio.create_task(_run(flight, port, left))
    await flight.clock.sleep(RESUME_S)
    flight.operator("resume", None)


async def _transmit(flight: Flight, sources: tuple[TransientSource, ...], seed: int) -> None:
    """The hidden sources: every radio that is in reach hears, with its own noise."""
    schedule = Transmissions(list(sources), np.random.default_rng([seed, 1]))
    rng = np.random.default_rng([seed, 2])
    names = list(flight.radios)
    while True:
        await flight.clock.sleep(0.05)
        for _, source in schedule.until(flight.clock.elapsed_s()):
            places = np.array([flight.fleet.rovers[name].place_m for name in names])
            ranges_m = np.hypot(*(places - (source.east_m, source.north_m)).T)
            levels = sample_rss_dbm(ANTENNA, ranges_m, source.power_db, rng)
            for name, level in zip(names, levels, strict=True):
                if np.isfinite(level) and not _is_unplugged(flight, name):
                    flight.radios[name].hear(float(level))


def _is_unplugged(flight: Flight, name: str) -> bool:
    now_s = flight.clock.elapsed_s()
    return any(
        fault.kind == "radio unplugged" and fault.robot == name and fault.at_s <= now_s < fault.until_s
        for fault in flight.faults
    )


async def _happen(flight: Flight, fault: Fault, port: int) -> None:
    """One fault, from its beginning to the operator's resume; in between, whether its robot stands."""
    await flight.clock.sleep(fault.at_s)
    if fault.kind.startswith("kill"):
        await _kill(flight, port)
        return
    victims = list(flight.fleet.rovers.values()) if not fault.robot else [flight.fleet.rovers[fault.robot]]
    begin, end = ACTS[fault.kind]
    goes_on = _goes_on_by_itself(fault, victims[0].holds, flight.mission.safety)
    for rover in victims:
        await begin(rover, flight, fault)
    if fault.kind in STOPS:
        await flight.clock.sleep(REACTION_S)
        drives = victims[0].drives_for_us and not _goes_home(flight, fault)
        if flight.clock.elapsed_s() < flight.ended_s and drives and not _forgiven(flight):
            flight.not_held.append(f"{fault.robot} after {fault.kind}")
    await flight.clock.sleep(max(0.0, fault.until_s - flight.clock.elapsed_s()))
    for rover in victims:
        await end(rover, flight, fault)
    if fault.kind in RESUMED:
        targets = len(victims[0].targets)
        await flight.clock.sleep(RESUME_S)
        waits = fault.kind in STOPS and not goes_on
        if waits and len(victims[0].targets) > targets and not _forgiven(flight):
            flight.resumed_wrongly.append(f"{fault.robot} after {fault.kind}")
        flight.operator("resume", fault.robot)


def _goes_on_by_itself(fault: Fault, held: bool, limits: SafetySettings) -> bool:
    """A robot that stood under a hold of ours when it lost its position, and has it back before we call for help."""
    call_s = limits.call_after_s + limits.pose_timeout_s
    return fault.kind == "GPS loss" and held and fault.until_s - fault.at_s <= call_s


def _goes_home(flight: Flight, fault: Fault) -> bool:
    """A robot whose battery is low is sent home by our own way-points."""
    if fault.kind != "battery drop":
        return False
    targets = flight.fleet.rovers[fault.robot].targets
    home_m = start_places(flight.mission)[fault.robot]
    return bool(targets) and math.dist((targets[-1].east_m, targets[-1].north_m), home_m) < HOME_M


def _forgiven(flight: Flight) -> bool:
    """After a resume of everybody (the mission was killed) a robot may rightly be under way again."""
    return len(flight.recordings) > 1
