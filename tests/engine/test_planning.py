"""Planners: paths stay in the fence, keep apart, go where it matters; ridges, tours and time on them."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st

from fieldkit import plugins
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.likelihood.pairwise import attenuation_db, log_e10, log_e11
from fieldkit.engine.planning.base import Situation, abreast, track
from fieldkit.engine.planning.infogain import InfoGainPlanner, blocks_summed
from fieldkit.engine.planning.prwa import cluster_ridges
from fieldkit.engine.planning.ridges import Ridge, farthest_pair, find_ridges
from fieldkit.engine.planning.spacing import best_spacing_m, spacing_entropies
from fieldkit.engine.planning.tour import EXACT_RIDGES, off_ridge_m, ridge_tour, time_on_ridges_s
from fieldkit.errors import ConfigError
from fieldkit.messages import Listening
from mission.lab.bench import settings

GOLDEN = Path(__file__).parent.parent / "golden"


def situation(engine, seed: int = 0) -> Situation:
    place = {r: (3.0 + 2.0 * (k // 2), 2.0 + 1.2 * (k % 2)) for k, r in enumerate(engine.robots)}
    return Situation(0, place, engine.teams, {})


@pytest.mark.parametrize("name", plugins.names("fieldkit.planners"))
@budget(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000))
def test_every_planner_keeps_its_way_points_inside_the_fence(name: str, seed: int) -> None:
    engine = replace(settings(sensing="levels"), seed=seed, fence_margin_m=0.4)
    belief = IntensityBelief(engine)
    plan = plugins.load("fieldkit.planners", name)(engine).plan(situation(engine), belief)
    assert set(plan.paths) == set(engine.robots)
    for path in plan.paths.values():
        for waypoint in path:
            assert 0.4 - 1e-9 <= waypoint.east_m <= 24.6 + 1e-9
            assert 0.4 - 1e-9 <= waypoint.north_m <= 24.6 + 1e-9
            assert 0.0 < waypoint.speed_m_s <= engine.max_speed_m_s + 1e-9


@pytest.mark.parametrize("name", plugins.names("fieldkit.planners"))
def test_every_planner_repeats_itself_for_the_same_seed(name: str) -> None:
    engine = settings(sensing="levels")
    plans = [
        plugins.load("fieldkit.planners", name)(engine).plan(situation(engine), IntensityBelief(engine))
        for _ in range(2)
    ]
    assert plans[0] == plans[1]


def test_infogain_goes_where_nobody_has_listened() -> None:
    engine = replace(settings(pairs=1, sensing="levels"), planning_period_s=60.0)
    belief = IntensityBelief(engine)
    for east in np.arange(1.0, 25.0, 2.0):  # all but the north has been listened to for long
        for north in np.arange(1.0, 17.0, 2.0):
            belief.listen(Listening(0, 60 * 10**9, ("x",), np.array([[east, north]])))
    place = {"r0": (12.0, 15.0), "r1": (13.5, 15.0)}
    plan = InfoGainPlanner(engine).plan(Situation(0, place, engine.teams, {}), belief)
    assert max(w.north_m for w in plan.paths["r0"]) > 18.0


def test_infogain_keeps_teams_apart() -> None:
    engine = replace(settings(sensing="levels"), min_separation_m=1.0)
    start = situation(engine)
    plan = InfoGainPlanner(engine).plan(start, IntensityBelief(engine))
    tracks = {}
    for team in engine.teams:
        begin = np.array([start.position_m[r] for r in team])
        places = np.array([[(w.east_m, w.north_m) for w in plan.paths[r]] for r in team]).transpose(1, 0, 2)
        tracks[team] = track(places, begin, engine.max_speed_m_s, 1.5, engine.tuning.infogain.horizon_s)
    for first, second in pairwise(tracks.values()):
        gaps = np.hypot(*(first[:, :, None] - second[:, None]).transpose(3, 0, 1, 2))
        assert gaps.min() >= min(1.0, gaps[0].min()) - 1e-6


def test_no_path_leads_further_than_the_battery_brings_a_robot_home_from() -> None:
    engine = settings(pairs=1, sensing="levels")
    place = {"r0": (12.0, 12.0), "r1": (13.0, 12.0)}
    home = {"r0": (11.0, 12.0), "r1": (14.0, 12.0)}
    for left_m in (9.0, 4.0):
        near = Situation(0, place, engine.teams, {}, {"r0": left_m, "r1": 100.0}, home)
        path = InfoGainPlanner(engine).plan(near, IntensityBelief(engine)).paths["r0"]
        corners = np.array([place["r0"], *((w.east_m, w.north_m) for w in path)])
        gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        assert (gone + np.hypot(*(corners - home["r0"]).T)).max() <= left_m + 1e-9
        assert len(path) > 0 or left_m < 5.0
    empty = Situation(0, place, engine.teams, {}, {"r0": 0.5}, home)
    plan = InfoGainPlanner(engine).plan(empty, IntensityBelief(engine))
    assert plan.paths["r0"] == () and plan.purpose["r0"] == "wait"


def test_a_team_waits_at_a_corner_for_its_slowest_turn() -> None:
    places = np.array([[[4.0, 0.0]], [[4.0, 4.0]]])  # east, then a quarter turn to the north
    at = track(places, np.array([[0.0, 0.0]]), 1.0, 1.0, 14.0, turn_deg_s=30.0)[:, 0]
    assert at[3].tolist() == pytest.approx([3.5, 0.0])
    assert at[4:7].tolist() == [pytest.approx([4.0, 0.0], abs=1e-6)] * 3
    assert at[7].tolist() == pytest.approx([4.0, 0.5], abs=1e-6)
    assert at[-1].tolist() == [4.0, 4.0]


def test_infogain_refuses_a_belief_without_exposure() -> None:
    engine = settings()
    with pytest.raises(ConfigError, match="intensity"):
        InfoGainPlanner(engine).plan(situation(engine), SpogBelief(engine))


@given(
    corners=st.lists(st.tuples(st.floats(0, 10), st.floats(0, 10)), min_size=1, max_size=6),
    spacing=st.floats(0.5, 3.0),
)
def test_a_pair_abreast_never_swaps_sides_needlessly_and_keeps_its_spacing(
    corners: list, spacing: float
) -> None:
    start = np.array([[2.0, 2.0], [3.0, 2.0]])
    places = abreast(np.array(corners), start, spacing, Grid(10, 10, 0.5), 0.2)
    gap = np.hypot(*(places[:, 0] - places[:, 1]).T)
    assert gap == pytest.approx(np.full(len(corners), spacing), abs=1e-6)
    for before, after in pairwise([start, *places]):
        straight = np.hypot(*(after - before).T).sum()
        assert straight <= np.hypot(*(after[::-1] - before).T).sum() + 1e-9


def test_components_touching_at_a_corner_are_one_ridge() -> None:
    presence = np.zeros((10, 10))
    presence[2, 2] = presence[3, 3] = presence[8, 8] = 0.5
    ridges = find_ridges(presence, presence, 0.1, Grid(5.0, 5.0, 0.5))
    assert sorted(len(r.cells) for r in ridges) == [1, 2]
    assert [r.length_m for r in ridges if len(r.cells) == 1] == [0.0]


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40)), min_size=1, max_size=60))
def test_ridge_ends_are_the_farthest_pair(points: list) -> None:
    array = np.array(points, dtype=float)
    ends = farthest_pair(array)
    best = max(float(np.hypot(*(a - b))) for a in array for b in array)
    assert float(np.hypot(*(ends[0] - ends[1]))) == pytest.approx(best)


@pytest.mark.parametrize("count", [1, 3, EXACT_RIDGES, EXACT_RIDGES + 1, 12])
def test_a_tour_visits_every_ridge_once(count: int) -> None:
    ends = np.random.default_rng(count).uniform(0, 20, (count, 2, 2))
    order = ridge_tour(np.zeros(2), ends)
    assert sorted(ridge for ridge, _ in order) == list(range(count))


def test_the_heuristic_tour_is_near_the_exact_one(monkeypatch: pytest.MonkeyPatch) -> None:
    from fieldkit.engine.planning import tour

    rng = np.random.default_rng(0)
    for _ in range(5):
        ends = rng.uniform(0, 20, (5, 2, 2))
        heuristic = off_ridge_m(np.zeros(2), ends, ridge_tour(np.zeros(2), ends))
        exact = off_ridge_m(np.zeros(2), ends, tour._exact(np.zeros(2), ends, closed=False))
        assert exact - 1e-9 <= heuristic <= 1.05 * exact + 0.2
    many = rng.uniform(0, 20, (25, 2, 2))
    order = ridge_tour(np.zeros(2), many)
    assert sorted(index for index, _ in order) == list(range(25))
    assert order == ridge_tour(np.zeros(2), many), "planners that plan apart must agree"


def test_time_on_ridges_matches_the_reference() -> None:
    vectors = json.loads((GOLDEN / "team.json").read_text())["vectors"]
    vector = next(v for v in vectors if v["id"] == "TIME_ALLOC")
    g = vector["inp"]
    times = time_on_ridges_s(np.array(g["wt"]), g["tau0"], g["d_off"], g["v"])
    assert times == pytest.approx(vector["tau"], abs=1e-9)
    assert times.sum() == pytest.approx(vector["t_on"], abs=1e-9)


def plain_entropy(engine, cells, presence, prior, pair, normalised):  # type: ignore[no-untyped-def]
    """Eq 25 and 26 for one place of a pair, cell by cell and level by level, as one writes them from the paper."""
    a = attenuation_db(cells, pair, engine.antenna, engine.grid.cell_m / 2)
    if normalised:
        presence = prior / prior.sum()
    total = 0.0
    for source in range(len(cells)):
        for level in engine.antenna.power_at_1m_dbm + np.array(engine.power_levels_db):
            z = np.floor(level - a[:, source] + 0.5)
            hears = z > engine.antenna.threshold_dbm
            if hears.all():  # before rounding: the difference the readings are most likely to show
                log = log_e11(a[1] - a[0] - (a[1, source] - a[0, source]), engine.antenna.sigma_db)
            elif hears.any():
                p, q = (0, 1) if hears[0] else (1, 0)
                log = log_e10(a[q] - a[p] - (z[p] - engine.antenna.threshold_dbm), engine.antenna.sigma_db)
            post = presence
            if hears.any():
                p1 = np.exp(log) * prior / (np.exp(log) * prior).sum()
                post = p1 if normalised else p1 + presence * (1.0 - p1)
            total -= float((post * np.log(post)).sum())
    return total


@pytest.mark.parametrize("normalised", [False, True])
def test_pairs_spread_as_far_as_leaves_least_entropy(normalised: bool) -> None:
    engine = replace(settings(pairs=1), normalised_entropy=normalised)
    rng = np.random.default_rng(6)
    cells = np.column_stack([rng.uniform(8.0, 14.0, 40), rng.uniform(8.0, 11.0, 40)])
    presence, prior = rng.uniform(0.1, 0.6, 40), rng.uniform(0.001, 0.03, 40)
    centres, across = np.array([[9.0, 9.5], [12.0, 9.5]]), np.array([[0.0, 1.0], [0.0, 1.0]])
    spacings = np.array([0.6, 1.5, 2.5, 4.0, 6.0])
    entropy = [
        sum(
            plain_entropy(
                engine, cells, presence, prior, np.array([c - d * x / 2, c + d * x / 2]), normalised
            )
            for c, x in zip(centres, across, strict=True)
        )
        for d in spacings
    ]
    compiled = spacing_entropies(
        engine, cells, presence, prior, centres, across, spacings, normalised=normalised
    )
    assert compiled == pytest.approx(entropy, rel=1e-5)
    best = best_spacing_m(engine, cells, presence, prior, centres, across, spacings, normalised=normalised)
    assert best == spacings[int(np.argmin(entropy))]


def test_no_time_is_left_when_travel_takes_the_whole_period() -> None:
    assert time_on_ridges_s(np.array([1.0, 2.0]), 10.0, 100.0, 0.4).tolist() == [0.0, 0.0]


def test_clusters_are_as_many_as_asked_and_none_is_empty() -> None:
    ridges = [
        Ridge(np.array([[x, y], [x + 1, y]]), np.array([[x, y]]), np.array([0]), 1.0)
        for x, y in ((0, 0), (1, 1), (20, 20), (21, 20), (0, 20))
    ]
    clusters = cluster_ridges(ridges, 3, np.random.default_rng(0))
    assert sorted(len(c) for c in clusters) == [1, 2, 2]
    assert cluster_ridges([], 0, np.random.default_rng(0)) == []


@pytest.mark.parametrize(("shape", "block"), [((6, 8), 2), ((7, 5), 3), ((4, 4), 1), ((3, 2), 9)])
def test_ground_valued_in_squares_keeps_its_sum(shape: tuple[int, int], block: int) -> None:
    value = np.random.default_rng(0).uniform(0, 1, shape)
    squares = blocks_summed(value, block)
    assert squares.shape == (-(-shape[0] // block), -(-shape[1] // block))
    assert squares.sum() == pytest.approx(value.sum())
    assert squares[0, 0] == pytest.approx(value[:block, :block].sum())
