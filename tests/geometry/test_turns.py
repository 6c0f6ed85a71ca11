"""Paths that begin with a turn, against circles, tangents and a vehicle that is steered by small steps."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fieldkit.geometry.segments import Place, Segment, nearest_m, standing
from fieldkit.geometry.turns import CHORD_RAD, Path, is_behind, turning, until

places = st.tuples(st.floats(-20, 20), st.floats(-20, 20))
headings = st.floats(0.0, 360.0)
radii = st.floats(0.1, 5.0)


def steered(start: Place, end: Place, heading_deg: float, radius_m: float) -> np.ndarray:
    """Places of a vehicle that steers as hard as it can towards `end`, by steps of a hundredth of its radius."""
    heading, place, step_m = math.radians(heading_deg), np.array(start), 0.01 * radius_m
    driven = [place.copy()]
    for _ in range(40_000):
        way = np.array(end) - place
        if np.hypot(*way) <= step_m:
            break
        off = (math.atan2(way[0], way[1]) - heading + math.pi) % (2.0 * math.pi) - math.pi
        if abs(off) < 1e-9:  # straight from here on
            driven += [place + share * way for share in np.linspace(0.0, 1.0, 50)]
            break
        most = step_m / radius_m
        heading += min(max(off, -most), most)
        place = place + step_m * np.array([math.sin(heading), math.cos(heading)])
        driven.append(place.copy())
    return np.array(driven)


@given(start=places, end=places, heading_deg=headings, radius_m=radii)
def test_it_is_the_path_of_a_vehicle_that_steers_as_hard_as_it_can(
    start: Place, end: Place, heading_deg: float, radius_m: float
) -> None:
    segment = Segment(start, end, 1.0)
    off = math.atan2(end[0] - start[0], end[1] - start[1]) - math.radians(heading_deg)
    off = (off + math.pi) % (2.0 * math.pi) - math.pi
    assume(abs(off) < math.radians(175.0))  # of one behind nobody knows the side
    right = np.array([math.cos(math.radians(heading_deg)), -math.sin(math.radians(heading_deg))])
    centre = np.array(start) + math.copysign(radius_m, off) * right
    assume(math.dist(centre, end) > 1.05 * radius_m)  # and one inside its circle is never reached
    way = turning(segment, heading_deg, radius_m)
    driven = steered(start, end, heading_deg, radius_m)
    corners = np.array([leg.end_m for leg in way.legs])
    apart = np.linalg.norm(corners[:, None] - driven[None], axis=2).min(axis=1)
    # The steps themselves are off by about a hundredth of the radius; ten degrees count as straight.
    assert apart.max() < 0.08 * radius_m + 0.02


@given(start=places, end=places, heading_deg=headings, radius_m=radii, wrong_way=st.booleans())
def test_it_turns_on_its_circle_and_leaves_it_along_a_tangent(
    start: Place, end: Place, heading_deg: float, radius_m: float, wrong_way: bool
) -> None:
    way = turning(Segment(start, end, 1.0), heading_deg, radius_m, wrong_way=wrong_way)
    assert way.start_m == start and way.legs[-1].end_m == end
    if not isinstance(way, Path):
        return
    right = np.array([math.cos(math.radians(heading_deg)), -math.sin(math.radians(heading_deg))])
    centres = [np.array(start) + side * radius_m * right for side in (-1.0, 1.0)]
    arc = np.array([leg.end_m for leg in way.legs[:-1]])
    off_m = [np.abs(np.linalg.norm(arc - centre, axis=1) - radius_m).max() for centre in centres]
    assert min(off_m) == pytest.approx(0.0, abs=1e-9)
    first = way.legs[0]
    if first.length_m < 1e-6:
        return  # no arc: beside it, inside the circle, an arc of no length is the nearest that it comes
    centre = centres[int(np.argmin(off_m))]
    if math.dist(centre, end) > radius_m * 1.001:
        assert np.dot(arc[-1] - centre, np.array(end) - arc[-1]) == pytest.approx(
            0.0, abs=1e-6 * (1 + radius_m) * 60
        )
    off = math.atan2(first.end_m[0] - start[0], first.end_m[1] - start[1]) - math.radians(heading_deg)
    assert abs((off + math.pi) % (2 * math.pi) - math.pi) <= CHORD_RAD / 2 + 1e-6


@given(start=places, end=places, heading_deg=headings, radius_m=radii, late_s=st.floats(0, 9))
def test_it_is_driven_leg_by_leg_in_time(
    start: Place, end: Place, heading_deg: float, radius_m: float, late_s: float
) -> None:
    way = turning(Segment(start, end, 0.5, late_s), heading_deg, radius_m)
    assert way.at(-1.0) == start and way.at(1e6) == pytest.approx(end)
    times = np.linspace(0.0, way.knots_s[-1] + 1.0, 200)
    driven = np.array([way.at(t) for t in times])
    assert np.linalg.norm(np.diff(driven, axis=0), axis=1).max() <= 0.5 * (times[1] - times[0]) + 1e-9
    half = until(way, times[100])
    assert all(half.at(t) == pytest.approx(way.at(t)) for t in times[:100])
    assert half.at(1e6) == pytest.approx(way.at(times[100]))


def test_where_nothing_is_to_turn_it_is_the_straight_segment() -> None:
    segment = Segment((0.0, 0.0), (5.0, 0.0), 1.0)
    assert turning(segment, None, 1.0) is segment, "nobody knows where it looks"
    assert turning(segment, 180.0, 0.0) is segment, "it turns on the spot"
    assert turning(segment, 85.0, 1.0) is segment, "it looks there"
    stays = standing((1.0, 1.0))
    assert turning(stays, 0.0, 1.0) is stays


def test_a_half_turn_swings_two_radii_to_either_side() -> None:
    back = Segment((0.0, 0.0), (0.0, -10.0), 1.0)
    assert is_behind(back, 0.0) and is_behind(back, 350.0) and not is_behind(back, 340.0)
    assert not is_behind(back, None)
    for wrong_way, beside in ((False, (2.0, 0.0)), (True, (-2.0, 0.0))):
        way = turning(back, 0.0, 1.0, wrong_way=wrong_way)
        # The tangent to a way-point ten radii behind leans in a little.
        assert nearest_m(way, standing(beside)) < 0.2
