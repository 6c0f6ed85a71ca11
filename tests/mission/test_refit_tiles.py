"""Ground in tiles: every place in one of them, every source once, and what is heard near each."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldkit.engine.grid import Grid
from fieldkit.messages import Detection, Listening, SourceEstimate
from mission.analysis.refit_sessions import Session
from mission.analysis.refit_tiles import MOST_CELLS, owned, probability_left, tiles_of

GROUND = Grid(40.0, 20.1, 0.2)
QUARTERS = tiles_of(GROUND, 3.0, (2, 2))


def source(ident: int, east_m: float, north_m: float, sigma_m: float = 0.2, note: str = "") -> SourceEstimate:
    cov_m2 = np.eye(2) * sigma_m**2
    return SourceEstimate(ident, east_m, north_m, cov_m2, 4, 9.0, 0.1, 0.99, 0.95, "found", note)


@given(st.floats(-5.0, 45.0), st.floats(-5.0, 25.0))
def test_every_place_is_in_one_tile(east_m: float, north_m: float) -> None:
    assert sum(tile.holds(east_m, north_m) for tile in QUARTERS) == 1


def test_borders_belong_to_the_tile_east_and_north_of_them() -> None:
    first = QUARTERS[0]
    assert [tile.number for tile in QUARTERS if tile.holds(first.east_m, first.north_m)] == [3]
    assert first.holds(np.nextafter(first.east_m, 0.0), np.nextafter(first.north_m, 0.0))


def test_a_belief_is_of_the_tile_and_one_range_around_it_and_hears_robots_another_range_away() -> None:
    last = QUARTERS[3]
    assert last.grid.west_m == pytest.approx(last.west_m - 3.0) and last.grid.cell_m == 0.2
    assert last.grid.west_m + last.grid.size_east_m == pytest.approx(40.0)
    assert last.grid.south_m + last.grid.size_north_m == pytest.approx(20.1)
    assert last.heard.west_m == pytest.approx(last.west_m - 6.0)
    assert last.share == pytest.approx((20.0 * 10.1) / (23.0 * 13.1), rel=0.02)


def test_ground_that_is_small_against_the_range_is_one_tile() -> None:
    for side_m, tiles in ((1.0, 1), (40.0, 1), (54.0, 1), (58.0, 4), (100.0, 9)):
        assert len(tiles_of(Grid(side_m, side_m, 0.5), 3.0)) == tiles
    (whole,) = tiles_of(GROUND, 3.0)
    assert whole.grid == GROUND and whole.share == 1.0 and whole.holds(1e6, -1e6)


def test_cells_grow_where_a_tile_would_have_too_many() -> None:
    (tile,) = tiles_of(Grid(1000.0, 1000.0, 0.5), 900.0)
    assert tile.grid.n_cells <= 1.01 * MOST_CELLS and tile.grid.cell_m > 0.5


def own(believed: dict[int, list[SourceEstimate]]) -> list[tuple[int, float, float]]:
    its = owned(QUARTERS, [believed.get(tile.number, []) for tile in QUARTERS])
    return [(each.ident, each.east_m, each.north_m) for each in its]


@pytest.mark.parametrize("off_m", [-0.1, 0.1])
def test_a_source_at_a_border_is_there_once_on_whichever_side_each_tile_sees_it(off_m: float) -> None:
    border_m = QUARTERS[0].east_m
    seen = {0: [source(7, border_m - off_m, 5.0)], 1: [source(3, border_m + 1.1 * off_m, 5.0)]}
    assert len(own(seen)) == 1
    assert len(own({0: [source(7, border_m, 5.0)], 1: [source(3, border_m, 5.0)]})) == 1


def test_a_source_where_four_tiles_meet_is_there_once() -> None:
    east_m, north_m = QUARTERS[0].east_m, QUARTERS[0].north_m
    for sign in (-1.0, 1.0):
        seen = {
            tile.number: [source(1, east_m + sign * 0.05 * tile.number, north_m - sign * 0.03)]
            for tile in QUARTERS
        }
        assert len(own(seen)) == 1


def test_two_sources_across_a_border_stay_two() -> None:
    border_m = QUARTERS[0].east_m
    both = [source(1, border_m - 0.4, 5.0), source(2, border_m + 0.4, 5.0)]
    assert own({0: both, 1: both}) == [(1, border_m - 0.4, 5.0), (2, border_m + 0.4, 5.0)]


def test_what_a_tile_believes_of_the_ground_around_it_is_not_taken_from_it() -> None:
    assert own({0: [source(1, QUARTERS[0].east_m + 2.0, 5.0)]}) == []
    assert len(own({1: [source(1, QUARTERS[0].east_m + 2.0, 5.0)]})) == 1


def test_sources_are_numbered_anew_and_notes_name_no_number_of_a_tile() -> None:
    note = "gone silent; may have moved: source 12 at 3.0, 4.0 m has been heard since"
    (first, second) = owned(QUARTERS, [[source(4, 1.0, 1.0)], [], [], [source(4, 30.0, 15.0, note=note)]])
    assert (first.ident, second.ident) == (1, 2)
    assert second.note == "gone silent; may have moved: a source at 3.0, 4.0 m has been heard since"
    alone = [source(4, 1.0, 1.0, note=note)]
    assert owned(tiles_of(GROUND, 3.0), [alone]) == alone


def test_what_is_left_counts_by_the_ground_that_is_a_tiles_own() -> None:
    assert probability_left(tiles_of(GROUND, 3.0), [0.37]) == 0.37
    halves = [replace(tile, share=0.5) for tile in QUARTERS[:2]]
    assert probability_left(halves, [0.75, 0.75]) == pytest.approx(0.75)
    assert probability_left(halves, [0.0, 0.0]) == 0.0
    assert probability_left(halves, [1.0, 0.0]) <= 1.0


def rows() -> list[Detection | Listening]:
    at = np.array([[1.0, 1.0], [30.0, 1.0]])
    zero = np.zeros(2)
    heard = Detection(
        5, ("a", "b"), at, zero + 90.0, np.array([-60.0, np.nan]), zero > 0.0, zero, zero, sender="s"
    )
    return [
        Listening(0, 4, ("a", "b"), at, zero, zero, zero),
        heard,
        Listening(4, 8, ("b",), at[1:], *[zero[1:]] * 3),
    ]


def test_a_session_is_the_same_after_a_file(tmp_path) -> None:
    session = Session.of(("a", "b"), rows(), 9)
    (tmp_path / "session.npz").write_bytes(session.packed())
    again = Session.read(tmp_path / "session.npz")
    assert again.detections == 1 and again.last_ns == 9 and again.robots == ("a", "b")
    for mine, theirs in zip(again.named(("2.a", "2.b")), rows(), strict=True):
        assert type(mine) is type(theirs)
        assert mine.robots == tuple(f"2.{robot}" for robot in theirs.robots)
        assert np.array_equal(mine.position_m, theirs.position_m)
        assert np.array_equal(mine.heading_deg, theirs.heading_deg)
    assert [row.sender for row in again.named("ab") if isinstance(row, Detection)] == ["s"]


def test_of_a_session_a_tile_takes_what_robots_near_it_heard() -> None:
    session = Session.of(("a", "b"), rows(), 9)
    near_a, near_b = session.within(Grid(10.0, 10.0, 10.0)), session.within(Grid(10.0, 10.0, 10.0, 25.0))
    assert [row.robots for row in near_a.named("ab")] == [("a",), ("a",)]
    assert [row.robots for row in near_b.named("ab")] == [("b",), ("b",)]
    assert near_a.detections == 1
    assert near_b.detections == 0, "it did not hear that one, which says nothing so far away"
    assert len(session.within(Grid(1.0, 1.0, 1.0, 15.0)).heard) == 0
