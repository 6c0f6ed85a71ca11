"""No planner sends a robot over ground to be kept out of, wherever that lies; and robots get on all the same."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from fieldkit import plugins
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.detour import MOST_CELLS, Detours
from fieldkit.engine.planning.dprwa import DprwaPlanner
from fieldkit.engine.settings import EngineSettings
from fieldkit.geometry.polygons import KeepOut, Polygon
from fieldkit.messages import Plan
from fieldkit.tuning import RidgeTuning
from mission.lab.bench import settings

CLEARANCE_M = RidgeTuning().clearance_m

OTHERS = [name for name in plugins.names("fieldkit.planners") if not name.startswith("infogain")]
WALL = KeepOut((((11.0, -1.0), (12.0, -1.0), (12.0, 20.0), (11.0, 20.0)),))
S = 1_000_000_000


def belief(engine: EngineSettings, rng: np.random.Generator) -> SpogBelief:
    """Three blots of P(C_i), anywhere."""
    presence = np.zeros(engine.grid.shape)
    for row, column in rng.integers(0, np.array(engine.grid.shape) - 4, (3, 2)):
        presence[row : row + 2, column : column + 4] = 0.5
    made = SpogBelief(engine)
    made.log_absent = np.log1p(-presence.ravel())
    made.log_prior = np.log((presence.ravel() + 1e-6) / (presence + 1e-6).sum())
    return made


def places(engine: EngineSettings, rng: np.random.Generator) -> dict[str, tuple[float, float]]:
    """Robots on open ground."""
    size = np.array([engine.grid.size_east_m, engine.grid.size_north_m])
    found: list[np.ndarray] = []
    while len(found) < len(engine.robots):
        point = rng.uniform(0.5, size - 0.5)
        if not engine.keep_out.contains(point[None])[0]:
            found.append(point)
    return {robot: (float(e), float(n)) for robot, (e, n) in zip(engine.robots, found, strict=True)}


def legs(plan: Plan, place: dict[str, tuple[float, float]]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for robot, path in plan.paths.items():
        corners = np.array([place[robot], *((w.east_m, w.north_m) for w in path)])
        yield corners[:-1], corners[1:]


def boxes() -> st.SearchStrategy[Polygon]:
    """Turned rectangles, some across the border."""

    def box(middle: tuple[float, float], half: tuple[float, float], turn: float) -> Polygon:
        along = np.array([np.cos(turn), np.sin(turn)])
        across = np.array([-along[1], along[0]])
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = [np.array(middle) + a * half[0] * along + b * half[1] * across for a, b in signs]
        return tuple((float(e), float(n)) for e, n in corners)

    middle = st.tuples(st.floats(0, 25), st.floats(0, 25))
    return st.builds(box, middle, st.tuples(st.floats(0.3, 6), st.floats(0.3, 3)), st.floats(0, 3))


@pytest.mark.parametrize("planner", OTHERS)
@examples(max_examples=15, deadline=None)
@given(polygons=st.lists(boxes(), min_size=1, max_size=3), seed=st.integers(0, 1000))
def test_no_leg_touches_ground_to_keep_out_of(planner: str, polygons: list[Polygon], seed: int) -> None:
    rng = np.random.default_rng(seed)
    engine = replace(settings(pairs=2), keep_out=KeepOut(tuple(polygons)), seed=seed)
    place = places(engine, rng)
    walk = plugins.load("fieldkit.planners", planner)(engine)
    known = belief(engine, rng)
    for t_ns in (0, 30 * S):  # the second, of a ring, from where the ring does not have it
        plan = walk.plan(Situation(t_ns, place, engine.teams, {}), known)
        assert set(plan.paths) == set(engine.robots)
        for start, end in legs(plan, place):
            assert not engine.keep_out.blocks(start, end).any()
        place = places(engine, rng)


@pytest.mark.parametrize("planner", OTHERS)
def test_robots_come_to_the_other_side_of_a_wall(planner: str) -> None:
    engine = replace(settings(pairs=1), keep_out=WALL, seed=3)
    presence = np.zeros(engine.grid.shape)
    presence[4:6, 36:40] = 0.5
    known = SpogBelief(engine)
    known.log_absent = np.log1p(-presence.ravel())
    place = {"r0": (4.0, 3.0), "r1": (6.0, 3.0)}
    walk = plugins.load("fieldkit.planners", planner)(engine)
    east = []
    for step in range(60):
        plan = walk.plan(Situation(step * 40 * S, place, engine.teams, {}), known)
        for start, end in legs(plan, place):
            assert not WALL.blocks(start, end).any()
            east.extend(end[:, 0])
        place |= {r: (path[-1].east_m, path[-1].north_m) for r, path in plan.paths.items() if path}
    assert max(east) > 14.0


def test_a_fence_polygon_is_kept_by_every_planner() -> None:
    fence = (
        (1.0, 1.0),
        (24.0, 1.0),
        (24.0, 24.0),
        (13.0, 24.0),
        (13.0, 8.0),
        (9.0, 8.0),
        (9.0, 24.0),
        (1.0, 24.0),
    )
    engine = replace(settings(pairs=1), keep_out=KeepOut(fence=fence))
    place = {"r0": (4.0, 20.0), "r1": (5.5, 20.0)}
    for planner in OTHERS:
        walk = plugins.load("fieldkit.planners", planner)(engine)
        plan = walk.plan(Situation(0, place, engine.teams, {}), belief(engine, np.random.default_rng(1)))
        assert any(plan.paths.values()), planner
        for start, end in legs(plan, place):
            assert not engine.keep_out.blocks(start, end).any(), planner


@pytest.mark.parametrize("planner", OTHERS)
def test_a_robot_on_closed_ground_leaves_it_first_and_its_partner_goes(planner: str) -> None:
    """As when an area is closed over the place where a robot stands."""
    box = KeepOut((((3.0, 2.0), (5.0, 2.0), (5.0, 4.0), (3.0, 4.0)),))
    engine = replace(settings(pairs=1), keep_out=box)
    place = {"r0": (4.0, 3.0), "r1": (8.0, 3.0)}
    walk = plugins.load("fieldkit.planners", planner)(engine)
    plan = walk.plan(Situation(0, place, engine.teams, {}), belief(engine, np.random.default_rng(2)))
    first, *onward = [(w.east_m, w.north_m) for w in plan.paths["r0"]]
    assert first == pytest.approx((4.0, 2.0), abs=1e-5), "by the shortest way"
    corners = np.array([first, *onward])
    assert not box.blocks(corners[:-1], corners[1:]).any()
    assert plan.paths["r1"] != ()


@pytest.mark.parametrize("planner", OTHERS)
def test_where_no_ground_is_free_all_stay(planner: str) -> None:
    engine = replace(
        settings(pairs=1), keep_out=KeepOut((((-1.0, -1.0), (30.0, -1.0), (30.0, 30.0), (-1.0, 30.0)),))
    )
    walk = plugins.load("fieldkit.planners", planner)(engine)
    place = {"r0": (4.0, 3.0), "r1": (8.0, 3.0)}
    plan = walk.plan(Situation(0, place, engine.teams, {}), belief(engine, np.random.default_rng(2)))
    assert plan.paths == {"r0": (), "r1": ()}


def test_the_ring_leads_round_and_its_lap_counts_the_detour() -> None:
    engine = settings(pairs=2)
    known = belief(engine, np.random.default_rng(5))
    here = [np.array([[2.0, 2.0], [4.0, 2.0]]), np.array([[2.0, 5.0], [4.0, 5.0]])]
    (_, free), *_ = DprwaPlanner(engine, tau0_s=1.0).periods(here, known)
    (_, walled), *_ = DprwaPlanner(replace(engine, keep_out=WALL), tau0_s=1.0).periods(here, known)
    assert walled.duration_s > free.duration_s


def test_large_fields_are_walked_on_larger_cells() -> None:
    detours = Detours(
        Grid(500.0, 500.0, 0.5),
        KeepOut((((200.0, -1.0), (210.0, -1.0), (210.0, 400.0), (200.0, 400.0)),)),
        0.0,
        CLEARANCE_M,
    )
    assert detours.grid.n_cells <= 1.1 * MOST_CELLS
    way = detours.way(np.array([100.0, 50.0]), np.array([300.0, 50.0]))
    assert way is not None
    corners = np.concatenate([[[100.0, 50.0]], way])
    assert not detours.keep_out.blocks(corners[:-1], corners[1:]).any()
    shortest = 2.0 * np.hypot(100.0, 350.0)
    assert np.hypot(*np.diff(corners, axis=0).T).sum() < 1.05 * shortest


def test_ways_keep_off_the_shore_where_there_is_room_and_go_through_gaps_where_there_is_none() -> None:
    pond = KeepOut((((8.0, 8.0), (14.0, 8.0), (14.0, 12.0), (8.0, 12.0)),))
    start, end = np.array([5.0, 10.0]), np.array([18.0, 10.0])
    way = Detours(Grid(25.0, 25.0, 0.5), pond, 0.0, CLEARANCE_M).way(start, end)
    assert way is not None
    corners = np.concatenate([start[None], way])
    assert pond.distance_m(corners[:-1], corners[1:]).min() >= CLEARANCE_M - 1e-6
    gap = KeepOut(
        (
            ((10.0, -1.0), (11.0, -1.0), (11.0, 9.8), (10.0, 9.8)),
            ((10.0, 10.1), (11.0, 10.1), (11.0, 26.0), (10.0, 26.0)),
        )
    )
    through = Detours(Grid(15.0, 15.0, 0.2), gap, 0.0, CLEARANCE_M).way(
        np.array([5.0, 3.0]), np.array([14.0, 10.0])
    )
    assert through is not None
    corners = np.concatenate([[[5.0, 3.0]], through])
    assert not gap.blocks(corners[:-1], corners[1:]).any()
    near = np.array([7.9, 10.0])  # a goal nearer to the shore than that is driven to all the same
    straight = Detours(Grid(25.0, 25.0, 0.5), pond, 0.0, CLEARANCE_M).way(start, near)
    assert straight is not None and straight[-1].tolist() == near.tolist()
