"""Members without a robot: they get all logs, carry them on, and hold nobody up."""

from collections.abc import Callable

import numpy as np
import pytest

from fieldkit.engine.decentralised import packing
from fieldkit.engine.decentralised.logs import NEVER, TICK_NS, Logs, Stream
from fieldkit.engine.decentralised.peer import GIVE_BACK_S
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import WATCHERS, Talk
from fieldkit.messages import Operator, Pose, RssReading
from fieldkit.world.network import Air, Network, Place

ROBOTS = ("a", "b")
S = 1_000_000_000
START_NS = 1_800_000_000 * S
KEY = session_key(bytes(32), "a mission")
Places = Callable[[float], dict[str, Place]]


def robot(name: str, **more: float) -> Talk:
    return Talk(Logs(name, ROBOTS), Seal(KEY, ROBOTS.index(name)), **more)


def watcher(number: int = WATCHERS[0], **more: float) -> Talk:
    return Talk(Logs("", ROBOTS), Seal(KEY, number), **more)


def converse(
    team: dict[str, Talk],
    seconds: tuple[int, int],
    air: Air = Air(),
    places: Places = lambda t_s: {},
    meanwhile: Callable[[float], None] = lambda t_s: None,
    clock_s: float = 0.0,
) -> None:
    """Each robot logs a pose and a reading at every tick; watchers' clocks are `clock_s` ahead."""
    network = Network(air, np.random.default_rng(seconds[0]))
    for tick in range(2 * seconds[0], 2 * seconds[1]):
        t_s, now_ns = tick / 2, START_NS + tick * TICK_NS

        def time_ns(name: str, now_ns: int = now_ns) -> int:
            return now_ns + (0 if name in ROBOTS else round(clock_s * 1e9))

        for name, data in network.arrived(t_s):
            if name in team:
                team[name].take(data, time_ns(name))
        meanwhile(t_s)
        for name, talk in team.items():
            if name in ROBOTS:
                talk.logs.append(packing.quantised(Pose(now_ns, name, 0.1 * tick, 1.0)), now_ns)
                talk.logs.append(packing.quantised(RssReading(now_ns, name, -60.0)), now_ns)
                talk.logs.close(now_ns)
            there = dict.fromkeys(team, (0.0, 0.0)) | places(t_s)
            for message in talk.messages(time_ns(name)):
                network.send(t_s, name, message, there)


def behind(talk: Talk, t_s: float) -> int:
    """Ticks that its checkpoint lies back."""
    return round(2 * t_s) + START_NS // TICK_NS - talk.logs.checkpoint()


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_watchers_that_come_late_get_every_log_whole_and_robots_ask_nothing_of_them(loss: float) -> None:
    team = {name: robot(name) for name in ROBOTS}
    converse(team, (0, 60))
    team |= {"laptop": watcher(), "tablet": watcher(WATCHERS[1])}
    converse(team, (60, 140), Air(loss=loss))
    for name in ("laptop", "tablet"):
        assert behind(team[name], 140.0) <= (6 if loss else 3)
        for key, log in team[name].logs.entries.items():
            assert list(log) == list(team[key[0]].logs.entries[key])[: len(log)]
    a = team["a"]
    assert set(a.peers) == {"b"} and set(a.watchers) == {*WATCHERS[:2]} and a.in_range(START_NS + 140 * S)
    assert not a.refused and not a.lost and not team["laptop"].refused


def test_a_watcher_that_lacks_an_hour_delays_nothing_between_robots_that_have_little_to_spare() -> None:
    most: dict[bool, int] = {}
    for watched in (False, True):
        team = {name: robot(name, bytes_s=180.0) for name in ROBOTS}
        converse(team, (0, 1000))
        if watched:
            team["laptop"] = watcher()
        lags: list[int] = []

        def look(t_s: float, team: dict[str, Talk] = team, lags: list[int] = lags) -> None:
            lags.append(max(behind(team[name], t_s) for name in ROBOTS))

        converse(team, (1000, 1100), meanwhile=look)
        most[watched] = max(lags[5:])
        if watched:
            assert sum(map(len, team["laptop"].logs.entries.values())) > 100, "it gets on meanwhile"
            assert behind(team["laptop"], 1100.0) > 200, "and is not done"
            a_second = sum(team["a"].sent.values()) / 1100
            assert a_second <= 180.0 and team["a"].sent["spare"] > 0
    assert most[True] <= most[False]


def test_what_robots_know_that_never_meet_is_carried_from_one_to_the_other() -> None:
    air = Air(range_m=10.0)
    far = {"a": (0.0, 0.0), "b": (100.0, 0.0)}

    def walks(t_s: float) -> dict[str, Place]:
        return far | {"laptop": (0.0, 5.0) if t_s % 80 < 40 else (100.0, 5.0)}

    team = {"a": robot("a"), "b": robot("b"), "laptop": watcher()}
    order = packing.quantised(Operator(START_NS, "hold", None, "stop"))
    team["a"].logs.append(order, START_NS)
    converse(team, (0, 40), air, walks)
    assert not any(team["b"].logs.entries["a", stream] for stream in (0, 1, 2))
    heard: list[Operator] = []
    converse(team, (40, 80), air, walks)
    heard = [entry.event for entry in team["b"].logs.entries["a", 0] if isinstance(entry.event, Operator)]  # type: ignore[index]
    assert heard == [order]
    known = team["b"].logs.closed_of("a") - START_NS // TICK_NS
    assert 70 <= known <= 80, "all that a had said before the laptop left"
    converse(team, (80, 120), air, walks)
    assert team["a"].logs.closed_of("b") - START_NS // TICK_NS >= 150
    assert not team["b"].peers and not team["a"].peers


def test_a_robot_that_has_lost_its_log_gets_it_back_from_a_watcher_and_waits_for_none_that_has_gone() -> None:
    team = {"a": robot("a"), "laptop": watcher()}
    converse(team, (0, 20))
    forgetful = robot("a")
    now_ns = START_NS + 20 * S
    for message in team["laptop"].messages(now_ns):
        forgetful.take(message, now_ns)
    assert forgetful.lacks_own(now_ns) and not forgetful.lacks_own(now_ns + 10 * S)
    for tick in range(1, 40):
        at_ns = now_ns + tick * TICK_NS
        for message in forgetful.messages(at_ns):
            team["laptop"].take(message, at_ns)
        for message in team["laptop"].messages(at_ns):
            forgetful.take(message, at_ns)
        if tick * TICK_NS < GIVE_BACK_S * S:
            assert not any(forgetful.logs.entries.values()), "it may be of the next mission"
    assert not forgetful.lacks_own(now_ns + 20 * S)
    assert sum(map(len, forgetful.logs.entries.values())) == sum(
        map(len, team["laptop"].logs.entries.values())
    )


def test_a_watcher_learns_how_far_its_clock_is_off_and_robots_go_by_no_watchers() -> None:
    team = {"a": robot("a"), "b": robot("b"), "laptop": watcher()}
    converse(team, (0, 10), clock_s=4.0)
    now_ns = START_NS + 10 * S
    off = team["laptop"].clock_off(now_ns + 4 * S)
    assert off is not None and off[0] == "a" and off[1] == pytest.approx(4.0, abs=0.3)
    assert team["a"].clock_off(now_ns) is None and team["b"].clock_off(now_ns) is None


def test_an_order_is_kept_being_said_until_it_is_void() -> None:
    laptop = watcher()
    order = packing.quantised(Operator(START_NS, "hold", None, "stop"))
    assert isinstance(order, Operator)
    said = robot("a").take(laptop.order(order, START_NS), START_NS)
    assert said is not None and (said.robot, said.order) == ("", order)
    for tick in range(1, 30):
        laptop.keep_saying(order)
        assert len(laptop.messages(START_NS + tick * TICK_NS)) == 2
    laptop.say_no_more(order)
    assert len(laptop.messages(START_NS + 30 * TICK_NS)) == 1


def test_who_has_no_robot_adds_to_no_log() -> None:
    logs = Logs("", ROBOTS)
    logs.close(START_NS)
    assert logs.own == () and set(logs.closed.values()) == {NEVER}
    with pytest.raises(ValueError, match="'z' is not one of a, b"):
        Logs("z", ROBOTS)


def test_a_watcher_that_has_just_come_knows_where_all_are_though_not_yet_where_they_were() -> None:
    team = {name: robot(name, bytes_s=180.0) for name in ROBOTS}
    converse(team, (0, 1000))
    laptop, seen_ns = watcher(), dict.fromkeys(ROBOTS, 0)
    for tick in range(2000, 2006):
        now_ns = START_NS + tick * TICK_NS
        for name, talk in team.items():
            talk.logs.append(packing.quantised(Pose(now_ns, name, 1.0, 1.0)), now_ns)
            talk.logs.close(now_ns)
            for message in talk.messages(now_ns):
                said = laptop.take(message, now_ns)
                assert said is not None
                seen_ns |= {entry.event.robot: entry.event.t_ns for entry in said.ahead if entry.event.robot}
        for message in laptop.messages(now_ns):
            for talk in team.values():
                talk.take(message, now_ns)
    assert min(seen_ns.values()) >= START_NS + 2004 * TICK_NS and laptop.logs.checkpoint() == NEVER


def test_over_links_that_take_seconds_a_watcher_waits_for_what_is_on_its_way() -> None:
    air = Air(range_m=10.0, delay_s=5.0)
    far = {"a": (0.0, 0.0), "b": (100.0, 0.0)}

    def walks(t_s: float) -> dict[str, Place]:
        return far | {"laptop": (0.0, 5.0) if t_s < 200 else (100.0, 5.0)}

    team = {"a": robot("a"), "b": robot("b"), "laptop": watcher()}
    converse(team, (0, 200), air, walks, clock_s=30.0)
    before = team["laptop"].sent["again"]
    converse(team, (200, 300), air, walks, clock_s=30.0)
    known = sum(len(team["b"].logs.entries["a", stream]) for stream in Stream)
    assert known > 740, "all that a had said"
    needed = sum(log.packed_bytes for log in team["laptop"].logs.entries.values()) or known * 8
    assert team["laptop"].sent["again"] - before < 4 * needed
    assert team["laptop"].peers["b"].round_trip_s == pytest.approx(10.5, abs=1.0)


def next_mission(team: dict[str, Talk], first: int, end: int) -> None:
    """The robots that are there and a laptop of the mission before are in reach of each other."""
    for tick in range(first, end):
        now_ns = START_NS + 1000 * S + tick * TICK_NS
        for name in ROBOTS:
            if name in team:
                team[name].logs.append(packing.quantised(RssReading(now_ns, name, -50.0)), now_ns)
                team[name].logs.close(now_ns)
        for name, talk in team.items():
            for message in talk.messages(now_ns):
                for other in team.keys() - {name}:
                    team[other].take(message, now_ns)


def test_a_laptop_of_the_mission_before_ends_no_agent_before_it_can_know_better() -> None:
    """A laptop that was left open comes into reach, and leaves when it hears that another mission has begun."""
    laptop = watcher()
    converse({"a": robot("a"), "b": robot("b"), "laptop": laptop}, (0, 60))
    a = robot("a")
    next_mission({"a": a}, 0, 10)
    next_mission({"a": a, "laptop": laptop}, 10, 10 + 2 * round(GIVE_BACK_S) - 1)
    assert not a.lost
    next_mission({"a": a}, 40, 60)
    next_mission({"a": a, "laptop": laptop}, 60, 70)
    assert not a.lost, "what it said long ago is nothing that it goes on saying"
    next_mission({"a": a, "laptop": laptop}, 70, 80)
    assert a.lost, "it knows that it is the same mission, and that this robot has lost its log"


def test_a_laptop_of_the_mission_before_brings_nobody_the_logs_of_others() -> None:
    """One robot has begun anew, the other has not: what the laptop knows of that one is of the mission before."""
    laptop = watcher()
    converse({"a": robot("a"), "b": robot("b"), "laptop": laptop}, (0, 60))
    a = robot("a")
    next_mission({"a": a, "laptop": laptop}, 0, 2 * round(GIVE_BACK_S) - 1)
    assert not any(a.logs.entries["b", stream] for stream in Stream)
    next_mission({"a": a, "laptop": laptop}, 2 * round(GIVE_BACK_S) - 1, 2 * round(GIVE_BACK_S) + 4)
    assert any(a.logs.entries["b", stream] for stream in Stream), "it has not left: it is of this mission"
