"""What is known of one robot and what is wrong with it: each limit just below and just above, by plain reckoning."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_field import LIMITS, driven, kind, ns, on_its_way, pose, seen

from fieldkit.geometry.polygons import KeepOut
from fieldkit.geometry.segments import Segment
from fieldkit.messages import ReceiverState, VehicleState
from mission.safety.limits import BatteryLimits, RadioLimits, SafetySettings
from mission.safety.monitor import (
    Trouble,
    Watched,
    low_battery,
    not_ready,
    reserve_of,
    trouble_of,
    under_way_trouble,
)

SQUARE = ((40.0, 40.0), (60.0, 40.0), (60.0, 60.0), (40.0, 60.0))


# The settings' ground


@pytest.mark.parametrize("margin_m", [0.2, 3.0])
def test_way_points_keep_the_margin_and_robots_the_bounds(margin_m: float) -> None:
    closed = KeepOut((SQUARE,))
    limits = SafetySettings(("a",), 100.0, 80.0, fence_margin_m=margin_m, keep_out=closed)
    assert limits.bounds.clearance_m((10.0, 30.0)) == pytest.approx(10.0, abs=1e-3)
    assert limits.bounds.clearance_m((30.0, 50.0)) == pytest.approx(10.0, abs=1e-3)
    assert limits.bounds.clearance_m((90.0, 75.0)) == pytest.approx(5.0, abs=1e-3)
    for corner in ((0.0, 0.0), (100.0, 0.0), (100.0, 80.0), (0.0, 80.0)):
        assert limits.bounds.clearance_m(corner) == pytest.approx(0.0, abs=1e-3)
    assert limits.margins.clearance_m((30.0, 50.0)) == pytest.approx(10.0 - margin_m, abs=1e-3)
    assert limits.fence.clearance_m((10.0, 40.0)) == pytest.approx(10.0 - margin_m, abs=1e-3)
    assert limits.fence.clearance_m((50.0, 50.0)) > 0.0, "closed ground is none of the fence's business"


@pytest.mark.parametrize("separation_m", [0.5, 3.0])
def test_too_near_is_half_the_separation_of_way_points(separation_m: float) -> None:
    limits = replace(LIMITS, min_separation_m=separation_m)
    assert limits.near_m + limits.near_m == separation_m


# Positions


@pytest.mark.parametrize("timeout_s", [2.0, 7.0])
def test_a_position_older_than_its_limit_is_no_position(timeout_s: float) -> None:
    limits = replace(LIMITS, pose_timeout_s=timeout_s)
    robot = seen(pose(10.0, 50.0))
    assert not_ready(robot, limits, ns(10.0 + timeout_s - 0.01)) is None
    trouble = not_ready(robot, limits, ns(10.0 + timeout_s + 0.01))
    assert trouble is not None and trouble.kind == "position" and trouble.then == "operator"
    assert f"{timeout_s:.1f} s old (limit {timeout_s:.1f} s)" in trouble.reason


def test_a_position_more_than_a_second_ahead_of_us_comes_from_a_wrong_clock() -> None:
    robot = seen(pose(10.0, 50.0))
    assert not_ready(robot, LIMITS, ns(9.01)) is None
    trouble = not_ready(robot, LIMITS, ns(8.9))
    assert trouble is not None and "from 1.1 s in the future" in trouble.reason


@pytest.mark.parametrize("side_m", [100.0, 40.0])
def test_a_position_less_sure_than_a_quarter_of_the_field_is_none(side_m: float) -> None:
    """With tens of metres of it nothing could be said to be outside, too fast or too near."""
    limits = replace(LIMITS, size_north_m=side_m)
    sure, unsure = (seen(pose(10.0, 5.0, 5.0, share * side_m)) for share in (0.24, 0.26))
    assert not_ready(sure, limits, ns(10.0)) is None
    trouble = not_ready(unsure, limits, ns(10.0))
    assert trouble is not None and trouble.kind == "position" and "m only" in trouble.reason
    assert not_ready(unsure, replace(limits, on_foot=frozenset({"a"})), ns(10.0)) is None


@pytest.mark.parametrize("sigma_m", [math.nan, math.inf])
def test_a_position_of_which_nobody_knows_how_sure_it_is_is_none(sigma_m: float) -> None:
    robot = seen(pose(10.0, 50.0), pose(10.2, 50.0, sigma_m=sigma_m))
    assert robot.pose is not None and robot.pose.t_ns == ns(10.0)
    assert kind(not_ready(robot, LIMITS, ns(10.2))) == "position"


def test_a_robot_never_seen_has_no_position() -> None:
    assert kind(not_ready(Watched("a"), LIMITS, 0)) == "position"
    assert kind(under_way_trouble(Watched("a"), LIMITS, 0)) == "position"
    assert Watched("a").place_m is None


def test_one_that_holds_stands_where_it_is_seen_from_then_on() -> None:
    """Where messages are lost the word that it holds may come before the positions of its last metre."""
    robot = Watched("a")
    robot.see(pose(9.0, 20.0), LIMITS)
    robot.send(Segment((20.0, 20.0), (30.0, 20.0), 0.4), ns(9.0))
    robot.now_ns = ns(10.0)
    robot.stop()
    robot.hear_vehicle(VehicleState(ns(10.5), "a", "hold", True))
    way = robot.segment()
    assert way is not None and way.end_m == (30.0, 20.0), "its last position is from before it held"
    robot.see(pose(10.5, 20.5), LIMITS)
    robot.hear_vehicle(VehicleState(ns(11.0), "a", "hold", True))
    way = robot.segment()
    assert way is not None and way.length_m == 0.0 and way.end_m[0] == 20.5


@pytest.mark.parametrize("further_m", [-0.01, 0.01])
@pytest.mark.parametrize(("speed_m_s", "passed_s", "sigma_m"), [(1, 1, 0), (1, 0, 0), (3, 1, 0), (1, 4, 0.5)])
def test_no_robot_gets_further_than_three_times_its_speed_and_its_positions_noise(
    speed_m_s: float, passed_s: float, sigma_m: float, further_m: float
) -> None:
    limits = replace(LIMITS, max_speed_m_s=speed_m_s, pose_timeout_s=30.0)
    reach_m = 0.5 + 3 * speed_m_s * passed_s + 6 * sigma_m
    moved_m = reach_m + further_m
    # 3-4-5: east and north count alike
    robot = seen(pose(0, 0.0, 0.0), pose(passed_s, 0.6 * moved_m, 0.8 * moved_m, sigma_m), settings=limits)
    assert robot.place_m == pytest.approx((0.6 * moved_m, 0.8 * moved_m)), "it is kept all the same"
    reason = getattr(not_ready(robot, limits, ns(passed_s + 2.99)), "reason", "")
    assert ("jumped" in reason) == (further_m > 0)
    assert not_ready(robot, limits, ns(passed_s + 3.01)) is None


def test_positions_that_come_in_the_wrong_order_may_differ_by_the_slack() -> None:
    limits = replace(LIMITS, pose_timeout_s=30.0)
    assert not_ready(seen(pose(5, 50.0), pose(4, 50.4), settings=limits), limits, ns(5)) is None
    assert kind(not_ready(seen(pose(5, 50.0), pose(4, 50.6), settings=limits), limits, ns(5))) == "position"


@pytest.mark.parametrize("broken", [(math.nan, 50.0), (50.0, math.nan), (math.inf, 50.0), (50.0, -math.inf)])
def test_a_position_that_is_no_number_is_dropped_and_makes_the_others_doubted(
    broken: tuple[float, float],
) -> None:
    robot = seen(pose(0, 50.0), pose(1, *broken))
    assert robot.place_m == (50.0, 50.0)
    assert kind(not_ready(robot, LIMITS, ns(1))) == "position"


def test_home_is_where_it_was_first_seen() -> None:
    assert seen(pose(0, 50.0), pose(1, 50.7), pose(2, 51.4)).home_m == (50.0, 50.0)
    assert seen(pose(0, math.nan), pose(1, 50.7)).home_m == (50.7, 50.0)


# Speed


def test_velocity_after_one_second_is_half_of_what_a_robot_from_rest_drives() -> None:
    robot = seen(pose(0, 50.0, 50.0), pose(1, 52.0, 49.0))
    assert robot.velocity_m_s == pytest.approx((1.0, -0.5))


@given(east=st.floats(-2, 2), north=st.floats(-2, 2), step_s=st.floats(0.05, 2.0), count=st.integers(1, 12))
def test_velocity_nears_the_true_one_by_the_same_share_each_step(
    east: float, north: float, step_s: float, count: int
) -> None:
    robot = seen(*(pose(k * step_s, k * step_s * east, k * step_s * north) for k in range(count + 1)))
    missing = (1.0 / (1.0 + step_s)) ** count
    assert robot.velocity_m_s == pytest.approx((east * (1 - missing), north * (1 - missing)), abs=1e-6)


def test_a_jump_is_no_velocity_and_a_repeated_position_changes_none() -> None:
    robot = driven(1.0, -0.5)
    before = robot.velocity_m_s
    robot.see(pose(10, 50.0), LIMITS)
    assert robot.velocity_m_s == before
    robot.see(pose(10.2, 80.0), LIMITS)
    assert robot.velocity_m_s == (0.0, 0.0)


@pytest.mark.parametrize("limit_m_s", [0.4, 1.0])
@pytest.mark.parametrize(("over_m_s", "held"), [(-0.02, False), (0.02, True)])
def test_a_quarter_and_a_bit_above_the_limit_is_too_fast(
    limit_m_s: float, over_m_s: float, held: bool
) -> None:
    limits = replace(LIMITS, max_speed_m_s=limit_m_s)
    speed = limit_m_s + limit_m_s / 4 + 0.2 + over_m_s
    robot = driven(0.8 * speed, 0.6 * speed, 20.0, limits)
    robot.send(Segment((50.0, 50.0), (90.0, 80.0), limit_m_s), ns(20))
    trouble = trouble_of(robot, limits, ns(20))
    assert (kind(trouble) == "fast") == held
    if trouble is not None:
        assert f"drives {speed:.1f} m/s where the limit is {limit_m_s:.1f}" in trouble.reason


def test_speed_that_the_noise_of_positions_explains_is_forgiven() -> None:
    robot = Watched("a")
    for k in range(101):
        robot.see(pose(k / 5, 20 + 1.8 * k / 5, sigma_m=0.15), LIMITS)  # 1.8 m/s; limit 1.45 + 3 x 0.15 m/s
    assert robot.fast_ns is None
    for k in range(101, 201):
        robot.see(pose(k / 5, 20 + 1.8 * k / 5, sigma_m=0.1), LIMITS)
    assert robot.fast_ns is not None


@pytest.mark.parametrize("sigma_m", [0.3, 1.0, 2.0])
@pytest.mark.parametrize(("speed_m_s", "fast"), [(1.9, False), (2.0, True)])
def test_unsure_positions_forgive_half_a_metre_a_second_at_the_most(
    sigma_m: float, speed_m_s: float, fast: bool
) -> None:
    robot = Watched("a")
    for k in range(1001):
        robot.see(pose(k / 5, speed_m_s * k / 5, sigma_m=sigma_m), LIMITS)
    assert (robot.fast_ns is not None) == fast


def test_a_robot_three_times_too_fast_is_noticed_within_ten_seconds_by_gnss_of_a_metre() -> None:
    robot, rng = Watched("a"), np.random.default_rng(5)
    robot.send(Segment((0.0, 50.0), (95.0, 50.0), 1.0), ns(0))
    for k in range(51):
        east, north = rng.normal((3.0 * k / 5, 50.0), 1.0)
        robot.see(pose(k / 5, east, north, sigma_m=1.0), LIMITS)
    assert kind(under_way_trouble(robot, LIMITS, ns(10))) == "fast"


@pytest.mark.parametrize("wrong", ["near", "fast", "stuck"])
def test_people_may_stand_run_and_walk_side_by_side(wrong: str) -> None:
    robot = seen(pose(10.0, 50.0))
    robot.send(Segment((50.0, 50.0), (90.0, 50.0), 1.0), ns(10))
    match wrong:
        case "near":
            robot.too_near = True
        case "fast":
            robot.fast_ns = ns(5)
        case _:
            robot.progress_ns = ns(-600)
    assert kind(under_way_trouble(robot, LIMITS, ns(10))) == wrong
    assert under_way_trouble(robot, replace(LIMITS, on_foot=frozenset({"a"})), ns(10)) is None


@pytest.mark.parametrize("sigma_m", [0.3, 1.0])
def test_noise_alone_makes_nobody_too_fast(sigma_m: float) -> None:
    """Ten minutes at the limit, five positions a second."""
    robot, rng = Watched("a"), np.random.default_rng(6)
    limits = replace(LIMITS, size_east_m=1000.0)
    for k in range(3001):
        east, north = rng.normal((1.0 * k / 5, 50.0), sigma_m)
        robot.see(pose(k / 5, east, north, sigma_m=sigma_m), limits)
        assert robot.fast_ns is None or k / 5 - robot.fast_ns * 1e-9 < 3.0


@pytest.mark.parametrize(
    ("said_m_s", "old_s", "fast"), [(1.46, 1.9, True), (1.46, 2.1, False), (1.44, 0.0, False)]
)
def test_a_vehicles_own_word_on_its_speed_counts_while_it_is_fresh(
    said_m_s: float, old_s: float, fast: bool
) -> None:
    robot = seen(pose(10.0, 50.0))
    robot.vehicle = VehicleState(ns(10.2 - old_s), "a", "guided", True, speed_m_s=said_m_s)
    robot.see(pose(10.2, 50.0), LIMITS)
    assert (robot.fast_ns is not None) == fast


def test_too_fast_for_three_seconds_is_too_fast_and_slowing_down_ends_it() -> None:
    robot = driven(0.5)
    robot.send(Segment((50.0, 50.0), (95.0, 50.0), 1.0), ns(10))
    t_s, since_s, east_m = 10.0, None, 50.0
    while t_s < 16.0:
        t_s, east_m = t_s + 0.2, east_m + 0.5
        robot.see(pose(t_s, east_m), LIMITS)
        if since_s is None and robot.velocity_m_s[0] > 1.45:
            since_s = t_s
        expected = since_s is not None and t_s - since_s >= 2.999
        assert (kind(trouble_of(robot, LIMITS, ns(t_s))) == "fast") == expected
    for _ in range(40):
        t_s, east_m = t_s + 0.2, east_m + 0.1
        robot.see(pose(t_s, east_m), LIMITS)
    assert trouble_of(robot, LIMITS, ns(t_s)) is None


# Out of bounds


def entering(depth_m: float, seconds: float, sigma_m: float = 0.0, braking_m: float = 0.0) -> str:
    """The trouble of a robot that has stood so deep in closed ground for so long; it was sent from outside it."""
    limits = replace(LIMITS, keep_out=KeepOut((SQUARE,)), braking_m=braking_m)
    robot = seen(pose(0, 39.9), settings=limits)
    robot.send(Segment((39.9, 50.0), (90.0, 50.0), 1.0), 0)
    for k in range(round(10 * seconds) + 1):
        robot.see(pose(5 + k / 10, 40.0 + depth_m, sigma_m=sigma_m), limits)
    return kind(trouble_of(robot, limits, ns(5 + seconds)))


@pytest.mark.parametrize(
    ("depth_m", "seconds", "sigma_m", "braking_m", "expected"),
    [
        (0.05, 3.0, 0.0, 0.0, ""), (0.08, 3.0, 0.0, 0.0, "fence"),  # two centimetres' noise is always granted
        (0.85, 3.0, 0.3, 0.0, ""), (0.95, 3.0, 0.3, 0.0, "fence"),  # ... and three times its own
        (0.40, 1.4, 0.0, 0.0, ""), (0.40, 1.6, 0.0, 0.0, "fence"),  # for a second and a half
        (0.54, 0.0, 0.0, 0.0, ""), (0.58, 0.0, 0.0, 0.0, "fence"),  # or deeper than it can have rolled
        (1.54, 0.0, 0.0, 1.0, ""), (1.58, 0.0, 0.0, 1.0, "fence"),
    ],
)  # fmt: skip
def test_a_robot_is_out_of_bounds_when_it_is_so_for_long_or_deep(
    depth_m: float, seconds: float, sigma_m: float, braking_m: float, expected: str
) -> None:
    assert entering(depth_m, seconds, sigma_m, braking_m) == expected


def test_one_position_inside_ends_its_being_outside() -> None:
    limits = replace(LIMITS, keep_out=KeepOut((SQUARE,)))
    robot = seen(pose(0, 39.9), pose(1, 40.4), pose(2, 39.9), pose(3, 40.4), settings=limits)
    robot.send(Segment((40.4, 50.0), (90.0, 50.0), 1.0), ns(3))
    robot.set_out_outside_m = 0.0
    assert trouble_of(robot, limits, ns(3)) is None
    robot.see(pose(4.6, 40.4), limits)
    trouble = trouble_of(robot, limits, ns(4.6))
    assert trouble is not None and "0.3 m deep, at 40.4 m east, 50.0 m north" in trouble.reason


@pytest.mark.parametrize(("sigma_m", "slack_m"), [(0.0, 0.02), (0.3, 0.3)])
def test_a_robot_on_its_way_back_in_may_be_as_deep_as_it_set_out(sigma_m: float, slack_m: float) -> None:
    limits = replace(LIMITS, keep_out=KeepOut((SQUARE,)))
    for deeper_m, expected in ((slack_m - 0.01, ""), (slack_m + 0.01, "fence")):
        robot = seen(pose(0, 43.0, sigma_m=sigma_m), pose(1, 43.0, sigma_m=sigma_m), settings=limits)
        robot.send(Segment((43.0, 50.0), (30.0, 50.0), 1.0), ns(1))
        robot.see(pose(3, 43.0 + deeper_m, sigma_m=sigma_m), limits)
        assert kind(trouble_of(robot, limits, ns(3))) == expected


# Link, battery, radio, others


def test_who_steers_a_robot_is_known_only_while_it_is_heard() -> None:
    robot = seen(pose(0, 50.0))
    assert not robot.somebody_elses and not robot.holds
    for mode, link_up, others, holds in [
        ("other", True, True, False), ("other", False, False, False), ("guided", True, False, False),
        ("hold", True, False, True), ("hold", False, False, False),
    ]:  # fmt: skip
        robot.vehicle = VehicleState(0, "a", mode, True, link_up, text="no heartbeat")  # type: ignore[arg-type]
        assert (robot.somebody_elses, robot.holds) == (others, holds)
        trouble = not_ready(robot, LIMITS, 0)
        assert kind(trouble) == ("" if link_up else "link")
        assert trouble is None or trouble.reason == "its link is down: no heartbeat"


@pytest.mark.parametrize(("timeout_s", "return_s"), [(10.0, 120.0), (3.0, 40.0)])
def test_a_radio_down_holds_and_later_sends_home(timeout_s: float, return_s: float) -> None:
    limits = replace(LIMITS, radio=RadioLimits(timeout_s, return_s), pose_timeout_s=1000.0)
    robot = seen(pose(0, 50.0))
    robot.hear(ReceiverState(ns(5), "a", False))
    robot.hear(ReceiverState(ns(6), "a", False))  # said again: it has been down since the first time
    assert not_ready(robot, limits, ns(5 + timeout_s - 0.01)) is None
    for down_s, after_s in (
        (timeout_s + 0.01, math.inf),
        (return_s - 0.01, math.inf),
        (return_s + 0.01, 0.0),
    ):
        trouble = not_ready(robot, limits, ns(5 + down_s))
        assert trouble == Trouble("radio", f"its radio is down for {down_s:.0f} s", "return", after_s)
    robot.hear(ReceiverState(ns(300), "a", True))
    assert not_ready(robot, limits, ns(300)) is None


@pytest.mark.parametrize("reserve_pct", [25.0, 40.0])
@pytest.mark.parametrize(("path_m", "pct_per_m"), [(20.0, 0.0), (20.0, 1.0), (40.0, 1.0), (20.0, 3.0)])
def test_the_reserve_brings_it_home_one_and_a_half_times(
    reserve_pct: float, path_m: float, pct_per_m: float
) -> None:
    limits = replace(LIMITS, battery=BatteryLimits(reserve_pct, pct_per_m))
    robot = seen(pose(0, 50.0, 50.0), pose(100, 50.0 + 0.6 * path_m, 50.0 - 0.8 * path_m), settings=limits)
    must_keep_pct = max(reserve_pct, path_m * pct_per_m + path_m * pct_per_m / 2)
    for left_pct, low in ((must_keep_pct + 0.1, False), (must_keep_pct, True)):
        robot.vehicle = VehicleState(0, "a", "guided", True, True, left_pct)
        assert bool(low_battery(robot, limits)) == low
        trouble = not_ready(robot, limits, ns(100))
        assert trouble is None or (trouble.kind, trouble.then, trouble.after_s) == ("battery", "return", 0.0)
        assert (trouble is not None) == low
    assert reserve_of(Watched("a"), limits) == reserve_pct, "of one never seen the way home is not known"


@pytest.mark.parametrize(
    ("limit_v", "volts", "low"),
    [(10.5, 10.51, False), (10.5, 10.5, True), (0.9, 0.8, True), (0.0, 0.0, False), (10.5, None, False)],
)
def test_a_battery_is_low_at_its_limiting_voltage_where_there_is_one(
    limit_v: float, volts: float | None, low: bool
) -> None:
    robot = seen(pose(0, 50.0))
    assert low_battery(robot, LIMITS) == ""
    robot.vehicle = VehicleState(0, "a", "guided", True, battery_v=volts)
    assert bool(low_battery(robot, replace(LIMITS, battery=BatteryLimits(low_v=limit_v)))) == low


def test_what_stops_a_robot_under_way_does_not_keep_one_from_being_sent() -> None:
    robot = on_its_way((60.0, 50.0))
    robot.too_near = True
    assert kind(trouble_of(robot, LIMITS, 0)) == "near" and not_ready(robot, LIMITS, 0) is None
    robot.stop()
    assert trouble_of(robot, LIMITS, 0) is None
