"""The default planner: each team takes, of many paths, the one from which the belief will learn most.

A path's reward is the sources it would newly hear on unsearched ground, plus the progress it would make on
candidates not yet resolved: receptions still missing, and the shrinking of their posterior by Fisher information,
both as expected over samples of where and how strong each candidate may be. Teams are planned one after another
on what the others leave; no path comes nearer to another team than the separation, or leads further than a robot's
battery brings it home from.
"""

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldkit.engine.belief.base import Belief, Unresolved
from fieldkit.engine.planning import path_loops
from fieldkit.engine.planning.base import (
    InformativeBelief,
    Planner,
    Situation,
    informative,
    legs_within_range,
    track,
    waypoints,
)
from fieldkit.engine.planning.reward import Reward, hearing_of
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Plan, Waypoint

Place = tuple[float, float]
"""East and north, in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class _Options:
    """n paths of a team to choose from."""

    purpose: list[str]
    places_m: FloatArray
    """(n, most legs, m, 2)"""
    legs: NDArray[np.int64]
    """(n,) how many of those each path has, at least 1."""
    tracks_m: FloatArray
    """(n, steps, m, 2)"""


class InfoGainPlanner(Planner):
    """See the module."""

    TEAM_BY_TEAM = True

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self.grid = settings.grid
        self._tuning = settings.tuning.infogain
        self._rng = np.random.default_rng([settings.seed, 0x1F0])
        self._last: dict[tuple[str, ...], list[Place]] = {}
        shortest_m = float(settings.antenna.nominal_range_m(min(settings.power_levels_db)))
        self._block = max(1, int(self._tuning.ground_block * shortest_m / settings.grid.cell_m))
        """Ground is valued in squares of so many cells: finer than that, ranges blur it anyway."""

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """Paths for all teams of the situation. Raises `ConfigError` for a belief that is not informative."""
        informed = informative(belief, "infogain")
        horizon_s = max(self._tuning.horizon_s, 1.5 * self.settings.planning_period_s)
        reward = self._reward(informed, situation.removed)
        for team, busy in situation.busy.items():
            if all(robot in situation.position_m for robot in team):
                reward.take(self._underway(team, busy, situation, horizon_s), self._ears(team, situation))
        paths: dict[str, tuple[Waypoint, ...]] = {}
        purpose: dict[str, str] = {}
        for team in situation.teams:
            start = np.array([situation.position_m[robot] for robot in team])
            options = self._options(situation, team, start, reward, horizon_s)
            ears = self._ears(team, situation)
            rewards = reward.of(options.tracks_m, ears)
            best = int(np.argmax(rewards)) if rewards.size else -1
            if (
                best < 0 or rewards[best] == -np.inf
            ):  # boxed in by the others, or no battery left for any path: stay
                for robot in team:
                    paths[robot], purpose[robot] = (), "wait"
                reward.take(self._standing(start, horizon_s), ears)
                continue
            places = options.places_m[best, : options.legs[best]]
            reward.take(options.tracks_m[best], ears)
            self._last[team] = [tuple(place.mean(axis=0)) for place in places]
            for robot, path in zip(team, waypoints(places, start, self.settings.max_speed_m_s), strict=True):
                paths[robot], purpose[robot] = path, options.purpose[best]
        return Plan(situation.t_ns, paths, purpose)

    def _reward(self, belief: InformativeBelief, removed: frozenset[int]) -> Reward:
        value = blocks_summed(self._tuning.ground_value * belief.ground_value(), self._block)
        unresolved = [
            each for each in belief.unresolved(self._tuning.samples, self._rng) if each.ident not in removed
        ]
        return Reward(self.settings, belief.model, value, self._block * self.grid.cell_m, unresolved)

    def _ears(self, team: tuple[str, ...], situation: Situation) -> FloatArray:
        return hearing_of(self.settings, team, situation.up_m)

    def _underway(
        self, team: tuple[str, ...], plan: Plan, situation: Situation, horizon_s: float
    ) -> FloatArray:
        """(steps, m, 2): where a team that goes on will be."""
        start = np.array([situation.position_m[robot] for robot in team])
        legs = max(len(plan.paths[robot]) for robot in team)
        if legs == 0:
            return self._standing(start, horizon_s)
        places = np.empty((legs, len(team), 2))
        for slot, robot in enumerate(team):
            path = [(w.east_m, w.north_m) for w in plan.paths[robot]]
            path += [path[-1] if path else tuple(start[slot])] * (legs - len(path))
            places[:, slot] = path
        return track(
            places,
            start,
            self.settings.max_speed_m_s,
            self._tuning.step_s,
            horizon_s,
            self.settings.max_turn_deg_s,
        )

    # -- paths to choose from ----------------------------------------------------------------------------

    def _options(
        self,
        situation: Situation,
        team: tuple[str, ...],
        start: FloatArray,
        reward: Reward,
        horizon_s: float,
    ) -> _Options:
        """Paths within fence, battery and keep-out; they may still meet other teams' ways."""
        ranges = self.settings.antenna.nominal_range_m(np.array(self.settings.power_levels_db))
        typical_m = float(np.median(ranges))
        spacings = [
            max(self.settings.min_separation_m, factor * typical_m) for factor in self._tuning.spacings
        ]
        centre = (float(start[:, 0].mean()), float(start[:, 1].mean()))
        ways = self._over_ground(reward, centre, typical_m, self.settings.max_speed_m_s * horizon_s)
        spacing = [spacings[index % len(spacings)] for index in range(len(ways))]
        purpose = ["search"] * len(ways)
        if self._last.get(team):
            ways.append(self._last[team])
            purpose.append("search")
        nearest = sorted(
            reward.unresolved,
            key=lambda u: (u.p_gone > 0.0, float(np.hypot(*(u.points_m.mean(axis=0) - centre)))),
        )
        for candidate in nearest[: self._tuning.max_candidates]:
            ways += self._around(candidate, centre, typical_m)
            purpose += [f"resolve {candidate.ident}"] * self._tuning.paths_per_candidate
        spacing += [spacings[0]] * (len(ways) - len(spacing))
        return self._driven(situation, team, start, horizon_s, ways, np.array(spacing), purpose)

    def _over_ground(
        self, reward: Reward, centre: Place, typical_m: float, length_m: float
    ) -> list[list[Place]]:
        """Corners of paths over unsearched ground: across the field, and every other one nearby."""
        pick = self._picker(reward.left())
        ways = []
        for index in range(self._tuning.ground_paths):
            way: list[Place] = []
            here, gone = centre, 0.0
            while gone < length_m and len(way) < self._tuning.most_legs:
                drawn = self._rng.random()
                if index % 2:
                    bearing = self._rng.uniform(0.0, 2.0 * math.pi)
                    far_m = self._rng.uniform(1.0, 4.0) * typical_m
                    there = (here[0] + far_m * math.sin(bearing), here[1] + far_m * math.cos(bearing))
                else:
                    there = pick(drawn)
                way.append(there)
                gone += math.dist(here, there)
                here = there
            ways.append(way)
        return ways

    def _picker(self, weight: FloatArray) -> Callable[[float], Place]:
        """The middle of a square of ground for a number between 0 and 1, by weight (n_north, n_east of the squares)."""
        weight = weight**1.5 if weight.sum() > 0 else np.ones(weight.shape)
        cumulative = np.cumsum(weight.ravel() / weight.sum()).tolist()
        side = self._block * self.grid.cell_m
        columns = weight.shape[1]

        def pick(drawn: float) -> Place:
            row, column = divmod(min(bisect_left(cumulative, drawn), len(cumulative) - 1), columns)
            return (
                min((column + 0.5) * side, self.grid.size_east_m),
                min((row + 0.5) * side, self.grid.size_north_m),
            )

        return pick

    def _around(self, candidate: Unresolved, centre: Place, typical_m: float) -> list[list[Place]]:
        """Corners round possible places of a candidate: the nearest first, then on round it."""
        middle = candidate.points_m.mean(axis=0)
        ways = []
        for index in range(self._tuning.paths_per_candidate):
            focus = candidate.points_m[int(self._rng.integers(candidate.points_m.shape[0]))]
            east, north = (middle if index % 3 == 0 else focus).tolist()
            radius = typical_m * (0.15, 0.35, 0.6, 0.9)[index % 4]
            bearing = math.atan2(centre[0] - east, centre[1] - north) + self._rng.uniform(-0.5, 0.5)
            turn = math.radians(120.0 if index % 2 else 75.0) * (1 if self._rng.random() < 0.5 else -1)
            angles = [bearing + k * turn for k in range(6)]
            ways.append([(east + radius * math.sin(a), north + radius * math.cos(a)) for a in angles])
        return ways

    def _driven(
        self,
        situation: Situation,
        team: tuple[str, ...],
        start: FloatArray,
        horizon_s: float,
        ways: list[list[Place]],
        spacing_m: FloatArray,
        purpose: list[str],
    ) -> _Options:
        """The ways of a team's middle as its robots would drive them abreast, but for those that cannot be driven."""
        s = self.settings
        legs = np.array([len(way) for way in ways], dtype=np.int64)
        centres = np.zeros((len(ways), self._tuning.most_legs, 2))
        for index, way in enumerate(ways):
            centres[index, : len(way)] = way
        low = np.full(2, s.fence_margin_m)
        high = np.maximum(low, np.array([self.grid.size_east_m, self.grid.size_north_m]) - s.fence_margin_m)
        places = np.zeros((len(ways), self._tuning.most_legs, len(team), 2))
        path_loops.all_abreast(centres, legs, start, spacing_m, low, high, places)
        range_m = np.array([situation.range_m.get(robot, np.inf) for robot in team])
        home_m = np.array([situation.home_m.get(robot, at) for robot, at in zip(team, start, strict=True)])
        if not np.isinf(range_m).all():
            for index, count in enumerate(legs):
                legs[index] = legs_within_range(places[index, :count], start, range_m, home_m)
        can = legs > 0
        if s.keep_out.needs_detours:
            can &= [not self._blocked(start, places[i, :count]) for i, count in enumerate(legs)]
        places, legs = places[can], legs[can]
        tracks = np.empty((len(legs), self._n_steps(horizon_s), len(team), 2))
        path_loops.all_tracks(
            places, legs, start, s.max_speed_m_s, math.radians(s.max_turn_deg_s), self._tuning.step_s, tracks
        )
        return _Options([p for p, kept in zip(purpose, can, strict=True) if kept], places, legs, tracks)

    def _blocked(self, start: FloatArray, places: FloatArray) -> bool:
        """Whether a robot's way from `start` (m, 2) over places (legs, m, 2) crosses ground to be kept out of."""
        keep_out = self.settings.keep_out
        before, after = places[:-1].reshape(-1, 2), places[1:].reshape(-1, 2)
        first = zip(start.tolist(), places[0].tolist(), strict=True)
        return bool(keep_out.blocks(before, after).any()) or not all(
            keep_out.permits((a[0], a[1]), (b[0], b[1])) for a, b in first
        )

    def _standing(self, start_m: FloatArray, horizon_s: float) -> FloatArray:
        """(steps, m, 2): the track of robots that stay at `start_m` (m, 2)."""
        return np.repeat(start_m[None], self._n_steps(horizon_s), axis=0)

    def _n_steps(self, horizon_s: float) -> int:
        """Points of a track."""
        return max(1, int(horizon_s / self._tuning.step_s))


def blocks_summed(value: FloatArray, block: int) -> FloatArray:
    """`value` (n_north, n_east) summed over squares of `block` x `block` cells; the last ones may be cut."""
    if block == 1:
        return value
    rows, columns = np.arange(0, value.shape[0], block), np.arange(0, value.shape[1], block)
    return np.asarray(np.add.reduceat(np.add.reduceat(value, rows, axis=0), columns, axis=1))
