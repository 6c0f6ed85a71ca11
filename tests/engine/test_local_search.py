"""Local search betters the best paths by moving their corners, within what robots may do and a number of paths."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.infogain import InfoGainPlanner
from fieldkit.engine.planning.reward import Reward
from fieldkit.engine.planning.search import BATCH, Departure, Options, Search
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray
from mission.lab.bench import settings

HORIZON_S = 45.0
EARS = np.array([[0.0, 1.0, 0.0]] * 2)
TEAM = ("r0", "r1")
PLACE = {"r0": (6.0, 6.0), "r1": (7.2, 6.0)}


class Counting(Reward):
    """Counts the paths it values."""

    valued = 0

    def of(self, tracks_m: FloatArray, ears: FloatArray) -> FloatArray:
        """As a reward's."""
        self.valued += len(tracks_m)
        return super().of(tracks_m, ears)


def searched(
    engine: EngineSettings, budget: int, **limits: object
) -> tuple[Options, FloatArray, FloatArray, int]:
    """Paths after local search with their rewards, the first ones' rewards, and how many more were valued."""
    tuning = engine.tuning.infogain
    belief = IntensityBelief(engine)
    reward = Counting(engine, tuning, belief.model, belief.ground_value(), 0.5, HORIZON_S, [])
    search = Search(engine, tuning, np.random.default_rng(3))
    departure = Departure.of(TEAM, Situation(0, PLACE, (TEAM,), {}, **limits), None, HORIZON_S)  # type: ignore[arg-type]
    options = search.options(departure, reward)
    first = reward.of(options.tracks_m, EARS)
    before = reward.valued
    options, rewards = search.improved(departure, reward, EARS, options, first, budget)
    return options, rewards, first, reward.valued - before


def test_it_finds_better_paths_and_values_no_more_than_its_budget() -> None:
    engine = settings(pairs=1, sensing="levels")
    best = []
    for budget in (1, BATCH, 2 * BATCH + 5, 200):
        options, rewards, first, valued = searched(engine, budget)
        assert valued == budget
        assert rewards.max() >= first.max()
        assert len(options.ways) == len(options.purpose) == len(options.places_m) == len(rewards)
        best.append(rewards.max() / first.max())
    assert best[-1] > 1.03


def test_no_budget_leaves_the_first_choice() -> None:
    engine = settings(pairs=1, sensing="levels")
    options, rewards, first, valued = searched(engine, 0)
    assert valued == 0 and (rewards == first).all() and len(options.ways) == len(first)
    with pytest.raises(ValueError, match=r"tuning.infogain.budget: expected a number from 0 to .*, got -1"):
        engine.tuning.with_tables({"infogain": {"budget": -1}})


def test_moved_paths_keep_to_fence_and_battery() -> None:
    engine = replace(settings(pairs=1, sensing="levels"), fence_margin_m=0.4)
    home = {"r0": (6.0, 5.0), "r1": (7.0, 5.0)}
    options, _, _, _ = searched(engine, 100, range_m={"r0": 9.0, "r1": 30.0}, home_m=home)
    for places, legs in zip(options.places_m, options.legs, strict=True):
        assert (places[:legs] >= 0.4 - 1e-9).all() and (places[:legs] <= 24.6 + 1e-9).all()
        corners = np.array([PLACE["r0"], *places[:legs, 0]])
        gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        assert (gone + np.hypot(*(corners - home["r0"]).T)).max() <= 9.0 + 1e-9


def test_plans_with_local_search_repeat_themselves() -> None:
    engine = settings(pairs=1, sensing="levels")
    engine = replace(engine, tuning=engine.tuning.with_tables({"infogain": {"budget": 40}}))
    at = Situation(0, PLACE, (TEAM,), {})
    plans = [InfoGainPlanner(engine).plan(at, IntensityBelief(engine)) for _ in range(2)]
    without = replace(engine, tuning=engine.tuning.with_tables({"infogain": {"budget": 0}}))
    assert plans[0] == plans[1] != InfoGainPlanner(without).plan(at, IntensityBelief(without))
