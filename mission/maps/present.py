"""The present of a mission as maps want it: where everybody is, what was found. A follower that keeps the newest alone.

What it keeps is replaced whole, so that a thread that looks meanwhile sees the old or the new.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fieldkit.geo import FieldFrame
from fieldkit.messages import Event, Operator, Pose, SourceEstimate, Tick
from mission.core.mission_file import Mission

CLAIMED = ("found", "candidate")
"""States of a source of which a position is claimed: of what does not fit the model nothing is shown."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A person's word that a transmitter is here."""

    number: int
    by: str
    east_m: float
    north_m: float
    t_ns: int


@dataclass(frozen=True, slots=True)
class Present:
    """One moment of a mission."""

    name: str
    frame: FieldFrame
    t_ns: int
    """UTC, by the mission's clock; 0 before its first tick."""
    began_ns: int
    poses: tuple[Pose, ...]
    """The newest of each robot that has one."""
    sources: tuple[SourceEstimate, ...]
    """Those of which a position is claimed."""
    marks: tuple[Mark, ...]
    on_foot: frozenset[str]
    flying: frozenset[str]


class Latest:
    """A follower; `present` may be asked in any thread."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._t_ns = self._began_ns = 0
        self._poses: dict[str, Pose] = {}
        self._sources: tuple[SourceEstimate, ...] = ()
        self._marks: tuple[Mark, ...] = ()

    def present(self) -> Present:
        """The latest positions, sources and marks."""
        poses = tuple(pose for name in self._mission.kernel.engine.robots if (pose := self._poses.get(name)))
        return Present(
            self._mission.file.name,
            self._mission.frame,
            self._t_ns,
            self._began_ns,
            poses,
            self._sources,
            self._marks,
            self._mission.safety.on_foot,
            frozenset(self._mission.safety.altitude_m),
        )

    def event(self, inbox_number: int, log_time_ns: int, event: Event) -> None:
        """Take in an event."""
        match event:
            case Pose():
                self._poses[event.robot] = event
            case Tick():
                self._began_ns = self._began_ns or event.t_ns
                self._t_ns = event.t_ns
            case Operator(action="mark") if (pose := self._poses.get(event.robot or "")) is not None:
                mark = Mark(len(self._marks) + 1, pose.robot, pose.east_m, pose.north_m, event.t_ns)
                self._marks = (*self._marks, mark)
            case _:
                pass

    def sources(self, inbox_number: int, log_time_ns: int, sources: Sequence[SourceEstimate]) -> None:
        """Take in what is believed; of what does not fit the model, and of what was taken away, nothing is shown."""
        self._sources = tuple(s for s in sources if s.state in CLAIMED)

    def command(self, *given: Any) -> None:
        """Maps show no commands."""

    detection = plan = note = command

    def belief(self, *given: Any, **more: Any) -> None:
        """Nor the belief over the field."""

    def flush(self) -> None:
        """Nothing waits here."""
