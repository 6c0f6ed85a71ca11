"""What a mission writes down as it goes: the recording, and whoever else follows along. Acts, decides nothing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from fieldkit.clock import wall_s
from fieldkit.messages import Command, Detection, Event, FloatArray, Plan, SourceEstimate
from fieldkit.recording.writer import RecordingWriter
from mission.core.kernel import Kernel, Outcome
from mission.core.mission_file import Mission

BELIEF_EVERY_S = 10.0
"""Mission time between looks at the whole belief."""
LOOK_SHARE = 0.05
"""A look may take no more than this share of the time between two: on a large field it comes more rarely."""
LONGEST_LOOK_S = 1.0
"""A look that took longer is not taken again before the end: steering waits while it lasts."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """The belief over the whole field, as taken at one moment."""

    presence: FloatArray
    probability_left: float
    digest: str


def recording_of(
    mission: Mission, path: Path, more: Mapping[str, Any], start_ns: int = 0, rotate_mb: float | None = None
) -> RecordingWriter:
    """A recording that begins with what the mission is, and with `more` of how this one came about."""
    about = {"mission": mission.file.name, "seed": mission.file.seed, **mission.recorded_settings, **more}
    return RecordingWriter(
        path,
        mission_toml=mission.text,
        antenna_toml=mission.antenna_text,
        metadata=about,
        frame=mission.frame,
        start_ns=start_ns,
        rotate_bytes=None if rotate_mb is None else round(rotate_mb * 1e6),
    )


class Follower(Protocol):
    """Somebody who is given everything in order: a `RecordingWriter`, the live page."""

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


class MissionRecorder:
    """Writes what happens to all followers."""

    def __init__(self, kernel: Kernel, cell_m: float, *followers: Follower) -> None:
        self.kernel = kernel
        self._cell_m = cell_m
        self._followers = followers
        self._last_look_s = -BELIEF_EVERY_S
        self._look_took_s = 0.0
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

    def flush(self) -> None:
        """Followers hand on what they have."""
        for follower in self._followers:
            follower.flush()

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
            digest = self.kernel.digest()
            for follower in self._followers:
                follower.belief(number, t_ns, digest=digest)
        if outcome.notes:
            self.flush()

    def look_if_due(self, t_ns: int) -> Look | None:
        """The whole belief, if it is time to look. Takes as long as the field is large: not for the event loop."""
        if self._look_took_s > LONGEST_LOOK_S:
            return None
        every_s = max(BELIEF_EVERY_S, self._look_took_s / LOOK_SHARE)
        return self.look(t_ns) if self.kernel.elapsed_s(t_ns) - self._last_look_s >= every_s else None

    def look(self, t_ns: int) -> Look:
        """The whole belief now."""
        self._last_look_s, began_s = self.kernel.elapsed_s(t_ns), wall_s()
        belief = self.kernel.belief
        look = Look(belief.presence(), belief.probability_left(), self.kernel.digest())
        self._look_took_s = wall_s() - began_s
        return look

    def belief(self, number: int, t_ns: int, look: Look) -> None:
        """A look at the belief over the whole field."""
        self.left = look.probability_left
        for follower in self._followers:
            follower.belief(
                number,
                t_ns,
                look.presence,
                cell_m=self._cell_m,
                digest=look.digest,
                numbers={"probability_left": self.left},
            )

    def end(self, number: int, t_ns: int) -> None:
        """The last look at everything."""
        self.belief(number, t_ns, self.look(t_ns))
        self._sources(number, t_ns)

    def _sources(self, number: int, t_ns: int) -> None:
        sources = self.kernel.sources()
        for follower in self._followers:
            follower.sources(number, t_ns, sources)
