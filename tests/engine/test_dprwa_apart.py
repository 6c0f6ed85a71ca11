"""DPRWA apart: robots that know different things of the present plan the same next ring, and meet on it (Lemma 2)."""

import math

import numpy as np
import pytest

from fieldkit import plugins
from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.dprwa import DprwaPlanner
from fieldkit.engine.planning.dprwa_apart import DprwaApartPlanner, Team
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Plan

GRID = Grid(25.0, 25.0, 0.5)
S = 10**9


def settings(pairs: int) -> EngineSettings:
    teams = tuple((f"t{t}a", f"t{t}b") for t in range(pairs))
    return EngineSettings(GRID, Antenna(2.53, -76.4, 3.3, -90.0), teams, (0.0,), prior_rule="dirichlet")


def belief(engine: EngineSettings, *places: tuple[float, float]) -> SpogBelief:
    """P = 0.95 in one cell at each place."""
    made = SpogBelief(engine)
    for place in places:
        row, column = GRID.cell_of(*place)
        made.log_absent[row * GRID.n_east + column] = np.log(0.05)
        made.log_prior[row * GRID.n_east + column] = np.log(0.2)
    return made


def place(engine: EngineSettings, north_m: float = 1.0) -> dict[str, tuple[float, float]]:
    return {robot: (2.0 + 1.6 * k, north_m) for k, robot in enumerate(engine.robots)}


def ask(
    planner: DprwaPlanner,
    t_s: float,
    *places: tuple[float, float],
    north_m: float = 1.0,
    due: int | None = None,
) -> Plan:
    """A plan at that time for the first `due` teams, the others under way, of a belief with sources there."""
    engine = planner.settings
    teams = engine.teams if due is None else engine.teams[:due]
    busy = {team: Plan(0, {}) for team in engine.teams if team not in teams}
    situation = Situation(round(t_s * S), place(engine, north_m), teams, busy)
    return planner.plan(situation, belief(engine, *places))


def side(pairs: int, *now: tuple[float, float], north_m: float) -> DprwaApartPlanner:
    """A planner into its second ring, by a side that by then knows sources at `now` and robots at `north_m`."""
    planner = DprwaApartPlanner(settings(pairs))
    ask(planner, 0.0, (10.0, 10.0))
    ask(planner, planner.ring_ns / S, (10.0, 10.0), (20.0, 5.0))
    ask(planner, planner.until_ns / S, (10.0, 10.0), *now, north_m=north_m)
    return planner


@pytest.mark.parametrize("pairs", [2, 3])
def test_sides_that_know_other_things_by_now_plan_the_same_next_ring(pairs: int) -> None:
    one, other = side(pairs, (3.0, 22.0), north_m=2.0), side(pairs, (22.0, 22.0), (8.0, 3.0), north_m=9.0)
    assert one.period == other.period == 2
    assert (one.ring_ns, one.until_ns, one.meetings_ns) == (other.ring_ns, other.until_ns, other.meetings_ns)
    for robot, (t_ns, at) in one._ways.items():
        assert (t_ns == other._ways[robot][0]).all() and (at == other._ways[robot][1]).all()


def test_where_one_computer_decides_the_next_ring_is_of_what_is_known_then() -> None:
    """The same two sides with `dprwa`: why robots apart need their own planner."""
    rings = []
    for now, north_m in (((3.0, 22.0), 2.0), ((22.0, 22.0), 9.0)):
        planner = DprwaPlanner(settings(2))
        ask(planner, 0.0, (10.0, 10.0))
        ask(planner, planner._until_ns / S, (10.0, 10.0), now, north_m=north_m)
        rings.append(planner._until_ns)
    assert rings[0] != rings[1]


def at(planner: DprwaApartPlanner, team: Team, t_ns: int) -> np.ndarray:
    """Where the middle of a team is by plan."""
    ways = [planner._ways[robot] for robot in team]
    middle = np.mean([[np.interp(t_ns, t, where[:, k]) for k in range(2)] for t, where in ways], axis=0)
    return np.asarray(middle)


@pytest.mark.parametrize("pairs", [2, 3, 4, 5, 6])
def test_who_meets_by_the_ring_has_a_checkpoint_of_its_beginning_when_the_next_is_planned(pairs: int) -> None:
    """Lemma 2, with the rings that the planner makes: both are at one place, and news go round before it ends."""
    planner = side(pairs, north_m=1.0)
    teams = planner.settings.teams
    knows_ns = {team: dict.fromkeys(teams, -math.inf) | {team: planner.ring_ns} for team in teams}
    assert planner.meetings_ns
    for t_ns, first, second in sorted(planner.meetings_ns):
        assert planner.ring_ns < t_ns <= planner.until_ns
        assert at(planner, first, t_ns) == pytest.approx(at(planner, second, t_ns), abs=1e-6)
        knows_ns[first][first] = knows_ns[second][second] = t_ns
        both = {team: max(knows_ns[first][team], knows_ns[second][team]) for team in teams}
        knows_ns[first], knows_ns[second] = dict(both), dict(both)
    assert min(min(known.values()) for known in knows_ns.values()) >= planner.ring_ns


def test_before_the_ring_it_goes_to_its_beginning_and_then_along_it() -> None:
    planner = DprwaApartPlanner(settings(2))
    first = ask(planner, 0.0)
    assert {len(path) for path in first.paths.values()} == {1}
    assert ask(planner, planner.ring_ns / S - 1.0, due=1).paths.keys() == set(planner.settings.teams[0])
    assert planner.kept is None
    later = ask(planner, planner.ring_ns / S, due=1)
    assert planner.kept is not None and planner.kept.teams == planner.settings.teams
    assert min(len(path) for path in later.paths.values()) > 3
    assert {(p.east_m, p.north_m) for p in later.paths["t0a"]} <= {
        tuple(p) for p in planner._ways["t0a"][1].tolist()
    }


def test_a_next_ring_begins_by_the_clock_though_somebody_is_still_under_way() -> None:
    planner = DprwaApartPlanner(settings(2))
    ask(planner, 0.0)
    ask(planner, planner.ring_ns / S)
    until_ns = planner.until_ns
    ask(planner, until_ns / S + 3.0, due=1)
    assert planner.period == 2 and planner._ways["t1a"][0][0] == until_ns
    ask(planner, until_ns / S + 3_600.0, due=1)
    assert planner.until_ns > until_ns + 3_600 * S, "after a long hold the ring's time has gone on"


def test_who_comes_late_waits_for_the_next_ring_but_not_for_the_first() -> None:
    planner = DprwaApartPlanner(settings(2))
    here = place(planner.settings)
    for t_s, teams in ((0.0, 1), (1.0, 2)):
        planner.plan(
            Situation(round(t_s * S), here, planner.settings.teams[:teams], {}), belief(planner.settings)
        )
    assert planner._ways.keys() == set(planner.settings.robots)

    planner = DprwaApartPlanner(settings(2))
    first = planner.settings.teams[:1]
    for t_ns in (0, planner.ring_ns + 100 * S):
        planner.plan(Situation(t_ns, here, first, {}), belief(planner.settings))
    late = ask(planner, 101.0)
    assert late.paths["t1a"] == () and late.purpose["t1b"] == "wait" and late.paths["t0a"]
    ask(planner, planner.until_ns / S)
    assert planner._ways.keys() == set(first[0]), "it was not there when the ring began"
    ask(planner, planner.ring_ns / S)
    ask(planner, planner.until_ns / S)
    assert planner._ways.keys() == set(planner.settings.robots)


def test_nobody_needs_no_ring_and_it_is_found_by_its_name() -> None:
    engine = settings(2)
    assert ask(DprwaApartPlanner(engine), 0.0, due=0).paths == {}
    assert isinstance(plugins.load("fieldkit.planners", "dprwa-apart")(engine), DprwaApartPlanner)
