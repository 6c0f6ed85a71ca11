"""Closed ground and routes round it, against what small steps find."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldkit.geometry.polygons import KeepOut, fault_of, margin_m
from fieldkit.geometry.routes import route

FENCE = ((0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (5.0, 5.0), (5.0, 10.0), (0.0, 10.0))
POND = ((2.0, 2.0), (4.0, 2.0), (4.0, 3.0), (2.0, 3.0))
GROUND = KeepOut((POND,), FENCE, 0.3)
places = st.tuples(st.floats(-2, 12), st.floats(-2, 12))


@given(place=places)
def test_clearance_is_the_distance_to_the_border_and_negative_beyond(place: tuple[float, float]) -> None:
    bare = GROUND.wider(0.0)
    clearance_m = bare.clearance_m(place)
    inside = margin_m(place, FENCE) > 0 and margin_m(place, POND) < 0
    if abs(clearance_m) > 1e-6:
        assert (clearance_m > 0) == inside
    assert abs(clearance_m) <= min(abs(margin_m(place, FENCE)), abs(margin_m(place, POND))) + 1e-9


@given(place=places)
def test_the_nearest_open_place_is_open_and_no_other_is_nearer(place: tuple[float, float]) -> None:
    open_m = GROUND.nearest_open(place)
    assert GROUND.clearance_m(open_m) >= -1e-6
    assert GROUND.wider(0.0).clearance_m(open_m) >= 0.3 - 1e-3
    away_m = math.dist(place, open_m)
    for bearing in np.linspace(0, 2 * math.pi, 24):
        nearer = (
            place[0] + (away_m - 0.02) * math.sin(bearing),
            place[1] + (away_m - 0.02) * math.cos(bearing),
        )
        assert away_m <= 0.02 or GROUND.clearance_m(nearer) < 1e-3


@given(start=places, end=places)
def test_a_permitted_path_is_open_or_leads_out_of_closed_ground_once(start, end) -> None:  # type: ignore[no-untyped-def]
    steps = np.linspace(0.0, 1.0, 400)[:, None]
    closed = GROUND.contains(np.array(start) + steps * (np.array(end) - np.array(start)))
    if GROUND.permits(start, end):
        opened = int(np.argmin(closed)) if closed[0] else 0
        # Steps may just miss a border that a path touches.
        assert closed[opened + 2 :].sum() <= 2 and not closed[-1]
    elif not closed.any():
        assert GROUND.distance_m(np.array([start]), np.array([end]))[0] < 0.05


@pytest.mark.parametrize("start", [(0.05, 5.0), (-0.05, 5.0), (-1.0, 5.0), (9.95, 0.05), (3.0, 2.1)])
def test_from_the_margin_from_outside_and_from_closed_ground_a_path_leads_back(start) -> None:  # type: ignore[no-untyped-def]
    inside = GROUND.nearest_open(start)
    further = tuple(b + (b - a) * 0.1 for a, b in zip(start, inside, strict=True))
    assert GROUND.permits(start, further)  # type: ignore[arg-type]


@settings(max_examples=40)
@given(start=places, end=places)
def test_a_route_is_open_all_along_and_no_shorter_than_a_straight_line(start, end) -> None:  # type: ignore[no-untyped-def]
    start, end = GROUND.nearest_open(start), GROUND.nearest_open(end)
    path = route(GROUND, start, end)
    assert path and path[-1] == end
    corners = (start, *path)
    length_m = sum(math.dist(a, b) for a, b in itertools.pairwise(corners))
    assert length_m >= math.dist(start, end) - 1e-9
    assert all(GROUND.permits(a, b) for a, b in itertools.pairwise(corners))


def test_the_route_round_a_notch_is_the_shortest_one() -> None:
    notched = KeepOut(fence=FENCE)
    path = route(notched, (9.0, 4.0), (4.0, 9.0))
    assert len(path) == 2
    length_m = math.dist((9.0, 4.0), path[0]) + math.dist(path[0], path[1])
    assert length_m == pytest.approx(
        math.dist((9.0, 4.0), (5.0, 5.0)) + math.dist((5.0, 5.0), (4.0, 9.0)), abs=0.3
    )


def test_where_no_path_leads_there_is_none() -> None:
    island = KeepOut((), ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))).also(
        ((4.0, -1.0), (6.0, -1.0), (6.0, 11.0), (4.0, 11.0))
    )
    assert route(island, (1.0, 5.0), (9.0, 5.0)) == ()


@pytest.mark.parametrize(
    ("corners", "says"),
    [
        (((0, 0), (1, 0)), "at least 3 corners"),
        (((0, 0), (math.nan, 0), (1, 1)), "finite"),
        (((0, 0), (2, 2), (2, 0), (0, 2)), "cross"),
        (((0, 0), (1, 0), (2, 0)), "area|cross"),
        (((0, 0), (1, 0), (1, 1)), "^$"),
    ],
)
def test_what_is_no_polygon_is_said(corners, says: str) -> None:  # type: ignore[no-untyped-def]
    import re

    assert re.search(says, fault_of(corners))
