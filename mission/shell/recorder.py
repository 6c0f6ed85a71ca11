"""What a mission writes down as it goes: the recording, and whoever else follows along. Acts, decides nothing."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

from fieldkit.messages import Command, Detection, Event, FloatArray, Plan, SourceEstimate
from mission.core.kernel import Kernel, Outcome

BELIEF_EVERY_S = 10.0


class Follower(Protocol):
    """Somebody who is told everything in order: a `RecordingWriter`, the live page."""

    def event(self, inbox_number: int, log_time_ns: int, event: Event) -> None: ...

    def command(
        self, inbox_number: int, log_time_ns: int, command: Command, origin: Literal["kernel", "safety"]
    ) -> None: ...

    def detection(self, inbox_number: int, log_time_ns: int, detection: Detection) -> None: ...

    def sources(self, inbox_number: int, log_time_ns: int, sources: Sequence[SourceEstimate]) -> None: ...

    def plan(self, inbox_number: int, log_time_ns: int, plan: Plan) -> None: ...

    def belief(
        self,
        inbox_number: int,
        log_time_ns: int,
        values: FloatArray | None = None,
        *,
        cell_m: float = 1.0,
        digest: str = "",
        numbers: Mapping[str, float] | None = None,
    ) -> None: ...

    def note(self, level: Any, text: str, log_time_ns: int = 0) -> None: ...

    def flush(self) -> None: ...


class Journal:
    """Writes what happens to all followers."""

    def __init__(self, kernel: Kernel, cell_m: float, *followers: Follower) -> None:
        self._kernel = kernel
        self._cell_m = cell_m
        self._followers = followers
        self._last_belief_s = -BELIEF_EVERY_S
        self.left = 1.0
        """Probability that a source of the reference rate is still not found, as last looked at."""

    def event(self, number: int, t_ns: int, event: Event) -> None:
        """An event, before it is stepped."""
        for follower in self._followers:
            follower.event(number, t_ns, event)

    def command(self, number: int, t_ns: int, command: Command, origin: Literal["kernel", "safety"]) -> None:
        """A command: what the kernel asked for, or what safety let pass."""
        for follower in self._followers:
            follower.command(number, t_ns, command, origin)

    def note(self, level: str, text: str, t_ns: int) -> None:
        """A line for whoever looks later."""
        for follower in self._followers:
            follower.note(level, text, t_ns)

    def outcome(self, number: int, t_ns: int, outcome: Outcome) -> None:
        """What a step led to, commands apart."""
        for note in outcome.notes:
            self.note("info", note, t_ns)
        for follower in self._followers:
            for detection in outcome.detections:
                follower.detection(number, t_ns, detection)
            if outcome.plan is not None:
                follower.plan(number, t_ns, outcome.plan)
        if outcome.detections:
            self._sources(number, t_ns)
            digest = self._kernel.digest()
            for follower in self._followers:
                follower.belief(number, t_ns, digest=digest)
        if self._kernel.elapsed_s(t_ns) - self._last_belief_s >= BELIEF_EVERY_S:
            self.belief(number, t_ns)
        if outcome.notes:
            for follower in self._followers:
                follower.flush()

    def belief(self, number: int, t_ns: int) -> None:
        """The belief over the whole field."""
        self._last_belief_s = self._kernel.elapsed_s(t_ns)
        self.left = self._kernel.belief.probability_left()
        presence, digest = self._kernel.belief.presence(), self._kernel.digest()
        for follower in self._followers:
            follower.belief(
                number,
                t_ns,
                presence,
                cell_m=self._cell_m,
                digest=digest,
                numbers={"probability_left": self.left},
            )

    def end(self, number: int, t_ns: int) -> None:
        """The last look at everything."""
        self.belief(number, t_ns)
        self._sources(number, t_ns)

    def _sources(self, number: int, t_ns: int) -> None:
        sources = self._kernel.sources()
        for follower in self._followers:
            follower.sources(number, t_ns, sources)
