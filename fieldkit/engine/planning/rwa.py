"""Ridge walking for single robots (RWA Algorithm 2; RWA-2009 is the same walk on an older sensing model).

The level set of P(C_i) at p = (6/n) sum P falls into components, each with a ridge; a robot tours them, staying on
each in proportion to the component's summed probability. Where nothing stands out it walks at random.

Deviations from the print: the level is capped at half of the largest P, since (6/n) sum P passes 1 after some n/6
receptions and the level set would be empty for ever; cells of sources already found are taken out, so that their
ridges take no more time (the paper removes identified sources); ridges are swept back and forth at full speed, as
robots cannot crawl. With more than one robot ridges are divided as PRWA divides them over pairs.
"""

import numpy as np

from fieldkit.engine.belief.base import Belief
from fieldkit.engine.planning.base import Planner, Situation
from fieldkit.engine.planning.prwa import assign, cluster_ridges
from fieldkit.engine.planning.ridges import Ridge, find_ridges
from fieldkit.engine.planning.schedule import ridge_schedule
from fieldkit.engine.planning.steering import Steering
from fieldkit.engine.planning.tour import ridge_tour
from fieldkit.engine.planning.walks import random_corners, typical_range_m
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Plan, Waypoint


def level_of(presence: FloatArray, factor: float, *, capped: bool = True) -> float:
    """p = (factor/n) sum P(C_i) (RWA section VII.C: 6); `capped` at half of the largest P."""
    level = factor * float(presence.mean())
    return min(level, 0.5 * float(presence.max())) if capped else level


class RwaPlanner(Planner):
    """See the module."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self._rng = np.random.default_rng([settings.seed, 0x12A])
        self._steering = Steering(settings)

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """A tour of ridges for every robot there are ridges for; a random walk for the others."""
        presence = self._without_found(belief)
        ridges = [r for r in self._ridges(presence) if r.weight > 0.0]
        groups = [(robot,) for team in situation.teams for robot in team]
        clusters = cluster_ridges(ridges, min(len(groups), len(ridges)), self._rng)
        starts = [np.array(situation.position_m[robot]) for (robot,) in groups]
        assigned = assign(clusters, starts)
        paths: dict[str, tuple[Waypoint, ...]] = {}
        purpose: dict[str, str] = {}
        for index, ((robot,), start) in enumerate(zip(groups, starts, strict=True)):
            own: dict[str, tuple[Waypoint, ...]] = {}
            why, spacing = "ridge", typical_range_m(self.settings)
            if index in assigned:
                corners = self._walk(clusters[assigned[index]], start)
                own = self._steering.steer((robot,), start[None], corners, spacing)
            if not any(own.values()):  # no ridge, or none that can be reached
                corners, why = random_corners(self.settings, start, self._rng), "walk"
                own = self._steering.steer((robot,), start[None], corners, spacing)
            paths |= own
            purpose[robot] = why if own[robot] else "wait"
        return Plan(situation.t_ns, paths, purpose)

    def _without_found(self, belief: Belief) -> FloatArray:
        """P(C_i) with the neighbourhoods of found sources taken out."""
        presence = np.array(belief.presence())
        grid = self.settings.grid
        for source in belief.sources():
            if source.state == "found":
                reach = max(2.0 * grid.cell_m, float(np.sqrt(source.region_90)) * grid.cell_m)
                near = np.hypot(*(grid.centres_m - (source.east_m, source.north_m)).T) <= reach
                presence.ravel()[near] = 0.0
        return presence

    def _ridges(self, presence: FloatArray) -> list[Ridge]:
        """RWA weighs a ridge by the summed P(C_i) of its component (eq 29)."""
        level = level_of(presence, self.settings.tuning.ridges.rwa_level)
        return find_ridges(presence, presence, level, self.settings.grid) if level > 1e-9 else []

    def _walk(self, ridges: list[Ridge], start_m: FloatArray) -> FloatArray:
        ends = np.array([ridge.ends_m for ridge in ridges])
        weights = np.array([ridge.weight for ridge in ridges])
        order = ridge_tour(start_m, ends)
        period, speed = self.settings.planning_period_s, self.settings.max_speed_m_s
        return ridge_schedule(start_m, ends, order, weights, period, speed, sweeps=True).corners_m()
