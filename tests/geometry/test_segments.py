"""Segments in time and space, against what plane geometry says."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldkit.geometry.polygons import KeepOut, margin_m
from fieldkit.geometry.segments import Segment, ever_m, nearest_m, standing

L_SHAPE = ((0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (5.0, 5.0), (5.0, 10.0), (0.0, 10.0))
places = st.tuples(st.floats(-20, 20), st.floats(-20, 20))


def test_head_on_they_meet_and_abreast_they_keep_their_distance() -> None:
    assert nearest_m(Segment((0, 0), (10, 0), 1.0), Segment((10, 0), (0, 0), 1.0)) == pytest.approx(0.0)
    assert nearest_m(Segment((0, 0), (10, 0), 1.0), Segment((0, 1), (10, 1), 1.0)) == pytest.approx(1.0)


def test_crossing_ways_keep_clear_when_one_is_later() -> None:
    one = Segment((0, 0), (10, 0), 1.0)
    assert nearest_m(one, Segment((5, -5), (5, 5), 1.0)) == pytest.approx(0.0)
    assert nearest_m(one, Segment((5, -5), (5, 5), 1.0, delay_s=4.0)) > 2.0
    assert ever_m(one, Segment((5, -5), (5, 5), 1.0, delay_s=4.0)) == 0.0


@given(a=places, b=places, c=places, d=places, u=st.floats(0.1, 3), v=st.floats(0.1, 3))
def test_the_nearest_is_what_small_steps_find(a, b, c, d, u, v) -> None:  # type: ignore[no-untyped-def]
    one, other = Segment(a, b, u), Segment(c, d, v, delay_s=1.0)
    moments = np.linspace(0.0, max(one.arrival_s, other.arrival_s), 400)
    stepped = min(math.dist(one.at(t), other.at(t)) for t in moments)
    exact = nearest_m(one, other)
    assert exact <= stepped + 1e-9
    assert exact >= stepped - (u + v) * moments[1] - 1e-9
    assert ever_m(one, other) <= exact + 1e-9


@given(
    a=places, b=places, c=places, d=places, u=st.floats(0.1, 3), v=st.floats(0.1, 3), late_s=st.floats(0, 9)
)
def test_to_set_out_later_is_to_be_delayed(a, b, c, d, u, v, late_s) -> None:  # type: ignore[no-untyped-def]
    one, other = Segment(a, b, u), Segment(c, d, v)
    assert nearest_m(one, other, late_s, 0.0) == nearest_m(Segment(a, b, u, delay_s=late_s), other)
    assert nearest_m(one, other, 0.0, late_s) == nearest_m(one, Segment(c, d, v, delay_s=late_s))


@given(a=places, b=places, c=places, d=places)
def test_whenever_driven_they_come_as_near_as_their_closest_points(a, b, c, d) -> None:  # type: ignore[no-untyped-def]
    one, other = Segment(a, b, 1.0), Segment(c, d, 1.0)
    share = np.linspace(0.0, 1.0, 60)[:, None]
    on_one, on_other = a + share * np.subtract(b, a), c + share * np.subtract(d, c)
    sampled = float(np.hypot(*(on_one[:, None] - on_other[None, :]).reshape(-1, 2).T).min())
    assert ever_m(one, other) <= sampled + 1e-9
    assert ever_m(one, other) >= sampled - (one.length_m + other.length_m) / 59 - 1e-9


@given(point=st.tuples(st.floats(-5, 15), st.floats(-5, 15)))
def test_outside_a_fence_is_what_is_not_inside_it(point) -> None:  # type: ignore[no-untyped-def]
    inside = (0 < point[0] < 10 and 0 < point[1] < 5) or (0 < point[0] < 5 and 0 < point[1] < 10)
    if abs(margin_m(point, L_SHAPE)) > 1e-6:
        assert KeepOut(fence=L_SHAPE).contains(np.array([point]))[0] == (not inside)
        assert (margin_m(point, L_SHAPE) > 0) == inside


def test_a_way_across_the_notch_of_a_fence_leaves_it() -> None:
    ground = KeepOut(fence=L_SHAPE)
    assert ground.blocks(np.array([[9.0, 4.0]]), np.array([[4.0, 9.0]]))[0]
    assert not ground.blocks(np.array([[9.0, 4.0]]), np.array([[1.0, 1.0]]))[0]


def test_the_margin_is_the_distance_to_the_nearest_side() -> None:
    assert margin_m((2.0, 3.0), L_SHAPE) == pytest.approx(2.0)
    assert margin_m((9.0, 9.0), L_SHAPE) == pytest.approx(-4.0)
    assert nearest_m(standing((0, 0)), standing((3, 4))) == pytest.approx(5.0)
