"""What there is to show of a running mission."""

from dataclasses import dataclass

from mission.core.kernel import Kernel


@dataclass(frozen=True, slots=True)
class Progress:
    """A mission at one moment, for terminals."""

    elapsed_s: float
    detections: int
    kernel: Kernel
    doing: dict[str, str]
    """Robot to what it is on: "search", "resolve 3", "held: ..."."""
    notes: tuple[str, ...]
    probability_left: float = 1.0
    """That a source of the reference rate is still not found, as last looked at."""
    alarms: tuple[str, ...] = ()
    """What the operator must know at once, as long as it lasts."""
