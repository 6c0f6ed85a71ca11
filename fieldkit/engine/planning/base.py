"""What every planner offers to the kernel, and how a team moves abreast."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from fieldkit.engine.belief.base import Belief, Unresolved
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning import path_loops
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
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
    range_m: Mapping[str, float] = field(default_factory=dict)
    """How far a robot can still drive, the way home included; robots not named can go anywhere."""
    home_m: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Where those robots have to come back to."""
    up_m: Mapping[str, float] = field(default_factory=dict)
    """How high robots are above the field's origin; robots not named are on it."""
    removed: frozenset[int] = frozenset()
    """Sources that were taken away: nobody is sent to look at them."""


class HearingModel(Protocol):
    """How likely one robot hears a packet, against squared distance: tables with a column for each `step2_m2`.

    `fieldkit.engine.likelihood.levels.LevelsModel` is one.
    """

    hear: FloatArray
    """(h, steps) P(heard) at squared distance (k + 1/2) * step2_m2, by power hypothesis."""
    hear_known_mean: FloatArray
    """(steps,) the same averaged over the power levels a source may have."""
    step2_m2: float
    search_reach_m: float
    """Beyond this distance `hear_known_mean` counts as nothing."""


@runtime_checkable
class InformativeBelief(Belief, Protocol):
    """A belief that also says what there is to learn, and where: what the planner `infogain` asks for."""

    @property
    def model(self) -> HearingModel:
        """What the belief takes for granted about hearing."""
        ...

    @property
    def exposure_s(self) -> FloatArray:
        """(h, n_north, n_east): P(some robot hears a source there) integrated over the time listened."""
        ...

    def ground_value(self) -> FloatArray:
        """(n_north, n_east) expected number of sources of the reference rate that are not among the candidates."""
        ...

    def unresolved(self, samples: int, rng: np.random.Generator) -> list[Unresolved]:
        """Candidates to be listened to again, each with so many samples of where and how strong it may be."""
        ...


def informative(belief: Belief, planner: str) -> InformativeBelief:
    """The belief as one that says what there is to learn. Raises `ConfigError` that names what it lacks."""
    if isinstance(belief, InformativeBelief):
        return belief
    needed = ("exposure_s", "ground_value", "model", "unresolved")
    lacks = ", ".join(name for name in needed if not hasattr(belief, name))
    raise ConfigError(
        f"planner '{planner}' needs a belief that says what there is to learn, as 'intensity' does; "
        f"{type(belief).__name__} lacks {lacks}: choose planner 'prwa' for it"
    )


@runtime_checkable
class PointingBelief(Belief, Protocol):
    """A belief that knows its most probable place better than the highest cell of `presence`."""

    def most_probable(self) -> tuple[float, float] | None:
        """East and north in metres; None where no place stands out."""
        ...


Team = tuple[str, ...]
"""Robots that are planned for together."""


class Planner(Protocol):
    """Decides where teams go. Deterministic given its own seeded generator.

    Planners inherit from it explicitly, and so from its default of `TEAM_BY_TEAM`.
    """

    TEAM_BY_TEAM: ClassVar[bool] = False
    """True: it plans for one team on what the others (`Situation.busy`) leave, and is asked for one at a time.
    False: it is asked for all teams together."""

    def __init__(self, settings: EngineSettings) -> None: ...

    def teams(self, stated: tuple[Team, ...]) -> tuple[Team, ...]:
        """Who is planned for together, of the teams that the mission states: as stated, where it says nothing else."""
        return stated

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
    path_loops.abreast(
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
    places_m: FloatArray,
    start_m: FloatArray,
    speed_m_s: float,
    step_s: float,
    horizon_s: float,
    turn_deg_s: float = np.inf,
) -> FloatArray:
    """(steps, m, 2): where robots are every `step_s` until `horizon_s` on places (legs, m, 2); they wait at the end.

    At a corner the team waits until its slowest robot has turned on the spot, at `turn_deg_s`.
    """
    out = np.empty((max(1, int(horizon_s / step_s)), start_m.shape[0], 2))
    path_loops.track(
        np.ascontiguousarray(places_m),
        np.ascontiguousarray(start_m),
        speed_m_s,
        np.radians(turn_deg_s),
        step_s,
        out,
    )
    return out


def legs_within_range(
    places_m: FloatArray, start_m: FloatArray, range_m: FloatArray, home_m: FloatArray
) -> int:
    """How many of the places (legs, m, 2) every robot can go to one after another and still come home.

    `range_m` (m,) is how far each can drive, `home_m` (m, 2) where it has to come back to.
    """
    if np.isinf(range_m).all():
        return len(places_m)
    corners = np.concatenate([start_m[None], places_m])
    legs = np.diff(corners, axis=0)
    gone = np.cumsum(np.hypot(legs[..., 0], legs[..., 1]), axis=0)
    back = places_m - home_m
    too_far = (gone + np.hypot(back[..., 0], back[..., 1]) > range_m).any(axis=1)
    return int(np.argmax(too_far)) if too_far.any() else len(places_m)
