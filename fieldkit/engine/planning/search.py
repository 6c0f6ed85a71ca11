"""What the default planner chooses from: ways a team could drive, as its robots would drive them.

Ways are drawn at random over unsearched ground, by weight and near by, and laid round candidates. Each is driven
abreast within fence, keep-out ground and battery, at the speed and turn rate robots have.
"""

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldkit.engine.belief.base import Unresolved
from fieldkit.engine.planning import path_loops
from fieldkit.engine.planning.base import Situation, legs_within_range, track
from fieldkit.engine.planning.reward import Reward
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Plan
from fieldkit.tuning import InfogainTuning

Place = tuple[float, float]
"""East and north, in metres."""
Way = list[Place]
"""Corners of the way of a team's middle."""
BATCH, PARENTS = 16, 4
"""Local search moves so many ways at a time, made of so many of the best so far."""


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """n paths of a team to choose from."""

    ways: list[Way]
    spacing_m: FloatArray
    """(n,) how far abreast the team would drive."""
    purpose: list[str]
    places_m: FloatArray
    """(n, most legs, m, 2)"""
    legs: NDArray[np.int64]
    """(n,) how many of those each path has, at least 1."""
    tracks_m: FloatArray
    """(n, steps, m, 2)"""


@dataclass(frozen=True, slots=True, eq=False)
class Departure:
    """A team of m robots that is to be given a way, and what limits it."""

    start_m: FloatArray
    """(m, 2)"""
    range_m: FloatArray
    """(m,) how far each can still drive, the way home included."""
    home_m: FloatArray
    """(m, 2) where each has to come back to."""
    last: Way | None
    """The way it was given before."""
    horizon_s: float

    @classmethod
    def of(
        cls, team: tuple[str, ...], situation: Situation, last: Way | None, horizon_s: float
    ) -> "Departure":
        """A team as the situation has it."""
        start = np.array([situation.position_m[robot] for robot in team])
        range_m = np.array([situation.range_m.get(robot, np.inf) for robot in team])
        home_m = np.array([situation.home_m.get(robot, at) for robot, at in zip(team, start, strict=True)])
        return cls(start, range_m, home_m, last, horizon_s)

    @property
    def centre(self) -> Place:
        """The team's middle."""
        return float(self.start_m[:, 0].mean()), float(self.start_m[:, 1].mean())


class Search:
    """Proposes ways and drives them; what it draws comes from `rng`."""

    def __init__(self, settings: EngineSettings, tuning: InfogainTuning, rng: np.random.Generator) -> None:
        self.settings, self.grid = settings, settings.grid
        self._tuning, self._rng = tuning, rng
        ranges = settings.antenna.nominal_range_m(np.array(settings.power_levels_db))
        self._typical_m = float(np.median(ranges))
        self._spacings_m = [
            max(settings.min_separation_m, factor * self._typical_m) for factor in self._tuning.spacings
        ]
        margin_m = settings.fence_margin_m
        self._low = np.full(2, margin_m)
        self._high = np.maximum(
            self._low, np.array([self.grid.size_east_m, self.grid.size_north_m]) - margin_m
        )

    def options(self, departure: Departure, reward: Reward) -> Options:
        """Paths within fence, battery and keep-out; they may still meet other teams' ways."""
        centre = departure.centre
        ways = self._over_ground(reward, centre, self.settings.max_speed_m_s * departure.horizon_s)
        spacing = [self._spacings_m[index % len(self._spacings_m)] for index in range(len(ways))]
        purpose = ["search"] * len(ways)
        if departure.last:
            ways.append(departure.last)
            purpose.append("search")
        nearest = sorted(
            reward.unresolved,
            key=lambda u: (u.p_gone > 0.0, float(np.hypot(*(u.points_m.mean(axis=0) - centre)))),
        )
        for candidate in nearest[: self._tuning.max_candidates]:
            ways += self._around(candidate, centre)
            purpose += [f"resolve {candidate.ident}"] * self._tuning.paths_per_candidate
        spacing += [self._spacings_m[0]] * (len(ways) - len(spacing))
        return self._driven(departure, ways, np.array(spacing), purpose)

    def standing(self, start_m: FloatArray, horizon_s: float) -> FloatArray:
        """(steps, m, 2): the track of robots that stay at `start_m` (m, 2)."""
        return np.repeat(start_m[None], self._n_steps(horizon_s), axis=0)

    def underway(
        self, team: tuple[str, ...], plan: Plan, situation: Situation, horizon_s: float
    ) -> FloatArray:
        """(steps, m, 2): where a team that goes on with a plan will be."""
        start = np.array([situation.position_m[robot] for robot in team])
        legs = max(len(plan.paths[robot]) for robot in team)
        if legs == 0:
            return self.standing(start, horizon_s)
        places = np.empty((legs, len(team), 2))
        for slot, robot in enumerate(team):
            path = [(w.east_m, w.north_m) for w in plan.paths[robot]]
            path += [path[-1] if path else tuple(start[slot])] * (legs - len(path))
            places[:, slot] = path
        s = self.settings
        return track(places, start, s.max_speed_m_s, self._tuning.step_s, horizon_s, s.max_turn_deg_s)

    # -- proposals ---------------------------------------------------------------------------------------

    def _over_ground(self, reward: Reward, centre: Place, length_m: float) -> list[Way]:
        """Corners of paths over unsearched ground: across the field, and every other one nearby."""
        pick = self._picker(reward)
        ways = []
        for index in range(self._tuning.ground_paths):
            way: Way = []
            here, gone = centre, 0.0
            while gone < length_m and len(way) < self._tuning.most_legs:
                drawn = self._rng.random()
                if index % 2:
                    bearing = self._rng.uniform(0.0, 2.0 * math.pi)
                    far_m = self._rng.uniform(1.0, 4.0) * self._typical_m
                    there = (here[0] + far_m * math.sin(bearing), here[1] + far_m * math.cos(bearing))
                else:
                    there = pick(drawn)
                way.append(there)
                gone += math.dist(here, there)
                here = there
            ways.append(way)
        return ways

    def _picker(self, reward: Reward) -> Callable[[float], Place]:
        """The middle of a square of ground for a number between 0 and 1, by what is left there."""
        weight = reward.left()
        weight = weight**1.5 if weight.sum() > 0 else np.ones(weight.shape)
        cumulative = np.cumsum(weight.ravel() / weight.sum()).tolist()
        side, columns = reward.square_m, weight.shape[1]

        def pick(drawn: float) -> Place:
            row, column = divmod(min(bisect_left(cumulative, drawn), len(cumulative) - 1), columns)
            return (
                min((column + 0.5) * side, self.grid.size_east_m),
                min((row + 0.5) * side, self.grid.size_north_m),
            )

        return pick

    def _around(self, candidate: Unresolved, centre: Place) -> list[Way]:
        """Corners round possible places of a candidate: the nearest first, then on round it."""
        middle = candidate.points_m.mean(axis=0)
        ways = []
        for index in range(self._tuning.paths_per_candidate):
            focus = candidate.points_m[int(self._rng.integers(candidate.points_m.shape[0]))]
            east, north = (middle if index % 3 == 0 else focus).tolist()
            radius = self._typical_m * (0.15, 0.35, 0.6, 0.9)[index % 4]
            bearing = math.atan2(centre[0] - east, centre[1] - north) + self._rng.uniform(-0.5, 0.5)
            turn = math.radians(120.0 if index % 2 else 75.0) * (1 if self._rng.random() < 0.5 else -1)
            angles = [bearing + k * turn for k in range(6)]
            ways.append([(east + radius * math.sin(a), north + radius * math.cos(a)) for a in angles])
        return ways

    # -- local search ------------------------------------------------------------------------------------

    def improved(
        self,
        departure: Departure,
        reward: Reward,
        ears: FloatArray,
        options: Options,
        rewards: FloatArray,
        budget: int,
    ) -> tuple[Options, FloatArray]:
        """The best of `options` and what becomes of them by moving their corners, with their rewards (n,).

        `budget` further paths are valued, a batch at a time: each is one of the best so far with corners moved, at
        first by about a range and then by less. A budget of 0 leaves the options as they are.
        """
        left = budget
        while left > 0 and rewards.size and rewards.max() > -np.inf:
            count = min(BATCH, left)
            best = np.argsort(-rewards, kind="stable")[:PARENTS]
            best = best[rewards[best] > -np.inf]
            far_m = self._typical_m * max(0.1, left / budget)
            parents = [int(best[index % len(best)]) for index in range(count)]
            moved = self._driven(
                departure,
                [self._moved(options.ways[parent], far_m) for parent in parents],
                options.spacing_m[parents],
                [options.purpose[parent] for parent in parents],
            )
            left -= count
            options = _together(options, best, moved)
            rewards = np.concatenate([rewards[best], reward.of(moved.tracks_m, ears)])
        return options, rewards

    def _moved(self, way: Way, far_m: float) -> Way:
        """A way with one of its corners, or all, moved by about `far_m`."""
        shift = self._rng.normal(0.0, far_m, (len(way), 2))
        only = int(self._rng.integers(2 * len(way)))
        return [
            (place[0] + shift[k, 0], place[1] + shift[k, 1]) if only >= len(way) or k == only else place
            for k, place in enumerate(way)
        ]

    # -- driving -----------------------------------------------------------------------------------------

    def _driven(
        self, departure: Departure, ways: list[Way], spacing_m: FloatArray, purpose: list[str]
    ) -> Options:
        """The ways of a team's middle as its robots would drive them abreast, but for those that cannot be driven."""
        s, start = self.settings, departure.start_m
        legs = np.array([len(way) for way in ways], dtype=np.int64)
        centres = np.zeros((len(ways), self._tuning.most_legs, 2))
        for index, way in enumerate(ways):
            centres[index, : len(way)] = way
        places = np.zeros((len(ways), self._tuning.most_legs, len(start), 2))
        path_loops.all_abreast(centres, legs, start, spacing_m, self._low, self._high, places)
        if not np.isinf(departure.range_m).all():
            for index, count in enumerate(legs):
                legs[index] = legs_within_range(
                    places[index, :count], start, departure.range_m, departure.home_m
                )
        can = legs > 0
        if s.keep_out.needs_detours:
            can &= [not self._blocked(start, places[i, :count]) for i, count in enumerate(legs)]
        places, legs = places[can], legs[can]
        tracks = np.empty((len(legs), self._n_steps(departure.horizon_s), len(start), 2))
        path_loops.all_tracks(
            places, legs, start, s.max_speed_m_s, math.radians(s.max_turn_deg_s), self._tuning.step_s, tracks
        )
        kept = np.flatnonzero(can).tolist()
        return Options(
            [ways[i] for i in kept], spacing_m[can], [purpose[i] for i in kept], places, legs, tracks
        )

    def _blocked(self, start: FloatArray, places: FloatArray) -> bool:
        """Whether a robot's way from `start` (m, 2) over places (legs, m, 2) crosses ground to be kept out of."""
        keep_out = self.settings.keep_out
        before, after = places[:-1].reshape(-1, 2), places[1:].reshape(-1, 2)
        first = zip(start.tolist(), places[0].tolist(), strict=True)
        return bool(keep_out.blocks(before, after).any()) or not all(
            keep_out.permits((a[0], a[1]), (b[0], b[1])) for a, b in first
        )

    def _n_steps(self, horizon_s: float) -> int:
        """Points of a track."""
        return max(1, int(horizon_s / self._tuning.step_s))


def _together(some: Options, which: NDArray[np.int64], others: Options) -> Options:
    """Those of some options, and all others."""
    return Options(
        [some.ways[i] for i in which] + others.ways,
        np.concatenate([some.spacing_m[which], others.spacing_m]),
        [some.purpose[i] for i in which] + others.purpose,
        np.concatenate([some.places_m[which], others.places_m]),
        np.concatenate([some.legs[which], others.legs]),
        np.concatenate([some.tracks_m[which], others.tracks_m]),
    )
