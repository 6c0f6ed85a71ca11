"""DPRWA for robots that decide apart: every one plans the next ring from what Lemma 2 gives to all of them.

That is the belief as it was when the last ring began, of which all have had a checkpoint when it ends, and the places
at which its plan ends. So robots out of contact plan the same ring, and meet on it again. It begins by the clock, not
when the last robot is there, and is of the teams that could be sent when the last one began.

What a kernel keeps that has been told of everybody (`mission.core.timeline`, its common line) is the same everywhere.
One that goes on without some keeps what it knows, until it is made anew from the common one. A robot for which no
checkpoint came in a whole ring plans from that: it is off the others' ring until it meets somebody.

Robots late on their way drive on to where they should be; see `dprwa`. Teams that come late to the first ring, before
it has begun, have it planned anew; later ones wait for the next. With ridges in several groups (`group_gap_m`) only
the teams of a group meet.
"""

from dataclasses import dataclass

import numpy as np

from fieldkit.engine.belief.base import Belief, Snapshot
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.dprwa import DprwaPlanner
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Plan

Team = tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """What the next ring is planned from, and who was where."""

    teams: tuple[Team, ...]
    place_m: dict[str, tuple[float, float]]
    belief: Snapshot


class DprwaApartPlanner(DprwaPlanner):
    """See the module."""

    def __init__(
        self,
        settings: EngineSettings,
        *,
        tau0_s: float | None = None,
        ridges: int | None = None,
    ) -> None:
        """As `DprwaPlanner`."""
        super().__init__(settings, tau0_s=tau0_s, ridges=ridges)
        self.ring_ns = 0
        """When the present ring begins: everybody is in place."""
        self.meetings_ns: list[tuple[int, Team, Team]] = []
        """When which teams meet on the present ring."""
        self.kept: Kept | None = None
        """Of the present ring's beginning; None before it."""
        self._has_rung = False
        """Whether a ring has ever begun."""

    @property
    def until_ns(self) -> int:
        """When the present ring ends, and the next period begins."""
        return self._until_ns

    def plan(self, situation: Situation, belief: Belief) -> Plan:
        """What is left of the present period, or of a new one once its time has come."""
        now_ns = situation.t_ns
        due = {robot for team in situation.teams for robot in team}
        if not due:
            return Plan(now_ns, {}, {})
        if self.period and self.kept is None and now_ns >= self.ring_ns:
            self.kept, self._has_rung = self._keep(situation, belief), True
        if not self.period or (not self._has_rung and due - self._ways.keys()):
            self._ways = {}
            self._begin(now_ns, self._keep(situation, belief))
        while now_ns >= self._until_ns:
            self._begin(self._until_ns, self.kept or self._keep(situation, belief))
        placed = due.intersection(self._ways)
        plan = self._rest(situation, placed)
        for robot in due - placed:
            plan.paths[robot], plan.purpose[robot] = (), "wait"
        return plan

    def _keep(self, situation: Situation, belief: Belief) -> Kept:
        sent = {robot for team in (*situation.teams, *situation.busy) for robot in team}
        teams = (tuple(robot for robot in team if robot in sent) for team in self.settings.teams)
        return Kept(
            tuple(team for team in teams if team),
            dict(situation.position_m),
            Snapshot.of(belief),
        )

    def _begin(self, t_ns: int, kept: Kept) -> None:
        """A period from `t_ns` on, from where the last one ends."""
        ends = {robot: place[-1] for robot, (_, place) in self._ways.items()}
        here = [
            np.array([ends.get(robot, kept.place_m.get(robot, (0.0, 0.0))) for robot in team], dtype=float)
            for team in kept.teams
        ]
        self._ways, self.meetings_ns, self.kept = {}, [], None
        self.ring_ns = self._until_ns = t_ns
        for members, period in self.periods(here, kept.belief):
            ring_ns = t_ns + round(period.ring_start_s * 1e9)
            self.ring_ns = max(self.ring_ns, ring_ns)
            self._until_ns = max(self._until_ns, t_ns + round(period.duration_s * 1e9))
            for index, number in enumerate(members):
                times = t_ns + np.rint(period.t_s[index] * 1e9).astype(np.int64)
                for k, robot in enumerate(kept.teams[number]):
                    self._ways[robot] = (times, period.place_m[index][:, k])
            for meeting in period.meetings:
                first, second = (kept.teams[members[k]] for k in (meeting.first, meeting.second))
                self.meetings_ns.append((ring_ns + round(meeting.t_s * 1e9), first, second))

    def _rest(self, situation: Situation, due: set[str]) -> Plan:
        """Before its ring begins a robot has only the way to it: who is there asks again, and its beginning is kept."""
        ways, now_ns = self._ways, situation.t_ns
        self._ways = {
            # Without the corner at which it would wait for the others: robots on a path drive slowly instead.
            robot: (t_ns[2:3], place[2:3]) if now_ns < t_ns[2] else (t_ns, place)
            for robot, (t_ns, place) in ways.items()
        }
        try:
            return super()._rest(situation, due)
        finally:
            self._ways = ways
