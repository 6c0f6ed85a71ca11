"""One that comes back into range says where it goes long before its positions have been caught up with."""

import math

from fieldkit.engine.decentralised.logs import TICK_NS
from fieldkit.engine.decentralised.ways import Way
from fieldkit.messages import Command, GoTo, Hold, Pose, Tick, VehicleState, Waypoint
from mission.safety.apart import SafetyApart
from mission.safety.limits import SafetySettings

S = 1_000_000_000
START_NS = 1_800_000_000 * S
SETTINGS = SafetySettings(("r1", "r2"), 12.0, 12.0, max_speed_m_s=0.4, min_separation_m=0.6)
CONTACT_M = 4.0
AWAY_S = 60.0


def back(way: Way, seen_m: tuple[float, float] = (9.0, 9.0)) -> SafetyApart:
    """Safety of r1 at (1, 1), which saw r2 a minute ago and has just heard of its way, not of where it is."""
    safety = SafetyApart(SETTINGS, me="r1", contact_m=CONTACT_M)
    for name, place in (("r1", (1.0, 1.0)), ("r2", seen_m)):
        safety.observe(VehicleState(START_NS, name, "guided", True))
        safety.observe(Pose(START_NS, name, *place, sigma_m=0.03))
    tick(safety, AWAY_S)
    safety.expect("r2", way, -1, at_ns(AWAY_S), at_ns(AWAY_S))
    return safety


def at_ns(seconds: float) -> int:
    return START_NS + round(seconds * 1e9)


def tick(safety: SafetyApart, seconds: float) -> list[Command]:
    """Go on to that time, half a second a tick; what r1 is told meanwhile."""
    told, now_ns = [], safety.robots["r1"].now_ns or START_NS
    while now_ns < at_ns(seconds):
        now_ns += S // 2
        safety.observe(Pose(now_ns, "r1", 1.0, 1.0, sigma_m=0.03))
        told += [each for each in safety.observe(Tick(now_ns)) if getattr(each, "robot", "") == "r1"]
    return told


def ask(
    safety: SafetyApart, seconds: float, east_m: float, north_m: float, speed_m_s: float = 0.4
) -> Command:
    return safety.allow(GoTo(at_ns(seconds), "r1", Waypoint(east_m, north_m, speed_m_s)))


def test_one_that_stands_where_nobody_has_seen_it_is_not_driven_over() -> None:
    safety = back(Way(7, (3.0, 1.0), (3.0, 1.0)))
    refused = ask(safety, AWAY_S, 5.0, 1.0)
    assert isinstance(refused, Hold) and "r2" in refused.reason
    assert isinstance(ask(safety, AWAY_S, 1.0, 5.0), GoTo), "elsewhere nobody is in its way"


def test_where_it_was_a_minute_ago_is_free_again() -> None:
    safety = back(Way(7, (9.0, 9.0), (9.0, 9.0)), seen_m=(3.0, 1.0))
    assert isinstance(ask(safety, AWAY_S, 5.0, 1.0), GoTo)


def test_old_positions_that_are_caught_up_with_do_not_put_it_back() -> None:
    standing = Way(7, (3.0, 1.0), (3.0, 1.0))
    safety = back(standing)
    safety.observe(Pose(at_ns(20.0), "r2", 8.0, 7.0, sigma_m=0.03))
    safety.expect("r2", standing, -1, at_ns(AWAY_S + 0.5), at_ns(AWAY_S + 0.5))
    assert isinstance(ask(safety, AWAY_S + 0.5, 5.0, 1.0), Hold)


def test_the_way_of_one_under_way_is_kept_clear_and_a_new_way_is_confirmed_first() -> None:
    drives = Way(at_ns(AWAY_S - 3.0) // TICK_NS, (3.0, 0.5), (3.0, 6.0), 0.4)
    safety = back(drives)
    crossing = ask(safety, AWAY_S, 5.0, 1.0)
    assert isinstance(crossing, Hold) and "was last seen 60 s ago, and may be on its path" in crossing.reason
    beside = ask(safety, AWAY_S, 1.0, 4.0)
    assert isinstance(beside, Hold) and "has not confirmed" in beside.reason
    assert safety.way is not None and safety.way.waits
    safety.expect("r2", drives, safety.way.number, at_ns(AWAY_S + 1.0), at_ns(AWAY_S + 1.0))
    assert isinstance(ask(safety, AWAY_S + 1.0, 1.0, 4.0), GoTo)


def test_one_under_way_goes_on_past_somebody_who_comes_into_range_and_holds_before_its_way() -> None:
    safety = back(Way(7, (9.0, 9.0), (9.0, 9.0)))
    assert isinstance(ask(safety, AWAY_S, 5.0, 1.0), GoTo)
    assert tick(safety, AWAY_S + 3.0) == []
    safety.expect("r2", Way(8, (9.0, 9.0), (9.0, 4.0), 0.4), -1, at_ns(AWAY_S + 3.0), at_ns(AWAY_S + 3.0))
    assert tick(safety, AWAY_S + 3.5) == []
    safety.expect("r2", Way(9, (9.0, 4.0), (2.0, 0.5), 0.4), -1, at_ns(AWAY_S + 3.5), at_ns(AWAY_S + 3.5))
    (held,) = tick(safety, AWAY_S + 4.0)
    assert isinstance(held, Hold)


def test_one_that_is_not_heard_is_out_of_range_as_promised() -> None:
    safety = back(Way(7, (3.0, 1.0), (3.0, 1.0)))
    tick(safety, AWAY_S + 30.0)
    assert isinstance(ask(safety, AWAY_S + 30.0, 1.0, 5.0), GoTo)


def test_another_speed_on_the_same_way_is_said() -> None:
    safety = back(Way(7, (9.0, 9.0), (9.0, 9.0)))
    assert isinstance(ask(safety, AWAY_S, 1.0, 6.0, 0.15), GoTo)
    slow = safety.way
    assert slow is not None and slow.speed_m_s == 0.15
    assert isinstance(ask(safety, AWAY_S + 1.0, 1.0, 6.0, 0.4), GoTo)
    assert safety.way is not None and safety.way.speed_m_s == 0.4
    assert safety.way.number == slow.number, "what was confirmed is where it leads"


def test_another_speed_that_is_said_is_believed() -> None:
    safety = back(Way(7, (9.0, 9.0), (9.0, 9.0)))
    for number, speed_m_s in ((1, 0.15), (1, 0.4)):
        safety.observe(Pose(at_ns(AWAY_S), "r2", 9.0, 9.0, sigma_m=0.03))
        safety.expect("r2", Way(number, (9.0, 9.0), (9.0, 4.0), speed_m_s), -1, at_ns(AWAY_S), at_ns(AWAY_S))
        target = safety.robots["r2"].target
        assert target is not None and math.isclose(target.speed_m_s, speed_m_s)


def test_words_that_come_late_do_not_say_where_it_stands_now() -> None:
    safety = back(Way(7, (9.0, 9.0), (9.0, 9.0)))
    said = Way(8, (3.0, 4.0), (3.0, 4.0))
    safety.expect("r2", said, -1, at_ns(AWAY_S + 5.0), at_ns(AWAY_S))
    place_m = safety.robots["r2"].place_m
    assert place_m == (9.0, 9.0), "it may have set out in the five seconds since"
    safety.expect("r2", said, -1, at_ns(AWAY_S + 5.0), at_ns(AWAY_S + 4.0))
    assert safety.robots["r2"].place_m == (3.0, 4.0)
