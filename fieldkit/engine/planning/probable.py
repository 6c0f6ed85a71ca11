"""Motion towards the most probable source (CSMA-PF section IV.A); every robot goes there on its own."""

import numpy as np

from fieldkit.engine.belief.base import Belief
from fieldkit.engine.belief.csma import CsmaBelief
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.walks import random_corners, steer, typical_range_m
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Plan, Waypoint


class ProbablePlanner:
    """Takes the peak of P(C_i) for any other belief; walks at random where nothing stands out."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self._rng = np.random.default_rng([settings.seed, 0x9B0])

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """One stretch towards the most probable place, as far as a robot gets in a planning period."""
        place = self._goal(belief)
        paths: dict[str, tuple[Waypoint, ...]] = {}
        reach = self.settings.max_speed_m_s * self.settings.planning_period_s
        for team in situation.teams:
            start = np.array([situation.position_m[robot] for robot in team])
            middle = start.mean(axis=0)
            if place is None:
                corners = random_corners(self.settings, middle, self._rng)
            else:
                way = np.array(place) - middle
                length = float(np.hypot(*way))
                corners = (middle + way * min(1.0, reach / max(length, 1e-9)))[None]
                if length < self.settings.grid.cell_m:  # there: look round it instead of standing on it
                    corners = middle + self._rng.normal(0.0, 2.0 * self.settings.grid.cell_m, (2, 2))
            paths |= steer(self.settings, team, start, corners, typical_range_m(self.settings))
        return Plan(situation.t_ns, paths, dict.fromkeys(paths, "walk" if place is None else "probable"))

    def _goal(self, belief: Belief) -> tuple[float, float] | None:
        if isinstance(belief, CsmaBelief):
            return belief.most_probable()
        presence = np.array(belief.presence())
        if presence.max() <= 1.001 * presence.min() or presence.max() < 1e-6:
            return None
        row, column = np.unravel_index(int(np.argmax(presence)), presence.shape)
        return float(self.settings.grid.east_m[column]), float(self.settings.grid.north_m[row])
