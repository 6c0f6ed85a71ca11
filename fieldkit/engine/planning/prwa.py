"""Pairwise ridge walking (PRWA Algorithm 2), on any belief that offers P(C_i) and P(C_i^1).

The level set of P(C_i) at 0.1 falls into components, each with a ridge; ridges are clustered over the pairs by
k-means, every pair tours its cluster, staying on each ridge in proportion to its weight and sweeping it back and
forth, as far abreast as leaves least entropy.

The paper waits until there are more components than pairs ("S(p) >= m/2"), which never comes with fewer sources
than pairs: here as many pairs as there are components walk ridges and the others walk at random.
"""

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.optimize import linear_sum_assignment

from fieldkit.engine.belief.base import Belief
from fieldkit.engine.planning.base import Planner, Situation
from fieldkit.engine.planning.ridges import Ridge, find_ridges
from fieldkit.engine.planning.spacing import best_spacing_m
from fieldkit.engine.planning.steering import Steering
from fieldkit.engine.planning.tour import off_ridge_m, ridge_tour, time_on_ridges_s
from fieldkit.engine.planning.walks import random_corners, typical_range_m
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Plan, Waypoint


class PrwaPlanner(Planner):
    """See the module."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self._rng = np.random.default_rng([settings.seed, 0x93A])
        self._steering = Steering(settings)

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """A tour of ridges for as many teams as there are components; random walks for the rest."""
        presence, activity = belief.presence(), belief.activity()
        ridges = find_ridges(presence, activity, self.settings.tuning.ridges.prwa_level, self.settings.grid)
        clusters = cluster_ridges(ridges, min(len(situation.teams), len(ridges)), self._rng)
        starts = [np.array([situation.position_m[r] for r in team]) for team in situation.teams]
        assigned = assign(clusters, [start.mean(axis=0) for start in starts])
        paths: dict[str, tuple[Waypoint, ...]] = {}
        purpose: dict[str, str] = {}
        for index, (team, start) in enumerate(zip(situation.teams, starts, strict=True)):
            own: dict[str, tuple[Waypoint, ...]] = {}
            why = "ridge"
            if index in assigned:
                mine = clusters[assigned[index]]
                corners = self._walk(mine, start.mean(axis=0))
                own = self._steering.steer(team, start, corners, self._spacing(mine, presence, activity))
            if not any(own.values()):  # no ridge, or none that can be reached
                corners, why = random_corners(self.settings, start.mean(axis=0), self._rng), "walk"
                own = self._steering.steer(team, start, corners, typical_range_m(self.settings))
            paths |= own
            purpose |= dict.fromkeys(team, why)
        return Plan(situation.t_ns, paths, purpose)

    def _walk(self, ridges: list[Ridge], start_m: FloatArray) -> FloatArray:
        """(k, 2) corners for one period: each ridge swept back and forth for its share of the time."""
        settings = self.settings
        ends = np.array([ridge.ends_m for ridge in ridges])
        order = ridge_tour(start_m, ends)
        speed = settings.max_speed_m_s
        time_s = time_on_ridges_s(
            np.array([ridge.weight for ridge in ridges]),
            settings.planning_period_s,
            off_ridge_m(start_m, ends, order),
            speed,
        )
        corners: list[FloatArray] = []
        for index, flip in order:
            entry, leave = ends[index][::-1] if flip else ends[index]
            length = ridges[index].length_m
            # Never faster than the robots: a ridge takes at least its length, an odd number of sweeps ends at `leave`.
            sweeps = max(1, int(time_s[index] * speed / length)) if length > settings.grid.cell_m else 1
            sweeps = min(sweeps | 1, 21)
            corners.append(entry)
            corners += [leave if k % 2 == 0 else entry for k in range(sweeps)]
        return np.array(corners)

    def _spacing(self, ridges: list[Ridge], presence: FloatArray, activity: FloatArray) -> float:
        settings, tuning = self.settings, self.settings.tuning.ridges
        cells = np.concatenate([ridge.cells for ridge in ridges])
        flat = np.concatenate([ridge.flat for ridge in ridges])
        if len(flat) > tuning.prwa_max_cells:
            keep = np.linspace(0, len(flat) - 1, tuning.prwa_max_cells).astype(int)
            cells, flat = cells[keep], flat[keep]
        heaviest = ridges[0]
        share = (np.arange(tuning.prwa_positions) + 0.5) / tuning.prwa_positions
        centres = heaviest.ends_m[0] + share[:, None] * (heaviest.ends_m[1] - heaviest.ends_m[0])
        along = heaviest.ends_m[1] - heaviest.ends_m[0]
        along = along / np.hypot(*along) if heaviest.length_m > 0 else np.array([0.0, 1.0])
        across = np.repeat(np.array([[-along[1], along[0]]]), tuning.prwa_positions, axis=0)
        longest = float(settings.antenna.nominal_range_m(max(settings.power_levels_db)))
        spacings = np.linspace(
            settings.min_separation_m, max(1.5 * longest, settings.min_separation_m), tuning.prwa_spacings
        )
        return best_spacing_m(
            settings,
            cells,
            presence.ravel()[flat],
            activity.ravel()[flat],
            centres,
            across,
            spacings,
            normalised=settings.normalised_entropy,
        )


def cluster_ridges(ridges: list[Ridge], count: int, rng: np.random.Generator) -> list[list[Ridge]]:
    """Ridges in `count` clusters by k-means of their middles, seeded farthest first; none is empty."""
    if count == 0:
        return []
    middles = np.array([ridge.middle_m for ridge in ridges])
    seeds = [middles[0]]
    while len(seeds) < count:
        distance = np.min([np.hypot(*(middles - seed).T) for seed in seeds], axis=0)
        seeds.append(middles[int(np.argmax(distance))])
    _, label = kmeans2(middles, np.array(seeds), minit="matrix", missing="warn", seed=rng) if count > 1 else (
        None,
        np.zeros(len(ridges), dtype=int),
    )  # fmt: skip
    clusters = [[ridge for ridge, at in zip(ridges, label, strict=True) if at == k] for k in range(count)]
    return [cluster for cluster in clusters if cluster]


def assign(clusters: list[list[Ridge]], teams_m: list[FloatArray]) -> dict[int, int]:
    """Team index to cluster index, least total distance (Hungarian)."""
    if not clusters:
        return {}
    centres = np.array([np.mean([ridge.middle_m for ridge in cluster], axis=0) for cluster in clusters])
    distance = np.array([np.hypot(*(centres - team).T) for team in teams_m])
    rows, columns = linear_sum_assignment(distance)
    return {int(team): int(cluster) for team, cluster in zip(rows, columns, strict=True)}
