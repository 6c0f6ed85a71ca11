"""Decentralised pairwise ridge walking (DPRWA Algorithm 1): one tour of ridges that all pairs share, as a ring in time.

Ridges of the level set at 0.1 are merged with virtual ones, laid at random anew in every period, until there are
`tuning.ridges.dprwa_ridges`: the only exploration in these papers. Chance comes from (seed, number of the period), so
pairs that plan apart from the same belief plan the same.

What the paper leaves open: the number of ridges; a virtual ridge is 0.1 to 0.3 of the field's shorter side long and
weighs what P(C_i^1) is within a typical range of it; a ridge of one cell is walked one cell long; ridges that distance
splits into groups each get pairs by their summed weight, at least one, and virtual ridges join the nearest group.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist, squareform

from fieldkit.engine.belief.base import Belief, RidgedBelief
from fieldkit.engine.planning.base import Planner, Situation
from fieldkit.engine.planning.circle import Circle, Period, make_circle, plan_period
from fieldkit.engine.planning.detour import Detours, shares_of_length
from fieldkit.engine.planning.ridges import Ridge, find_ridges
from fieldkit.engine.planning.tour import ridge_tour
from fieldkit.engine.planning.walks import typical_range_m
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from fieldkit.messages import FloatArray, Plan, Waypoint

SLOWEST_M_S = 0.01


class DprwaPlanner(Planner):
    """See the module."""

    alone = False

    def __init__(
        self,
        settings: EngineSettings,
        *,
        tau0_s: float | None = None,
        ridges: int | None = None,
    ) -> None:
        """Circumference of the ring and number of ridges as tuned, or as given; `ConfigError` for none of either."""
        tau0_s = settings.tuning.ridges.dprwa_tau0_s if tau0_s is None else tau0_s
        ridges = settings.tuning.ridges.dprwa_ridges if ridges is None else ridges
        if ridges < 1 or not tau0_s > 0.0:
            raise ConfigError(
                f"dprwa: expected at least 1 ridge and tau0_s above 0, got {ridges} and {tau0_s}"
            )
        self.settings, self.tau0_s, self.most_ridges = settings, tau0_s, ridges
        self._detours = Detours(
            settings.grid, settings.keep_out, settings.fence_margin_m, settings.tuning.ridges.clearance_m
        )
        self.period = 0
        """Number of the planning period: plans made so far."""
        self._ways: dict[str, tuple[NDArray[np.int64], FloatArray]] = {}
        """When (k,) each robot is where (k, 2) in the present period."""
        self._until_ns = 0

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """What is left of the present period, or the paths of a new one once it is over and all teams can be sent.

        Robots on a path cannot wait: who is near its place on the ring drives there slowly. Who has come to the end
        before the others stays.
        """
        due = {robot for team in situation.teams for robot in team}
        if due <= self._ways.keys() and (situation.t_ns < self._until_ns or situation.busy):
            return self._rest(situation, due)
        here = [np.array([situation.position_m[r] for r in team]) for team in situation.teams]
        self._ways, self._until_ns = {}, situation.t_ns
        for members, period in self.periods(here, belief):
            for index, team in enumerate(members):
                # Without the corner at which it would wait for the others.
                t_ns = situation.t_ns + np.rint(np.delete(period.t_s[index], 1) * 1e9).astype(np.int64)
                place = np.delete(period.place_m[index], 1, axis=0)
                for k, robot in enumerate(situation.teams[team]):
                    self._ways[robot] = (t_ns, place[:, k])
                self._until_ns = max(self._until_ns, int(t_ns[-1]))
        return self._rest(situation, due)

    def _rest(self, situation: Situation, due: set[str]) -> Plan:
        """Paths along what is still to come of each robot's way, round what must not be entered."""
        paths: dict[str, tuple[Waypoint, ...]] = {}
        for robot in sorted(due):
            t_ns, place = self._ways[robot]
            left = t_ns > situation.t_ns
            corners = np.concatenate([[situation.position_m[robot]], place[left]])
            t_s = np.concatenate([[0.0], (t_ns[left] - situation.t_ns) * 1e-9])
            paths[robot] = _timed(*self._detours.timed(t_s, corners), self.settings.max_speed_m_s)
        return Plan(situation.t_ns, paths, dict.fromkeys(paths, "ring"))

    def periods(self, here_m: list[FloatArray], belief: RidgedBelief) -> list[tuple[list[int], Period]]:
        """For each group the indices of its teams, and their movements; `here_m` holds (m, 2) of each team."""
        self.period += 1
        if not here_m:
            return []
        real, virtual = self.ridges(belief)
        ridges = real + virtual
        groups = group_ridges(real or virtual, self.settings.group_gap_m, len(here_m))
        if real:
            for index, ridge in enumerate(virtual, start=len(real)):
                groups[
                    _nearest(ridge, [[real[r] for r in group if r < len(real)] for group in groups])
                ].append(index)
        weights = np.array([sum(ridges[r].weight for r in group) for group in groups])
        slots = np.repeat(np.arange(len(groups)), dispatch(weights, len(here_m)))
        middles = np.array([np.mean([ridges[r].middle_m for r in group], axis=0) for group in groups])
        cost = cdist([here.mean(axis=0) for here in here_m], middles[slots])
        # One group: pairs keep their order on the ring, as the paper has it.
        chosen = slots if len(groups) == 1 else slots[linear_sum_assignment(cost)[1]]
        result = []
        for index, group in enumerate(groups):
            members = [team for team in range(len(here_m)) if chosen[team] == index]
            circle = self._circle([ridges[r] for r in group], {len(here_m[team]) for team in members})
            speed = self.settings.max_speed_m_s
            result.append((members, plan_period(circle, [here_m[team] for team in members], speed)))
        return result

    def ridges(self, belief: RidgedBelief) -> tuple[list[Ridge], list[Ridge]]:
        """Those of the level set and, up to `most_ridges` in all, virtual ones of this period."""
        activity = belief.activity()
        real = find_ridges(
            belief.presence(), activity, self.settings.tuning.ridges.dprwa_level, self.settings.grid
        )
        chance = np.random.default_rng([self.settings.seed, 0xD9, self.period])
        return real, virtual_ridges(self.settings, activity, max(0, self.most_ridges - len(real)), chance)

    def _circle(self, ridges: list[Ridge], sizes: set[int]) -> Circle:
        settings = self.settings
        ends = np.array([_at_least(ridge.ends_m, settings.grid.cell_m) for ridge in ridges])
        points = ends.reshape(-1, 2)
        leftmost = points[np.lexsort((points[:, 1], points[:, 0]))[0]]  # where moment 0 of the ring is
        order = ridge_tour(leftmost, ends, closed=True)
        corners = np.concatenate([ends[r][::-1] if flip else ends[r] for r, flip in order])
        weight = np.zeros(len(corners))
        weight[::2] = [ridges[r].weight for r, _ in order]  # the legs on ridges
        corners, weight = self._round(corners, weight)
        spacing = max(typical_range_m(settings), settings.min_separation_m)
        return make_circle(
            corners,
            weight,
            self.tau0_s,
            settings.max_speed_m_s,
            spacing,
            sizes,
            settings.grid,
            settings.fence_margin_m,
        )

    def _round(self, corners_m: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The ring's corners (k, 2) and the weights (k,) of the legs from them, with detours put in between.

        Corners that cannot be reached are left out, with what their legs weigh; where that leaves no ring, nothing is.
        """
        free = np.flatnonzero(~self.settings.keep_out.contains(corners_m))
        if not self.settings.keep_out.needs_detours or len(free) == 0:
            return corners_m, weight
        last = free[0]
        places, weights = [corners_m[last]], []
        for index in [*free[1:], free[0]]:
            way = self._detours.way(places[-1], corners_m[index])
            if way is not None:
                weights.extend(weight[last] * shares_of_length(np.concatenate([places[-1][None], way])))
                places.extend(way)
                last = index
        if len(places) < 3 or last != free[0]:
            return corners_m, weight
        return np.array(places[:-1]), np.array(weights)


def virtual_ridges(
    settings: EngineSettings, activity: FloatArray, count: int, chance: np.random.Generator
) -> list[Ridge]:
    """`count` segments anywhere in the field."""
    grid = settings.grid
    size = np.array([grid.size_east_m, grid.size_north_m])
    reach = typical_range_m(settings)
    ridges = []
    for _ in range(count):
        middle = chance.uniform(0.0, size)
        heading, half = chance.uniform(0.0, np.pi), 0.5 * chance.uniform(0.1, 0.3) * size.min()
        along = half * np.array([np.sin(heading), np.cos(heading)])
        ends = np.clip(np.array([middle - along, middle + along]), 0.0, size)
        flat = np.flatnonzero(_distance_m(grid.centres_m, ends) <= reach)
        ridges.append(Ridge(ends, grid.centres_m[flat], flat, float(activity.ravel()[flat].sum())))
    return ridges


def group_ridges(ridges: list[Ridge], gap_m: float, most: int) -> list[list[int]]:
    """Indices of ridges in groups further than `gap_m` apart, the nearest merged until there are at most `most`."""
    if len(ridges) < 2 or most < 2 or np.isinf(gap_m):
        return [list(range(len(ridges)))]
    ends = np.array([ridge.ends_m for ridge in ridges])
    along = np.linspace(0.0, 1.0, 5)[:, None]
    points = ends[:, :1] + along * (ends[:, 1:] - ends[:, :1])
    distance = np.array([[cdist(a, b).min() for b in points] for a in points])
    np.fill_diagonal(distance, 0.0)
    tree = linkage(squareform(distance, checks=False), "single")
    label = fcluster(tree, gap_m, "distance")
    if label.max() > most:
        label = fcluster(tree, most, "maxclust")
    return [[int(r) for r in np.flatnonzero(label == k)] for k in np.unique(label)]


def dispatch(weights: FloatArray, pairs: int) -> list[int]:
    """Pairs for each of at most as many groups: one each, and the others by weight (largest remainders)."""
    if len(weights) > pairs:
        raise ValueError(f"weights: {len(weights)} groups for {pairs} pairs; merge groups first")
    total = float(np.sum(weights))
    share = np.full(len(weights), 1.0 / len(weights)) if total <= 0.0 else np.asarray(weights) / total
    given = np.ones(len(weights), dtype=int)
    while given.sum() < pairs:
        given[int(np.argmax(share * pairs - given))] += 1
    return [int(n) for n in given]


def _nearest(ridge: Ridge, groups: list[list[Ridge]]) -> int:
    """The group one of whose ridges has its middle nearest to that of `ridge`."""
    distance = [min(float(np.hypot(*(r.middle_m - ridge.middle_m))) for r in group) for group in groups]
    return int(np.argmin(distance))


def _at_least(ends_m: FloatArray, length_m: float) -> FloatArray:
    """A ridge of one cell has no length: it is walked one cell long, west to east."""
    if np.hypot(*(ends_m[1] - ends_m[0])) > 1e-9:
        return ends_m
    return ends_m + 0.5 * length_m * np.array([[-1.0, 0.0], [1.0, 0.0]])


def _distance_m(points_m: FloatArray, ends_m: FloatArray) -> FloatArray:
    """(n,) distance of points (n, 2) from a segment (2, 2)."""
    along = ends_m[1] - ends_m[0]
    share = np.clip((points_m - ends_m[0]) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(points_m - ends_m[0] - share[:, None] * along).T))


def _timed(t_s: FloatArray, place_m: FloatArray, top_m_s: float) -> tuple[Waypoint, ...]:
    """Way-points of one robot that is at places (k, 2) at times (k,)."""
    legs = np.hypot(*np.diff(place_m, axis=0).T)
    speed = np.clip(legs / np.maximum(np.diff(t_s), 1e-9), SLOWEST_M_S, top_m_s)
    return tuple(Waypoint(float(e), float(n), float(v)) for (e, n), v in zip(place_m[1:], speed, strict=True))
