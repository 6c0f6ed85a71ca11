"""SIGINT, SIGTERM and SIGHUP stop a mission, and nothing stops the stop.

The first one ends the mission: every vehicle is told to hold until it shows it. A second one changes nothing and says
who has not shown it yet. A third one leaves, naming them. SIGHUP comes when a terminal closes or ssh drops: the
vehicles must not learn of it later than the operator.
"""

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType

STOPS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)


class StopSignals:
    """What each signal in turn leads to: `first` ends the mission, `again` speaks, `last` stops waiting."""

    def __init__(
        self, first: Callable[[str], None], again: Callable[[], None], last: Callable[[], None]
    ) -> None:
        self._first, self._again, self._last = first, again, last
        self.count = 0

    def came(self, number: int) -> None:
        """A signal has come, in the event loop's thread."""
        self.count += 1
        if self.count == 1:
            self._first(signal.Signals(number).name)
        elif self.count == 2:
            self._again()
        else:
            self._last()

    @contextlib.contextmanager
    def caught(self) -> Iterator[None]:
        """Signals come here while inside, in whichever way this platform has."""
        loop = asyncio.get_running_loop()
        by_loop: list[int] = []
        before: dict[int, Callable[[int, FrameType | None], object] | int | None] = {}

        def plain(number: int, _: FrameType | None) -> None:
            loop.call_soon_threadsafe(self.came, number)

        for number in STOPS:
            try:
                loop.add_signal_handler(number, self.came, number)
                by_loop.append(number)
            except (NotImplementedError, RuntimeError):  # Windows; a thread that is not the main one
                with contextlib.suppress(ValueError):
                    before[number] = signal.signal(number, plain)
            except ValueError:
                continue
        try:
            yield
        finally:
            for number in by_loop:
                loop.remove_signal_handler(number)
            for number, handler in before.items():
                signal.signal(number, handler)
