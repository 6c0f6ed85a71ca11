"""Watching a replay: events at a multiple of the mission's own pace, and what is believed at each moment."""

from collections.abc import Callable
from dataclasses import dataclass, field

from fieldkit.clock import wall_s, wall_sleep
from fieldkit.messages import Event
from mission.core.kernel import Kernel, Outcome


@dataclass(frozen=True, slots=True)
class Moment:
    """What there is to show at one moment of a replay."""

    t_s: float
    detections: int
    finds: tuple[str, ...]
    """Each source with its state and probability, as text."""
    notes: tuple[str, ...]
    """What the kernel said since the last moment."""


@dataclass
class Pace:
    """Hold a replay back to `speed` mission seconds a wall second, and show a moment now and then.

    Made to be the `on_step` of `mission.replay.replay`. `every_s` is in wall seconds.
    """

    speed: float
    show: Callable[[Moment], None]
    every_s: float = 0.5
    sleep: Callable[[float], None] = wall_sleep
    now_s: Callable[[], float] = wall_s
    _began_s: float | None = None
    _shown_s: float = float("-inf")
    _notes: list[str] = field(default_factory=list)

    def __call__(self, t_s: float, event: Event, outcome: Outcome, kernel: Kernel) -> None:
        """Wait until this event's moment, and show it where it is time or something was decided."""
        if self._began_s is None:
            self._began_s = self.now_s()
        ahead_s = t_s / self.speed - (self.now_s() - self._began_s)
        if ahead_s > 0.0:
            self.sleep(ahead_s)
        self._notes += outcome.notes
        if outcome.notes or self.now_s() - self._shown_s >= self.every_s:
            self._shown_s = self.now_s()
            self.show(moment(t_s, kernel, tuple(self._notes)))
            self._notes.clear()


def moment(t_s: float, kernel: Kernel, notes: tuple[str, ...] = ()) -> Moment:
    """The kernel's present word on everything."""
    finds = tuple(
        f"{s.ident} {s.state} {s.east_m:.1f},{s.north_m:.1f} P {s.p_here:.2f}"
        for s in kernel.sources()
        if s.state != "candidate" or s.p_exists > 0.5
    )
    return Moment(t_s, kernel.detections, finds, notes)


def line(now: Moment) -> str:
    """A moment as one line for a terminal."""
    said = "; ".join(now.finds) or "no source yet"
    notes = "".join(f"\n           {note}" for note in now.notes)
    return f"{now.t_s:8.1f} s  {now.detections:4d} heard  {said}{notes}"
