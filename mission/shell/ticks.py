"""When the kernel is asked to look: at every regular tick, and as soon as a reception can be looked at.

Ticks that come while one is still waiting are skipped: a slow moment costs resolution, never a backlog.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from fieldkit.settings import TICK_S

DUE_SLACK_S = 0.002
"""Receptions this near to each other are looked at together."""
MOST_HEARD = 200
"""Receptions from one tick to the next, a thousand a second. A tick that has more to think about thinks for minutes."""


@dataclass
class Ticks:
    """Times in the event loop's seconds; mission time is `rate` times as fast."""

    put: Callable[[], None]
    """Puts a tick into the inbox."""
    has_begun: Callable[[], bool]
    """Whether the mission has had its first tick."""
    reception_due_s: float
    """So long after a reception it can be looked at, in mission time."""
    rate: float
    _waits: bool = False
    """Whether a tick is in the inbox."""
    _due_s: deque[float] = field(default_factory=deque)
    """When a reception can be looked at, in order."""
    _timer: asyncio.TimerHandle | None = None
    _heard: int = 0
    """Receptions since the last tick."""
    _taken: asyncio.Event = field(default_factory=asyncio.Event)

    def tick(self) -> None:
        """A tick into the inbox, unless one waits there."""
        if self._waits:
            return
        self._waits = True
        now_s = asyncio.get_running_loop().time()
        while self._due_s and self._due_s[0] <= now_s:
            self._due_s.popleft()
        self.put()

    def taken(self) -> None:
        """The tick that waited has come out of the inbox."""
        self._waits = False
        self._heard = 0
        self._taken.set()
        self._tick_if_due()

    async def room(self) -> bool:
        """Wait until one more reception can be thought about; whether that took until another tick.

        Others have their turn meanwhile: a stop, vehicles.
        """
        waited = False
        while self._heard >= MOST_HEARD:
            if not self.has_begun():  # nothing is thought about yet
                self._heard = 0
                await asyncio.sleep(0)
                return False
            waited = True
            self._taken.clear()
            await self._taken.wait()
        return waited

    def heard(self) -> None:
        """Where receptions are joined quickly, look as soon as this one can be: not at the next regular tick."""
        self._heard += 1
        if self.reception_due_s >= TICK_S:
            return
        due_s = asyncio.get_running_loop().time() + self.reception_due_s / self.rate
        if not self._due_s or due_s > self._due_s[-1]:
            self._due_s.append(due_s + DUE_SLACK_S / self.rate)
            self._tick_if_due()

    def _tick_if_due(self) -> None:
        """Look if something can be looked at, and see to it that this is asked again when the next can be.

        Not while a tick waits already: its time may be too early for what came meanwhile.
        """
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if not self._due_s or self._waits:
            return
        loop = asyncio.get_running_loop()
        if self._due_s[0] > loop.time():
            self._timer = loop.call_at(self._due_s[0], self._tick_if_due)
        elif not self.has_begun():
            self._due_s.clear()
        else:
            self.tick()
