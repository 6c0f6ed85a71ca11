"""One robot's agent from start to end in this process: its devices, its files, its journal."""

import asyncio
import hashlib
import math
import secrets
import socket
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fieldkit import settings as given
from fieldkit.clock import Clock
from fieldkit.engine.decentralised.card import Card
from fieldkit.engine.decentralised.logs import Logs
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import Talk
from fieldkit.errors import ConfigError
from fieldkit.ports import Network
from fieldkit.recording.made_with import software
from mission.core.agent import Agent
from mission.core.mission_file import Mission
from mission.core.taking_up import Left
from mission.safety.apart import least_contact_m
from mission.shell import journal as journals
from mission.shell.agent_runner import AgentRunner, Crew
from mission.shell.chronicle import common_of
from mission.shell.keyboard import keyboard
from mission.shell.progress import Progress
from mission.shell.recorder import recording_of
from mission.shell.runner import Runner
from mission.shell.setups import Setup

if TYPE_CHECKING:
    from mission.page.serve import LivePage

LEAST_NS = 1_735_689_600_000_000_000
"""The beginning of 2025: a clock that says an earlier time was never set."""


@dataclass(frozen=True, slots=True)
class Options:
    """What the operator chooses on one robot's computer."""

    robot: str
    key: bytes
    contact_m: float | None
    bytes_s: float
    override: str = ""
    wait_s: float = given.AGENT_WAIT_S.default
    """So long it waits at the start for robots that nobody has heard of."""
    resumed: Path | None = None
    """The journal of a flight that was interrupted."""
    left: Path | None = None
    """The journal of an agent that was ended before the mission was over: what others say tells if it goes on."""


def mission_hash(mission: Mission) -> str:
    """A short hash of everything that must be the same on all robots: mission and antenna file."""
    return hash_of(mission.text, mission.antenna_text)


def hash_of(mission_toml: str, antenna_toml: str) -> str:
    """The same, of both files' texts as they were read."""
    both = (mission_toml + "\n\0\n" + antenna_toml).replace("\r\n", "\n")
    return hashlib.sha256(both.encode()).hexdigest()[:12]


def card_of(mission: Mission, robot: str, clock: Clock) -> Card:
    """Who the agent is. Raises `ConfigError` for a robot that is not in the mission, or a clock that was never set."""
    robots = mission.kernel.engine.robots
    if robot not in robots:
        raise ConfigError(
            f"--robot: there is no {robot!r} in {mission.where}; robots are: {', '.join(robots)}"
        )
    return card_named(mission, robot, clock)


def card_named(mission: Mission, name: str, clock: Clock) -> Card:
    """The card of this process. Raises `ConfigError` for a clock that was never set."""
    if clock.now_ns() < LEAST_NS:
        raise ConfigError(
            f"this computer's clock says {clock.now_ns() // 1_000_000_000} s since 1970, which is long past: set it "
            "first, by a satellite receiver (gpsd with chrony) or from another robot's computer"
        )
    made = software()
    return Card(
        name,
        mission.file.name,
        mission_hash(mission),
        made["fieldkit"],
        made["code"],
        socket.gethostname(),
        secrets.token_hex(4),
        clock.now_ns(),
    )


def make_agent(mission: Mission, card: Card, options: Options) -> Agent:
    """The agent, with what an interrupted flight had observed. Raises `ConfigError`."""
    least_m = least_contact_m(mission.safety)
    budget = given.AGENT_BYTES_S
    if not budget.low <= options.bytes_s <= budget.high:
        raise ConfigError(
            f"--bytes-s: expected {budget.low:g} to {budget.high:g} B/s, got {options.bytes_s:g}"
        )
    if options.contact_m is not None and not least_m <= options.contact_m < math.inf:
        raise ConfigError(
            f"--contact-m: expected at least {least_m:.1f} m, in which two robots that come towards each other can "
            f"stop, got {options.contact_m:g}"
        )
    robots = mission.kernel.engine.robots
    logs = Logs(card.robot, robots)
    if options.resumed is not None:
        journals.load(options.resumed, logs)
    seal = Seal(session_key(options.key, card.common), robots.index(card.robot))
    return Agent(mission.kernel, Talk(logs, seal, options.bytes_s), patience_s=options.wait_s)


def head_of(card: Card, key: bytes) -> journals.Head:
    """What an agent's journal says of itself."""
    team = session_key(key, "journal").hex()[:12]
    return journals.Head(card.robot, card.mission_hash, f"{card.version} {card.code}", team)


def fly_agent(
    mission: Mission,
    setup: Setup,
    network: Network,
    card: Card,
    options: Options,
    folder: Path,
    on_progress: Callable[[Progress], None] = lambda _: None,
    page: "LivePage | None" = None,
    on_start: Callable[[Runner], None] = lambda _: None,
) -> AgentRunner:
    """Run one robot's part of a mission; the runner, ended. Recordings and journal are closed whatever happens.

    `page` shows what this robot knows, of the others too. `on_start` is given the runner before it runs.
    """
    agent = make_agent(mission, card, options)
    with ExitStack() as stack:
        journal = journals.Journal(folder / journals.NAME)
        stack.enter_context(closing(journal))
        journal.begin(head_of(card, options.key))
        journal.write(
            agent.logs
        )  # it takes the place of the one that is gone on with, also where this start fails
        everybodys = stack.enter_context(recording_of(mission, folder / "common.mcap", {"common": True}))
        common = common_of(mission, agent.common, everybodys)
        left = None if options.left is None else left_in(options.left, mission, card.robot, options.wait_s)
        crew = Crew(agent, network, options.key, card, journal, options.contact_m, common, left, options.left)
        followers = () if page is None else (page.follower,)
        own = recording_of(mission, folder / "mission.mcap", {"agent": card.robot}, setup.clock.now_ns())
        recorder = stack.enter_context(own)
        runner = AgentRunner(mission, setup, recorder, on_progress, followers, options.override, crew=crew)
        _stand_by_orders(runner)
        on_start(runner)

        async def run() -> None:
            if page is not None:
                page.attach(runner, f"{card.robot}'s page")
            if setup.tap is not None:
                setup.tap.listen(lambda robot, data: recorder.raw(setup.clock.now_ns(), robot, data))
            async with network:
                with keyboard(runner, "agent", f"{card.robot}'s terminal"):
                    await runner.run()

        asyncio.run(run())
    return runner


def _stand_by_orders(runner: AgentRunner) -> None:
    """What operators ordered before a restart stands: safety is told again, in order."""
    for order in runner.crew.agent.remembered():
        runner.remember(order)


def left_in(path: Path, mission: Mission, robot: str, wait_s: float) -> Left:
    """What an agent knew that was ended before its mission was over."""
    logs = Logs(robot, mission.kernel.engine.robots)
    journals.load(path, logs)
    first_ns = min((log[0].order_ns for log in logs.entries.values() if log), default=0)
    return Left(logs, first_ns + round((mission.kernel.max_duration_s + wait_s) * 1e9))


def interrupted(out: Path, card: Card, key: bytes) -> Path | None:
    """The latest journal of this robot in this mission, where its agent was interrupted not long ago."""
    return _latest(out, card, key, journals.Ending.CUT)


def left(out: Path, card: Card, key: bytes) -> Path | None:
    """... where its agent was ended not long ago, and the mission may go on."""
    return _latest(out, card, key, journals.Ending.LEFT)


def _latest(out: Path, card: Card, key: bytes, wanted: journals.Ending) -> Path | None:
    path, ending = journals.latest(out, head_of(card, key), card.started_ns * 1e-9) or (None, None)
    return path if ending is wanted else None
