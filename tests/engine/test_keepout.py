"""Keep-out polygons: what they contain and which ways they block; planners and safety respect them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.infogain import InfoGainPlanner
from fieldkit.geometry.polygons import KeepOut
from fieldkit.messages import GoTo, Hold, Pose, Waypoint
from mission.lab.bench import settings
from mission.safety.limits import SafetySettings
from mission.safety.rules import Safety

SQUARE = KeepOut((((2.0, 2.0), (6.0, 2.0), (6.0, 6.0), (2.0, 6.0)),))
L_SHAPE = KeepOut((((0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (1.0, 1.0), (1.0, 4.0), (0.0, 4.0)),))


def test_a_point_in_the_notch_of_an_l_is_outside() -> None:
    assert L_SHAPE.contains(np.array([[0.5, 3.0], [3.0, 0.5], [3.0, 3.0]])).tolist() == [True, True, False]


@given(e=st.floats(-10, 20), n=st.floats(-10, 20))
def test_a_square_contains_what_lies_between_its_sides(e: float, n: float) -> None:
    expected = 2.0 < e < 6.0 and 2.0 < n < 6.0
    if min(abs(e - 2), abs(e - 6), abs(n - 2), abs(n - 6)) > 1e-9:
        assert SQUARE.contains(np.array([[e, n]]))[0] == expected


@pytest.mark.parametrize(
    ("start", "end", "blocked"),
    [
        ((0, 4), (10, 4), True),  # straight through
        ((0, 0), (1, 1), False),
        ((0, 4), (3, 4), True),  # ends inside
        ((0, 0), (10, 0), False),
        ((0, 3), (4, 10), False),
        ((0, 6), (10, 6), True),  # along an edge
        ((7, 2), (10, 2), False),  # in line with an edge, beyond it
        ((4, 4), (4.5, 4.5), True),  # wholly inside
    ],
)
def test_ways_that_touch_are_blocked(start: tuple, end: tuple, blocked: bool) -> None:
    assert SQUARE.blocks(np.array([start], float), np.array([end], float))[0] == blocked


@pytest.mark.parametrize(
    ("start", "end", "distance"),
    [
        ((0, 0), (0, 10), 2.0),  # beside it
        ((0, 0), (1, 1), 2**0.5),  # ends before a corner
        ((3, 4), (4, 4), 0.0),
        ((0, 4), (10, 4), 0.0),
        ((8, 7), (7, 8), 2**0.5 * 1.5),  # a corner is nearest to the middle of the way
        ((9, 4), (9, 4), 3.0),  # a place
    ],
)
def test_how_near_a_way_comes(start: tuple, end: tuple, distance: float) -> None:
    assert SQUARE.distance_m(np.array([start], float), np.array([end], float))[0] == pytest.approx(distance)


def test_no_polygon_blocks_nothing() -> None:
    assert not KeepOut().blocks(np.zeros((3, 2)), np.ones((3, 2))).any()


def test_no_planned_way_crosses_it() -> None:
    wall = KeepOut((((6.0, 0.0), (7.0, 0.0), (7.0, 15.0), (6.0, 15.0)),))
    engine = replace(settings(pairs=1, sensing="levels"), keep_out=wall)
    for seed in range(5):
        start = {"r0": (3.0, 5.0), "r1": (4.2, 5.0)}
        plan = InfoGainPlanner(replace(engine, seed=seed)).plan(
            Situation(0, start, engine.teams, {}), IntensityBelief(engine)
        )
        for robot, path in plan.paths.items():
            corners = np.array([start[robot], *((w.east_m, w.north_m) for w in path)])
            assert not wall.blocks(corners[:-1], corners[1:]).any()
            assert len(path) > 0


def test_safety_holds_a_robot_whose_way_is_blocked() -> None:
    safety = Safety(SafetySettings(("a",), 10.0, 10.0, keep_out=SQUARE))
    safety.observe(Pose(0, "a", 1.0, 4.0))
    held = safety.allow(GoTo(0, "a", Waypoint(8.0, 4.0, 0.3)))
    assert isinstance(held, Hold) and "closed ground" in held.reason
    assert isinstance(safety.allow(GoTo(0, "a", Waypoint(1.0, 8.0, 0.3))), GoTo)
