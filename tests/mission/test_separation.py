"""How near robots come: against small steps in time, at every start, and at each limit just below and just above."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fieldkit.geometry.segments import Segment, standing
from fieldkit.messages import Pose, VehicleState
from mission.safety.limits import SafetySettings
from mission.safety.monitor import FADING_S, Watched
from mission.safety.separation import STARTS_S, are_layered, conflict, mark_too_near, occupancies

Place = tuple[float, float]
NAMES = ("a", "b", "c")
LIMITS = SafetySettings(NAMES, 100.0, 100.0, max_speed_m_s=0.5, min_separation_m=2.0)
NEAR_M = 1.0
S = 1_000_000_000
places = st.tuples(st.floats(-8, 8), st.floats(-8, 8))


def robot(
    name: str, at_m: Place, to_m: Place | None = None, speed: float = 0.5, up_m: float = 0.0
) -> Watched:
    watched = Watched(name)
    watched.see(Pose(0, name, *at_m, up_m=up_m), LIMITS)
    if to_m is not None:
        watched.send(Segment(at_m, to_m, speed), 0)
    return watched


def held(
    mine: Segment,
    *others: Watched,
    new: dict[str, Segment] | None = None,
    undecided: tuple[str, ...] = (),
    settings: SafetySettings = LIMITS,
) -> str:
    robots = {other.name: other for other in (robot("a", mine.start_m), *others)}
    return conflict(robots["a"], mine, new or {}, occupancies(robots, settings), undecided, settings)


def stepped_m(one: Segment, other: Segment, late_s: float) -> float:
    """The least distance when either sets out up to `late_s` after the other, by small steps in time."""

    def path(segment: Segment, t_s: np.ndarray) -> np.ndarray:
        length_m = math.dist(segment.start_m, segment.end_m)
        share = np.clip(t_s * segment.speed_m_s / length_m, 0, 1) if length_m > 0 else np.zeros_like(t_s)
        return np.array(segment.start_m) + share[:, None] * np.subtract(segment.end_m, segment.start_m)

    moments = np.arange(0.0, 90.0, 0.25)
    delays = np.arange(0.0, late_s + 0.01, 0.4)
    starts = [(late, 0.0) for late in delays] + [(0.0, late) for late in delays]
    return min(
        float(np.linalg.norm(path(one, moments - a) - path(other, moments - b), axis=1).min())
        for a, b in starts
    )


# Before segments are given


@settings(max_examples=60, deadline=None)
@given(a=places, b=places, c=places, d=places, u=st.floats(0.2, 0.5), v=st.floats(0.2, 0.5))
def test_a_segment_is_held_where_small_steps_at_any_start_come_too_near(
    a: Place, b: Place, c: Place, d: Place, u: float, v: float
) -> None:
    assume(math.dist(a, c) > 1.3 * NEAR_M)
    mine, theirs = Segment(a, b, u), Segment(c, d, v)
    closest_m = stepped_m(mine, theirs, STARTS_S)
    assume(not 1.2 * NEAR_M - 0.25 < closest_m < 1.2 * NEAR_M + 0.13)  # between two starts, and two steps
    assert bool(held(mine, robot("b", c, d, v))) == (closest_m < 1.2 * NEAR_M)


@pytest.mark.parametrize("separation_m", [2.0, 3.0, 0.5])
@pytest.mark.parametrize(("aside_m", "refused"), [(-0.01, True), (-4e-7, True), (4e-7, False), (0.01, False)])
def test_a_path_keeps_a_fifth_more_than_too_near_from_one_that_stands(
    separation_m: float, aside_m: float, refused: bool
) -> None:
    settings = replace(LIMITS, min_separation_m=separation_m)
    off_m = 0.6 * separation_m + aside_m
    reason = held(Segment((0, 0), (0, 20), 0.5), robot("b", (off_m, 10.0)), settings=settings)
    assert bool(reason) == refused
    assert not refused or reason == f"its path comes within {off_m:.2f} m of b"


@pytest.mark.parametrize(("theirs_s", "beyond_m"), [(0.5, 0.5), (6.0, 2.0)])
@pytest.mark.parametrize("later_s", [-4.9, -2.5, 2.5, 3.8, 4.9, 7.5])
def test_a_crossing_is_held_when_either_starts_up_to_four_seconds_late_and_then_meets_the_other(
    theirs_s: float, beyond_m: float, later_s: float
) -> None:
    """Both drive 1 m/s, they across my path: they are there in `theirs_s`, I so much later."""
    if theirs_s + later_s <= 1.0:
        return
    theirs = robot("b", (0.0, -theirs_s), (0.0, beyond_m), 1.0)
    mine = Segment((-theirs_s - later_s, 0.0), (9.0, 0.0), 1.0)
    assert bool(held(mine, theirs, settings=replace(LIMITS, min_separation_m=0.5))) == (abs(later_s) < 4.0)


@pytest.mark.parametrize("gap_m", [0.3, 1.0, 1.19])
def test_robots_side_by_side_may_part_but_come_no_nearer(gap_m: float) -> None:
    beside = robot("b", (gap_m, 0.0))
    assert held(Segment((0, 0), (-5, 0), 0.5), beside) == ""
    assert held(Segment((0, 0), (0, 5), 0.5), beside) == "", "abreast is no nearer"
    assert held(Segment((0, 0), (0.005, 0), 0.5), beside) == "", "a centimetre is noise"
    assert held(Segment((0, 0), (0.02, 0), 0.5), beside)


def test_a_robot_is_not_in_its_own_way_nor_in_that_of_one_that_is_sent_elsewhere() -> None:
    mine = Segment((0, 0), (0, 10), 0.5)
    assert held(mine, robot("b", (5, 5), (-5, 5)))
    assert held(mine, robot("b", (5, 5), (-5, 5)), undecided=("b",)) == ""
    assert held(mine, robot("b", (5, 5), (-5, 5)), new={"b": Segment((5, 5), (9, 5), 0.5)}) == ""
    assert held(mine, robot("b", (5, 5)), new={"b": Segment((5, 5), (-5, 5), 0.5)})
    assert "of c" in held(mine, robot("b", (5, 5)), robot("c", (0.5, 5.0)))


def test_one_told_to_stop_is_looked_at_both_driving_and_standing() -> None:
    other = robot("b", (5.0, 0.0), (5.0, 10.0))
    other.stop()
    assert held(Segment((1, 0.5), (9, 0.5), 0.5), other), "it may stand"
    assert held(Segment((6.5, 9), (4, 9), 0.5), other), "it may drive on"
    other.now_ns = round((FADING_S + 0.1) * S)
    other.pose = Pose(other.now_ns, "b", 5.0, 0.0)
    assert held(Segment((6.5, 9), (4, 9), 0.5), other) == ""


def lost(at_m: Place, to_m: Place) -> Watched:
    """One that was sent to `to_m` and has not been seen for half a minute."""
    other = robot("b", at_m, to_m)
    other.now_ns = 30 * S
    return other


@pytest.mark.parametrize(("end_north_m", "refused"), [(8.79, False), (8.81, True)])
def test_one_not_seen_may_be_anywhere_on_its_way(end_north_m: float, refused: bool) -> None:
    other = lost((-4.0, 10.0), (4.0, 10.0))  # 7.5 m at 0.5 m/s by the time its failsafe has stopped it
    reason = held(Segment((0, 0), (0, end_north_m), 0.5), other)
    assert bool(reason) == refused
    assert not refused or reason == "its path comes within 1.19 m of where b may be"
    assert (held(Segment((4.75, 0), (4.75, 10.0), 0.5), other)) == "", "so far it has not come"
    assert held(Segment((4.65, 0), (4.65, 10.0), 0.5), other)


def test_one_where_a_lost_robot_may_be_may_drive_off_but_not_along() -> None:
    other = lost((0.0, 10.0), (4.0, 10.0))
    assert held(Segment((2, 9.5), (2, 5), 0.5), other) == ""
    assert held(Segment((2, 9.5), (3.5, 9.4), 0.5), other)
    assert held(Segment((2, 9.5), (2, 15), 0.5), other), "through it"
    assert held(Segment((2, 9.5), (2, 9), 0.5), other), "not clear of it"


@pytest.mark.parametrize("gap_m", [3.0, 5.0])
@pytest.mark.parametrize("lower", ["a", "b"])
def test_robots_cannot_meet_when_both_their_layers_and_they_are_apart(gap_m: float, lower: str) -> None:
    upper = "b" if lower == "a" else "a"
    low = robot(lower, (0, 0), up_m=20.0)
    for layer_m, now_m, apart in (
        (gap_m, 0.7 * gap_m + 0.01, True), (gap_m, 0.7 * gap_m - 0.01, False), (gap_m - 0.01, gap_m, False),
    ):  # fmt: skip
        layers = {lower: 20.0, upper: 20.0 + layer_m}
        settings = replace(LIMITS, vertical_separation_m=gap_m, altitude_m=layers)
        assert are_layered(low, robot(upper, (0, 0), up_m=20.0 + now_m), settings) == apart
        assert are_layered(robot(upper, (0, 0), up_m=20.0 + now_m), low, settings) == apart


def test_a_path_below_another_robot_is_open() -> None:
    settings = replace(LIMITS, altitude_m={"b": 20.0})
    path = Segment((0, 0), (0, 9), 0.5)
    assert held(path, robot("b", (0, 5), up_m=20.0), settings=settings) == ""
    assert held(path, robot("b", (0, 5), up_m=0.5), settings=settings), "it has landed in the way"


def test_one_on_the_ground_has_the_lowest_layer_and_one_not_seen_none() -> None:
    settings = replace(LIMITS, altitude_m={"a": 3.0})
    assert are_layered(robot("a", (0, 0), up_m=3.0), robot("b", (0, 0)), settings)
    assert not are_layered(Watched("a"), robot("b", (0, 0)), settings)
    assert not are_layered(robot("a", (0, 0), up_m=3.0), Watched("b"), settings)
    assert not are_layered(Watched("a"), Watched("b"), settings)


# While they drive


def too_near(
    *robots: Watched, homeward: dict[str, Segment] | None = None, settings: SafetySettings = LIMITS
) -> set[str]:
    mark_too_near({each.name: each for each in robots}, homeward or {}, settings)
    return {each.name for each in robots if each.too_near}


@settings(max_examples=60, deadline=None)
@given(a=places, b=places, c=places, d=places, u=st.floats(0.2, 0.5), v=st.floats(0.2, 0.5))
def test_under_way_two_are_stopped_when_small_steps_of_the_next_moments_come_too_near(
    a: Place, b: Place, c: Place, d: Place, u: float, v: float
) -> None:
    assume(math.dist(a, c) > NEAR_M + 0.05)
    one, other = Segment(a, b, u), Segment(c, d, v)
    soon = [replace(s, end_m=s.at(4.0)) for s in (one, other)]
    closest_m = stepped_m(soon[0], soon[1], 0.0)
    assume(not NEAR_M - 0.02 < closest_m < NEAR_M + 0.13)
    pair = robot("a", a, b, u), robot("b", c, d, v)
    for each, driven in zip(pair, (one, other), strict=True):
        (e0, n0), (e1, n1) = driven.at(0.0), driven.at(1e-3)
        each.velocity_m_s = (1e3 * (e1 - e0), 1e3 * (n1 - n0))  # both have got going
    stopped = too_near(*pair)
    assert bool(stopped) == (closest_m < NEAR_M)
    if stopped:
        helps_m = stepped_m(soon[0], standing(c), 0.0)
        assume(abs(helps_m - NEAR_M) > 0.13)
        assert stopped == {"b" if helps_m > NEAR_M else "a"}, "the later-named one, where that helps"


@pytest.mark.parametrize(("braking_m", "speed_m_s", "ahead_s"), [(0, 0.5, 4), (1, 0.5, 6), (1, 0.25, 8)])
def test_they_look_as_far_ahead_as_stopping_takes(braking_m: float, speed_m_s: float, ahead_s: float) -> None:
    settings = replace(LIMITS, braking_m=braking_m, max_speed_m_s=speed_m_s)
    for off_m, stopped in ((-0.02, {"a"}), (0.02, set())):
        away_m = NEAR_M + 0.5 * ahead_s + off_m
        pair = robot("a", (0, 0), (20, 0)), robot("b", (away_m, 0))
        assert too_near(*pair, settings=settings) == stopped
        assert too_near(robot("a", (away_m, 0)), robot("b", (0, 0), (20, 0)), settings=settings) == (
            {"b"} if stopped else set()
        )


def test_a_mission_in_which_nobody_may_drive_is_watched_as_well() -> None:
    settings = replace(LIMITS, max_speed_m_s=0.0, braking_m=1.0)
    assert too_near(robot("a", (0, 0)), robot("b", (0.5, 0)), settings=settings) == set()


@pytest.mark.parametrize("separation_m", [2.0, 4.0, 0.8])
def test_of_two_too_near_the_later_named_waits_until_the_gap_has_opened(separation_m: float) -> None:
    settings = replace(LIMITS, min_separation_m=separation_m)
    near_m = separation_m / 2

    def after(gap_m: float, before: bool, towards_m: float) -> set[str]:
        a, b = robot("a", (0, 0), (0, 40)), robot("b", (gap_m, 0), (gap_m - towards_m, 0.0))
        a.target, b.too_near = None, before
        return too_near(a, b, settings=settings)

    assert after(0.99 * near_m, False, 0.2) == {"b"}
    assert after(0.99 * near_m, False, -0.2) == set(), "apart it may go"
    assert after(0.99 * near_m, False, 0.005) == set(), "a centimetre is noise"
    assert after(1.19 * near_m, True, 0.05 * near_m) == {"b"}
    assert after(1.21 * near_m, True, 0.05 * near_m) == set()
    assert after(1.19 * near_m, False, 0.05 * near_m) == set(), "it had not been too near"


def test_of_two_too_near_the_one_that_drives_waits() -> None:
    assert too_near(robot("a", (0, 0), (5, 0)), robot("b", (0.9, 0))) == {"a"}
    assert too_near(robot("a", (0, 0)), robot("b", (0.9, 0), (-5, 0))) == {"b"}
    assert too_near(robot("a", (0, 0), (5, 0)), robot("b", (0.9, 0), (-5, 0))) == {"a", "b"}, (
        "head-on both wait"
    )
    assert too_near(robot("a", (0, 0)), robot("b", (0.9, 0))) == set()


def test_when_nobody_is_too_near_any_more_nobody_is_marked() -> None:
    a, b = robot("a", (0, 0), (0, 20)), robot("b", (9, 0), (9, 20))
    a.too_near = b.too_near = True
    assert too_near(a, b) == set()
    assert too_near(a, Watched("b")) == set(), "of one never seen nothing is known"


def test_a_centimetre_at_the_limit_stops_nobody() -> None:
    for closing_m, stopped in ((0.008, set()), (0.03, {"b"})):
        start_m = NEAR_M + 0.005
        pair = robot("a", (0, 0)), robot("b", (start_m, 0), (start_m - closing_m, 0.0))
        assert too_near(*pair) == stopped


def test_a_robot_on_its_way_home_counts_as_driving_that_way() -> None:
    home = {"b": Segment((4, 0), (0, 0), 0.5)}
    assert too_near(robot("a", (1.5, 0)), robot("b", (4, 0))) == set()
    assert too_near(robot("a", (1.5, 0)), robot("b", (4, 0)), homeward=home) == {"b"}
    assert too_near(robot("b", (4, 0)), robot("c", (1.5, 0)), homeward=home) == {"b"}


def test_robots_one_above_the_other_do_not_stop_each_other() -> None:
    settings = replace(LIMITS, altitude_m={"a": 20.0, "b": 30.0})
    pair = robot("a", (0, 0), (5, 0), up_m=20.0), robot("b", (1.5, 1.5), (1.5, -5), up_m=30.0)
    assert too_near(*pair) == {"b"} and too_near(*pair, settings=settings) == set()


def test_one_that_others_steer_is_kept_clear_of_by_how_it_moves() -> None:
    other = robot("b", (4.0, 0.0))
    other.vehicle = VehicleState(0, "b", "other", True)
    standing_still = robot("a", (0, 0), (20, 0), 0.25)
    assert too_near(standing_still, other) == set()
    other.velocity_m_s = (-0.6, 0.0)
    assert too_near(robot("a", (0, 0), (20, 0), 0.25), other) == {"a"}
    assert too_near(robot("c", (0, 0), (20, 0), 0.25), other) == {"c"}, "of two the one that we can stop"
    other.velocity_m_s = (0.5, 0.0)
    assert too_near(robot("a", (0, 0), (20, 0), 0.25), other) == set()


def test_one_that_strays_is_where_it_drives_and_not_where_it_was_sent() -> None:
    for strays, stopped in ((False, set()), (True, {"b"})):
        stray = robot("b", (2.8, 0.0), (20.0, 0.0))
        stray.now_ns = 10 * S
        stray.pose = Pose(10 * S, "b", 2.8, 0.0)
        stray.velocity_m_s = (-0.5, 0.0) if strays else (0.5, 0.0)
        assert too_near(robot("a", (0, 0)), stray) == stopped


@pytest.mark.parametrize(("name", "lost_name"), [("a", "b"), ("b", "a")])
def test_one_that_drives_to_where_a_lost_one_may_be_is_stopped(name: str, lost_name: str) -> None:
    def near_lost(east_m: float, to_m: Place | None) -> set[str]:
        gone = robot(lost_name, (0.0, 0.0), (20.0, 0.0))
        gone.now_ns = 30 * S
        mover = robot(name, (east_m, 2.5), to_m)
        mover.now_ns, mover.pose = 30 * S, Pose(30 * S, name, east_m, 2.5)
        return too_near(mover, gone) - {lost_name}

    assert near_lost(7.0, (7.0, 0.0)) == {name}, "somewhere on its way, 7.5 m long"
    assert near_lost(9.0, (9.0, 0.0)) == set()
    assert near_lost(7.0, (7.0, 9.0)) == set()
    assert near_lost(7.0, None) == set(), "one that stands cannot be stopped"


@pytest.mark.parametrize(("to_m", "stopped"), [((4.0, 5.0), set()), ((7.0, 0.9), {"b"})])
def test_one_beside_a_lost_ones_way_may_drive_off(to_m: Place, stopped: set[str]) -> None:
    gone = robot("a", (0.0, 0.0), (20.0, 0.0))
    mover = robot("b", (4.0, 0.9), to_m)
    gone.now_ns = mover.now_ns = 30 * S
    mover.pose = Pose(30 * S, "b", 4.0, 0.9)
    assert too_near(gone, mover) - {"a"} == stopped


def test_one_that_drives_over_a_robot_that_was_stopped_is_stopped_as_well() -> None:
    past = robot("a", (0.3, 0.0), (-5.0, 0.1))
    assert too_near(past, robot("b", (0.0, 0.0), (0.0, 5.0), 0.5)) == {"a", "b"}
    leaving = robot("a", (0.3, 0.0), (5.0, 0.0))
    assert too_near(leaving, robot("b", (0.0, 0.0), (5.0, 0.0), 1.0)) == {"b"}, "one that leaves may go on"


def test_a_robot_that_has_not_got_going_is_taken_to_stand_too() -> None:
    """A car that was sent north turns first; another would pass in front of where it should be, and does not."""

    def stopped(velocity_m_s: tuple[float, float], sent_ago_s: float) -> set[str]:
        slow = robot("a", (0.0, 0.0), (0.0, 20.0), 0.5)
        passing = robot("b", (1.5, 0.0), (-5.0, 0.0), 0.5)
        for each in (slow, passing):
            each.now_ns = round(1.5e9)
        slow.velocity_m_s, slow.sent_ns = velocity_m_s, round((1.5 - sent_ago_s) * 1e9)
        passing.velocity_m_s = (-0.5, 0.0)
        return too_near(slow, passing)

    assert stopped((0.05, 0.05), 1.0) == {"b"}
    assert stopped((0.0, 0.45), 1.0) == set(), "it has got going, and will be gone"
    assert stopped((0.0, 0.26), STARTS_S - 0.1) == set() and stopped((0.0, 0.24), STARTS_S - 0.1) == {"b"}


@pytest.mark.parametrize(("late_name", "name"), [("a", "b"), ("b", "a")])
@pytest.mark.parametrize(("aside_m", "stops"), [(0.99, True), (1.01, False)])
def test_past_one_that_has_not_got_going_another_keeps_the_least_distance(
    late_name: str, name: str, aside_m: float, stops: bool
) -> None:
    """It passes behind the one that should be gone by then: too near only if that one still stands."""
    slow = robot(late_name, (0.0, 0.0), (0.0, 20.0), 0.5)
    passing = robot(name, (1.9, -aside_m), (-5.0, -aside_m), 0.5)
    passing.velocity_m_s = (-0.5, 0.0)
    assert too_near(slow, passing) == ({name} if stops else set())
    slow.velocity_m_s = (0.0, 0.5)
    assert too_near(slow, passing) == set(), "it has got going"


@pytest.mark.parametrize("speed_m_s", [0.5, 0.2])
def test_a_robot_lags_for_a_while_after_it_was_sent_until_it_makes_half_its_speed(speed_m_s: float) -> None:
    late = robot("a", (0.0, 0.0), (0.0, 20.0), speed_m_s)
    half = 0.5 * speed_m_s
    late.sent_ns, late.now_ns = 10 * S, 14 * S
    for velocity, lags in (((0.0, half), False), ((half, 0.0), False), ((0.0, 0.99 * half), True)):
        late.velocity_m_s = velocity
        assert late.lags(4.0) == lags
    late.velocity_m_s = (0.8 * half, 0.8 * half)
    assert not late.lags(4.0), "however it is headed"
    late.velocity_m_s = (0.0, 0.0)
    assert late.lags(4.0) and not late.lags(3.999)
    late.stop()
    assert not late.lags(4.0), "it is to stand"


def aimed_past(distance_m: float, gap_m: float) -> Place:
    """Where to drive from the origin to come so near to one at (gap, 0)."""
    sine = distance_m / gap_m
    return (20.0 * math.sqrt(1.0 - sine**2), 20.0 * sine)


@pytest.mark.parametrize(
    ("gap_m", "before", "comes_m", "both"),
    [
        (0.9, False, 0.885, True),
        (0.9, False, 0.895, False),
        (1.1, True, 0.985, True),
        (1.1, True, 0.995, False),
    ],
)
def test_where_stopping_one_is_not_enough_both_stop(
    gap_m: float, before: bool, comes_m: float, both: bool
) -> None:
    """The earlier-named drives past the place where the later-named stops: a centimetre nearer stops it as well."""
    first = robot("a", (0.0, 0.0), aimed_past(comes_m, gap_m))
    second = robot("b", (gap_m, 0.0), (-5.0, 0.0))
    second.too_near = before
    assert too_near(first, second) == ({"a", "b"} if both else {"b"})


def test_one_that_others_steer_is_not_stopped_beside_ours() -> None:
    theirs = robot("a", (0.0, 0.0))
    theirs.vehicle = VehicleState(0, "a", "other", True)
    theirs.velocity_m_s = (0.5, 0.0)
    assert too_near(theirs, robot("b", (0.9, 0.0), (-5.0, 0.0))) == {"b"}


@pytest.mark.parametrize(("seen_s_ago", "stopped"), [(0.0, False), (1.0, True)])
@pytest.mark.parametrize("seen_late", ["a", "b"])
def test_one_that_was_seen_a_while_ago_has_got_on_since(
    seen_s_ago: float, stopped: bool, seen_late: str
) -> None:
    """Two cross: where both were last seen they pass 1.15 m apart; one of them is half a metre further on by now."""
    late, other = robot("a", (0.0, 2.63), (0.0, -2.0)), robot("b", (-1.0, 0.0), (2.0, 0.0))
    for each in (late, other):
        each.velocity_m_s = (0.5, 0.0) if each is other else (0.0, -0.5)
        assert each.pose is not None
        each.pose = replace(each.pose, t_ns=round((10.0 - (seen_s_ago if each is late else 0.0)) * S))
    late.name, other.name = ("a", "b") if seen_late == "a" else ("b", "a")
    assert bool(too_near(*sorted((late, other), key=lambda each: each.name))) == stopped
