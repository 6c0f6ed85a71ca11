"""Ridge walking in pairs: how many walk ridges, and what becomes of beliefs and teams out of the ordinary."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.dprwa import DprwaPlanner
from fieldkit.engine.planning.prwa import PrwaPlanner
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Plan
from fieldkit.tuning import RidgeTuning
from mission.lab.bench import random_detection, settings

TEAMS = (("a", "b"), ("c", "d"), ("e",))
"""An odd number of robots: the last goes alone."""


def engine(**changes: object) -> EngineSettings:
    return replace(settings(), teams=TEAMS, **changes)  # type: ignore[arg-type]


def belief(made: EngineSettings, *blots: tuple[int, int, int, int]) -> SpogBelief:
    """P(C_i) = 0.5 in rows r0:r1, columns c0:c1 of each blot, and hardly anything elsewhere."""
    presence = np.full(made.grid.shape, 1e-6)
    for r0, r1, c0, c1 in blots:
        presence[r0:r1, c0:c1] = 0.5
    known = SpogBelief(made)
    known.log_absent = np.log1p(-presence.ravel())
    known.log_prior = np.log(presence.ravel() / presence.sum())
    return known


def plan(made: EngineSettings, known: SpogBelief, planner: type = PrwaPlanner) -> Plan:
    place = {r: (3.0 + 3.0 * k, 3.0 + (k % 2)) for k, r in enumerate(made.robots)}
    return planner(made).plan(Situation(0, place, made.teams, {}), known)


def corners(result: Plan, robot: str) -> np.ndarray:
    return np.array([(w.east_m, w.north_m) for w in result.paths[robot]])


def walks_ridges(result: Plan, made: EngineSettings) -> int:
    return sum(result.purpose[team[0]] == "ridge" for team in made.teams)


@pytest.mark.parametrize(
    ("blots", "walking"),
    [
        ((), 0),  # an empty level set: all walk at random
        (((10, 12, 10, 16),), 1),  # more pairs than ridges
        (((10, 12, 10, 16), (40, 42, 40, 46)), 2),
        (((10, 12, 10, 16), (40, 42, 40, 46), (5, 6, 40, 44)), 3),
        (((10, 12, 10, 16), (40, 42, 40, 46), (5, 6, 40, 44), (30, 31, 5, 9), (20, 21, 30, 34)), 3),
    ],
)
def test_as_many_teams_walk_ridges_as_there_are_components(
    blots: tuple[tuple[int, int, int, int], ...], walking: int
) -> None:
    made = engine()
    result = plan(made, belief(made, *blots))
    assert walks_ridges(result, made) == walking
    assert all(result.paths.values()), "the others walk at random"


def test_a_fresh_belief_has_no_level_set_and_one_transmission_may_make_one() -> None:
    made = engine()
    known = SpogBelief(made)
    assert known.presence().max() < RidgeTuning().prwa_level
    assert walks_ridges(plan(made, known), made) == 0
    for seed in range(12):
        known.detect(random_detection(made, np.random.default_rng(seed), 4))
    assert known.presence().max() > RidgeTuning().prwa_level
    assert walks_ridges(plan(made, known), made) >= 1


def test_all_cells_in_one_component_are_one_ridge_from_corner_to_corner() -> None:
    made = engine()
    result = plan(made, belief(made, (0, 50, 0, 50)))
    assert walks_ridges(result, made) == 1
    team = next(team for team in made.teams if result.purpose[team[0]] == "ridge")
    way = np.mean([corners(result, robot) for robot in team], axis=0)
    assert np.hypot(*(way.max(axis=0) - way.min(axis=0))) > 0.8 * np.hypot(25.0, 25.0)


@pytest.mark.parametrize("planner", [PrwaPlanner, DprwaPlanner])
@pytest.mark.parametrize("cell", [(0, 0), (0, 49), (49, 0), (49, 49), (0, 25)])
def test_a_source_on_the_border_is_a_ridge_without_length_that_robots_come_to(
    planner: type, cell: tuple[int, int]
) -> None:
    made = engine(fence_margin_m=0.3)
    row, column = cell
    result = plan(made, belief(made, (row, row + 1, column, column + 1)), planner)
    source = np.array([made.grid.east_m[column], made.grid.north_m[row]])
    nearest = min(np.hypot(*(corners(result, robot) - source).T).min() for robot in made.robots)
    assert nearest < 3.0
    for path in result.paths.values():
        for waypoint in path:
            assert 0.3 - 1e-9 <= waypoint.east_m <= 24.7 + 1e-9
            assert 0.3 - 1e-9 <= waypoint.north_m <= 24.7 + 1e-9
            assert 0.0 < waypoint.speed_m_s <= made.max_speed_m_s


def test_the_heavier_of_two_ridges_is_swept_longer() -> None:
    made = replace(settings(pairs=1), planning_period_s=200.0)
    known = belief(made, (10, 11, 10, 16), (30, 31, 10, 16))
    weight = np.exp(known.log_prior).reshape(made.grid.shape)
    weight[10] *= 6.0
    known.log_prior = np.log(weight.ravel() / weight.sum())
    result = PrwaPlanner(made).plan(Situation(0, {"r0": (5.0, 9.0), "r1": (6.0, 9.0)}, made.teams, {}), known)
    north = np.mean([corners(result, robot) for robot in ("r0", "r1")], axis=0)[:, 1]
    assert (north < 10.0).sum() > (north > 10.0).sum() > 0


@pytest.mark.parametrize("planner", [PrwaPlanner, DprwaPlanner])
def test_one_robot_is_a_team_of_one(planner: type) -> None:
    made = replace(settings(sensing="levels"), teams=(("a",),))
    result = plan(made, belief(made, (20, 22, 20, 26)), planner)
    assert len(result.paths["a"]) > 0
    assert np.hypot(*(corners(result, "a") - (11.5, 10.5)).T).min() < 3.0


@pytest.mark.parametrize("planner", [PrwaPlanner, DprwaPlanner])
def test_nobody_to_plan_for_is_an_empty_plan(planner: type) -> None:
    made = engine()
    assert planner(made).plan(Situation(0, {}, (), {}), belief(made)).paths == {}
