"""When which team is planned for: at every period, when it has no task, and when it has just heard something new."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from fieldkit.engine.planning.base import Team
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, SourceEstimate

NEWS_RANGES = 2.0
"""Within so many nominal ranges of the loudest source, what a robot hears may be from a source not found yet."""
NEWS_EVERY_S = 5.0
"""A team is not planned for anew more often on what it hears."""


@dataclass
class PlanningTurns:
    """The teams that wait for a plan, and when each was last planned for."""

    engine: EngineSettings
    _next_ns: int | None = None
    _waiting: set[Team] = field(default_factory=set)
    _planned_ns: dict[Team, int] = field(default_factory=dict)

    def start_anew(self) -> None:
        """All teams are planned for at the next tick, as at the beginning."""
        self._next_ns = None

    def is_due(self, now_ns: int) -> bool:
        """Whether a period has ended."""
        return self._next_ns is None or now_ns >= self._next_ns

    def hear(
        self,
        now_ns: int,
        teams: tuple[Team, ...],
        detections: list[Detection],
        sources: Iterable[SourceEstimate],
    ) -> None:
        """Teams that have just heard something near a source not found yet should stay rather than drive on."""
        open_m = [(s.east_m, s.north_m) for s in sources if s.state in ("candidate", "inconsistent")]
        reach_m = NEWS_RANGES * float(self.engine.antenna.nominal_range_m(max(self.engine.power_levels_db)))
        heard_by = {
            robot
            for detection in detections
            for robot, heard, place_m in zip(
                detection.robots, detection.heard, detection.position_m, strict=True
            )
            if heard and any(np.hypot(*(place_m - source_m)) <= reach_m for source_m in open_m)
        }
        latest_ns = now_ns - round(NEWS_EVERY_S * 1e9)
        self._waiting.update(
            team
            for team in teams
            if heard_by.intersection(team) and self._planned_ns.get(team, 0) <= latest_ns
        )

    def take(
        self,
        now_ns: int,
        teams: tuple[Team, ...],
        busy: Collection[Team],
        *,
        found_more: bool,
        one_at_a_time: bool,
    ) -> tuple[Team, ...]:
        """Which teams to plan for at this tick; `busy` are those with a task.

        A planner that goes team by team is asked for one team a tick, the longest planned first: with many teams a
        plan for all would keep the radios waiting.
        """
        if self.is_due(now_ns) or found_more:
            self._next_ns = now_ns + round(self.engine.planning_period_s * 1e9)
            self._waiting = set(teams)
        self._waiting.update(team for team in teams if team not in busy)
        turns = sorted(self._waiting.intersection(teams), key=lambda t: (self._planned_ns.get(t, 0), t))
        if one_at_a_time:
            turns = turns[:1]
        self._waiting.difference_update(turns)
        self._planned_ns.update(dict.fromkeys(turns, now_ns))
        return tuple(turns)
