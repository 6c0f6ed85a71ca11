"""The default planner: each team takes, of many paths, the one from which the belief will learn most.

A path is worth the sources it would newly hear on unsearched ground, plus the progress it would make on
candidates not yet resolved: receptions still missing, and the shrinking of their posterior by Fisher information,
both as expected over samples of where and how strong each candidate may be. Teams are planned one after another
on what the others leave; no path comes nearer to another team than the separation, or leads further than a robot's
battery brings it home from.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fieldkit.engine.belief.base import Belief
from fieldkit.engine.belief.intensity import IntensityBelief, Unresolved
from fieldkit.engine.planning.base import Situation, abreast, legs_within_range, track, waypoints
from fieldkit.engine.planning.ledger import STEP_S, Ledger
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from fieldkit.messages import FloatArray, Plan, Waypoint

HORIZON_S = 45.0
"""How far ahead paths are judged."""
GROUND_PATHS = 60
PATHS_PER_CANDIDATE = 16
MAX_CANDIDATES = 6
SAMPLES = 16
SPACINGS = (0.6, 1.3, 2.0)
"""How far abreast teams may search, in typical ranges; candidates are resolved at the first."""
GROUND_VALUE = 1.0
GROUND_BLOCK = 0.4
"""Side of the squares in which ground is valued, at most, in the shortest typical range."""


@dataclass(frozen=True, slots=True, eq=False)
class _Option:
    purpose: str
    places_m: FloatArray
    """(legs, m, 2)"""
    track_m: FloatArray
    """(steps, m, 2)"""


class InfoGainPlanner:
    """See the module."""

    TEAM_BY_TEAM = True

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self.grid = settings.grid
        self._rng = np.random.default_rng([settings.seed, 0x1F0])
        self._last: dict[tuple[str, ...], list[tuple[float, float]]] = {}
        shortest_m = float(settings.antenna.nominal_range_m(min(settings.power_levels_db)))
        self._block = max(1, int(GROUND_BLOCK * shortest_m / settings.grid.cell_m))
        """Ground is valued in squares of so many cells: finer than that, ranges blur it anyway."""

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """Paths for all teams of the situation. Raises `ConfigError` for a belief without exposure."""
        if not isinstance(belief, IntensityBelief):
            raise ConfigError("planner 'infogain' needs belief 'intensity'; choose 'prwa' for other beliefs")
        horizon_s = max(HORIZON_S, 1.5 * self.settings.planning_period_s)
        ledger = self._ledger(belief)
        for team, busy in situation.busy.items():
            if all(robot in situation.position_m for robot in team):
                ledger.take(self._underway(team, busy, situation, horizon_s))
        paths: dict[str, tuple[Waypoint, ...]] = {}
        purpose: dict[str, str] = {}
        for team in situation.teams:
            start = np.array([situation.position_m[robot] for robot in team])
            best, best_worth = None, -math.inf
            for option in self._options(situation, team, start, ledger, horizon_s):
                if ledger.is_clear(option.track_m):
                    worth = ledger.worth(option.track_m)
                    if worth > best_worth:
                        best, best_worth = option, worth
            if best is None:  # boxed in by the others, or no battery left for any path: stay
                for robot in team:
                    paths[robot], purpose[robot] = (), "wait"
                ledger.take(standing(start, horizon_s))
                continue
            ledger.take(best.track_m)
            self._last[team] = [tuple(place.mean(axis=0)) for place in best.places_m]
            for robot, path in zip(
                team, waypoints(best.places_m, start, self.settings.max_speed_m_s), strict=True
            ):
                paths[robot], purpose[robot] = path, best.purpose
        return Plan(situation.t_ns, paths, purpose)

    def _ledger(self, belief: IntensityBelief) -> Ledger:
        value = blocks_summed(GROUND_VALUE * belief.ground_value(), self._block)
        unresolved = belief.unresolved(SAMPLES, self._rng)
        return Ledger(self.settings, belief.model, value, self._block * self.grid.cell_m, unresolved)

    def _underway(
        self, team: tuple[str, ...], plan: Plan, situation: Situation, horizon_s: float
    ) -> FloatArray:
        """(steps, m, 2): where a team that goes on will be."""
        start = np.array([situation.position_m[robot] for robot in team])
        legs = max(len(plan.paths[robot]) for robot in team)
        if legs == 0:
            return standing(start, horizon_s)
        places = np.empty((legs, len(team), 2))
        for slot, robot in enumerate(team):
            path = [(w.east_m, w.north_m) for w in plan.paths[robot]]
            path += [path[-1] if path else tuple(start[slot])] * (legs - len(path))
            places[:, slot] = path
        return track(
            places, start, self.settings.max_speed_m_s, STEP_S, horizon_s, self.settings.max_turn_deg_s
        )

    def _blocked(self, corners_m: FloatArray) -> bool:
        """Whether a robot's way along corners (legs, m, 2) crosses ground to be kept out of."""
        before, after = corners_m[:-1].reshape(-1, 2), corners_m[1:].reshape(-1, 2)
        return bool(self.settings.keep_out.blocks(before, after).any())

    # -- paths to choose from ----------------------------------------------------------------------------

    def _options(
        self,
        situation: Situation,
        team: tuple[str, ...],
        start: FloatArray,
        ledger: Ledger,
        horizon_s: float,
    ) -> list[_Option]:
        ranges = self.settings.antenna.nominal_range_m(np.array(self.settings.power_levels_db))
        typical_m = float(np.median(ranges))
        centre = start.mean(axis=0)
        length_m = self.settings.max_speed_m_s * horizon_s
        spacings = [max(self.settings.min_separation_m, factor * typical_m) for factor in SPACINGS]
        options: list[_Option] = []
        range_m = np.array([situation.range_m.get(robot, np.inf) for robot in team])
        home_m = np.array([situation.home_m.get(robot, at) for robot, at in zip(team, start, strict=True)])

        def add(purpose: str, corners: list[FloatArray] | FloatArray, spacing_m: float) -> None:
            places = abreast(
                np.asarray(corners, dtype=float), start, spacing_m, self.grid, self.settings.fence_margin_m
            )
            places = places[: legs_within_range(places, start, range_m, home_m)]
            if len(places) == 0 or self._blocked(np.concatenate([start[None], places])):
                return
            route = track(
                places, start, self.settings.max_speed_m_s, STEP_S, horizon_s, self.settings.max_turn_deg_s
            )
            options.append(_Option(purpose, places, route))

        pick = self._picker(ledger.left())
        for index in range(GROUND_PATHS):
            corners: list[FloatArray] = []
            here, gone = centre, 0.0
            while gone < length_m and len(corners) < 8:
                target = pick()
                if index % 2:  # a nearby stretch rather than across the field
                    bearing = self._rng.uniform(0.0, 2.0 * math.pi)
                    target = here + self._rng.uniform(1.0, 4.0) * typical_m * np.array(
                        [math.sin(bearing), math.cos(bearing)]
                    )
                corners.append(target)
                gone += float(np.hypot(*(target - here)))
                here = target
            add("search", corners, spacings[index % len(spacings)])
        if self._last.get(team):
            add("search", np.array(self._last[team]), spacings[0])
        nearest = sorted(
            ledger.unresolved, key=lambda u: float(np.hypot(*(u.points_m.mean(axis=0) - centre)))
        )
        for candidate in nearest[:MAX_CANDIDATES]:
            for index in range(PATHS_PER_CANDIDATE):
                add(
                    f"resolve {candidate.ident}",
                    self._around(candidate, centre, typical_m, index),
                    spacings[0],
                )
        return options

    def _picker(self, weight: FloatArray) -> Callable[[], FloatArray]:
        """Draws the middle of a square of ground, by weight (n_north, n_east of the squares)."""
        weight = weight**1.5 if weight.sum() > 0 else np.ones(weight.shape)
        cumulative = np.cumsum(weight.ravel() / weight.sum())
        side = self._block * self.grid.cell_m
        columns = weight.shape[1]
        limit = np.array([self.grid.size_east_m, self.grid.size_north_m])

        def pick() -> FloatArray:
            index = min(int(np.searchsorted(cumulative, self._rng.random())), cumulative.size - 1)
            row, column = divmod(index, columns)
            return np.minimum(np.array([(column + 0.5) * side, (row + 0.5) * side]), limit)

        return pick

    def _around(
        self, candidate: Unresolved, centre: FloatArray, typical_m: float, index: int
    ) -> list[FloatArray]:
        """Corners round one possible place of a candidate: the nearest first, then on round it."""
        focus = candidate.points_m[int(self._rng.integers(candidate.points_m.shape[0]))]
        if index % 3 == 0:
            focus = candidate.points_m.mean(axis=0)
        radius = typical_m * (0.15, 0.35, 0.6, 0.9)[index % 4]
        away = centre - focus
        bearing = math.atan2(away[0], away[1]) + self._rng.uniform(-0.5, 0.5)
        turn = math.radians(120.0 if index % 2 else 75.0) * (1 if self._rng.random() < 0.5 else -1)
        return [
            focus + radius * np.array([math.sin(bearing + k * turn), math.cos(bearing + k * turn)])
            for k in range(6)
        ]


def blocks_summed(value: FloatArray, block: int) -> FloatArray:
    """`value` (n_north, n_east) summed over squares of `block` x `block` cells; the last ones may be cut."""
    if block == 1:
        return value
    rows, columns = np.arange(0, value.shape[0], block), np.arange(0, value.shape[1], block)
    return np.asarray(np.add.reduceat(np.add.reduceat(value, rows, axis=0), columns, axis=1))


def standing(start_m: FloatArray, horizon_s: float) -> FloatArray:
    """(steps, m, 2): the track of robots that stay at `start_m` (m, 2)."""
    return np.repeat(start_m[None], max(1, int(horizon_s / STEP_S)), axis=0)
