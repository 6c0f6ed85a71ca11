"""Ridge walking of one robot: level, ridges, tour, time and place against the reference; ways round obstacles."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.spog import EIGHT, SpogBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.bounds import missed_tours, mst_tour_bound_m, rwa_search_time_bound_s
from fieldkit.engine.planning.detour import Detours
from fieldkit.engine.planning.ridges import find_ridges
from fieldkit.engine.planning.rwa import RwaPlanner, level_of
from fieldkit.engine.planning.schedule import ridge_schedule
from fieldkit.engine.planning.tour import off_ridge_m, ridge_tour, time_on_ridges_s
from fieldkit.engine.settings import EngineSettings
from fieldkit.geometry.polygons import KeepOut
from fieldkit.tuning import RidgeTuning

VECTORS = {
    v["id"]: v
    for v in json.loads((Path(__file__).parent.parent / "golden" / "single_robot.json").read_text())[
        "vectors"
    ]
}
CELL = 0.0508


def reference_presence() -> np.ndarray:
    presence = np.zeros((50, 50))
    presence[10, 10:15], presence[11, 14:16] = 0.5, 0.4
    presence[30:34, 40] = 0.6
    presence[45, 5], presence[46, 6] = 0.9, 0.2
    return presence


def test_level_ridges_tour_and_times_match_the_reference() -> None:
    expected = VECTORS["rwa"]["expect"]
    presence = reference_presence()
    assert level_of(presence, RidgeTuning().rwa_level) == pytest.approx(expected["p"], abs=1e-12)
    assert ndimage.label(presence >= expected["p"], EIGHT)[1] == expected["ncomp8"]
    assert ndimage.label(presence >= expected["p"])[1] == expected["ncomp4"]
    ridges = find_ridges(presence, presence, expected["p"], Grid(50 * CELL, 50 * CELL, CELL))
    assert [r.length_m for r in ridges] == pytest.approx(expected["ridge_len"], abs=1e-9)
    ends = np.array([sorted(r.ends_m.tolist(), key=lambda p: (p[1], p[0])) for r in ridges])
    start = np.array([1.27, 1.27])
    order = ridge_tour(start, ends)
    assert off_ridge_m(start, ends, order) == pytest.approx(expected["dOFF_open"], abs=1e-9)
    assert [2 * index + flip for index, flip in order] == expected["entry_nodes_open"]
    there_and_back = ridge_tour(start, ends, closed=True)
    closed = off_ridge_m(start, ends, there_and_back, closed=True)
    assert closed == pytest.approx(expected["dOFF_closed"], abs=1e-9)
    weights = np.array([r.weight for r in ridges])
    tau = time_on_ridges_s(weights, 800.0, expected["dOFF_open"], 0.4)
    assert tau == pytest.approx(expected["tau"], abs=1e-9)
    assert tau.sum() == pytest.approx(expected["tON"], abs=1e-9)
    schedule = ridge_schedule(start, ends, order, weights, 800.0, 0.4)
    for t_s, pose in expected["pose_at"].items():
        assert schedule.pose_at(float(t_s)) == pytest.approx(pose, abs=1e-9)


def test_the_search_time_bound_matches_the_reference() -> None:
    expected = VECTORS["thm1"]["expect"]
    assert missed_tours(0.012, 0.0508, 0.4) == pytest.approx(expected["e38_v04"], rel=1e-9)
    assert missed_tours(0.012, 0.0508, 0.01) == pytest.approx(expected["e38_v001"], rel=1e-9)
    bound = rwa_search_time_bound_s(0.012, 800.0, 0.0508, 0.4, 1.27 * np.sqrt(2.0))
    assert bound == pytest.approx(expected["bound_v04"], rel=1e-9)


@given(seed=st.integers(0, 1000), count=st.integers(3, 60))
def test_the_printed_tour_bound_fails_where_the_corrected_one_holds(seed: int, count: int) -> None:
    """Eq 41 bounds a sum by its squares with 2 where the number of edges belongs."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.uniform(0, 1, count))
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    assert mst_tour_bound_m(points) <= 2.0 * np.sqrt(6.0 * (count - 1)) + 1e-9
    with pytest.raises(ValueError, match="at least 2"):
        rwa_search_time_bound_s(0.01, 800.0, 0.05, 0.4, 1.0, form="corrected")


def test_many_points_break_the_printed_tour_bound() -> None:
    points = np.random.default_rng(0).uniform(-0.7, 0.7, (400, 2))
    assert mst_tour_bound_m(points) > 4.0 * np.sqrt(3.0)


def engine(**changes: object) -> EngineSettings:
    settings = EngineSettings(Grid(10.0, 10.0, 0.5), Antenna(2.5, -50.0, 3.3, -70.0), (("r0",),), (0.0,))
    return replace(settings, **changes)  # type: ignore[arg-type]


class Presence(SpogBelief):
    """A belief with a given P(C_i)."""

    def __init__(self, settings: EngineSettings, presence: np.ndarray) -> None:
        super().__init__(settings)
        self.log_absent = np.log1p(-presence.ravel())


def plan_of(settings: EngineSettings, presence: np.ndarray, robots: int = 1):  # type: ignore[no-untyped-def]
    names = tuple(f"r{k}" for k in range(robots))
    place = {name: (1.0 + k, 1.0) for k, name in enumerate(names)}
    situation = Situation(0, place, tuple((name,) for name in names), {})
    return RwaPlanner(settings).plan(situation, Presence(settings, presence))


def test_a_robot_walks_to_the_ridge_and_an_empty_level_set_means_a_random_walk() -> None:
    presence = np.zeros((20, 20))
    assert plan_of(engine(), presence).purpose == {"r0": "walk"}
    presence[12, 6:11] = 0.5
    plan = plan_of(engine(), presence)
    assert plan.purpose == {"r0": "ridge"}
    assert all(3.0 <= w.east_m <= 5.5 and abs(w.north_m - 6.25) < 1e-6 for w in plan.paths["r0"])


def test_found_sources_take_no_more_time() -> None:
    presence = np.zeros((20, 20))
    presence[12, 6:9], presence[3, 15] = 0.6, 0.99  # the second is past the threshold: found
    plan = plan_of(engine(), presence)
    assert {round(w.north_m, 2) for w in plan.paths["r0"]} == {6.25}


def test_all_cells_alike_make_one_ridge_across_the_field() -> None:
    plan = plan_of(engine(), np.full((20, 20), 0.3))
    assert plan.purpose["r0"] == "ridge" and len(plan.paths["r0"]) >= 1


def test_one_cell_is_a_ridge_without_length_and_more_robots_than_ridges_walk() -> None:
    presence = np.zeros((20, 20))
    presence[0, 0] = 0.6  # on the border
    plan = plan_of(engine(teams=(("r0",), ("r1",), ("r2",))), presence, robots=3)
    assert sorted(plan.purpose.values()) == ["ridge", "walk", "walk"]
    robot = next(r for r, why in plan.purpose.items() if why == "ridge")
    assert plan.paths[robot][0].east_m <= 0.5 and plan.paths[robot][0].north_m <= 0.5


def test_robots_go_round_what_must_not_be_entered() -> None:
    wall = KeepOut((((4.0, -1.0), (5.0, -1.0), (5.0, 8.0), (4.0, 8.0)),))
    presence = np.zeros((20, 20))
    presence[2, 14:18] = 0.5
    plan = plan_of(engine(keep_out=wall), presence)
    corners = np.array([(1.0, 1.0), *((w.east_m, w.north_m) for w in plan.paths["r0"])])
    assert plan.purpose["r0"] == "ridge" and corners[:, 0].max() > 7.0
    assert not wall.blocks(corners[:-1], corners[1:]).any()


def test_a_place_walled_in_cannot_be_reached_and_is_left_out() -> None:
    box = KeepOut(
        (
            ((4.0, 4.0), (7.0, 4.0), (7.0, 4.3), (4.0, 4.3)),
            ((4.0, 6.7), (7.0, 6.7), (7.0, 7.0), (4.0, 7.0)),
            ((4.0, 4.0), (4.3, 4.0), (4.3, 7.0), (4.0, 7.0)),
            ((6.7, 4.0), (7.0, 4.0), (7.0, 7.0), (6.7, 7.0)),
        )
    )
    detours = Detours(Grid(10.0, 10.0, 0.5), box, 0.0, 0.25)
    assert detours.way(np.array([1.0, 1.0]), np.array([5.5, 5.5])) is None
    assert detours.way(np.array([1.0, 1.0]), np.array([4.1, 5.5])) is None
    way = detours.way(np.array([1.0, 5.5]), np.array([9.0, 5.5]))
    assert way is not None and len(way) >= 3
    length = np.hypot(*np.diff(np.concatenate([[[1.0, 5.5]], way]), axis=0).T).sum()
    assert 8.0 < length < 10.0


def test_a_schedule_never_outlasts_its_period_nor_outruns_the_robot() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        count = int(rng.integers(1, 5))
        ends = rng.uniform(0, 10, (count, 2, 2))
        if rng.random() < 0.3:
            ends[0, 1] = ends[0, 0]  # a ridge without length
        order = ridge_tour(np.zeros(2), ends)
        for sweeps in (False, True):
            period = float(rng.uniform(1.0, 200.0))
            schedule = ridge_schedule(np.zeros(2), ends, order, np.ones(count), period, 0.4, sweeps=sweeps)
            assert schedule.pieces[-1].t1_s <= period + 1e-9
            for piece in schedule.pieces:
                length = np.hypot(*np.subtract(piece.end_m, piece.start_m))
                assert length <= 0.4 * (piece.t1_s - piece.t0_s) + 1e-9
