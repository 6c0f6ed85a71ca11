"""Cars swing wide before they are on their way: two are sent only where they keep clear while they turn, too."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fieldkit.geometry.segments import Place, Segment, standing
from fieldkit.messages import Pose
from fieldkit.world.bodies import Car, car_for
from mission.safety.limits import SafetySettings
from mission.safety.monitor import Watched
from mission.safety.return_sequence import ReturnSequence
from mission.safety.separation import STARTS_S, conflict, mark_too_near, occupancies

S = 1_000_000_000
LIMITS = SafetySettings(("a", "b"), 100.0, 100.0, max_speed_m_s=0.4, min_separation_m=0.5, turn_radius_m=0.24)
places = st.tuples(st.floats(-2, 2), st.floats(-2, 2))
headings = st.floats(0.0, 360.0, exclude_min=True)


def robot(name: str, at_m: Place, heading_deg: float, to_m: Place | None = None) -> Watched:
    watched = Watched(name)
    watched.see(Pose(0, name, *at_m, heading_deg=heading_deg), LIMITS)
    if to_m is not None:
        watched.send(Segment(at_m, to_m, 0.4), 0)
    return watched


def asked(
    mine: Watched, to_m: Place, other: Watched, theirs: Segment | None, limits: SafetySettings = LIMITS
) -> str:
    assert mine.place_m is not None
    robots = {mine.name: mine, other.name: other}
    new = {} if theirs is None else {other.name: theirs}
    segment = Segment(mine.place_m, to_m, 0.4)
    return conflict(mine, segment, new, occupancies(robots, limits), (), limits)


def closest_m(cars: tuple[Car, Car], targets: tuple[Place | None, Place | None], late_s: Place) -> float:
    """How near two cars come that are sent to their targets, each so much later."""
    closest, dt_s = math.inf, 0.05
    for step in range(round(30.0 / dt_s)):
        for car, target, late in zip(cars, targets, late_s, strict=True):
            if target is not None and abs(step * dt_s - late) < dt_s / 2:
                car.go_to(*target, 0.4)
            car.step(dt_s)
        closest = min(closest, math.dist(*((car.east_m, car.north_m) for car in cars)))
    return closest


@settings(max_examples=150, deadline=None)
@given(
    a=places, b=places, to_a=places, to_b=places, heads=st.tuples(headings, headings), late_s=st.floats(0, 4),
    first=st.booleans(),
)  # fmt: skip
def test_cars_that_are_sent_together_never_come_too_near(
    a: Place, b: Place, to_a: Place, to_b: Place, heads: Place, late_s: float, first: bool
) -> None:
    assume(math.dist(a, b) > 0.31 and math.dist(to_a, to_b) > 0.5)
    assume(min(math.dist(a, to_a), math.dist(b, to_b)) > 0.2)
    one, two = robot("a", a, heads[0]), robot("b", b, heads[1])
    goes_a: Place | None = None if asked(one, to_a, two, standing(b)) else to_a
    segment = standing(a) if goes_a is None else Segment(a, goes_a, 0.4)
    goes_b: Place | None = None if asked(two, to_b, one, segment) else to_b
    cars = (car_for(*a, heads[0], 0.4), car_for(*b, heads[1], 0.4))
    late = (late_s, 0.0) if first else (0.0, late_s)
    assert closest_m(cars, (goes_a, goes_b), late) >= LIMITS.near_m


def test_such_cars_do_come_too_near_where_nobody_reckons_with_turns() -> None:
    """The same with straight segments alone: the property above is none that every rule has."""
    straight = replace(LIMITS, turn_radius_m=0.0)
    one, two = robot("a", (0.0, 0.0), 80.0), robot("b", (0.58, 0.0), 280.0)
    west, east = (-3.0, 0.0), (3.5, 0.0)
    cars = (car_for(0.0, 0.0, 80.0, 0.4), car_for(0.58, 0.0, 280.0, 0.4))
    assert asked(two, east, one, Segment((0.0, 0.0), west, 0.4), straight) == ""
    assert closest_m(cars, (west, east), (0.0, 0.0)) < LIMITS.near_m
    assert asked(one, west, two, standing((0.58, 0.0))) == "", "one after the other they may"
    assert asked(two, east, one, Segment((0.0, 0.0), west, 0.4)).startswith("turning, it comes within")


@pytest.mark.parametrize(
    ("heading_deg", "refused"), [(90.0, False), (20.0, False), (340.0, True), (300.0, True)]
)
def test_which_way_it_looks_decides(heading_deg: float, refused: bool) -> None:
    """Another stands to the west. The way leads south: who looks east turns right, away from it."""
    mine, other = robot("a", (0.0, 0.0), heading_deg), robot("b", (-0.5, 0.0), 1.0)
    assert bool(asked(mine, (0.1, -3.0), other, None)) == refused


def test_one_sent_straight_back_may_turn_to_either_side() -> None:
    mine = robot("a", (0.0, 0.0), 1.0)
    for beside in ((-0.6, 0.0), (0.6, 0.0)):
        assert asked(mine, (0.0, -3.0), robot("b", beside, 1.0), None).startswith("turning")


def test_what_flies_walks_or_turns_on_the_spot_has_no_arc() -> None:
    mine, other = robot("a", (0.0, 0.0), 340.0), robot("b", (-0.5, 0.0), 1.0)
    for limits in (
        replace(LIMITS, turn_radius_m=0.0),
        replace(LIMITS, altitude_m={"a": 10.0}),
        replace(LIMITS, on_foot=frozenset({"a"})),
    ):
        assert asked(mine, (0.1, -3.0), other, None, limits) == ""


def test_a_source_of_positions_without_headings_tells_them_by_how_the_robot_drives() -> None:
    watched = Watched("a")
    watched.see(Pose(0, "a", 0.0, 0.0), LIMITS)
    assert watched.heading_deg is None
    for k in range(1, 9):
        watched.see(Pose(k * S, "a", -0.4 * k, 0.0), LIMITS)
    assert watched.heading_deg == pytest.approx(-90.0)
    watched.see(Pose(9 * S, "a", -3.6, 0.0, heading_deg=30.0), LIMITS)
    assert watched.heading_deg == 30.0


def test_of_two_that_are_about_to_swing_together_one_holds() -> None:
    one, two = robot("a", (0.0, 0.0), 80.0, (-3.0, 0.0)), robot("b", (0.58, 0.0), 280.0, (3.5, 0.0))
    mark_too_near({"a": one, "b": two}, {}, LIMITS)
    assert (one.too_near, two.too_near) == (False, True)
    mark_too_near({"a": one, "b": two}, {}, replace(LIMITS, turn_radius_m=0.0))
    assert not one.too_near and not two.too_near


@pytest.mark.parametrize(("heading_deg", "goes"), [(90.0, True), (350.0, False)])
def test_one_sets_out_for_home_when_its_turn_keeps_clear(heading_deg: float, goes: bool) -> None:
    robots = {"a": robot("a", (10.0, 10.0), heading_deg), "b": robot("b", (9.5, 10.0), 1.0)}
    robots["a"].home_m = (10.1, 5.0)
    sequence = ReturnSequence()
    sequence.ask("a", "operator")
    sequence.step(robots, LIMITS, 0)
    assert ("a" in sequence.under_way) == goes


def test_the_reach_of_a_turn_is_never_cut_short() -> None:
    """The quick look by distance and length must not hide a swing."""
    rng = np.random.default_rng(7)
    for _ in range(300):
        at, to = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2)
        beside = rng.uniform(-2, 2, 2)
        if math.dist(at, beside) < 0.31:
            continue
        mine, other = robot("a", tuple(at), rng.uniform(1, 359)), robot("b", tuple(beside), 1.0)
        way = mine.way(Segment(tuple(at), tuple(to), 0.4), LIMITS)
        nearest = min(
            math.dist(way.at(t), tuple(beside)) for t in np.linspace(0, way.knots_s[-1] + STARTS_S, 400)
        )
        if nearest < 0.29:
            assert asked(mine, tuple(to), other, None)


def test_a_way_home_is_refused_where_the_turn_leads_round_another_that_stands_on_the_straight_way() -> None:
    """The car may turn tighter than it is taken to, up to on the spot."""
    robots = {"a": robot("a", (10.0, 10.0), 270.0), "b": robot("b", (10.0, 9.6), 1.0)}
    robots["a"].home_m = (10.0, 5.0)
    wide = replace(LIMITS, turn_radius_m=1.0)
    sequence = ReturnSequence()
    sequence.ask("a", "operator")
    sequence.step(robots, wide, 0)
    assert "a" not in sequence.under_way
