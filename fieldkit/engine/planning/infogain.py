"""The default planner: each team takes, of many paths, the one from which the belief will learn most.

`search` proposes the paths and betters them where it is given a budget, `reward` values them. Teams are planned one
after another on what the others leave; no path comes nearer to another team than the separation, or leads further than
a robot's battery brings it home from.
"""

from typing import ClassVar

import numpy as np

from fieldkit.engine.belief.base import Belief
from fieldkit.engine.planning.base import InformativeBelief, Planner, Situation, Team, informative, waypoints
from fieldkit.engine.planning.reward import Reward, hearing_of
from fieldkit.engine.planning.search import Departure, Search, Way
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Plan, Waypoint
from fieldkit.tuning import InfogainTuning


class InfoGainPlanner(Planner):
    """See the module."""

    TEAM_BY_TEAM = True
    NAME: ClassVar = "infogain"
    REWARD: ClassVar[type[Reward]] = Reward

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self.grid = settings.grid
        self._tuning = self._table(settings)
        self._rng = np.random.default_rng([settings.seed, 0x1F0])
        self._search = Search(settings, self._tuning, self._rng)
        self._last: dict[tuple[str, ...], Way] = {}
        shortest_m = float(settings.antenna.nominal_range_m(min(settings.power_levels_db)))
        self._block = max(1, int(self._tuning.ground_block * shortest_m / settings.grid.cell_m))
        """Ground is valued in squares of so many cells: finer than that, ranges blur it anyway."""

    @staticmethod
    def _table(settings: EngineSettings) -> InfogainTuning:
        """The planner's own table of the tuning."""
        return settings.tuning.infogain

    def teams(self, stated: tuple[Team, ...]) -> tuple[Team, ...]:
        """Each robot by itself, unless teams are to be kept: two come together where a candidate is worth it."""
        if self.settings.keep_teams:
            return stated
        return tuple((robot,) for team in stated for robot in team)

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """Paths for all teams of the situation. Raises `ConfigError` for a belief that is not informative."""
        informed = informative(belief, self.NAME)
        horizon_s = max(self._tuning.horizon_s, 1.5 * self.settings.planning_period_s)
        reward = self._reward(informed, situation.removed, horizon_s)
        for team, busy in situation.busy.items():
            if all(robot in situation.position_m for robot in team):
                ears = hearing_of(self.settings, team, situation.up_m)
                reward.take(self._search.underway(team, busy, situation, horizon_s), ears)
        paths: dict[str, tuple[Waypoint, ...]] = {}
        purpose: dict[str, str] = {}
        for team in situation.teams:
            departure = Departure.of(team, situation, self._last.get(team), horizon_s)
            start = departure.start_m
            options = self._search.options(departure, reward)
            ears = hearing_of(self.settings, team, situation.up_m)
            rewards = reward.of(options.tracks_m, ears)
            options, rewards = self._search.improved(
                departure, reward, ears, options, rewards, self._tuning.budget
            )
            best = int(np.argmax(rewards)) if rewards.size else -1
            if (
                best < 0 or rewards[best] == -np.inf
            ):  # boxed in by the others, or no battery left for any path: stay
                for robot in team:
                    paths[robot], purpose[robot] = (), "wait"
                reward.take(self._search.standing(start, horizon_s), ears)
                continue
            places = options.places_m[best, : options.legs[best]]
            reward.take(options.tracks_m[best], ears)
            self._last[team] = [tuple(place.mean(axis=0)) for place in places]
            for robot, path in zip(team, waypoints(places, start, self.settings.max_speed_m_s), strict=True):
                paths[robot], purpose[robot] = path, options.purpose[best]
        return Plan(situation.t_ns, paths, purpose)

    def _reward(self, belief: InformativeBelief, removed: frozenset[int], horizon_s: float) -> Reward:
        value = blocks_summed(self._tuning.ground_value * belief.ground_value(), self._block)
        unresolved = [
            each for each in belief.unresolved(self._tuning.samples, self._rng) if each.ident not in removed
        ]
        square_m = self._block * self.grid.cell_m
        return self.REWARD(self.settings, self._tuning, belief.model, value, square_m, horizon_s, unresolved)


def blocks_summed(value: FloatArray, block: int) -> FloatArray:
    """`value` (n_north, n_east) summed over squares of `block` x `block` cells; the last ones may be cut."""
    if block == 1:
        return value
    rows, columns = np.arange(0, value.shape[0], block), np.arange(0, value.shape[1], block)
    return np.asarray(np.add.reduceat(np.add.reduceat(value, rows, axis=0), columns, axis=1))
