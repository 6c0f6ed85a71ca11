"""Strengths of receptions whose frames carry none: ATDB, and what may be said of whose strength that is.

DB is the strength of the module's last good packet, from anybody. So it is asked at once after a frame, and:

- with 802.15.4 firmware, one frame and a prompt answer, it is that frame's strength, and the frame is named;
- on a mesh it is the last hop's strength, whoever the packet came from: nobody is named;
- where another frame came between frame and answer it is one of theirs: nobody is named;
- an answer that is late is stale, it may be any packet's: there is no reading.

Source: Digi 90000982 and 90001500, parameter DB.
"""

from dataclasses import dataclass

STALE_S = 0.1
"""Wall time after which an answer is no longer believed; modules answer in 3 to 5 ms."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A reception whose strength has been asked for."""

    number: int
    """Frame id of the question, 1 to 255."""
    t_ns: int
    asked_s: float
    frame_id: str | None


class LastHop:
    """Which answer belongs to which reception. `now_s` is wall time on any steady scale."""

    def __init__(self, *, mesh: bool) -> None:
        self._mesh = mesh
        self._asked: Asked | None = None
        self._number = 0
        self.stale = 0
        """Answers that came too late to be believed, or not at all."""
        self.unattributed = 0
        """Receptions that shared one answer with others."""

    def received(self, t_ns: int, frame_id: str, now_s: float) -> int | None:
        """A frame without strength came: the number to ask DB under, None if an answer is still to come."""
        waiting = self._asked
        if waiting is not None and now_s - waiting.asked_s <= STALE_S:
            self.unattributed += 1
            self._asked = Asked(waiting.number, t_ns, waiting.asked_s, None)
            return None
        self.stale += waiting is not None
        self._number = self._number % 255 + 1
        self._asked = Asked(self._number, t_ns, now_s, None if self._mesh else frame_id)
        return self._number

    def answered(self, number: int, now_s: float) -> Asked | None:
        """The reception an answer belongs to; None if it is stale."""
        asked = self._asked
        if asked is None or asked.number != number:
            self.stale += 1
            return None
        self._asked = None
        if now_s - asked.asked_s > STALE_S:
            self.stale += 1
            return None
        return asked
