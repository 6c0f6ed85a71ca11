"""A kernel stepped through everybody's logs in the one order that all robots keep. Pure.

Up to a tick everything is taken in by time, robot, log and number, then the tick itself. Whoever steps the same logs up
to the same tick therefore has the same kernel, bit for bit: as a single computer would that had heard all of it. The
first tick of the mission is the first after which every member's logs have begun.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from fieldkit.engine.decentralised.logs import NEVER, TICK_NS, Key, Logs
from fieldkit.messages import EndMission, Event, Tick
from mission.core.kernel import Kernel, Outcome

Witness = Callable[[int, Event, Outcome], object]
"""Somebody who is shown every step with its time, event and outcome: a recorder."""


@dataclass
class Timeline:
    """See the module. `members` are those whose logs it waits for."""

    kernel: Kernel
    members: tuple[str, ...]
    horizon: int = NEVER
    """The tick it has come to."""
    fed: dict[Key, int] = field(default_factory=dict)
    """How many entries of each log it has taken in."""
    begun: set[str] = field(default_factory=set)
    end_reason: str = ""
    witness: Witness | None = None

    def copy(self, members: Collection[str]) -> "Timeline":
        """The same once more, to go on with these members alone. Nobody witnesses it."""
        kept = tuple(robot for robot in self.members if robot in members)
        return Timeline(
            self.kernel.copy(), kept, self.horizon, dict(self.fed), set(self.begun), self.end_reason
        )

    def step_to(self, logs: Logs, tick: int, most: int) -> list[Outcome]:
        """Go on to a tick, by `most` ticks at a time; what each step led to."""
        if self.horizon == NEVER:
            first_ns = min((log[0].order_ns for log in logs.entries.values() if log), default=None)
            if first_ns is None or first_ns > tick * TICK_NS:
                return []
            self.horizon = (first_ns - 1) // TICK_NS
        end = min(tick, self.horizon + most)
        if end <= self.horizon:
            return []
        waiting = logs.until(self.fed, end)
        outcomes, at = [], 0
        for now in range(self.horizon + 1, end + 1):
            while at < len(waiting) and waiting[at][1].order_ns <= now * TICK_NS:
                key, entry = waiting[at]
                at += 1
                self.fed[key] = self.fed.get(key, 0) + 1
                self.begun.add(key[0])
                outcomes.append(self._step(entry.order_ns, entry.event))
            if self.kernel.started_ns is not None or self.begun.issuperset(self.members):
                outcomes.append(self._step(now * TICK_NS, Tick(now * TICK_NS)))
        self.horizon = end
        return outcomes

    def has_missed(self, logs: Logs) -> bool:
        """Whether something has come to be known since that lies before where it has come to."""
        end_ns = self.horizon * TICK_NS
        return any(
            len(log) > (fed := self.fed.get(key, 0)) and log[fed].order_ns <= end_ns
            for key, log in logs.entries.items()
        )

    def _step(self, order_ns: int, event: Event) -> Outcome:
        outcome = self.kernel.step(event)
        for command in outcome.commands:
            if isinstance(command, EndMission):
                self.end_reason = command.reason
        if self.witness is not None:
            self.witness(order_ns, event, outcome)
        return outcome
