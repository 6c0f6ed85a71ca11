"""The papers' baseline motions (PRWA section VII.A): random walks and patrols, in pairs or each robot alone.

The papers give no step length or lane width, and both change the ranking, so they are stated here: a walk goes
straight on a uniformly random heading for 0.2 to 0.6 of the field's shorter side, cut at the border; a patrol
drives lanes two typical ranges apart, at least six of them, the teams spread evenly along the route.
"""

import math

import numpy as np

from fieldkit.engine.belief.base import Belief
from fieldkit.engine.planning.base import Planner, Situation
from fieldkit.engine.planning.steering import Steering
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Plan, Waypoint


def typical_range_m(settings: EngineSettings) -> float:
    """Nominal range at the median power level."""
    return float(np.median(settings.antenna.nominal_range_m(np.array(settings.power_levels_db))))


class PairRandomWalk(Planner):
    """Each team walks at random as one, its robots one typical range abreast."""

    alone = False

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self._rng = np.random.default_rng([settings.seed, 0x3A1])
        self._steering = Steering(settings)

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """Three legs for each team."""
        paths: dict[str, tuple[Waypoint, ...]] = {}
        for team in situation.teams:
            groups = [(robot,) for robot in team] if self.alone else [team]
            for group in groups:
                start = np.array([situation.position_m[robot] for robot in group])
                corners = random_corners(self.settings, start.mean(axis=0), self._rng)
                paths |= self._steering.steer(group, start, corners, typical_range_m(self.settings))
        return Plan(situation.t_ns, paths, dict.fromkeys(paths, "walk"))


class RandomWalk(PairRandomWalk):
    """Every robot walks at random on its own."""

    alone = True


def random_corners(settings: EngineSettings, here_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(legs, 2) corners of a random walk from `here_m`; a leg onto ground to be kept out of is drawn again."""
    size = np.array([settings.grid.size_east_m, settings.grid.size_north_m])
    corners = []
    for _ in range(settings.tuning.ridges.walk_legs):
        for _ in range(settings.tuning.ridges.walk_draws):
            heading = rng.uniform(0.0, 2.0 * math.pi)
            length = rng.uniform(0.2, 0.6) * size.min()
            corner = np.clip(here_m + length * np.array([math.sin(heading), math.cos(heading)]), 0.0, size)
            if not settings.keep_out.blocks(here_m[None], corner[None])[0]:
                break
        corners.append(corner)
        here_m = corner
    return np.array(corners)


class PairPatrol(Planner):
    """Teams drive one fixed route of lanes over the whole field, spread evenly along it."""

    alone = False

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self._steering = Steering(settings)
        self._route = np.array([self._steering.allowed(corner) for corner in lanes(settings)])
        self._lane_m = settings.grid.size_east_m / (len(self._route) / 2)
        groups = [(r,) for team in settings.teams for r in team] if self.alone else list(settings.teams)
        self._next = {group: round(i / len(groups) * len(self._route)) for i, group in enumerate(groups)}

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """The next two corners of the route for each team."""
        paths: dict[str, tuple[Waypoint, ...]] = {}
        for team in situation.teams:
            groups = [(robot,) for robot in team] if self.alone else [team]
            for group in groups:
                start = np.array([situation.position_m[robot] for robot in group])
                paths |= self._stretch(group, start)
        return Plan(situation.t_ns, paths, dict.fromkeys(paths, "patrol"))

    def _stretch(self, group: tuple[str, ...], start_m: FloatArray) -> dict[str, tuple[Waypoint, ...]]:
        """Paths along the next two corners; corners to which no way leads are passed over."""
        at = self._advance(group, start_m.mean(axis=0))
        paths: dict[str, tuple[Waypoint, ...]] = {}
        for _ in self._route:
            corners = self._route[[(at + k) % len(self._route) for k in range(2)]]
            paths = self._steering.steer(group, start_m, corners, typical_range_m(self.settings))
            if any(paths.values()):
                break
            at = self._next[group] = (at + 1) % len(self._route)
        return paths

    def _advance(self, group: tuple[str, ...], here_m: FloatArray) -> int:
        """The corner to drive to: the one after the corner it stands at, were it the second of the last plan."""
        at = self._next.setdefault(group, 0)
        reach = min(max(0.5 * typical_range_m(self.settings), 0.5), 0.4 * self._lane_m)
        for ahead in (1, 0):
            corner = self._route[(at + ahead) % len(self._route)]
            if np.hypot(*(corner - here_m)) < reach:
                at += ahead + 1
                break
        self._next[group] = at % len(self._route)
        return self._next[group]


class Patrol(PairPatrol):
    """Every robot drives the route on its own."""

    alone = True


def lanes(settings: EngineSettings) -> FloatArray:
    """(k, 2) corners of a closed route of parallel lanes, at most two typical ranges apart."""
    grid, margin = settings.grid, settings.fence_margin_m
    width = 2.0 * typical_range_m(settings)
    count = max(settings.tuning.ridges.least_lanes, math.ceil(grid.size_east_m / width))
    corners = []
    for lane in range(count):
        east = (lane + 0.5) / count * grid.size_east_m
        ends = [margin, grid.size_north_m - margin]
        corners += [(east, north) for north in (ends if lane % 2 == 0 else ends[::-1])]
    return np.array(corners)
