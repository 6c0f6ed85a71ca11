"""Which orders are still to be handed on, who has shown that it obeys, and what a watcher makes of what it hears."""

from dataclasses import replace
from pathlib import Path

import pytest

from fieldkit.engine.decentralised.logs import STEP_NS, TICK_NS, Logs, Stream
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import ORDER, WATCHERS, Talk, code_of
from fieldkit.messages import Operator, Pose, Tick, VehicleMode, VehicleState
from mission.core.agent import Agent
from mission.core.kernel_settings import KernelSettings
from mission.core.orders import Orders
from mission.core.watcher import Watcher
from mission.lab.synthetic import small_mission

ROBOTS = ("r1", "r2")
S = 1_000_000_000
START_NS = 1_800_000_000 * S
KEY = session_key(bytes(32), "a mission")


def order(action: str, robot: str | None = None, at_s: float = 0.0) -> Operator:
    made = quantised(Operator(START_NS + round(at_s * S), action, robot, "test"))  # type: ignore[arg-type]
    assert isinstance(made, Operator)
    return made


def state(robot: str, mode: VehicleMode, at_s: float) -> VehicleState:
    return VehicleState(START_NS + round(at_s * S), robot, mode, True)


# -- what waits ------------------------------------------------------------------------------------------------


def test_an_order_waits_until_it_stands_in_a_robots_log_and_no_message_will_do() -> None:
    orders = Orders(ROBOTS)
    hold = orders.give(order("hold"))
    assert not orders.learn(hold) and orders.waiting == [hold], (
        "a robot repeats it, and may be lost with its log"
    )
    assert not orders.read(hold, "r2", 0) and orders.waiting == []
    assert not orders.hand_on(hold) and orders.waiting == [], "another laptop says it still"


@pytest.mark.parametrize(
    ("first", "second", "left"),
    [
        (("hold", None), ("resume", None), 1),
        (("hold", "r1"), ("resume", None), 1),
        (("hold", None), ("resume", "r1"), 2),
        (("hold", "r1"), ("hold", "r2"), 2),
        (("return", "r2"), ("hold", None), 1),
        (("exclude", None), ("hold", None), 2),
        (("hold", None), ("remove", None), 2),
    ],
)
def test_a_later_order_takes_the_place_of_those_it_makes_void(
    first: tuple[str, str | None], second: tuple[str, str | None], left: int
) -> None:
    orders = Orders(ROBOTS)
    given = [orders.give(order(*each)) for each in (first, second)]
    assert orders.waiting == given[2 - left :] and orders.void == given[: 2 - left]


def test_what_waits_is_void_once_a_later_order_of_anybody_is_known() -> None:
    orders = Orders(ROBOTS)
    hold = orders.give(order("hold"))
    orders.learn(order("resume", "r1", at_s=2.0))
    assert orders.waiting == [hold], "r2 has still to hold"
    orders.read(order("resume", "r2", at_s=3.0), "r1", 0)
    assert orders.waiting == [] and orders.void == [hold]
    assert orders.hand_on(order("hold", "r1", at_s=1.0)) and orders.waiting == [], "it comes too late"


def test_an_order_is_later_than_all_that_are_known_whatever_the_clock_says() -> None:
    orders = Orders(ROBOTS)
    orders.read(order("hold", at_s=100.0), "r1", 0)
    assert orders.give(order("resume", at_s=3.0)).t_ns == START_NS + 100 * S + STEP_NS
    assert orders.give(order("hold", at_s=200.0)).t_ns == START_NS + 200 * S
    orders.learn(order("resume", at_s=150.0))
    assert set(orders.unheld()) == set(ROBOTS), "what comes late says nothing of now"


# -- who has shown it ------------------------------------------------------------------------------------------


def test_who_is_to_hold_has_shown_it_by_its_word_or_its_vehicle_and_not_by_having_got_the_order() -> None:
    orders = Orders(ROBOTS)
    hold = orders.give(order("hold", at_s=10.0))
    orders.see(state("r1", "hold", 9.0))
    assert set(orders.unheld()) == {"r1", "r2"}, "it held before already, for another reason"
    orders.obeyed("r1", code_of(order("hold", at_s=9.0)))
    orders.read(order("hold", at_s=5.0), "r1", 0)
    assert set(orders.unheld()) == {"r1", "r2"}
    orders.obeyed("r1", code_of(hold))
    assert set(orders.unheld()) == {"r2"}
    orders.obeyed("r1", code_of(order("exclude", at_s=12.0)))
    assert set(orders.unheld()) == {"r2"}, "what it obeys later takes nothing back"
    orders.see(state("r2", "hold", 11.0))
    assert not orders.unheld()
    orders.see(state("r2", "guided", 12.0))
    orders.see(state("r2", "hold", 11.5))
    assert set(orders.unheld()) == {"r2"}, "it goes on: it held by chance"
    orders.read(hold, "r2", 0)
    orders.has("r2", {"r2": 1})
    assert set(orders.unheld()) == {"r2"}, "its agent has got the order, and its vehicle goes on"
    orders.see(replace(state("r2", "hold", 13.0), speed_m_s=0.6))
    assert set(orders.unheld()) == {"r2"}, "it rolls on"
    orders.see(replace(state("r2", "hold", 14.0), speed_m_s=0.6, flies=True))
    assert set(orders.unheld()) == {"r2"}
    orders.see(replace(state("r2", "hold", 14.5), speed_m_s=0.4, flies=True))
    assert not orders.unheld(), "it hovers in the wind"
    orders.obeyed("r1", -1)
    assert set(orders.unheld()) == {"r1"}, "its agent takes its word back"
    later = orders.give(order("hold", at_s=15.0))
    orders.see(state("r1", "hold", 16.0))
    orders.obeyed("r2", code_of(later))
    assert not orders.unheld()
    again = orders.give(order("hold", "r2", at_s=20.0))
    assert orders.unheld() == {"r2": again}
    orders.read(order("withdraw", "r2", at_s=30.0), "r2", 0)
    assert not orders.unheld() and orders.withdrawn_ns() is None
    orders.read(order("withdraw", "r1", at_s=31.0), "r1", 0)
    assert orders.withdrawn_ns() == START_NS + 31 * S


def test_an_agents_word_does_not_count_where_it_has_lost_its_vehicle() -> None:
    orders = Orders(ROBOTS)
    orders.see(replace(state("r1", "other", 9.0), link_up=False))
    hold = orders.give(order("hold", at_s=10.0))
    for robot in ROBOTS:
        orders.read(hold, robot, 0)
        orders.obeyed(robot, code_of(hold))
    assert set(orders.unheld()) == {"r1"}
    orders.see(replace(state("r1", "hold", 12.0), link_up=False))
    assert set(orders.unheld()) == {"r1"}, "that is what was last heard of it"
    orders.see(state("r1", "hold", 13.0))
    assert not orders.unheld()
    orders.see(replace(state("r1", "hold", 14.0), link_up=False))
    assert not orders.unheld(), "it has held since, and may have been switched off"
    orders.give(order("hold", "r1", at_s=20.0))
    assert set(orders.unheld()) == {"r1"}


# -- a watcher -------------------------------------------------------------------------------------------------


@pytest.fixture
def settings(tmp_path: Path) -> KernelSettings:
    return small_mission(tmp_path, robots=2).kernel


def watcher(settings: KernelSettings, number: int = WATCHERS[0]) -> Watcher:
    return Watcher(settings, Talk(Logs("", settings.engine.robots), Seal(KEY, number)))


def agent(settings: KernelSettings, name: str) -> Agent:
    robots = settings.engine.robots
    return Agent(settings, Talk(Logs(name, robots), Seal(KEY, robots.index(name))))


def test_an_order_is_said_at_every_tick_until_a_copy_of_a_log_has_it(settings: KernelSettings) -> None:
    laptop, r1 = watcher(settings), agent(settings, settings.engine.robots[0])
    given, _ = laptop.give(order("hold"), START_NS)
    for tick in range(1, 40):
        said = laptop.messages(START_NS + tick * TICK_NS)
        assert [data[0] for data in said].count(ORDER) == 1
    now_ns = START_NS + 40 * TICK_NS
    assert r1.take(laptop.messages(now_ns)[0], now_ns) == [] and r1.unlogged == [given]
    r1.step(r1.unlogged[0])
    r1.step(Tick(now_ns))
    for message in r1.messages(now_ns):
        laptop.take(message, now_ns)
    assert laptop.orders.waiting == [] and r1.me not in laptop.unheld()
    for tick in range(41, 50):
        laptop.messages(START_NS + tick * TICK_NS)
    assert [data[0] for data in laptop.messages(START_NS + 60 * TICK_NS)].count(ORDER) == 0


def test_an_agent_that_does_not_reach_its_vehicle_says_of_no_order_that_it_obeys(
    settings: KernelSettings,
) -> None:
    r1, name = agent(settings, settings.engine.robots[0]), settings.engine.robots[0]
    laptop = Talk(Logs("", settings.engine.robots), Seal(KEY, WATCHERS[0]))
    hold, reached = order("hold"), []
    r1.take(laptop.order(hold, START_NS), START_NS)
    for second, link_up in enumerate((True, False, True)):
        now_ns = START_NS + second * S
        r1.step(replace(state(name, "hold", second), link_up=link_up))
        for message in r1.messages(now_ns):
            laptop.take(message, now_ns)
        reached.append(laptop.peers[name].obeyed == code_of(hold))
    assert reached == [True, False, True]


def test_an_order_that_is_void_is_said_no_more(settings: KernelSettings) -> None:
    laptop = watcher(settings)
    laptop.give(order("hold"), START_NS)
    resume, _ = laptop.give(order("resume", at_s=0.2), START_NS)
    r1 = agent(settings, settings.engine.robots[0])
    for message in laptop.messages(START_NS + TICK_NS):
        r1.take(message, START_NS + TICK_NS)
    assert r1.unlogged == [resume]


def test_another_laptops_order_is_handed_on_and_a_robots_is_left_to_its_log(settings: KernelSettings) -> None:
    laptop, tablet = watcher(settings), watcher(settings, WATCHERS[1])
    given, data = laptop.give(order("hold"), START_NS)
    assert tablet.take(data, START_NS) == [given] and tablet.orders.waiting == [given]
    r1 = agent(settings, settings.engine.robots[0])
    theirs = order("resume", r1.me, at_s=1.0)
    assert tablet.take(r1.talk.order(theirs, START_NS), START_NS) == [theirs]
    assert tablet.orders.waiting == [given] and tablet.take(data, START_NS) == []


def test_a_watcher_without_robots_in_contact_shows_what_was_and_says_how_old_it_is(
    settings: KernelSettings,
) -> None:
    laptop, name = watcher(settings), settings.engine.robots[0]
    assert laptop.step(START_NS).detections == () and laptop.lines.present(START_NS) == ()
    team = {each: agent(settings, each) for each in settings.engine.robots}
    for tick in range(1, 30):
        now_ns = START_NS + tick * TICK_NS
        for each, one in team.items():
            one.step(Pose(now_ns, each, 2.0, 2.0))
            one.step(Tick(now_ns))
            for message in one.messages(now_ns):
                laptop.take(message, now_ns)
                for other in team.values():
                    other.take(message, now_ns)
        for message in laptop.messages(now_ns):
            for one in team.values():
                one.take(message, now_ns)
        laptop.step(now_ns)
    assert laptop.lines.present(START_NS + 15 * S) == settings.engine.robots
    known = laptop.lines.common.horizon
    assert known - START_NS // TICK_NS >= 28 and laptop.fresh
    for tick in range(30, 300):
        laptop.step(START_NS + tick * TICK_NS)
    assert laptop.lines.common.horizon == laptop.lines.line.horizon == known
    assert laptop.lines.ages_s(START_NS + 150 * S)[name] == pytest.approx(135.5, abs=1.0)
    team[name].lines.step(START_NS + 29 * TICK_NS)
    assert (team[name].common.horizon, team[name].common.kernel.digest()) == (known, laptop.kernel.digest())


def test_an_agent_that_began_when_the_mission_was_over_is_of_the_next_one(settings: KernelSettings) -> None:
    laptop = watcher(settings)
    robots = settings.engine.robots
    assert not laptop.is_of_another(robots[0], START_NS + 10**6 * S, 7200.0), (
        "nothing is known of any mission"
    )
    for key in Logs.keys(robots):
        laptop.logs.learn(key, 0, (START_NS + 100 * S) // TICK_NS)
    began_ns = START_NS + 200 * S
    assert not laptop.is_of_another(robots[0], began_ns, 7200.0), "it was killed, and goes on"
    assert laptop.is_of_another(robots[0], began_ns, 60.0), "nothing was heard for a long time"
    for robot in robots:
        laptop.orders.read(replace(order("withdraw", at_s=150.0), robot=robot), robot, 0)
    assert laptop.is_of_another(robots[0], began_ns, 7200.0), "all had been ended"
    assert not laptop.is_of_another(robots[0], START_NS + 140 * S, 7200.0)
    assert not laptop.is_of_another("laptop 130", began_ns, 7200.0)
    laptop.over_ns = START_NS + 300 * S
    assert not laptop.is_of_another(robots[0], began_ns, 7200.0)
    assert laptop.is_of_another(robots[0], START_NS + 301 * S, 7200.0)


def test_an_order_that_comes_before_an_agent_has_its_log_back_does_not_begin_another(
    settings: KernelSettings,
) -> None:
    name = settings.engine.robots[0]
    laptop, before = watcher(settings), agent(settings, name)
    for tick in range(20):
        now_ns = START_NS + tick * TICK_NS
        before.step(Pose(now_ns, name, 2.0, 2.0))
        before.step(Tick(now_ns))
        for message in before.messages(now_ns):
            laptop.take(message, now_ns)
    again = agent(settings, name)
    given, data = laptop.give(order("hold", at_s=11.0), START_NS + 11 * S)
    again.take(data, given.t_ns)
    again.step(again.unlogged[0])
    tick = 23
    while tick < 30 or (tick < 90 and again.talk.lacks_own(START_NS + tick * TICK_NS)):  # it looks round
        tick += 1
        now_ns = START_NS + tick * TICK_NS
        for message in again.messages(now_ns):
            laptop.take(message, now_ns)
        for message in laptop.messages(now_ns):
            again.take(message, now_ns)
    again.step(Tick(START_NS + tick * TICK_NS))
    places = again.logs.entries[name, Stream.PLACES]
    assert list(places) == list(before.logs.entries[name, Stream.PLACES]) and not again.talk.lost
    assert given in [entry.event for entry in again.logs.entries[name, Stream.ORDERS]]


def test_a_hold_that_comes_late_does_not_undo_what_an_agents_own_operator_has_said_since(
    settings: KernelSettings,
) -> None:
    laptop, r1 = watcher(settings), agent(settings, settings.engine.robots[0])
    _, data = laptop.give(order("hold"), START_NS)
    r1.step(Tick(START_NS))
    r1.step(order("resume", at_s=20.0))
    assert r1.take(data, START_NS + 30 * S) == [] and r1.unlogged == []
