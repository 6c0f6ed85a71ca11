"""From a hold to the way home to the operator: what safety does when a trouble lasts, and who returns when."""

import math

import pytest
from small_field import Field, S

from fieldkit.geometry.polygons import KeepOut
from fieldkit.messages import (
    CallOperator,
    GoTo,
    Hold,
    Operator,
    Pose,
    ReceiverState,
    Return,
    Tick,
    VehicleState,
    Waypoint,
)
from mission.safety.limits import BatteryLimits

# Segments


def test_a_way_into_anothers_is_held_and_the_first_named_goes() -> None:
    field = Field()
    first, second = field.send(("a", 6.0, 8.0), ("b", 2.0, 8.0))
    assert isinstance(first, GoTo)
    assert isinstance(second, Hold) and "of a" in second.reason


def test_old_ways_of_robots_that_get_new_ones_do_not_count() -> None:
    field = Field()
    field.send(("b", 2.0, 8.0))
    field.tick(2)
    judged = field.send(("a", 2.0, 9.0), ("b", 8.0, 8.0))
    assert all(isinstance(c, GoTo) for c in judged)


def test_a_robot_that_must_stay_holds_those_whose_ways_counted_on_its_leaving() -> None:
    field = Field()
    field.at["b"] = (2.0, 6.0)
    field.tick(5)
    field.safety.observe(Operator(field.t_s * S, "hold", "b"))
    first, second = field.send(("a", 2.0, 12.0), ("b", 10.0, 6.0))
    assert isinstance(second, Hold)
    assert isinstance(first, Hold) and "of b" in first.reason


def test_robots_that_come_to_meet_are_stopped_before_they_do() -> None:
    field = Field()
    field.send(("a", 10.0, 10.0), ("b", 6.0, 15.0))
    field.tick(3)
    field.at["b"] = (5.8, 7.5)  # later than reckoned: across the way of a
    field.tick(4)
    field.at["a"], field.at["b"] = (4.6, 6.0), (6.8, 6.6)
    field.goal["b"] = None
    closest = math.inf
    for _ in range(12):
        field.tick()
        closest = min(closest, math.dist(*field.at.values()))
    assert closest > 0.3


def test_a_robot_that_goes_on_with_an_older_order_is_kept_clear_of() -> None:
    field = Field()
    field.at["b"] = (6.0, 0.3)
    field.tick(5)
    field.send(("a", 14.0, 6.0))
    field.tick(2)
    assert all(isinstance(c, GoTo) for c in field.send(("a", 2.0, 14.0), ("b", 6.0, 14.0)))
    field.goal["a"] = (14.0, 6.0)  # the new order was lost on the way
    closest = math.inf
    for _ in range(12):
        field.tick()
        closest = min(closest, math.dist(*field.at.values()))
    assert closest > field.safety.settings.near_m


def test_a_robot_told_to_stop_is_taken_for_driving_on_and_for_standing() -> None:
    field = Field()
    field.at["a"] = (3.0, 8.5)
    field.tick(5)
    field.send(("b", 6.0, 15.0))
    field.tick(6)  # b is at (6, 5), on its way north
    field.safety.observe(VehicleState(field.t_s * S, "b", "other", True))
    field.safety.observe(Tick(field.t_s * S))
    assert isinstance(field.send(("a", 9.0, 1.5))[0], Hold), "it may have stopped where it is"
    assert isinstance(field.send(("a", 9.0, 8.5))[0], Hold), "it may still be driving"
    assert isinstance(field.send(("a", 3.0, 14.0))[0], GoTo)


def test_a_robot_not_seen_any_more_may_be_anywhere_on_its_way() -> None:
    field = Field()
    field.send(("b", 6.0, 15.0))
    field.tick(4)
    field.dumb.add("b")
    field.goal["b"] = None
    field.tick(3)
    for target in ((10.0, 6.0), (10.0, 9.0)):
        assert isinstance(field.send(("a", *target))[0], Hold)
    assert isinstance(field.send(("a", 2.0, 14.0))[0], GoTo)
    field.ask("hold", "a")
    field.ask("resume", "a")
    field.tick(60)
    assert isinstance(field.send(("a", 10.0, 9.0))[0], Hold), "nobody has seen it stand since"
    field.dumb.clear()
    field.tick(5)
    assert isinstance(field.send(("a", 10.0, 9.0))[0], GoTo), "seen again, and not there"


def test_a_robot_where_a_lost_one_may_be_can_drive_off_but_not_along() -> None:
    field = Field()
    field.send(("b", 6.0, 15.0))
    field.tick(2)
    field.dumb.add("b")
    field.goal["b"] = None
    field.at["a"] = (6.3, 6.0)
    field.tick(60)
    assert isinstance(field.send(("a", 6.3, 12.0))[0], Hold)
    assert isinstance(field.send(("a", 12.0, 6.5))[0], GoTo)
    field.tick(10)
    assert field.at["a"][0] > 10.0, "it was not stopped on its way off"


def test_two_robots_too_near_may_drive_apart() -> None:
    field = Field()
    field.at["b"] = (2.3, 2.0)
    field.tick(5)
    field.log.clear()
    assert isinstance(field.send(("b", 8.0, 2.0))[0], GoTo)
    field.tick(20)
    assert not field.said(Hold, "b")
    assert math.dist(*field.at.values()) > 5.0


def test_a_way_past_a_standing_robot_is_held_but_one_away_from_it_is_not() -> None:
    field = Field()
    assert isinstance(field.send(("a", 8.0, 2.0))[0], Hold)
    field.at["b"] = (2.4, 2.0)
    field.tick(5)
    assert isinstance(field.send(("a", 1.0, 2.0))[0], GoTo)


def test_nothing_is_sent_out_of_a_fence_polygon() -> None:
    field = Field(keep_out=KeepOut(fence=((0.0, 0.0), (20.0, 0.0), (0.0, 20.0))))
    assert isinstance(field.send(("a", 5.0, 5.0))[0], GoTo)
    drawn_back = field.send(("b", 15.0, 15.0))[0]
    assert isinstance(drawn_back, GoTo)
    place = (drawn_back.waypoint.east_m, drawn_back.waypoint.north_m)
    assert field.safety.settings.margins.clearance_m(place) == pytest.approx(0.0, abs=1e-5)


def test_a_path_across_the_notch_of_a_fence_is_held() -> None:
    notched = ((0.0, 0.0), (20.0, 0.0), (20.0, 8.0), (8.0, 8.0), (8.0, 20.0), (0.0, 20.0))
    field = Field(keep_out=KeepOut(fence=notched))
    field.at["a"] = (2.0, 18.0)
    field.tick(5)
    held = field.send(("a", 18.0, 2.0))[0]
    assert isinstance(held, Hold) and "out of the fence" in held.reason


def test_an_excluded_area_is_closed_from_then_on() -> None:
    field = Field()
    assert isinstance(field.send(("a", 2.0, 10.0))[0], GoTo)
    field.ask("exclude", area_m=((0.0, 5.0), (4.0, 5.0), (4.0, 7.0), (0.0, 7.0)))
    assert isinstance(field.send(("a", 2.0, 10.0))[0], Hold)
    field.ask("exclude", area_m=((0.0, 5.0), (float("nan"), 5.0), (4.0, 7.0)))
    assert len(field.safety.settings.keep_out.polygons) == 1


# Troubles


def test_a_position_that_jumps_is_not_believed_until_it_has_settled() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.tick(3)
    field.at["a"] = (12.0, 12.0)
    field.tick()
    assert "jumped" in field.said(Hold, "a")[-1]
    assert isinstance(field.send(("a", 12.0, 15.0))[0], Hold)
    field.tick(4)
    assert isinstance(field.send(("a", 12.0, 15.0))[0], GoTo)


def test_a_position_from_the_future_holds() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.safety.observe(Pose((field.t_s + 5) * S, "a", 2.0, 2.0))
    field.dumb.add("a")
    field.tick()
    assert "a clock is wrong" in field.said(Hold, "a")[-1]


def test_a_late_steering_loop_holds_what_moves_and_then_goes_on() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.tick(gap_s=5)
    assert "silent for 5.0 s" in field.said(Hold, "a")[-1]
    assert not field.said(Hold, "b"), "it was standing"
    field.tick()
    assert isinstance(field.send(("a", 2.0, 15.0))[0], GoTo)


def test_a_clock_that_goes_back_holds() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.safety.observe(Pose((field.t_s - 1) * S, "a", 2.0, 2.2))
    field.carry_out(field.safety.observe(Tick((field.t_s - 1) * S)))
    assert "went back" in field.said(Hold, "a")[-1]


def test_a_stuck_robot_is_held_and_the_operator_called_once() -> None:
    field = Field()
    field.stuck.add("a")
    field.send(("a", 2.0, 15.0), ("b", 6.0, 15.0))
    field.tick(60)
    assert "stuck" in field.said(Hold, "a")[0]
    assert len(field.said(CallOperator, "a")) == 1
    assert not field.said(CallOperator, "b")
    field.ask("withdraw", "a")
    assert isinstance(field.send(("a", 2.0, 15.0))[0], Hold)
    field.stuck.clear()
    field.ask("resume", "a")
    assert isinstance(field.send(("a", 2.0, 15.0))[0], GoTo)


def test_a_slow_robot_is_not_stuck() -> None:
    field = Field()
    field.safety.judge([GoTo(field.t_s * S, "a", Waypoint(2.0, 15.0, 0.125))])
    for _ in range(90):
        field.at["a"] = (2.0, field.at["a"][1] + 0.12)
        field.tick()
    assert not field.said(CallOperator, "a")


def test_a_stale_position_calls_the_operator_when_it_lasts() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.dumb.add("a")
    field.tick(20)
    assert field.said(Hold, "a") and not field.said(CallOperator, "a")
    field.tick(20)
    assert len(field.said(CallOperator, "a")) == 1


def test_a_robot_somebody_else_took_is_left_alone_and_reported() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.tick(2)
    field.mode["a"] = "other"
    field.tick(30)
    assert len(field.said(CallOperator, "a")) == 1
    assert not field.said(Hold, "a")


def test_a_silent_radio_holds_then_goes_home() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.tick(10)
    field.safety.observe(ReceiverState(field.t_s * S, "a", False, "unplugged"))
    field.tick(9)
    assert not field.said(Hold, "a")
    field.tick(4)
    assert "radio" in field.said(Hold, "a")[0] and not field.homeward("a")
    field.tick(140)
    assert field.homeward("a") == 1 and "it is home" in field.said(Hold, "a")[-1]
    assert math.dist(field.at["a"], field.home["a"]) < 0.6


def test_a_short_trouble_within_a_long_one_does_not_call_for_help() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.tick(5)
    field.safety.observe(ReceiverState(field.t_s * S, "a", False, "unplugged"))
    field.tick(60)
    field.dumb.add("a")
    field.tick(5)
    field.dumb.clear()
    field.tick(20)
    assert not field.said(CallOperator, "a"), "its position was old for three seconds, not for a minute"
    field.tick(60)
    assert field.homeward("a") == 1, "and its radio was down all the time"


def test_a_radio_that_comes_back_soon_changes_nothing() -> None:
    field = Field()
    field.send(("a", 2.0, 15.0))
    field.safety.observe(ReceiverState(field.t_s * S, "a", False, "unplugged"))
    field.tick(8)
    field.safety.observe(ReceiverState(field.t_s * S, "a", True))
    field.tick(20)
    assert not field.said(Hold, "a")


# Battery and the way home


@pytest.mark.parametrize(("pct", "per_m", "goes"), [(30, 0.0, False), (25, 0.0, True), (30, 2.5, True)])
def test_the_reserve_grows_with_the_way_home(pct: float, per_m: float, goes: bool) -> None:
    field = Field(battery=BatteryLimits(pct_per_m=per_m))
    field.send(("a", 2.0, 12.0))
    field.tick(30)
    field.battery["a"] = pct
    field.tick(2)
    assert bool(field.homeward("a")) == goes
    field.tick(40)
    assert bool(field.said(CallOperator, "a")) == goes
    if goes:
        assert math.dist(field.at["a"], field.home["a"]) < 0.6


def test_robots_return_one_after_the_other_where_their_ways_cross() -> None:
    field = Field()
    field.send(("a", 2.0, 10.0), ("b", 6.0, 10.0))
    field.tick(30)
    field.at = {"a": (6.0, 10.0), "b": (2.0, 10.0)}  # carried across: the ways home cross
    field.tick(5)
    field.log.clear()
    field.ask("return")
    assert {c.robot for c in field.log if isinstance(c, Hold)} == {"a", "b"}
    closest = math.inf
    for _ in range(120):
        field.tick()
        closest = min(closest, math.dist(*field.at.values()))
    assert [c.robot for c in field.log if isinstance(c, GoTo)] == ["a", "b"]
    assert not field.said(Return, "a")
    assert closest > 0.5
    assert all(math.dist(field.at[name], field.home[name]) < 0.6 for name in "ab")


def test_robots_with_clear_ways_return_together() -> None:
    field = Field()
    field.send(("a", 2.0, 10.0), ("b", 6.0, 10.0))
    field.tick(30)
    field.ask("return")
    assert (field.homeward("a"), field.homeward("b")) == (1, 1)


def test_a_blocked_way_home_is_the_operators_business() -> None:
    field = Field()
    field.send(("a", 2.0, 12.0))
    field.tick(30)
    field.at["b"] = (2.0, 6.0)
    field.tick(5)
    field.ask("return", "a")
    field.tick(10)
    assert not field.homeward("a")
    assert any("blocked" in reason for reason in field.said(CallOperator, "a"))


def test_a_return_that_is_not_obeyed_is_asked_again_and_reported() -> None:
    field = Field()
    field.send(("a", 2.0, 12.0))
    field.tick(30)
    field.stuck.add("a")
    field.ask("return", "a")
    for _ in range(200):
        field.mode["a"] = "hold"
        field.tick()
    assert field.homeward("a") > 3, "by way-points first"
    assert len(field.said(Return, "a")) > 10, "by its own return, as the last resort"
    assert any("did not get home" in reason for reason in field.said(CallOperator, "a"))


def test_the_way_home_leads_round_closed_ground() -> None:
    field = Field(keep_out=KeepOut((((0.0, 5.0), (8.0, 5.0), (8.0, 7.0), (0.0, 7.0)),)))
    field.at["a"] = (2.0, 12.0)
    field.tick(4)
    field.ask("return", "a")
    closed = field.safety.settings.bounds
    for _ in range(120):
        field.tick()
        assert closed.clearance_m(field.at["a"]) >= 0.0
    assert math.dist(field.at["a"], field.home["a"]) < 0.6
    assert not field.said(CallOperator, "a")


def test_resume_ends_a_return() -> None:
    field = Field()
    field.send(("a", 2.0, 12.0))
    field.tick(30)
    field.ask("return", "a")
    field.ask("resume", "a")
    field.log.clear()
    field.tick(20)
    assert not field.homeward("a")
    assert isinstance(field.send(("a", 2.0, 12.0))[0], GoTo)


def test_a_released_robot_gets_no_commands_at_all() -> None:
    field = Field()
    field.send(("a", 2.0, 12.0))
    field.ask("release", "a")
    field.log.clear()
    field.dumb.add("a")
    field.battery["a"] = 1.0
    field.tick(60)
    assert not [c for c in field.log if getattr(c, "robot", "") == "a"]
