"""Two lines of time through everybody's logs: the one that all agree on, and the one to go by meanwhile. Pure.

The common line goes as far as everybody's logs are known. Robots out of contact would hold it up, so where some are, a
member goes on with a copy that waits for those in contact alone; whoever hears the same robots has the same copy. When
the missing ones are back the common line catches up, and all return to it.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from fieldkit.engine.decentralised.logs import NEVER, TICK_NS, Logs
from fieldkit.messages import Command
from fieldkit.settings import AGENT_ABSENT_S, AGENT_WAIT_S, TICK_S
from mission.core.kernel import Kernel, Outcome
from mission.core.kernel_settings import KernelSettings
from mission.core.timeline import Timeline

CATCH_UP_TICKS = 20
"""Ticks that a line is moved on by at one tick: more would keep a robot from being steered meanwhile."""
ABSENT_TICKS = math.ceil(AGENT_ABSENT_S / TICK_S)


def gathered(commands: Iterable[Command], outcomes: Iterable[Outcome]) -> Outcome:
    """One outcome of several: these commands, the last plan, all that was heard and noted."""
    outcomes = tuple(outcomes)
    detections = tuple(each for outcome in outcomes for each in outcome.detections)
    plans = [outcome.plan for outcome in outcomes if outcome.plan is not None]
    notes = tuple(note for outcome in outcomes for note in outcome.notes)
    return Outcome(tuple(commands), detections, plans[-1] if plans else None, notes)


@dataclass
class Lines:
    """See the module."""

    settings: KernelSettings
    logs: Logs
    most_ticks: int = CATCH_UP_TICKS
    patience_s: float = AGENT_WAIT_S.default
    """So long after its first tick it waits for robots that nobody has heard of."""
    common: Timeline = field(init=False)
    """What everybody agrees on."""
    line: Timeline = field(init=False)
    """What to go by: the common line, or one of those in contact."""
    follows: bool = False
    """Whether the line to go by has come to the present."""
    shown: list[Outcome] = field(default_factory=list)
    """What came of the last step on the line to go by, also where that lies back: to be looked at, not to be obeyed."""
    _next: Timeline | None = None
    """A line that is still being brought up to the present."""
    _began_ns: int | None = None

    def __post_init__(self) -> None:
        self.common = Timeline(Kernel(self.settings), self.logs.robots)
        self.line = self.common

    def step(self, now_ns: int) -> list[Outcome]:
        """Go on with what is known now; what came of it that is to be obeyed."""
        if self._began_ns is None:
            self._began_ns = now_ns
        agreed = outcomes = self.common.step_to(self.logs, self.logs.checkpoint(), self.most_ticks)
        if now_ns // TICK_NS - self.common.horizon <= ABSENT_TICKS:
            self.line, self._next, self.follows = self.common, None, True
        elif len(present := self.present(now_ns)) < len(self.logs.robots):
            outcomes = self._apart(present, now_ns - self._began_ns)
        elif self.line is self.common:  # everybody is here, and it is still catching up
            outcomes, self.follows = [], False
        else:
            outcomes = self._step(self.line)
        self.shown = agreed if self.line is self.common else outcomes
        return outcomes

    def _step(self, line: Timeline) -> list[Outcome]:
        return line.step_to(self.logs, self.logs.checkpoint(line.members), self.most_ticks)

    def _apart(self, present: tuple[str, ...], since_ns: int) -> list[Outcome]:
        """Go on with those in contact alone; what that led to."""
        # Before anything is common others may only not be ready; after a restart they will be heard soon.
        wait_s = self.patience_s if self.common.horizon == NEVER else min(self.patience_s, AGENT_ABSENT_S)
        if since_ns * 1e-9 < wait_s or not present:
            return []
        ahead = self._next or self.line
        if ahead is self.common or ahead.members != present or ahead.has_missed(self.logs):
            self._next = self.common.copy(present)
        if self._next is not None:
            outcomes = self._step(self._next)
            if self._next.horizon < self.logs.checkpoint(self._next.members):
                return [] if self.line is self.common else self._step(self.line)
            self.line, self._next, self.follows = self._next, None, True
            return outcomes
        return self._step(self.line)

    def present(self, now_ns: int) -> tuple[str, ...]:
        """Robots in contact, over others too: those of which everything is known up to a few seconds ago."""
        least = now_ns // TICK_NS - ABSENT_TICKS
        return tuple(robot for robot in self.logs.robots if self.logs.closed_of(robot) >= least)

    def ages_s(self, now_ns: int) -> dict[str, float]:
        """How old what is known of each other robot is; infinite where nothing is."""
        return {
            robot: math.inf
            if (tick := self.logs.closed_of(robot)) == NEVER
            else now_ns * 1e-9 - tick * TICK_S
            for robot in self.logs.robots
            if robot != self.logs.me
        }
