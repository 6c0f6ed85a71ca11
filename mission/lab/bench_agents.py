"""HOLD ALL over Eclipse Zenoh on loopback: from the operator's word at one agent to the stop's frame at each vehicle.

Four agents as in the field, each with its own Zenoh peer (TCP), its own MAVLink link and emulated rover, its own inbox
and kernel. They share one process and one event loop here, so they wait for each other more than computers of their own
would. What is measured ends where the frame reaches the vehicle's socket.
"""

import asyncio
import contextlib
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit import plugins
from fieldkit.clock import RealClock, wall_s
from fieldkit.messages import Operator
from fieldkit.ports import DriverContext
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.fakes import FakeReceiver
from mission.core.mission_file import Mission
from mission.lab.synthetic import small_mission
from mission.shell import journal as journals
from mission.shell.agent_flight import Options, card_of, head_of, make_agent
from mission.shell.agent_runner import AgentRunner, Crew
from mission.shell.setups import Setup, free_udp_port, start_places

ROBOTS, ROUNDS = 4, 25
KEY = bytes(range(32))
APART_S = 1.0
"""Vehicles are left in peace for so long before a resume, and before the next hold."""
LIMIT_S = 5.0
LOOK_S = 0.05
MEET_S = 60.0
"""So long agents may take to find each other."""


@dataclass
class _Member:
    """One robot with its agent."""

    runner: AgentRunner
    rover: Any
    flying: asyncio.Task[str]


def hold_agents() -> dict[str, Any]:
    """Milliseconds to the robot whose agent is told, and to the others. Takes about two minutes."""
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(_measure(Path(folder)))


async def _measure(folder: Path) -> dict[str, Any]:
    mission = small_mission(folder, duration_s=3_600.0, robots=ROBOTS)
    own_ms: list[float] = []
    others_ms: list[float] = []
    missed = 0
    async with contextlib.AsyncExitStack() as stack:
        members = await _team(mission, folder, stack)
        await _met(members)
        names = list(members)
        for number in range(ROUNDS):
            told = names[number % len(names)]
            took_ms = await _press(members, told)
            own_ms += [ms for name, ms in took_ms.items() if name == told]
            others_ms += [ms for name, ms in took_ms.items() if name != told]
            missed += len(names) - len(took_ms)
    return {
        "agents": len(members),
        "holds": ROUNDS,
        "own_vehicle_ms": _spread(own_ms),
        "other_vehicles_ms": _spread(others_ms),
        "not_reached": missed,
    }


async def _team(mission: Mission, folder: Path, stack: contextlib.AsyncExitStack) -> dict[str, _Member]:
    clock, port = RealClock(), free_udp_port()
    members = {}
    for number, (name, place_m) in enumerate(start_places(mission).items()):
        around = DriverContext(clock, mission.frame)
        wires = {
            "listen": [f"tcp/127.0.0.1:{port if number == 0 else 0}"],
            "connect": [f"tcp/127.0.0.1:{port}"] if number else [],
            "scouting": False,
        }
        network = plugins.load("fieldkit.networks", "zenoh")("bench", wires, around)
        udp = free_udp_port()
        link = plugins.load("fieldkit.vehicles", "mavlink")(
            f"udpin:127.0.0.1:{udp}", {name: {"system_id": 1}}, around
        )
        factory = plugins.load("fieldkit.emulators", "fleet")
        spec = factory.spec_type(mission.frame, {name: place_m}, ("127.0.0.1", udp), number)
        fleet = await stack.enter_async_context(factory(spec, clock))
        crew = _crew(mission, name, network, folder, stack, clock)
        recorder = stack.enter_context(
            RecordingWriter(
                folder / f"{name}.mcap", mission_toml=mission.text, antenna_toml=mission.antenna_text
            )
        )
        runner = AgentRunner(
            mission, Setup(clock, (FakeReceiver(name, clock),), (link,)), recorder, crew=crew
        )
        await stack.enter_async_context(network)
        flying = asyncio.create_task(runner.run(), name=name)
        stack.push_async_callback(_ended, runner, flying)
        members[name] = _Member(runner, fleet.rovers[name], flying)
    return members


def _crew(
    mission: Mission,
    name: str,
    network: Any,
    folder: Path,
    stack: contextlib.ExitStack | Any,
    clock: RealClock,
) -> Crew:
    card = card_of(mission, name, clock)
    options = Options(name, KEY, 5.0, 1_400.0)
    (folder / name).mkdir()
    journal = stack.enter_context(contextlib.closing(journals.Journal(folder / name / journals.NAME)))
    journal.begin(head_of(card, KEY))
    return Crew(make_agent(mission, card, options), network, KEY, card, journal, options.contact_m)


async def _ended(runner: AgentRunner, flying: "asyncio.Task[str]") -> None:
    runner.put(Operator(runner.setup.clock.now_ns(), "end", None, "the benchmark is over"))
    await flying


async def _met(members: dict[str, _Member]) -> None:
    """Until all hear all, and are steering."""
    until_s = wall_s() + MEET_S
    while wall_s() < until_s:
        agents = [member.runner.crew.agent for member in members.values()]
        now_ns = RealClock().now_ns()
        if all(
            len(agent.lines.present(now_ns)) == len(members) and agent.common.horizon > 0 for agent in agents
        ):
            return
        for member in members.values():
            if member.flying.done():
                member.flying.result()
        await asyncio.sleep(0.1)
    raise TimeoutError(f"the agents have not found each other in {MEET_S:.0f} s")


async def _press(members: dict[str, _Member], told: str) -> dict[str, float]:
    """Milliseconds from the word at one agent until a stop's frame came to each vehicle; late ones are left out."""
    arrived: dict[str, float] = {}
    all_arrived = asyncio.Event()

    def stopped(name: str) -> None:
        arrived.setdefault(name, wall_s())
        if len(arrived) == len(members):
            all_arrived.set()

    for name, member in members.items():
        member.rover.on_stop = partial(stopped, name)
    runner = members[told].runner
    pressed_s = wall_s()
    runner.put(Operator(RealClock().now_ns(), "hold", None, "the benchmark"))
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(all_arrived.wait(), LIMIT_S)
    for member in members.values():
        member.rover.on_stop = None
    await asyncio.sleep(APART_S)
    runner.put(Operator(RealClock().now_ns(), "resume", None, "the benchmark"))
    await _steered(members)
    return {name: 1e3 * (at_s - pressed_s) for name, at_s in arrived.items()}


async def _steered(members: dict[str, _Member]) -> None:
    """Until no vehicle holds, and a while longer: a late command to steer again would be taken for one to stop."""
    until_s = wall_s() + LIMIT_S
    holding = True
    while holding and wall_s() < until_s:
        await asyncio.sleep(LOOK_S)
        holding = any(member.rover.holds for member in members.values())
    await asyncio.sleep(APART_S)


def _spread(ms: list[float]) -> dict[str, float]:
    median, p99 = np.percentile(ms, [50, 99]) if ms else (float("nan"), float("nan"))
    return {"median": round(float(median), 1), "p99": round(float(p99), 1), "worst": round(max(ms), 1)}
