"""A computer without a robot among two agents: what it shows, its orders, coming and going, its files."""

import asyncio
import contextlib
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from test_agent_runner import KEY, Robot, both, notes, two

from fieldkit.clock import RealClock, VirtualClock
from fieldkit.engine.decentralised.card import Card
from fieldkit.engine.decentralised.logs import Logs
from fieldkit.engine.decentralised.sealing import Seal
from fieldkit.engine.decentralised.talk import WATCHERS, Talk
from fieldkit.messages import Operator
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.settings import AGENT_WAIT_S
from fieldkit.world.network import Air
from mission.page.live import LiveShow
from mission.page.serve import LivePage
from mission.page.view import View
from mission.replay.collect import collect
from mission.replay.replay import replay
from mission.safety.rules import Safety
from mission.shell import journal as journals
from mission.shell.agent_flight import head_of
from mission.shell.chronicle import Chronicle
from mission.shell.others import TeamClock
from mission.shell.watch_flight import make_watcher
from mission.shell.watching import Watching, watcher_name

NAMES = ("r1", "r2")
Place = tuple[float, float]


class Page(LivePage):
    """The page without a server."""

    def __init__(self, view: View) -> None:
        self.follower = LiveShow(view)


class Laptop:
    """One laptop: it may come, go and come again."""

    def __init__(self, team: dict[str, Robot], name: str = "laptop", place_m: Place = (5.0, 5.0)) -> None:
        some = team["r1"]
        self.name, self.mission, self.clock, self.folder = name, some.mission, some.clock, some.folder
        ether = some.network._ether
        self.place_m = place_m
        others = ether._places_m
        ether._places_m = lambda: {**others(), name: self.place_m}
        self.network = ether.member(name)
        self.runs = 0
        self.key = KEY

    async def watch(self, change: Callable[[Card], Card] = lambda card: card) -> Watching:
        self.runs += 1
        self.log.mkdir()
        watcher, card = make_watcher(self.mission, self.clock, self.key, 1400.0)
        card = change(card)
        watcher.talk.seal.me = int(card.robot.split()[-1])
        with contextlib.ExitStack() as stack:
            journal = stack.enter_context(contextlib.closing(journals.Journal(self.log / journals.NAME)))
            journal.begin(replace(head_of(card, self.key), robot=""))
            mission = self.mission
            recorder = stack.enter_context(
                RecordingWriter(
                    self.log / "common.mcap", mission_toml=mission.text, antenna_toml=mission.antenna_text,
                    metadata=mission.recorded_settings,
                )
            )  # fmt: skip
            common = Chronicle(watcher.lines.common.kernel, Safety(mission.safety), recorder)
            watcher.lines.common.witness = common.step
            self.view = View(mission)
            self.at = Watching(
                mission, self.clock, self.network, self.key, card, watcher, journal, common, recorder,
                page=Page(self.view),
            )  # fmt: skip
            await self.at.run()
        return self.at

    @property
    def log(self) -> Path:
        return self.folder / f"{self.name}-{self.runs}"

    def order(self, action: str, robot: str | None = None) -> None:
        order = Operator(self.clock.now_ns(), action, robot, "operator, on the page")  # type: ignore[arg-type]
        self.at.put(order)

    def shown(self) -> dict[str, dict[str, object]]:
        return {robot["name"]: dict(robot) for robot in self.view.frame()["robots"]}

    def said(self) -> str:
        return "\n".join(note["text"] for note in self.view.notes)


async def until(robot: Robot, true: Callable[[], bool], most_s: float = 60.0) -> float:
    """Seconds until it was true."""
    began_s = robot.clock.elapsed_s()
    while not true():
        assert robot.clock.elapsed_s() - began_s < most_s
        await robot.clock.sleep(0.01)
    return robot.clock.elapsed_s() - began_s


def stands(robot: Robot) -> bool:
    return robot.fleet.rovers[robot.name].target_m is None


async def transmit(team: dict[str, Robot]) -> None:
    while True:
        await team["r1"].clock.sleep(4.0)
        for robot in team.values():
            robot.radio.hear(-60.0)


def test_a_laptop_that_comes_late_shows_all_holds_all_and_leaves_what_collect_takes_in(
    tmp_path: Path,
) -> None:
    took_s: list[float] = []
    laptops: list[Laptop] = []

    async def act(team: dict[str, Robot]) -> None:
        sending, flights = asyncio.create_task(transmit(team)), asyncio.create_task(both(team))
        r1 = team["r1"]
        await r1.clock.sleep(20.0)
        laptop = Laptop(team)
        laptops.append(laptop)
        watching = asyncio.create_task(laptop.watch())
        await r1.clock.sleep(6.0)
        for name, robot in laptop.shown().items():
            body = team[name].fleet.rovers[name]
            assert math.dist((robot["east_m"], robot["north_m"]), (body.east_m, body.north_m)) < 0.7  # type: ignore[arg-type]
            assert robot["pose_age_s"] < 3.0  # type: ignore[operator]
        assert laptop.at.kernel.detections >= 3 and laptop.view.frame()["detections"] >= 3
        assert laptop.view.frame()["t_s"] > 15.0, "time counts from the mission's start"
        laptop.order("hold")
        took_s.append(await until(r1, lambda: all(map(stands, team.values()))))
        await r1.clock.sleep(2.0)
        assert not laptop.at.alarms() and not laptop.at.watcher.unheld()
        assert laptop.at.doing() == dict.fromkeys(NAMES, "held: operator, on the page")
        assert {each for each, _ in laptop.at.dispatcher.answers.values()} == {"hold"}
        laptop.order("resume", "r2")
        await until(r1, lambda: not stands(team["r2"]))
        assert stands(r1)
        laptop.order("resume")
        await until(r1, lambda: not stands(r1))
        laptop.order("end")
        await watching
        assert all(robot.runner is not None and not robot.runner.end_reason for robot in team.values())
        await flights
        sending.cancel()

    team = two(tmp_path, act, duration_s=60.0)
    (laptop,) = laptops
    assert took_s[0] < 0.5
    ended = {name: robot.runner.result() for name, robot in team.items() if robot.runner}
    assert all("time is up" in each["end_reason"] for each in ended.values())
    assert "hold all: operator, on the page" in notes(team["r2"].log / "mission.mcap")
    assert not any("laptop" in notes(team[name].log / "mission.mcap") for name in NAMES), "nobody misses it"
    recording = open_recording(laptop.log / "common.mcap")
    assert recording.complete and replay(laptop.log / "common.mcap").compared > 20
    done = collect(tmp_path / "collected.mcap", [laptop.log, *(robot.log for robot in team.values())])
    assert done.notes == [] and done.refused == [] and done.compared == 3 and done.orders >= 3
    alone = collect(tmp_path / "alone.mcap", [laptop.log])
    assert alone.observations > 50 and "r1: its own journal is not here" in "\n".join(alone.notes)


def test_nothing_changes_for_agents_when_laptops_come_and_go(tmp_path: Path) -> None:
    ended: dict[bool, dict[str, object]] = {}
    for watched in (False, True):

        async def act(team: dict[str, Robot], watched: bool = watched) -> None:
            sending, flights = asyncio.create_task(transmit(team)), asyncio.create_task(both(team))
            clock = team["r1"].clock
            if watched:
                laptops = [Laptop(team), Laptop(team, "tablet")]
                await clock.sleep(8.0)
                first = [asyncio.create_task(laptop.watch()) for laptop in laptops]
                await clock.sleep(6.0)
                first[0].cancel()  # its lid is closed
                await asyncio.wait({first[0]})
                await clock.sleep(8.0)
                again = asyncio.create_task(laptops[0].watch())
                await clock.sleep(8.0)
                assert all(laptop.at.kernel.detections >= 5 for laptop in laptops)
                for laptop in laptops:
                    laptop.order("end")
                await asyncio.gather(again, first[1])
            await flights
            sending.cancel()

        folder = tmp_path / str(watched)
        folder.mkdir()
        team = two(folder, act, duration_s=40.0)
        ended[watched] = {name: robot.runner.result() for name, robot in team.items() if robot.runner}
        for robot in team.values():
            assert "out of contact" not in notes(robot.log / "mission.mcap")
    for name in NAMES:
        with_it, without = ended[True][name], ended[False][name]
        assert with_it["common_hash"] == without["common_hash"]  # type: ignore[index]


def test_an_order_given_where_nobody_is_in_reach_goes_to_the_first_who_is_met_and_from_there_on(
    tmp_path: Path,
) -> None:
    """The robots hear each other; the laptop hears nobody at first."""

    async def act(team: dict[str, Robot]) -> None:
        flights = asyncio.create_task(both(team))
        r1 = team["r1"]
        laptop = Laptop(team, place_m=(500.0, 0.0))
        watching = asyncio.create_task(laptop.watch())
        await until(r1, lambda: not any(map(stands, team.values())))
        laptop.order("hold")
        await r1.clock.sleep(4.0)
        assert not any(map(stands, team.values()))
        assert "nobody is in reach: hold all" in laptop.said()
        late = "\n".join(laptop.at.alarms())
        assert "r1 has not shown for" in late and "nobody has got it yet: hold all" in late
        assert laptop.at.result()["not_handed_on"] == ["hold all"]
        laptop.place_m = (5.0, 5.0)
        await until(r1, lambda: all(map(stands, team.values())), 2.0)
        await r1.clock.sleep(3.0)
        assert not laptop.at.alarms() and not laptop.at.watcher.orders.waiting
        laptop.place_m = (500.0, 0.0)
        laptop.order("resume")
        laptop.order("hold", "r2")
        laptop.order("resume", "r2")
        await r1.clock.sleep(3.0)
        laptop.place_m = (5.0, 5.0)
        await until(r1, lambda: not any(map(stands, team.values())))
        laptop.order("end")
        await watching
        await flights

    two(tmp_path, act, duration_s=60.0, air=Air(range_m=100.0))


def test_a_laptop_that_hears_nobody_says_so_once_and_where_it_looked(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        flights = asyncio.create_task(both(team))
        r1, near, far = team["r1"], Laptop(team), Laptop(team, "tablet", (500.0, 0.0))
        watching = [asyncio.create_task(laptop.watch()) for laptop in (near, far)]
        await r1.clock.sleep(20.0)
        nobody = f"no robot's agent is heard yet (looked {far.network.where}): it goes on looking"
        assert far.said().count(nobody) == 1 and "is heard yet" not in near.said()
        for laptop in (near, far):
            laptop.order("end")
        await asyncio.gather(*watching, flights)

    two(tmp_path, act, duration_s=25.0, air=Air(range_m=100.0))


def test_what_one_robot_cannot_hear_from_the_other_the_laptop_carries(tmp_path: Path) -> None:
    """The robots are out of each other's reach; a hold at r1's terminal reaches r2 in the laptop's hands."""

    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        laptop = Laptop(team)
        ether = r1.network._ether
        places = ether._places_m
        ether._places_m = lambda: {**places(), "r2": (100.0, 0.0)}
        flights = asyncio.create_task(both(team))
        watching = asyncio.create_task(laptop.watch())
        await until(r1, lambda: not any(map(stands, team.values())), AGENT_WAIT_S.default + 20.0)
        assert r1.runner is not None
        r1.runner.put(Operator(r1.clock.now_ns(), "hold", None, "at r1"))
        await r1.clock.sleep(4.0)
        assert stands(r1) and not stands(r2) and set(laptop.at.watcher.unheld()) == {"r2"}
        assert laptop.shown()["r2"]["pose_age_s"] is None
        laptop.place_m = (100.0, 5.0)
        await until(r1, lambda: stands(r2), 5.0)
        await r1.clock.sleep(3.0)
        assert not laptop.at.watcher.unheld()
        assert laptop.shown()["r2"]["pose_age_s"] < 3.0 < laptop.shown()["r1"]["pose_age_s"]  # type: ignore[operator]
        assert "r1" in {key[0] for key, log in r2.runner.crew.agent.logs.entries.items() if log}  # type: ignore[union-attr]
        laptop.order("end")
        await asyncio.gather(watching, flights)

    two(tmp_path, act, duration_s=120.0, air=Air(range_m=50.0))


def test_two_laptops_that_draw_the_same_number_and_others_that_do_not_belong(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        flights = asyncio.create_task(both(team))
        clock = team["r1"].clock
        laptop, tablet, foreign = Laptop(team), Laptop(team, "tablet"), Laptop(team, "foreign")

        def same(card: Card) -> Card:
            return replace(card, robot=watcher_name(WATCHERS[5]))

        watching = [asyncio.create_task(laptop.watch(same))]
        await clock.sleep(1.0)
        watching.append(asyncio.create_task(tablet.watch(same)))
        watching.append(
            asyncio.create_task(foreign.watch(lambda card: replace(card, mission_hash="0" * 12, host="box")))
        )
        await clock.sleep(12.0)
        assert laptop.at.card.robot == watcher_name(WATCHERS[5]) != tablet.at.card.robot
        number = tablet.at.watcher.talk.seal.me
        assert tablet.at.card.robot == watcher_name(number) and number in WATCHERS
        who = foreign.at.card.robot
        for each in (laptop, tablet):
            assert f"{who} on box has another mission or antenna file" in each.said()
            assert set(each.at.watcher.lines.present(clock.now_ns())) == set(NAMES)
        tablet.order("hold")
        await until(team["r1"], lambda: all(map(stands, team.values())), 0.5)
        await clock.sleep(2.0)
        assert laptop.shown()["r1"]["ordered"] == "hold", "each shows what the other orders"
        for each in (laptop, tablet, foreign):
            each.order("end")
        await asyncio.gather(*watching, flights)

    team = two(tmp_path, act, duration_s=30.0)
    for robot in team.values():
        assert "on box has another mission or antenna file" in notes(robot.log / "mission.mcap")


def test_a_laptop_left_open_leaves_when_the_next_mission_begins(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        laptop = Laptop(team)
        watching = asyncio.create_task(laptop.watch())
        await both(team)
        await team["r1"].clock.sleep(30.0)
        assert not watching.done() and "the mission is over (time is up" in laptop.said()
        await both(team)
        assert "was started after the mission that is known here was over" in (await watching).end_reason

    team = two(tmp_path, act, duration_s=15.0)
    for robot in team.values():
        assert robot.runner is not None and robot.runner.result()["detections"] == 0
        assert replay(robot.log / "common.mcap").compared > 20, "a mission of its own"


def test_a_hold_given_before_any_agent_is_there_holds_them_from_the_start(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        laptop = Laptop(team)
        watching = asyncio.create_task(laptop.watch())
        r1 = team["r1"]
        await r1.clock.sleep(2.0)
        laptop.order("hold")
        assert set(laptop.at.watcher.unheld()) == set(NAMES)
        flights = asyncio.create_task(both(team))
        for _ in range(150):
            await r1.clock.sleep(0.1)
            assert all(map(stands, team.values()))
        assert not laptop.at.watcher.unheld() and not laptop.at.alarms()
        for robot in team.values():
            assert robot.runner is not None
            assert all(each.held for each in robot.runner.crew.agent.common.kernel.robots.values())
        laptop.order("resume")
        await until(r1, lambda: not any(map(stands, team.values())))
        laptop.order("end")
        await asyncio.gather(watching, flights)

    two(tmp_path, act, duration_s=40.0)


def test_over_a_bad_link_a_hold_arrives_all_the_same_and_who_has_it_is_known(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        flights = asyncio.create_task(both(team))
        r1 = team["r1"]
        laptop = Laptop(team)
        watching = asyncio.create_task(laptop.watch())
        await until(r1, lambda: not any(map(stands, team.values())))
        for _ in range(3):
            laptop.order("hold")
            await until(r1, lambda: all(map(stands, team.values())), 6.0)
            await until(r1, lambda: not laptop.at.watcher.unheld(), 10.0)
            await until(r1, lambda: not laptop.at.watcher.orders.waiting, 10.0)
            laptop.order("resume")
            await until(r1, lambda: not any(map(stands, team.values())), 20.0)
        laptop.order("end")
        await asyncio.gather(watching, flights)

    two(tmp_path, act, duration_s=120.0, air=Air(loss=0.5, delay_s=0.5, jitter_s=0.5, repeated=0.2))


class Off(Talk):
    """A conversation by which this computer's clock is 4 s ahead until it is set."""

    off_s = 4.0

    def clock_off(self, now_ns: int) -> tuple[str, float] | None:
        return ("r1", self.off_s) if self.off_s else None

    def clock_set_back(self, now_ns: int, by_s: float) -> None:
        self.off_s -= by_s


def test_a_clock_is_set_by_the_first_robots_and_one_that_cannot_be_set_is_spoken_of_once() -> None:
    talk, clock = Off(Logs("", NAMES), Seal(KEY, WATCHERS[0])), RealClock()
    before_ns = RealClock().now_ns()
    team = TeamClock(clock, talk)
    assert "this computer's clock is 4.00 s ahead of r1's: that is taken off" in team.follow()
    assert clock.now_ns() < before_ns and team.follow() == ""
    talk.off_s = -2.0
    other = TeamClock(VirtualClock(), talk)
    assert "2.00 s behind r1's: set the clocks" in other.follow() and other.follow() == ""
