"""What every planner offers to the kernel, and how a team moves abreast."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from fieldkit.engine import kernels
from fieldkit.engine.belief.base import Belief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Plan, Waypoint


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What a planner may look at: who is where, and which teams may be sent."""

    t_ns: int
    position_m: Mapping[str, tuple[float, float]]
    """Robots whose position is known and fresh."""
    teams: tuple[tuple[str, ...], ...]
    """Teams to plan for, reduced to the robots that can be steered."""
    busy: Mapping[tuple[str, ...], Plan]
    """Teams that keep going, with the plan they follow: to be kept clear of."""


class Planner(Protocol):
    """Decides where teams go. Deterministic given its own seeded generator."""

    def __init__(self, settings: EngineSettings) -> None: ...

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """Paths for every robot in `situation.teams`. An empty path means: stay."""
        ...


def abreast(
    centre_path_m: FloatArray, start_m: FloatArray, spacing_m: float, grid: Grid, margin_m: float
) -> FloatArray:
    """Way-points (legs, m, 2) of m robots that follow a centre path (legs, 2) side by side.

    `start_m` (m, 2) is where they are. Each leg's places are dealt to the robots so that they walk least and do
    not cross. Places are clipped to the field, `margin_m` inside its border. One robot follows the centre path.
    """
    low = np.array([margin_m, margin_m])
    high = np.maximum(low, np.array([grid.size_east_m, grid.size_north_m]) - margin_m)
    places = np.empty((centre_path_m.shape[0], start_m.shape[0], 2))
    kernels.abreast(
        np.ascontiguousarray(centre_path_m), np.ascontiguousarray(start_m), spacing_m, low, high, places
    )
    return places


def waypoints(places_m: FloatArray, start_m: FloatArray, max_speed_m_s: float) -> list[tuple[Waypoint, ...]]:
    """One path per robot from places (legs, m, 2): on each leg the nearer robot goes slower: all arrive together."""
    paths: list[list[Waypoint]] = [[] for _ in range(start_m.shape[0])]
    for before, after in pairwise([start_m, *places_m]):
        length = np.hypot(*(after - before).T)
        longest = max(float(length.max()), 1e-9)
        for robot, place in enumerate(after):
            speed = max_speed_m_s * max(0.25, float(length[robot]) / longest)
            paths[robot].append(Waypoint(float(place[0]), float(place[1]), speed))
    return [tuple(path) for path in paths]


def track(
    places_m: FloatArray, start_m: FloatArray, speed_m_s: float, step_s: float, horizon_s: float
) -> FloatArray:
    """(steps, m, 2): where robots are every `step_s` until `horizon_s` on places (legs, m, 2); they wait at the end."""
    steps = max(1, int(horizon_s / step_s))
    corners = np.concatenate([start_m[None], places_m])
    lengths = np.hypot(*(np.diff(corners, axis=0).transpose(2, 0, 1))).max(axis=1)
    at_s = np.concatenate([[0.0], np.cumsum(lengths / speed_m_s + 1e-9)])
    t = (np.arange(steps) + 0.5) * step_s
    leg = np.clip(np.searchsorted(at_s, t, side="right") - 1, 0, len(lengths) - 1)
    share = np.clip((t - at_s[leg]) / (at_s[leg + 1] - at_s[leg]), 0.0, 1.0)
    return np.ascontiguousarray(corners[leg] + share[:, None, None] * (corners[leg + 1] - corners[leg]))
