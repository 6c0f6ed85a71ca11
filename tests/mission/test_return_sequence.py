"""Robots on their way home: who may set out, what each is told and when, and what ends it. One tick at a time."""

import math
from dataclasses import replace

import pytest
from homeward import LIMITS, WALL, Place, Team, leaving

from fieldkit.geometry.polygons import KeepOut
from fieldkit.geometry.segments import Segment
from fieldkit.messages import CallOperator, GoTo, Hold, Land, Return, VehicleState
from mission.safety.monitor import Watched

# Who goes


def test_asking_twice_is_harmless_and_forgetting_ends_it() -> None:
    team = leaving()
    team.sequence.ask("a", "another reason")
    assert "a" in team.sequence and team.step() == [] and team.sequence.waiting == {}
    team.sequence.ask("b", "first")
    team.sequence.ask("b", "second")
    assert team.sequence.waiting == {"b": "first"} and "b" in team.sequence
    for name in "ab":
        team.sequence.forget(name)
        assert name not in team.sequence


@pytest.mark.parametrize("speed_m_s", [1.0, 0.3])
def test_it_is_sent_to_where_it_was_first_seen_at_the_missions_speed_and_told_once(speed_m_s: float) -> None:
    team = Team(replace(LIMITS, max_speed_m_s=speed_m_s), a=(5.0, 5.0))
    team.put("a", (20.0, 25.0))
    team.sequence.ask("a", "low")
    assert team.step() == [team.goto("a", (5.0, 5.0))]
    assert team.step(10.0) == [], "it does as it was told"
    driven = team.sequence.segments(team.robots, team.settings)
    assert driven == {"a": Segment((20.0, 25.0), (5.0, 5.0), speed_m_s)}


def test_a_home_within_the_margin_is_neared_as_far_as_margins_allow() -> None:
    team = Team(a=(0.05, 10.0))
    team.put("a", (20.0, 10.0))
    team.sequence.ask("a", "low")
    (order,) = team.step()
    assert isinstance(order, GoTo)
    assert (order.waypoint.east_m, order.waypoint.north_m) == pytest.approx((0.2, 10.0), abs=1e-4)


def test_one_that_cannot_be_told_waits_and_nobody_is_called() -> None:
    team = Team(a=(5.0, 5.0))
    team.put("a", (5.0, 35.0))
    team.robots["b"] = Watched("b")
    team.sequence.ask("a", "low")
    team.sequence.ask("b", "never seen")
    for mode, link_up in (("guided", False), ("other", True), ("other", False)):
        team.says("a", mode, link_up=link_up)
        assert team.step(1.0) == []
    team.robots["a"].vehicle = None
    assert team.step(1.0) == [team.goto("a", (5.0, 5.0))], "a vehicle that says nothing is told"
    assert team.step(1.0) == [] and team.sequence.waiting == {"b": "never seen"}


def test_a_robot_shut_in_stays_and_the_operator_is_asked() -> None:
    ring = (((14, 14), (26, 14), (26, 15), (14, 15)), ((14, 25), (26, 25), (26, 26), (14, 26)),
            ((14, 14), (15, 14), (15, 26), (14, 26)), ((25, 14), (26, 14), (26, 26), (25, 26)))  # fmt: skip
    team = Team(replace(LIMITS, keep_out=KeepOut(ring)), a=(5.0, 5.0))  # type: ignore[arg-type]
    team.put("a", (20.0, 20.0))
    team.sequence.ask("a", "low")
    (call,) = team.step()
    assert (
        isinstance(call, CallOperator) and call.reason == "its way home is blocked; it stays where it is: low"
    )
    assert team.step(1.0) == [] and "a" not in team.sequence


# Clear of the others


@pytest.mark.parametrize("separation_m", [2.0, 3.0, 0.8])
@pytest.mark.parametrize(("aside_m", "goes"), [(-0.01, False), (0.01, True)])
def test_it_sets_out_when_its_way_keeps_clear_of_one_that_stands(
    separation_m: float, aside_m: float, goes: bool
) -> None:
    team = Team(replace(LIMITS, min_separation_m=separation_m), a=(5.0, 5.0))
    team.put("a", (5.0, 35.0))
    team.robots["b"] = Watched("b")
    team.put("b", (5.0 + 0.6 * separation_m + aside_m, 20.0))
    team.sequence.ask("a", "low")
    assert isinstance(team.step()[0], GoTo if goes else CallOperator)


@pytest.mark.parametrize(
    ("beside", "goes"), [((5.5, 35.0), True), ((5.005, 34.4), False), ((5.5, 34.2), False)]
)
def test_one_beside_another_may_leave_it_but_not_pass_it_nearer(beside: Place, goes: bool) -> None:
    team = Team(a=(5.0, 5.0), b=beside)
    team.put("a", (5.0, 35.0))
    team.sequence.ask("a", "low")
    assert isinstance(team.step()[0], GoTo if goes else CallOperator)


def test_a_centimetre_nearer_is_noise() -> None:
    team = Team(a=(5.0, 5.0), b=(5.9, 34.95))  # 0.0014 m nearer as it passes
    team.put("a", (5.0, 35.0))
    team.sequence.ask("a", "low")
    assert isinstance(team.step()[0], GoTo)


def test_of_crossing_ways_the_second_waits_until_the_first_has_passed() -> None:
    team = Team(a=(5.0, 5.0), b=(10.0, 5.0))
    team.put("a", (10.0, 20.0))
    team.put("b", (5.0, 20.0))
    for name in "ab":
        team.sequence.ask(name, "low")
    assert team.step() == [team.goto("a", (5.0, 5.0))]
    assert team.step(1.0) == [] and "b" in team.sequence.waiting
    team.put("a", (5.2, 5.6))
    assert [c.robot for c in team.step(1.0)] == ["a", "b"], "home, and off"  # type: ignore[union-attr]


def test_what_one_under_way_has_behind_it_is_free_and_all_before_it_is_not() -> None:
    settings = replace(LIMITS, keep_out=KeepOut((WALL,)))
    for passed, goes in ((False, False), (True, True)):
        team = leaving((14.0, 24.0), (14.0, 16.0), settings)  # round the wall's west end, by two corners
        if passed:
            for place in ((9.9, 21.3), (9.9, 18.7)):
                team.put("a", place)
                team.step(1.0)
        team.robots["b"] = Watched("b")
        team.put("b", (12.0, 30.0))
        team.put("b", (12.0, 22.0))  # its way home leads across the other's first leg
        team.sequence.ask("b", "low")
        assert any(isinstance(c, GoTo) and c.robot == "b" for c in team.step(1.0)) == goes


def test_the_last_leg_of_one_under_way_is_in_the_way_from_the_beginning() -> None:
    team = leaving((14.0, 24.0), (14.0, 16.0), replace(LIMITS, keep_out=KeepOut((WALL,))))
    team.robots["b"] = Watched("b")
    team.put("b", (12.0, 10.0))
    team.put("b", (12.0, 18.0))
    team.sequence.ask("b", "low")
    assert team.step(1.0) == []


def test_one_that_drives_or_may_drive_is_in_the_way_with_all_of_its_segment() -> None:
    def goes(start_east_m: float, told_to_stop: bool = False, unseen_s: float = 0.0) -> bool:
        team = Team(a=(5.0, 5.0), b=(start_east_m, 20.0))
        team.put("a", (5.0, 35.0))
        team.robots["b"].send(Segment((start_east_m, 20.0), (3.0, 20.0), 1.0), team.now_ns)
        if told_to_stop:
            team.robots["b"].now_ns = team.now_ns
            team.robots["b"].stop()
        team.sequence.ask("a", "low")
        team.t_s += unseen_s
        team.put("a", (5.0, 35.0))
        for robot in team.robots.values():
            robot.now_ns = team.now_ns
        commands = team.sequence.step(team.robots, team.settings, team.now_ns)
        return any(isinstance(c, GoTo) for c in commands)

    assert not goes(25.0) and not goes(25.0, told_to_stop=True)
    assert goes(25.0, unseen_s=30.0), "lost, but its failsafe has stopped it 15 m on its way at the latest"
    assert not goes(19.0, unseen_s=30.0)


def test_one_that_flies_above_is_in_nobodys_way() -> None:
    for up_m, goes in ((10.0, True), (0.0, False)):
        team = Team(replace(LIMITS, altitude_m={"b": 10.0}), a=(5.0, 5.0), b=(5.0, 20.0))
        team.put("a", (5.0, 35.0))
        team.put("b", (5.0, 20.0), up_m)
        team.robots["c"] = Watched("c")  # of one never seen nothing is known
        team.sequence.ask("a", "low")
        assert isinstance(team.step()[0], GoTo) == goes


def test_a_blocked_way_may_come_free_while_anybody_moves_or_is_under_way() -> None:
    team = Team(a=(5.0, 5.0), b=(5.0, 20.0))
    team.put("a", (5.0, 35.0))
    team.sequence.ask("a", "low")
    team.robots["b"].send(Segment((5.0, 20.0), (5.0, 22.0), 0.5), team.now_ns)
    assert team.step(1.0) == []
    team.robots["b"].stop()
    team.robots["c"] = Watched("c")
    team.put("c", (30.0, 5.0))
    team.put("c", (30.0, 30.0))
    team.sequence.ask("c", "low too")
    assert team.step(20.0) == [team.goto("c", (30.0, 5.0))]
    assert team.step(1.0) == []
    team.sequence.forget("c")
    (call,) = team.step(1.0)
    assert isinstance(call, CallOperator) and call.robot == "a" and team.step(1.0) == []


# Under way


def test_an_order_that_its_vehicle_does_not_follow_is_repeated_every_three_seconds() -> None:
    team = leaving()
    team.says("a", "hold")
    assert team.step(2.9) == []
    assert team.step(0.2) == [team.goto("a", (5.0, 5.0))]
    assert team.step(2.9) == []
    team.says("a", "guided")
    assert team.step(1.0) == []
    team.robots["a"].vehicle = None
    assert team.step(1.0) == []


SHARP = replace(LIMITS, keep_out=KeepOut((WALL,)), fence_margin_m=0.0)
"""Round the wall's west end the path has two corners, just off those of the wall."""


@pytest.mark.parametrize("before_m", [0.52, 0.48])
def test_half_a_metre_from_a_corner_it_is_sent_to_the_next_at_once(before_m: float) -> None:
    team = leaving((15.0, 24.0), (15.0, 16.0), SHARP)
    corner = team.sequence.segments(team.robots, team.settings)["a"].end_m
    assert corner == pytest.approx((9.95, 21.05), abs=0.01)
    team.put("a", (corner[0] - before_m, corner[1]))
    orders = team.step(0.1)
    if before_m > 0.5:
        assert orders == []
        return
    assert orders == [team.goto("a", team.sequence.under_way["a"].path[1])]
    driven = team.sequence.segments(team.robots, team.settings)["a"]
    assert driven.end_m == pytest.approx((9.95, 18.95), abs=0.01)
    team.put("a", driven.end_m)
    assert team.step(0.1) == [team.goto("a", (15.0, 16.0))]
    assert team.step(0.1) == []


@pytest.mark.parametrize("margin_m", [0.0, 0.2, 1.0])
def test_round_a_corner_it_cuts_no_closed_ground(margin_m: float) -> None:
    team = leaving((15.0, 22.5), (15.0, 17.5), replace(SHARP, fence_margin_m=margin_m))
    here: Place = (15.0, 22.5)
    for _ in range(2000):
        goal = team.sequence.segments(team.robots, team.settings)["a"].end_m
        left_m = math.dist(here, goal)
        step_m = min(0.02, left_m)
        share = step_m / max(left_m, 1e-9)
        here = (here[0] + share * (goal[0] - here[0]), here[1] + share * (goal[1] - here[1]))
        assert team.settings.bounds.clearance_m(here) >= 0.0
        team.put("a", here)
        team.step(0.02)
        if "a" not in team.sequence:
            break
    assert "a" not in team.sequence and math.dist(here, (15.0, 17.5)) <= LIMITS.near_m


@pytest.mark.parametrize(("separation_m", "near_m"), [(2.0, 1.0), (0.4, 0.3)])
def test_it_is_home_near_where_it_started(separation_m: float, near_m: float) -> None:
    team = leaving(settings=replace(LIMITS, min_separation_m=separation_m))
    team.put("a", (5.0, 5.0 + near_m + 0.02))
    assert team.step(1.0) == []
    team.put("a", (5.0, 5.0 + near_m - 0.02))
    assert team.step(1.0) == [Hold(team.now_ns, "a", "it is home: low")]
    assert "a" not in team.sequence


def test_one_that_still_drives_is_home_when_it_rests_or_has_been_there_for_three_seconds() -> None:
    team = leaving()
    robot = team.robots["a"]

    def passing(north_m: float, after_s: float, speed_m_s: float) -> bool:
        team.put("a", (5.0, north_m))
        robot.velocity_m_s = (0.0, -speed_m_s)
        return bool(team.step(after_s))

    assert not passing(5.5, 1.0, 0.5)
    assert not passing(7.0, 1.0, 0.5), "past it"
    assert not passing(5.5, 1.0, 0.16) and not passing(5.5, 2.9, 0.16)
    assert passing(5.5, 0.2, 0.16)
    team = leaving()
    robot = team.robots["a"]
    assert passing(5.5, 1.0, 0.14)


def test_on_the_other_side_of_a_thin_wall_it_is_not_home() -> None:
    wall = ((1.0, 20.0), (30.0, 20.0), (30.0, 20.1), (1.0, 20.1))
    team = leaving((5.0, 20.5), (5.0, 19.7), replace(LIMITS, keep_out=KeepOut((wall,))))
    assert math.dist((5.0, 20.5), (5.0, 19.7)) < LIMITS.near_m
    assert team.step(1.0) == [] and "a" in team.sequence


@pytest.mark.parametrize(("far", "length_m"), [((5.0, 35.0), 30.0), ((23.0, 29.0), 30.0), ((5.0, 10.0), 5.0)])
def test_it_has_a_minute_and_ten_seconds_a_metre(far: Place, length_m: float) -> None:
    team = leaving(far, settings=replace(LIMITS, stall_s=1e6))
    limit_s = 60.0 + 10.0 * length_m
    assert team.step(limit_s - 0.01) == []
    hold, call = team.step(0.02)
    assert isinstance(hold, Hold) and "(low) and did not get there" in hold.reason
    assert isinstance(call, CallOperator) and call.reason == "it did not get home: low"
    assert "a" not in team.sequence


def test_one_that_somebody_else_takes_is_theirs() -> None:
    team = leaving()
    team.says("a", "other")
    (call,) = team.step(1.0)
    assert isinstance(call, CallOperator) and "not ours to steer any more" in call.reason
    assert "a" not in team.sequence and team.step(1.0) == []


def test_one_too_near_another_holds_and_goes_on_when_it_can() -> None:
    team = leaving()
    team.robots["a"].too_near = True
    (hold, *rest) = team.step(1.0)
    assert isinstance(hold, Hold) and "goes on home when it can" in hold.reason
    assert rest == [team.goto("a", (5.0, 5.0))], "as soon as its way is clear"
    assert team.sequence.under_way["a"].reason == "low"


@pytest.mark.parametrize("stall_s", [15.0, 40.0])
@pytest.mark.parametrize(("moved_m", "gets_on"), [(0.09, False), (0.11, True)])
def test_one_that_does_not_get_on_is_left_to_its_own_return(
    stall_s: float, moved_m: float, gets_on: bool
) -> None:
    team = leaving(settings=replace(LIMITS, stall_s=stall_s))
    assert team.step(1.0) == []
    team.put("a", (5.0, 35.0 - moved_m))
    assert team.step(5.0) == []
    assert team.step(stall_s - 5.1) == []
    if gets_on:
        assert team.step(5.0) == []
        return
    (order,) = team.step(0.2)
    assert isinstance(order, Return) and order.reason == "low; it did not get on by way-points"
    assert team.step(2.9) == []
    assert [type(c) for c in team.step(0.2)] == [Return], "it says that it does something else"
    team.says("a", "return")
    assert team.step(5.0) == [] and team.step(stall_s + 1.0) == [], "there is nothing after that but time"


def test_round_a_wall_getting_on_may_lead_away_from_home() -> None:
    team = leaving((20.0, 22.0), (20.0, 18.0), replace(LIMITS, keep_out=KeepOut((WALL,))))
    for k in range(1, 9):
        team.put("a", (20.0 - k, 22.0))
        assert team.step(5.0) == []


def test_one_stuck_behind_closed_ground_is_not_left_to_drive_straight() -> None:
    team = leaving((20.0, 22.0), (20.0, 18.0), replace(LIMITS, keep_out=KeepOut((WALL,))))
    team.step(0.0)
    (call,) = team.step(LIMITS.stall_s + 0.1)
    assert isinstance(call, CallOperator) and "does not get on on its way home: low" in call.reason
    assert "a" not in team.sequence


def test_one_that_drives_straight_home_by_itself_is_home_there() -> None:
    team = leaving((15.0, 24.0), (15.0, 16.0), SHARP)
    team.put("a", (5.0, 16.0))  # pushed to where a straight line home is open
    assert team.step(1.0) == []
    (order,) = team.step(LIMITS.stall_s + 0.1)
    assert isinstance(order, Return)
    team.says("a", "return")
    assert team.sequence.segments(team.robots, team.settings)["a"].end_m == (15.0, 16.0)
    team.put("a", (15.0, 16.0))
    assert [type(c) for c in team.step(10.0)] == [Hold] and "a" not in team.sequence


def test_ground_closed_on_the_way_home_is_gone_round() -> None:
    team = leaving((15.0, 35.0), (15.0, 5.0))
    aside = KeepOut((((20.0, 20.0), (25.0, 20.0), (25.0, 22.0)),), margin_m=0.2)
    assert team.sequence.ask_anew(team.robots, aside) == set()
    across = KeepOut((WALL,), margin_m=0.2)
    team.settings = replace(team.settings, keep_out=KeepOut((WALL,)))
    assert team.sequence.ask_anew(team.robots, across) == {"a"}
    (order,) = team.step(1.0)
    assert isinstance(order, GoTo) and order.waypoint.east_m < 10.0
    assert team.sequence.under_way["a"].reason == "low"
    beyond = KeepOut((((10.0, 10.0), (20.0, 10.0), (20.0, 11.0), (10.0, 11.0)),))
    assert team.sequence.ask_anew(team.robots, beyond) == {"a"}, "on a later leg as well"


def test_ground_closed_behind_or_below_one_that_lands_stops_nobody() -> None:
    team = leaving((15.0, 35.0), (15.0, 5.0))
    team.put("a", (15.0, 15.0))
    assert team.sequence.ask_anew(team.robots, KeepOut((WALL,))) == set()
    team = landing()
    assert team.sequence.ask_anew(team.robots, KeepOut((((0, 0), (10, 0), (10, 10), (0, 10)),))) == set()


# Landing


def landing() -> Team:
    """One that flies, above its home and just ordered to land."""
    team = leaving(settings=replace(LIMITS, altitude_m={"a": 12.0}))
    team.put("a", (5.0, 5.2), 12.0)
    assert team.step(100.0) == [Land(team.now_ns, "a", "it is home: low")]
    return team


def test_one_that_flies_goes_home_in_its_layer() -> None:
    team = Team(replace(LIMITS, altitude_m={"a": 12.0}), a=(5.0, 5.0))
    team.put("a", (20.0, 25.0))
    team.sequence.ask("a", "low")
    assert team.step() == [team.goto("a", (5.0, 5.0), 12.0)]


def test_it_is_told_to_land_every_three_seconds_until_it_does() -> None:
    team = landing()
    assert team.step(2.9) == []
    assert team.step(0.2) == [Land(team.now_ns, "a", "it is home: low")]
    team.says("a", "land")
    assert team.step(10.0) == [] and "a" in team.sequence
    team.robots["a"].vehicle = None
    assert [type(c) for c in team.step(10.0)] == [Land]


@pytest.mark.parametrize(
    ("armed", "on_ground", "link_up", "done"),
    [(True, True, True, True), (False, None, True, True), (True, None, True, False),
     (True, False, True, False), (False, True, False, False)],
)  # fmt: skip
def test_it_has_landed_when_it_says_so(
    armed: bool, on_ground: bool | None, link_up: bool, done: bool
) -> None:
    team = landing()
    team.robots["a"].vehicle = VehicleState(0, "a", "land", armed, link_up, on_ground=on_ground)
    assert team.step(1.0) == []
    assert ("a" not in team.sequence) == done


@pytest.mark.parametrize("taken", [False, True])
def test_one_that_does_not_land_is_the_operators_business(taken: bool) -> None:
    team = landing()
    team.says("a", "other" if taken else "land")
    if not taken:
        assert team.step(259.9) == [], "a minute and 30 m from where it set out"
    (call,) = team.step(0.2)
    assert isinstance(call, CallOperator) and call.reason == "it did not land: low"
    assert "a" not in team.sequence
