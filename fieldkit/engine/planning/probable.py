"""Motion towards the most probable source (CSMA-PF section IV.A); every robot goes there on its own."""

import numpy as np

from fieldkit.engine.belief.base import Belief
from fieldkit.engine.planning.base import Planner, PointingBelief, Situation
from fieldkit.engine.planning.steering import Steering
from fieldkit.engine.planning.walks import random_corners, typical_range_m
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Plan, Waypoint


class ProbablePlanner(Planner):
    """Takes the peak of P(C_i) for any other belief; walks at random where nothing stands out."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self._rng = np.random.default_rng([settings.seed, 0x9B0])
        self._steering = Steering(settings)

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """One stretch towards the most probable place, as far as a robot gets in a planning period."""
        goal = self._goal(belief)
        if goal is not None:
            goal = self._steering.allowed(goal)
        paths: dict[str, tuple[Waypoint, ...]] = {}
        purpose: dict[str, str] = {}
        for team in situation.teams:
            start = np.array([situation.position_m[robot] for robot in team])
            corners = np.empty((0, 2)) if goal is None else self._towards(goal, start.mean(axis=0))
            why = "probable" if len(corners) else "walk"
            if not len(corners):
                corners = random_corners(self.settings, start.mean(axis=0), self._rng)
            paths |= self._steering.steer(team, start, corners, typical_range_m(self.settings))
            purpose |= dict.fromkeys(team, why)
        return Plan(situation.t_ns, paths, purpose)

    def _towards(self, goal_m: FloatArray, here_m: FloatArray) -> FloatArray:
        """(k, 2) corners of one period's way; none where no way leads there."""
        if np.hypot(*(goal_m - here_m)) < self.settings.grid.cell_m:
            # There: look round it instead of standing on it.
            return here_m + self._rng.normal(0.0, 2.0 * self.settings.grid.cell_m, (2, 2))
        return self._steering.within(
            here_m, goal_m, self.settings.max_speed_m_s * self.settings.planning_period_s
        )

    def _goal(self, belief: Belief) -> FloatArray | None:
        if isinstance(belief, PointingBelief):
            place = belief.most_probable()
            return None if place is None else np.array(place)
        presence = np.array(belief.presence())
        if presence.max() <= 1.001 * presence.min() or presence.max() < 1e-6:
            return None
        row, column = np.unravel_index(int(np.argmax(presence)), presence.shape)
        return np.array([self.settings.grid.east_m[column], self.settings.grid.north_m[row]])
