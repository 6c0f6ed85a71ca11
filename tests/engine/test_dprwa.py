"""DPRWA's plan: one ring for all pairs, from which pairs that plan apart deduce the same."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit import plugins
from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.decentralised.ring import ring_time_s
from fieldkit.engine.decentralised.tracks import TrackAssociator
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.circle import make_circle, plan_period
from fieldkit.engine.planning.dprwa import DprwaPlanner, dispatch, group_ridges, virtual_ridges
from fieldkit.engine.planning.ridges import Ridge
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from fieldkit.messages import Pose, RssReading

GRID = Grid(25.0, 25.0, 0.5)
SPEED = 0.4


def settings(*sizes: int) -> EngineSettings:
    teams = tuple(tuple(f"t{t}r{k}" for k in range(size)) for t, size in enumerate(sizes))
    return EngineSettings(GRID, Antenna(2.53, -76.4, 3.3, -90.0), teams, (0.0,), prior_rule="dirichlet")


def belief(engine: EngineSettings, *places: tuple[float, float]) -> SpogBelief:
    """P = 0.95 in one cell at each place."""
    made = SpogBelief(engine)
    for place in places:
        row, column = GRID.cell_of(*place)
        made.log_absent[row * GRID.n_east + column] = np.log(0.05)
        made.log_prior[row * GRID.n_east + column] = np.log(0.2)
    return made


def start(engine: EngineSettings) -> list[np.ndarray]:
    return [
        np.array([(2.0 + 3.0 * t + k, 1.0) for k in range(len(team))]) for t, team in enumerate(engine.teams)
    ]


def square(spare: float = 200.0, sizes: tuple[int, ...] = (2,)):  # type: ignore[no-untyped-def]
    corners = np.array([[5.0, 5.0], [5.0, 20.0], [20.0, 20.0], [20.0, 5.0]])
    return make_circle(corners, np.array([3.0, 0.0, 1.0, 0.0]), spare, SPEED, 2.0, set(sizes), GRID, 0.2)


@pytest.mark.parametrize("sizes", [(2,), (1,), (1, 2), (3,)])
def test_a_lap_leads_back_and_no_robot_is_ever_too_fast(sizes: tuple[int, ...]) -> None:
    circle = square(sizes=sizes)
    for size in sizes:
        phi = np.linspace(-1.5 * circle.tau_s, 2.5 * circle.tau_s, 20_000)
        place = np.array([circle.at(float(p), size) for p in phi])
        step = np.hypot(*np.moveaxis(np.diff(place, axis=0), -1, 0))
        assert step.max() <= SPEED * (phi[1] - phi[0]) * 1.001
        lap = np.array([circle.at(float(p) + circle.tau_s, size) for p in phi[:200]])
        assert np.sort(lap, axis=1) == pytest.approx(np.sort(place[:200], axis=1), abs=1e-6)


def test_what_is_left_of_the_circumference_goes_to_the_ridges_by_weight() -> None:
    tight, wide = square(0.0), square(1000.0)
    assert wide.tau_s == pytest.approx(1000.0)
    spare = np.diff(wide.t_s) - np.diff(tight.t_s)
    assert spare == pytest.approx((1000.0 - tight.tau_s) * np.array([0.75, 0.0, 0.25, 0.0]))


@pytest.mark.parametrize("pairs", [1, 2, 3, 4, 5])
def test_pairs_that_meet_are_at_one_place_and_have_never_jumped(pairs: int) -> None:
    circle = square(300.0)
    here = [np.array([[1.0 + 3 * k, 1.0], [2.0 + 3 * k, 1.0]]) for k in range(pairs)]
    period = plan_period(circle, here, SPEED)
    assert period.duration_s == pytest.approx(period.ring_start_s + ring_time_s(pairs, circle.tau_s))
    assert len(period.meetings) >= (pairs > 1)
    for team in range(pairs):
        t, place = period.t_s[team], period.place_m[team]
        assert (np.diff(t) >= -1e-9).all() and t[-1] == pytest.approx(period.duration_s)
        way = np.hypot(*np.moveaxis(np.diff(place, axis=0), -1, 0)).max(axis=1)
        assert (way <= SPEED * np.diff(t) + 1e-6).all()
    for meeting in period.meetings:
        at = [
            [np.interp(period.ring_start_s + meeting.t_s, period.t_s[p], period.place_m[p][:, :, axis].mean(axis=1))
             for axis in range(2)]
            for p in (meeting.first, meeting.second)
        ]  # fmt: skip
        assert at[0] == pytest.approx(at[1], abs=1e-6)


def test_pairs_that_plan_apart_plan_the_same_and_each_period_anew() -> None:
    engine = settings(2, 2, 2)
    one, other = DprwaPlanner(engine), DprwaPlanner(engine)
    first = one.periods(start(engine), belief(engine, (10.0, 10.0)))[0][1]
    same = other.periods(start(engine), belief(engine, (10.0, 10.0)))[0][1]
    assert all((a == b).all() for a, b in zip(first.place_m, same.place_m, strict=True))
    second = one.periods(start(engine), belief(engine, (10.0, 10.0)))[0][1]
    assert first.duration_s != second.duration_s, "virtual ridges must be laid anew"
    elsewhere = DprwaPlanner(replace(engine, seed=9)).periods(start(engine), belief(engine, (10.0, 10.0)))[0][
        1
    ]
    assert elsewhere.duration_s != first.duration_s


@pytest.mark.parametrize("sizes", [(2, 2, 2), (2, 1), (1,), (3, 2), (2,) * 8])
@pytest.mark.parametrize("places", [(), ((10.0, 10.0),), ((0.3, 0.3), (24.8, 24.8))])
@pytest.mark.parametrize("ridges", [1, 12])
def test_any_team_and_any_belief_give_paths_inside_the_field(
    sizes: tuple[int, ...], places: tuple[tuple[float, float], ...], ridges: int
) -> None:
    engine = settings(*sizes)
    position = {
        r: (float(e), float(n))
        for team, at in zip(engine.teams, start(engine), strict=True)
        for r, (e, n) in zip(team, at, strict=True)
    }
    plan = DprwaPlanner(engine, ridges=ridges).plan(
        Situation(0, position, engine.teams, {}), belief(engine, *places)
    )
    assert set(plan.paths) == set(engine.robots)
    for path in plan.paths.values():
        assert path
        for point in path:
            assert 0.0 <= point.east_m <= 25.0 and 0.0 <= point.north_m <= 25.0
            assert 0.0 < point.speed_m_s <= engine.max_speed_m_s


def test_a_ring_needs_a_ridge_and_nobody_needs_no_ring() -> None:
    with pytest.raises(ConfigError, match="at least 1 ridge"):
        DprwaPlanner(settings(2), ridges=0)
    with pytest.raises(ConfigError, match="tau0_s"):
        DprwaPlanner(settings(2), tau0_s=0.0)
    engine = settings(2)
    assert DprwaPlanner(engine).plan(Situation(0, {}, (), {}), belief(engine)).paths == {}
    assert isinstance(plugins.load("fieldkit.planners", "dprwa")(engine), DprwaPlanner)
    with pytest.raises(ValueError, match="at least 2"):
        make_circle(np.zeros((1, 2)), np.zeros(1), 1.0, SPEED, 1.0, {2}, GRID, 0.2)


def ridge(east: float, weight: float) -> Ridge:
    return Ridge(np.array([[east, 5.0], [east, 6.0]]), np.zeros((1, 2)), np.zeros(1, dtype=np.intp), weight)


def test_sparse_ridges_are_split_and_pairs_sent_by_weight() -> None:
    ridges = [ridge(1.0, 1.0), ridge(3.0, 1.0), ridge(20.0, 6.0)]
    assert group_ridges(ridges, 6.0, 4) == [[0, 1], [2]]
    assert group_ridges(ridges, 1.0, 4) == [[0], [1], [2]]
    assert group_ridges(ridges, 1.0, 2) == [[0, 1], [2]], "more groups than pairs: the nearest are merged"
    assert group_ridges(ridges, np.inf, 4) == [[0, 1, 2]]
    assert dispatch(np.array([2.0, 6.0]), 4) == [1, 3]
    assert dispatch(np.array([0.0, 1.0]), 4) == [1, 3], "no group goes without"
    assert dispatch(np.zeros(2), 3) in ([1, 2], [2, 1])
    with pytest.raises(ValueError, match="merge groups"):
        dispatch(np.ones(3), 2)
    engine = settings(2, 2, 2, 2)
    planner = DprwaPlanner(replace(engine, group_gap_m=6.0))
    groups = planner.periods(start(engine), belief(engine, (2.0, 2.0), (23.0, 23.0)))
    assert sorted(team for members, _ in groups for team in members) == [0, 1, 2, 3]
    assert len(groups) == 2


def test_virtual_ridges_lie_all_over_the_field() -> None:
    engine = settings(2)
    ridges = virtual_ridges(engine, np.full(GRID.shape, 1 / GRID.n_cells), 400, np.random.default_rng(0))
    middles = np.array([r.middle_m for r in ridges])
    assert np.histogram2d(*middles.T, bins=4, range=[[0, 25], [0, 25]])[0].min() >= 8
    assert all(r.length_m > 0.0 and r.weight > 0.0 for r in ridges)


def test_a_transmission_waits_until_every_robots_place_is_known() -> None:
    tracks = TrackAssociator(("a", "b"))
    for t, east in ((0, 0.0), (100, 10.0)):
        tracks.pose(Pose(t, "a", east, 0.0))
    tracks.pose(Pose(0, "b", 5.0, 5.0))
    tracks.reading(RssReading(50, "a", -70.0))
    assert tracks.advance(100)[0] == [], "nobody knows yet where b was"
    tracks.pose(Pose(200, "b", 5.0, 25.0))
    (detection,) = tracks.advance(100)[0]
    assert detection.position_m.tolist() == [[5.0, 0.0], [5.0, 10.0]]
    assert detection.heard.tolist() == [True, False]


def test_asked_again_within_a_period_it_goes_on_with_its_ring() -> None:
    engine = settings(2, 2)
    position = {
        r: (float(e), float(n))
        for team, at in zip(engine.teams, start(engine), strict=True)
        for r, (e, n) in zip(team, at, strict=True)
    }
    planner, sure = DprwaPlanner(engine), belief(engine, (10.0, 10.0))
    first = planner.plan(Situation(0, position, engine.teams, {}), sure)
    later = planner.plan(Situation(60 * 10**9, position, engine.teams, {}), sure)
    assert planner.period == 1
    for robot, path in later.paths.items():
        ahead = [(p.east_m, p.north_m) for p in first.paths[robot]]
        assert [(p.east_m, p.north_m) for p in path] == ahead[len(ahead) - len(path) :]
    end = 3000 * 10**9
    waiting = planner.plan(Situation(end, position, engine.teams[:1], {engine.teams[1]: first}), sure)
    assert set(waiting.paths.values()) == {()}, "it waits for the pair that is still on its way"
    planner.plan(Situation(end, position, engine.teams, {}), sure)
    assert planner.period == 2
