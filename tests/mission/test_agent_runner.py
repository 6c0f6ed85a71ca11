"""Agents' shells over in-process stand-ins and a simulated network: start, orders, refusals, restart, files."""

import asyncio
import contextlib
import math
import socket
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest

from fieldkit import jumploop
from fieldkit.clock import RealClock
from fieldkit.engine.decentralised.card import MARK, Card, clock_refusal, is_second, read_card, refusal
from fieldkit.errors import ConfigError
from fieldkit.jumploop import LoopClock
from fieldkit.messages import Operator
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fake_network import Ether
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from fieldkit.world.network import Air
from mission.core.mission_file import Mission
from mission.lab.synthetic import small_mission
from mission.page.view import View
from mission.replay.replay import replay
from mission.safety.rules import Safety
from mission.shell import journal as journals
from mission.shell.agent_flight import (
    Options,
    card_of,
    head_of,
    left_in,
    make_agent,
    mission_hash,
)
from mission.shell.agent_runner import AgentRunner, Crew
from mission.shell.chronicle import Chronicle
from mission.shell.hold_all import hold_all
from mission.shell.others import MOST_MISSIONS, Refused
from mission.shell.setups import Setup, start_places

START_NS = 1_800_000_000 * 10**9
KEY = bytes(range(32))


class Robot:
    """One robot of two: its vehicle, radio, files and agent."""

    def __init__(
        self, name: str, mission: Mission, clock: LoopClock, ether: Ether, folder: Path, body: Rover
    ) -> None:
        self.name, self.mission, self.clock, self.folder = name, mission, clock, folder
        self.fleet, self.radio = FakeFleet({name: body}, clock), FakeReceiver(name, clock)
        self.network = ether.member(name)
        self.runner: AgentRunner | None = None
        self.followers: tuple[View, ...] = ()
        self.flights = 0

    async def fly(self, resumed: Path | None = None, left: Path | None = None) -> AgentRunner:
        self.flights += 1
        folder = self.folder / f"{self.name}-{self.flights}"
        folder.mkdir()
        mission, clock = self.mission, self.clock
        card = card_of(mission, self.name, clock)
        options = Options(self.name, KEY, 5.0, 1400.0, resumed=resumed, left=left)
        agent = make_agent(mission, card, options)
        with contextlib.ExitStack() as stack:
            writers = [
                stack.enter_context(
                    RecordingWriter(
                        folder / name, mission_toml=mission.text, antenna_toml=mission.antenna_text,
                        metadata={**mission.recorded_settings, **more},
                    )
                )
                for name, more in (("mission.mcap", {"agent": self.name}), ("common.mcap", {}))
            ]  # fmt: skip
            journal = stack.enter_context(contextlib.closing(journals.Journal(folder / journals.NAME)))
            journal.begin(head_of(card, KEY))
            common = Chronicle(agent.common.kernel, Safety(mission.safety), writers[1])
            agent.common.witness = common.step
            setup = Setup(clock, (self.radio,), (self.fleet,))
            before = None if left is None else left_in(left, mission, self.name, options.wait_s)
            crew = Crew(agent, self.network, KEY, card, journal, options.contact_m, common, before, left)
            self.runner = AgentRunner(mission, setup, writers[0], followers=self.followers, crew=crew)
            async with self.network:
                await self.runner.run()
        return self.runner

    @property
    def log(self) -> Path:
        return self.folder / f"{self.name}-{self.flights}"


Act = Callable[[dict[str, Robot]], Awaitable[None]]


def two(
    folder: Path, act: Act, duration_s: float = 30.0, air: Air = Air(), **engine: str
) -> dict[str, Robot]:
    """Two robots; `act` starts their agents and whatever else is to happen."""
    mission = small_mission(folder, duration_s=duration_s, robots=2, engine=engine)
    clock = LoopClock(START_NS)
    bodies = {name: Rover(*place) for name, place in start_places(mission).items()}
    team: dict[str, Robot] = {}

    async def go() -> None:
        def places_m() -> dict[str, tuple[float, float]]:
            return {name: (body.east_m, body.north_m) for name, body in bodies.items()} | {
                "laptop": (5.0, 5.0)
            }

        ether = Ether(air, 1, clock, places_m)
        team.update({name: Robot(name, mission, clock, ether, folder, body) for name, body in bodies.items()})
        await act(team)

    jumploop.run(go())
    return team


async def both(team: dict[str, Robot]) -> None:
    await asyncio.gather(*(robot.fly() for robot in team.values()))


def notes(path: Path) -> str:
    return "\n".join(note.text for _, note in open_recording(path).notes())


RING = {"belief": "spog", "sensing": "pairwise", "prior_rule": "dirichlet", "planner": "dprwa-apart"}


@pytest.mark.parametrize("engine", [{}, RING], ids=["intensity and infogain", "spog and dprwa-apart"])
def test_two_agents_fly_one_mission_and_leave_the_same_common_recording(
    tmp_path: Path, engine: dict[str, str]
) -> None:
    views: list[View] = []

    async def act(team: dict[str, Robot]) -> None:
        async def transmit() -> None:
            while True:
                await team["r1"].clock.sleep(4.0)
                for robot in team.values():
                    robot.radio.hear(-60.0)

        sending = asyncio.create_task(transmit())
        team["r1"].followers = (view := View(team["r1"].mission),)
        views.append(view)
        await both(team)
        sending.cancel()

    team = two(tmp_path, act, **engine)
    ended = {name: robot.runner.result() for name, robot in team.items() if robot.runner}
    assert all("time is up" in result["end_reason"] for result in ended.values())
    assert ended["r1"]["common_hash"] == ended["r2"]["common_hash"] and ended["r1"]["detections"] >= 5
    for robot in team.values():
        done = replay(robot.log / "common.mcap")
        assert done.complete and done.compared > 100
        assert max(abs(robot.fleet.rovers[robot.name].speed_m_s), 0.0) < 0.05
        own = open_recording(robot.log / "mission.mcap")
        assert own.complete and own.metadata["agent"] == robot.name
        said = notes(robot.log / "mission.mcap")
        other = "r2" if robot.name == "r1" else "r1"
        assert f"{other} is in contact" in said
    shown = {robot["name"]: robot for robot in views[0].frame()["robots"]}
    for name, robot in team.items():  # the page of one robot shows the others as well
        body = robot.fleet.rovers[name]
        place_m, age_s = (shown[name]["east_m"], shown[name]["north_m"]), shown[name]["pose_age_s"]
        assert place_m[0] is not None and place_m[1] is not None and age_s is not None and age_s < 15.0
        assert math.dist((place_m[0], place_m[1]), (body.east_m, body.north_m)) < 0.5
    hashes = [open_recording(robot.log / "common.mcap").result() for robot in team.values()]
    assert (
        hashes[0]["belief_hash"] == hashes[1]["belief_hash"]
        and hashes[0]["commands_hash"] == hashes[1]["commands_hash"]
    )  # type: ignore[index]
    sent = sum(ended["r1"]["bytes_sent"].values())
    assert 0 < sent / 40.0 < 200.0


def test_hold_all_at_one_robot_stops_the_other_at_once_and_resume_lets_it_go_on(tmp_path: Path) -> None:
    waited: list[float] = []

    async def act(team: dict[str, Robot]) -> None:
        flights = asyncio.create_task(both(team))
        r1, r2 = team["r1"], team["r2"]
        while r2.fleet.rovers["r2"].speed_m_s < 0.1:
            await r1.clock.sleep(0.1)
        assert r1.runner is not None
        r1.runner.put(Operator(r1.clock.now_ns(), "hold", None, "stop"))
        began_s = r1.clock.elapsed_s()
        while r2.fleet.rovers["r2"].target_m is not None:
            await r1.clock.sleep(0.01)
        waited.append(r1.clock.elapsed_s() - began_s)
        await r1.clock.sleep(5.0)
        assert all(robot.fleet.rovers[name].target_m is None for name, robot in team.items())
        assert r2.runner is not None
        assert r1.runner.doing() == r2.runner.doing() == dict.fromkeys(("r1", "r2"), "held: stop"), "by whom"
        r1.runner.put(Operator(r1.clock.now_ns(), "resume", None, "go on"))
        while r2.fleet.rovers["r2"].target_m is None:
            await r1.clock.sleep(0.1)
        await flights

    team = two(tmp_path, act, duration_s=40.0)
    assert waited[0] < 0.2
    assert "from others: hold all: stop" in notes(team["r2"].log / "mission.mcap")


class Late(LoopClock):
    """A clock that is ten minutes behind."""

    def now_ns(self) -> int:
        return super().now_ns() - 600 * 10**9


def test_a_computer_without_a_robot_holds_all_and_says_who_does(tmp_path: Path) -> None:
    said: list[dict[str, str]] = []

    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        laptop = r1.network._ether.member("laptop")
        mine = card_of(r1.mission, "r1", r1.clock)
        names = ("r1", "r2")
        said.append(await hold_all(names, laptop, mine, KEY, r1.clock, 2.0))
        flights = [asyncio.create_task(r1.fly())]
        await r1.clock.sleep(8.0)
        said.append(await hold_all(names, laptop, mine, KEY, r1.clock, 2.0))
        long_ago = replace(mine, robot="r2", host="box", sent_ns=r1.clock.now_ns() - 600 * 10**9)
        async with laptop:
            for _ in range(2):
                laptop.publish(long_ago.to_bytes(KEY))
                await r1.clock.sleep(1.0)
        flights.append(asyncio.create_task(r2.fly()))
        await r1.clock.sleep(8.0)
        said.append(await hold_all(names, laptop, mine, KEY, r1.clock, 2.0))
        await r1.clock.sleep(3.0)
        for name, robot in team.items():
            assert robot.runner is not None and robot.fleet.rovers[name].target_m is None
            assert robot.runner.crew.agent.common.kernel.fleet.any_held(), "it is in the logs"
        words: list[str] = []
        stranger = await hold_all(names, laptop, mine, bytes(32), r1.clock, 8.0, words.append)
        assert stranger == dict.fromkeys(names, "is not heard")
        assert len(words) == 1 and "of the same name" in words[0] and "another key" in words[0], words
        other = replace(mine, mission_hash="another")
        foreign = await hold_all(names, laptop, other, KEY, r1.clock, 8.0)
        assert all(f"is not heard: {name} on" in word for name, word in foreign.items()), foreign
        assert all("has another mission or antenna file" in word for word in foreign.values())
        late = await hold_all(names, laptop, mine, KEY, Late(START_NS), 1.0)
        assert all("is not heard: its clock is 600 s ahead of" in word for word in late.values())
        await asyncio.gather(*flights)

    team = two(tmp_path, act, duration_s=60.0)
    silent = dict.fromkeys(("r1", "r2"), "is not heard")
    assert said == [silent, {"r1": "holds", "r2": "is not heard"}, dict.fromkeys(("r1", "r2"), "holds")]
    assert f"operator, by --hold on {socket.gethostname()}" in notes(team["r2"].log / "mission.mcap")
    assert (
        notes(team["r1"].log / "mission.mcap").count("r2 on box is not heard: its clock is 600 s behind") == 1
    )


def test_ctrl_c_ends_one_agent_and_the_other_goes_on_without_it(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        flights = asyncio.create_task(both(team))
        r1, r2 = team["r1"], team["r2"]
        await r1.clock.sleep(12.0)
        assert r1.runner is not None and r2.runner is not None
        r1.runner.put(Operator(r1.clock.now_ns(), "end", None, "stopped by Ctrl-C"))
        await r1.clock.sleep(30.0)
        assert r1.runner.end_reason and not r2.runner.end_reason
        assert r2.runner.kernel.robots["r1"].held
        await flights

    team = two(tmp_path, act, duration_s=60.0)
    assert "r1 is out of contact" in notes(team["r2"].log / "mission.mcap")
    assert team["r2"].runner is not None and "time is up" in team["r2"].runner.end_reason


def test_a_killed_agent_goes_on_with_its_log_and_all_agree_again(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        flights = [asyncio.create_task(r1.fly()), asyncio.create_task(r2.fly())]
        await r1.clock.sleep(12.0)
        flights[1].cancel()
        await asyncio.wait({flights[1]})
        journal = r2.log / journals.NAME
        journal.write_bytes(journal.read_bytes()[:-30])  # as a kill leaves it: no end, and a cut record
        await r1.clock.sleep(20.0)
        flights[1] = asyncio.create_task(r2.fly(journal))
        await asyncio.gather(*flights)

    team = two(tmp_path, act, duration_s=70.0)
    first, second = (robot.runner.result() for robot in team.values() if robot.runner)
    assert first["common_hash"] == second["common_hash"] and "time is up" in second["end_reason"]
    assert team["r2"].flights == 2
    assert replay(team["r2"].log / "common.mcap").compared > 100
    assert "r2 is in contact" in notes(team["r1"].log / "mission.mcap")


# -- who belongs together --------------------------------------------------------------------------------------


def test_a_second_agent_for_a_robot_refuses_and_the_first_says_so(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        first = asyncio.create_task(both(team))
        r1 = team["r1"]
        await r1.clock.sleep(8.0)
        running = r1.runner
        twin = Robot("r1", r1.mission, r1.clock, r1.network._ether, tmp_path / "twin", Rover(5.0, 5.0))
        twin.folder.mkdir()
        r1.network._ether._members["r1 twin"] = twin.network
        r1.network._ether._members["r1"] = r1.network
        twin.network._name = "r1 twin"
        places = r1.network._ether._places_m
        r1.network._ether._places_m = lambda: {**places(), "r1 twin": (5.0, 5.0)}
        with pytest.raises(ConfigError, match="r1 has an agent already"):
            await twin.fly()
        assert twin.fleet.rovers["r1"].target_m is None and r1.runner is running
        await first

    team = two(tmp_path, act, duration_s=15.0)
    assert "a second agent for r1" in notes(team["r1"].log / "mission.mcap")


def card(mission: Mission, robot: str = "r1") -> Card:
    return replace(card_of(mission, robot, RealClock()), host="box")


def test_others_are_refused_by_name(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, robots=2)
    mine = card(mission)
    changed = replace(mission, text=mission.text.replace("rate_hz = 0.1", "rate_hz = 0.2"))
    assert mission_hash(changed) != mission_hash(mission)
    assert mission_hash(replace(mission, text=mission.text.replace("\n", "\r\n"))) == mission_hash(mission)
    other = card(changed, "r2")
    assert "r2 on box has another mission or antenna file" in refusal(mine, other)
    older = replace(card(mission, "r2"), version="0.0.9", code="abc")
    assert "runs another fieldkit (0.0.9, code abc" in refusal(mine, older)
    assert refusal(mine, card(mission, "r2")) == "" and not is_second(mine, card(mission))
    assert is_second(card(mission), mine) and not is_second(mine, mine)


def test_those_with_another_key_are_named_once_a_mission_and_not_without_end(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, robots=2)
    mine, others = card(mission), Refused()
    orchard = replace(card(mission, "r2"), mission="orchard\x1b[2J\n" + 60 * "x")
    said = others.other_mission(mine, orchard.to_bytes(bytes(32)))
    assert said.startswith("another mission is on this network, 'orchard[2Jxx") and "(r2 on box)" in said
    assert said.isprintable() and len(said) < 200
    assert others.other_mission(mine, orchard.to_bytes(bytes(32))) == ""
    same = card(mission, "r2").to_bytes(bytes(32))
    assert "r2 on box is of a mission of the same name" in others.other_mission(mine, same)
    assert others.other_mission(mine, MARK + b"no card") == others.other_mission(mine, b"") == ""
    more = [replace(orchard, mission=f"m{k}").to_bytes(bytes(32)) for k in range(20)]
    assert sum(bool(others.other_mission(mine, data)) for data in more) == MOST_MISSIONS - 2
    assert others.strangers == 25


def test_a_card_is_read_by_those_who_have_the_key_and_not_for_long(tmp_path: Path) -> None:
    now_ns = RealClock().now_ns()
    mine = replace(card(small_mission(tmp_path)), sent_ns=now_ns)
    data = mine.to_bytes(KEY)
    assert read_card(KEY, data) == mine and clock_refusal(mine, now_ns) == ""
    assert read_card(bytes(32), data) is None
    assert "300 s behind this computer's" in clock_refusal(mine, now_ns + 300 * 10**9)
    assert "300 s ahead of" in clock_refusal(mine, now_ns - 300 * 10**9)
    assert read_card(KEY, data[:-1]) is None and read_card(KEY, b"\x00card") is None


def test_what_cannot_be_is_said_before_anything_moves(tmp_path: Path) -> None:
    mission = small_mission(tmp_path)
    with pytest.raises(ConfigError, match="there is no 'r9'"):
        card_of(mission, "r9", RealClock())
    with pytest.raises(ConfigError, match="set it first"):
        card_of(mission, "r1", LoopClockOf1970())
    for contact_m in (0.5, math.nan, math.inf):
        with pytest.raises(ConfigError, match="--contact-m: expected at least"):
            make_agent(mission, card(mission), Options("r1", KEY, contact_m, 1400.0))
    for bytes_s in (0.0, math.nan):
        with pytest.raises(ConfigError, match="--bytes-s: expected"):
            make_agent(mission, card(mission), Options("r1", KEY, None, bytes_s))


class LoopClockOf1970(RealClock):
    def now_ns(self) -> int:
        return 12 * 10**9
