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

from fieldkit.antenna.model import MIN_RANGE_M
from fieldkit.engine import kernels
from fieldkit.engine.belief.base import Belief
from fieldkit.engine.belief.intensity import IntensityBelief, Unresolved
from fieldkit.engine.planning.base import Situation, abreast, legs_within_range, track, waypoints
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from fieldkit.messages import FloatArray, Plan, Waypoint

HORIZON_PERIODS = 1.5
GROUND_PATHS = 40
PATHS_PER_CANDIDATE = 16
MAX_CANDIDATES = 6
SAMPLES = 16
STEP_S = 1.5
SPACINGS = (0.6, 1.0)
"""How far abreast teams may search, in typical ranges; candidates are resolved at the first."""
RESOLVE_VALUE = 2.0
RECEPTION_VALUE = 0.4
GROUND_VALUE = 1.0
GROUND_BLOCK = 0.4
"""Side of the squares in which ground is valued, at most, in the shortest typical range."""
TARGET_CELLS = 0.45
"""Standard deviation, in cells, at which a place is certain to within one cell."""


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
        model = belief.model
        horizon_s = HORIZON_PERIODS * self.settings.planning_period_s
        value = blocks_summed(GROUND_VALUE * belief.ground_value(), self._block)
        planned_s = np.zeros(value.shape)
        scratch = np.empty(value.shape)
        unresolved = belief.unresolved(SAMPLES, self._rng)
        information = {u.ident: np.zeros(4) for u in unresolved}
        taken: list[FloatArray] = []

        def ground_gain(route: FloatArray) -> float:
            """Also leaves the path's own exposure in `scratch`."""
            return kernels.path_ground_gain(
                route,
                STEP_S,
                value,
                planned_s,
                self._block * self.grid.cell_m,
                model.hear_known_mean,
                model.step2_m2,
                model.search_reach_m,
                self.settings.reference_rate_hz,
                scratch,
            )

        def learnt(route: FloatArray, candidate: Unresolved) -> FloatArray:
            gained = np.empty(4)
            kernels.path_information(
                route, STEP_S, candidate.points_m, candidate.level, model.hear, model.step2_m2, MIN_RANGE_M, gained
            )  # fmt: skip
            return gained

        def take(route: FloatArray) -> None:
            """What a team does is left out of what the others gain."""
            nonlocal planned_s, scratch
            scratch = np.zeros(value.shape)
            ground_gain(route)
            planned_s = planned_s + scratch
            for candidate in unresolved:
                information[candidate.ident] = information[candidate.ident] + learnt(route, candidate)
            taken.append(route)

        for team, busy in situation.busy.items():
            if all(robot in situation.position_m for robot in team):
                take(self._underway(team, busy, situation, horizon_s))
        paths: dict[str, tuple[Waypoint, ...]] = {}
        purpose: dict[str, str] = {}
        for team in situation.teams:
            start = np.array([situation.position_m[robot] for robot in team])
            best, best_score = None, -math.inf
            for option in self._options(
                situation, team, start, belief, value, planned_s, unresolved, horizon_s
            ):
                if any(not self._clear(option.track_m, other) for other in taken):
                    continue
                score = ground_gain(option.track_m)
                for candidate in unresolved:
                    gained = learnt(option.track_m, candidate)
                    if gained[0] > 1e-3:
                        before = information[candidate.ident]
                        score += self._progress(candidate, before + gained) - self._progress(
                            candidate, before
                        )
                if score > best_score:
                    best, best_score = option, score
            if best is None:  # boxed in by the others, or no battery left for any path: stay
                for robot in team:
                    paths[robot], purpose[robot] = (), "wait"
                taken.append(np.repeat(start[None], max(1, int(horizon_s / STEP_S)), axis=0))
                continue
            take(best.track_m)
            self._last[team] = [tuple(place.mean(axis=0)) for place in best.places_m]
            for robot, path in zip(
                team, waypoints(best.places_m, start, self.settings.max_speed_m_s), strict=True
            ):
                paths[robot], purpose[robot] = path, best.purpose
        return Plan(situation.t_ns, paths, purpose)

    def _underway(
        self, team: tuple[str, ...], plan: Plan, situation: Situation, horizon_s: float
    ) -> FloatArray:
        """(steps, m, 2): where a team that goes on will be."""
        start = np.array([situation.position_m[robot] for robot in team])
        legs = max(len(plan.paths[robot]) for robot in team)
        if legs == 0:
            return np.repeat(start[None], max(1, int(horizon_s / STEP_S)), axis=0)
        places = np.empty((legs, len(team), 2))
        for slot, robot in enumerate(team):
            path = [(w.east_m, w.north_m) for w in plan.paths[robot]]
            path += [path[-1] if path else tuple(start[slot])] * (legs - len(path))
            places[:, slot] = path
        return track(
            places, start, self.settings.max_speed_m_s, STEP_S, horizon_s, self.settings.max_turn_deg_s
        )

    def _progress(self, candidate: Unresolved, gained: FloatArray) -> float:
        """Worth of what is known of a candidate after a path: (4,) exposure and information per unit rate."""
        rate = candidate.rate_hz
        antenna = self.settings.antenna
        scale = (10.0 * antenna.path_loss_exponent / (antenna.sigma_db * math.log(10.0))) ** 2 * rate
        floor = (0.1 * self.grid.cell_m) ** 2
        ee, en, nn = candidate.cov_m2[0, 0] + floor, candidate.cov_m2[0, 1], candidate.cov_m2[1, 1] + floor
        det = ee * nn - en * en
        ee, en, nn = nn / det + scale * gained[1], scale * gained[2] - en / det, ee / det + scale * gained[3]
        # Receptions still needed grow with the precision still missing: so counted, a candidate that is nearly
        # resolved is worth finishing before driving to the next. Eigenvalues of the precision, closed form.
        target = (TARGET_CELLS * self.grid.cell_m) ** 2
        middle, half = (ee + nn) / 2.0, math.hypot((ee - nn) / 2.0, en)
        done = (min((middle - half) * target, 1.0) + min((middle + half) * target, 1.0)) / 2.0
        missing = max(1.0, self.settings.min_receptions - candidate.receptions)
        received = 1.0 - math.exp(-rate * gained[0] / missing)
        worth = 0.3 if candidate.state == "doubtful" else 1.0
        return worth * (RESOLVE_VALUE * done + RECEPTION_VALUE * received)

    def _blocked(self, corners_m: FloatArray) -> bool:
        """Whether a robot's way along corners (legs, m, 2) crosses ground to be kept out of."""
        before, after = corners_m[:-1].reshape(-1, 2), corners_m[1:].reshape(-1, 2)
        return bool(self.settings.keep_out.blocks(before, after).any())

    def _clear(self, one: FloatArray, other: FloatArray) -> bool:
        """Whether two tracks keep the separation at every step after the first few, when they may yet part."""
        steps = min(one.shape[0], other.shape[0])
        gaps = one[:steps, :, None, :] - other[:steps, None, :, :]
        distance = np.hypot(gaps[..., 0], gaps[..., 1]).min(axis=(1, 2))
        floor = np.minimum(self.settings.min_separation_m, distance[0] - 1e-6)
        return bool((distance >= floor).all())

    # -- paths to choose from ----------------------------------------------------------------------------

    def _options(
        self,
        situation: Situation,
        team: tuple[str, ...],
        start: FloatArray,
        belief: IntensityBelief,
        value: FloatArray,
        planned_s: FloatArray,
        unresolved: list[Unresolved],
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

        left = value * np.exp(-self.settings.reference_rate_hz * planned_s)
        left = left / left.sum() if left.sum() > 0 else np.full(left.shape, 1.0 / left.size)
        pick = self._picker(left**1.5)
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
        nearest = sorted(unresolved, key=lambda u: float(np.hypot(*(u.points_m.mean(axis=0) - centre))))
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
