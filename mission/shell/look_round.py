"""What an agent does before it touches its robot: it listens who is there, and what they hold of its robot's log.

Two versions of one log fit into no common belief, so nothing is added to it before it is known to be whole: from the
journal of the agent before, or from the others.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fieldkit.clock import Clock
from fieldkit.errors import RecordingError
from fieldkit.messages import Operator
from fieldkit.settings import TICK_S
from mission.core.agent import Agent
from mission.core.taking_up import Left
from mission.shell import journal as journals

LOOK_ROUND_S = 3.0
"""Before the start an agent listens for so long: for a second one of its robot, and for its own log."""
OWN_LOG_S = 300.0
"""... and for so long where others bring its own log back."""


@dataclass
class LookRound:
    """See the module. `run` once."""

    agent: Agent
    clock: Clock
    remember: Callable[[Operator], object]
    """Takes an order that stands in a log which the agent goes on with."""
    say: Callable[[str], None]
    tell: Callable[[str], None]
    """Takes what is no trouble."""
    speak: Callable[[], None]
    """What is to be said at a tick."""
    left: Left | None = None
    """What an agent before it knew that was ended before the mission was over ..."""
    left_in: Path | None = None
    """... and the journal that has it."""
    _knew: int = 0
    """Observations in its robot's log without those that others have brought back."""

    async def run(self) -> None:
        """Until it is known how its log goes on. Raises `RecordingError` where others have more than they bring."""
        clock, talk = self.clock, self.agent.talk
        self._knew = self._known()
        began_s, lacked_s, waits = clock.elapsed_s(), 0.0, False
        while True:
            waited_s = clock.elapsed_s() - began_s
            self._decide(waited_s)
            lacks = talk.lacks_own(clock.now_ns())
            if waited_s >= LOOK_ROUND_S and self.left is None and not lacks:
                break
            if lacks and lacked_s >= OWN_LOG_S:
                raise RecordingError(self._still_lacks())
            if self.left is not None and not waits and waited_s >= LOOK_ROUND_S:
                waits = True
                self.say(
                    f"{self.agent.me}'s agent was ended while others may have gone on, and not all of them are heard: "
                    f"it listens for {self.agent.patience_s:g} s at the most before it goes on with what it knew"
                )
            self.speak()
            await clock.sleep(TICK_S)
            lacked_s = lacked_s + TICK_S if lacks else 0.0
        if self._known() > self._knew:
            what = "the end of it, which the journal lacked" if self._knew else "where it stood"
            self.tell(f"goes on with {self.agent.me}'s log, {what}: the others have brought it back")

    def _known(self) -> int:
        logs = self.agent.logs
        return sum(len(logs.entries[key]) for key in logs.own)

    def _still_lacks(self) -> str:
        talk, now_ns = self.agent.talk, self.clock.now_ns()
        heard = ", ".join(talk.in_range(now_ns)) or "nobody"
        return (
            f"others have more of {self.agent.me}'s log than they have brought back in {OWN_LOG_S:g} s (heard now: "
            f"{heard}): nothing was added to it; start its agent again where it hears them"
        )

    def _decide(self, waited_s: float) -> None:
        """Whether the mission that was left goes on, once that is known, or nobody can tell for too long."""
        left, talk, me = self.left, self.agent.talk, self.agent.me
        if left is None or self.left_in is None:
            return
        if left.goes_on(talk) or waited_s >= max(self.agent.patience_s, LOOK_ROUND_S):
            journals.load(self.left_in, self.agent.logs)
            for order in self.agent.remember_anew():
                self.remember(order)
            self.left, self._knew = None, self._known()
            self.tell(f"goes on with {me}'s log, where it stood: {self.left_in}")
        elif waited_s >= LOOK_ROUND_S and left.is_over(talk, self.clock.now_ns()):
            self.left = None
            self.tell(f"begins a new mission: the one that {me}'s agent was in is over ({self.left_in})")
