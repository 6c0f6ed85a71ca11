"""What one robot may be doing, and whether it gets on, by what was seen of it and what it was told."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_field import LIMITS, kind, ns, on_its_way, pose, seen

from fieldkit.geometry.segments import Segment, standing
from fieldkit.messages import VehicleState
from mission.safety.monitor import FADING_S, Watched, trouble_of

# What it may be doing


def test_a_robot_told_to_stop_may_drive_on_until_it_says_that_it_holds_or_its_failsafe_has_it() -> None:
    robot = on_its_way((80.0, 50.0), at_s=3.0)
    robot.now_ns = ns(3)
    assert robot.segments() == (Segment((50.0, 50.0), (80.0, 50.0), 1.0),)
    robot.stop()
    both = (Segment((50.0, 50.0), (80.0, 50.0), 1.0), standing((50.0, 50.0)))
    for mode, link_up, expected in [
        ("guided", True, both), ("hold", False, both), ("hold", True, both[1:]),
    ]:  # fmt: skip
        robot.vehicle = VehicleState(0, "a", mode, True, link_up)  # type: ignore[arg-type]
        assert robot.segments() == expected
    robot.vehicle = None
    robot.now_ns = ns(3 + FADING_S - 0.01)
    robot.stop()  # told again: it does not begin to drive anew
    assert robot.segments() == both
    robot.now_ns = ns(3 + FADING_S + 0.01)
    assert robot.segments() == both[1:]
    assert Watched("a").segments() == () and Watched("a").segment() is None


def test_what_is_left_of_a_segment_begins_where_the_robot_is() -> None:
    robot = on_its_way((60.0, 50.0))
    robot.see(pose(4, 53.0, 50.5), LIMITS)
    assert robot.segment() == Segment((53.0, 50.5), (60.0, 50.0), 1.0)
    assert robot.set_out_m == (50.0, 50.0)
    robot.stop()
    assert robot.set_out_m is None and not robot.moving


@pytest.mark.parametrize("timeout_s", [2.0, 6.0])
def test_a_robot_not_seen_for_long_is_anywhere_on_what_it_can_have_driven(timeout_s: float) -> None:
    limits = replace(LIMITS, pose_timeout_s=timeout_s)
    far, near = on_its_way((50.0, 95.0), 1.0), on_its_way((50.0, 60.0), 1.0)
    for robot in (far, near):
        robot.now_ns = ns(timeout_s - 0.01)
        assert robot.unseen(limits) is None
        robot.now_ns = ns(timeout_s + 0.01)
    somewhere, all_of_it = far.unseen(limits), near.unseen(limits)
    assert somewhere is not None and all_of_it is not None
    assert somewhere.start_m == (50.0, 50.0)
    assert somewhere.end_m == pytest.approx((50.0, 65.0)), "fifteen seconds at 1 m/s"
    assert all_of_it.end_m == (50.0, 60.0)


@pytest.mark.parametrize(("stopped_s", "moved"), [(5.1, True), (4.9, False)])
def test_one_told_to_stop_and_not_seen_to_stand_may_be_on_its_old_segment(
    stopped_s: float, moved: bool
) -> None:
    robot = on_its_way((50.0, 95.0))
    robot.now_ns = ns(stopped_s)
    robot.stop()
    robot.see(pose(stopped_s + FADING_S - 0.1 + 0.2 * (not moved), 50.0), LIMITS)
    robot.now_ns = ns(100)
    assert (robot.unseen(LIMITS) is not None) == moved


def test_one_that_was_sent_nowhere_stands_where_it_was_lost() -> None:
    robot = seen(pose(0, 50.0))
    robot.now_ns = ns(100)
    assert robot.unseen(LIMITS) is None and Watched("a").unseen(LIMITS) is None
    robot.send(standing((50.0, 50.0)), 0)
    assert robot.unseen(LIMITS) is None, "nothing can have been driven of no length"


@given(degrees=st.floats(-180, 180), speed=st.floats(0.2, 1.5))
def test_a_robot_strays_when_it_drives_more_than_60_degrees_off_its_segment(
    degrees: float, speed: float
) -> None:
    if abs(abs(degrees) - 60.0) < 0.1:
        return
    course = math.radians(degrees + 30.0)
    robot = seen(pose(0, 50.0, 20.0))
    robot.velocity_m_s = (speed * math.cos(course), speed * math.sin(course))
    ahead = math.radians(30.0)
    robot.send(Segment((50.0, 20.0), (50 + 20 * math.cos(ahead), 20 + 20 * math.sin(ahead)), 1.0), 0)
    robot.now_ns = ns(2.6)
    assert robot.strays == (abs(degrees) > 60.0)


def test_a_robot_does_not_stray_while_it_turns_or_stands_or_is_as_good_as_there() -> None:
    def backwards(left_m: float = 20.0, speed_m_s: float = 0.2) -> Watched:
        robot = on_its_way((50.0 + left_m, 50.0), at_s=7.0)
        robot.velocity_m_s, robot.now_ns = (-speed_m_s, 0.0), ns(7.0 + 2.6)
        return robot

    assert backwards().strays
    assert backwards(left_m=0.51).strays and not backwards(left_m=0.49).strays
    assert backwards(speed_m_s=0.16).strays and not backwards(speed_m_s=0.14).strays
    robot = backwards()
    robot.now_ns = ns(7.0 + 2.4)
    assert not robot.strays, "its order is still on the way"
    robot = backwards()
    robot.stop()
    assert not robot.strays, "it was sent nowhere"


@given(east=st.floats(-2, 2), north=st.floats(-2, 2), ahead_s=st.floats(0.5, 10))
def test_drift_goes_on_as_it_has_moved(east: float, north: float, ahead_s: float) -> None:
    robot = seen(pose(0, 50.0, 40.0))
    robot.velocity_m_s = (east, north)
    drift = robot.drift(ahead_s)
    assert drift is not None and drift.start_m == (50.0, 40.0)
    moves = east**2 + north**2 >= 0.15**2
    assert drift.end_m == pytest.approx((50 + ahead_s * east, 40 + ahead_s * north) if moves else (50, 40))
    assert drift.at(ahead_s) == pytest.approx(drift.end_m)
    assert Watched("a").drift(ahead_s) is None


# Getting on


@pytest.mark.parametrize(
    ("left_m", "speed_m_s", "stall_s", "should_m"),
    [(40.0, 1.0, 15.0, 3.0), (40.0, 0.5, 15.0, 1.5), (40.0, 0.5, 40.0, 4.0), (5.0, 1.0, 15.0, 1.0)],
)
def test_a_fifth_of_what_it_should_have_made_is_progress(
    left_m: float, speed_m_s: float, stall_s: float, should_m: float
) -> None:
    limits = replace(LIMITS, stall_s=stall_s, pose_timeout_s=60.0)
    for moved_m, stuck in ((0.8 * should_m, True), (1.05 * should_m, False)):
        robot = on_its_way((50.0 + left_m, 50.0), speed_m_s)
        robot.now_ns = ns(stall_s)
        robot.see(pose(stall_s, 50.0 + moved_m), limits)
        assert kind(trouble_of(robot, limits, ns(stall_s - 0.01))) == ""
        trouble = trouble_of(robot, limits, ns(stall_s + 0.01))
        assert (kind(trouble) == "stuck") == stuck
        if trouble is not None:
            assert trouble.after_s == 0.0 and trouble.then == "operator", "holding mends nothing"
            assert f"for {stall_s:.0f} s, {left_m - moved_m:.1f} m before" in trouble.reason


def test_a_creeping_robot_gets_on_by_more_than_its_positions_tremble() -> None:
    for moved_m, since_s in ((0.09, 0.0), (0.11, 8.0)):
        robot = on_its_way((70.0, 50.0), 0.02)
        robot.see(pose(8, 50.0 + moved_m), LIMITS)
        assert robot.progress_ns == ns(since_s)


@pytest.mark.parametrize(("separation_m", "near_m"), [(0.4, 0.5), (3.0, 1.5)])
def test_a_robot_almost_at_its_way_point_is_never_stuck(separation_m: float, near_m: float) -> None:
    limits = replace(LIMITS, min_separation_m=separation_m)
    for left_m, stuck in ((near_m - 0.02, False), (near_m + 0.02, True)):
        robot = on_its_way((50.0 + left_m, 50.0), 0.5)
        for t_s in range(1, 20):
            robot.see(pose(t_s, 50.0), limits)
        assert (kind(trouble_of(robot, limits, ns(19))) == "stuck") == stuck


def test_the_same_order_again_is_no_progress_and_another_one_is_a_new_start() -> None:
    robot = on_its_way((60.0, 50.0))
    robot.send(Segment((50.0, 50.0), (60.009, 50.0), 1.0), ns(5))
    assert (robot.progress_ns, robot.sent_ns) == (0, 0)
    robot.send(Segment((50.0, 50.0), (60.03, 50.0), 1.0), ns(6))
    assert (robot.progress_ns, robot.sent_ns) == (ns(6), ns(6))
    assert robot.ours and robot.progress_m == (50.0, 50.0)
    unseen = Watched("b")
    unseen.send(Segment((1.0, 2.0), (3.0, 4.0), 1.0), ns(7))
    assert unseen.progress_m == (1.0, 2.0)
