"""SIGINT, SIGTERM and SIGHUP stop a mission, and nothing stops the stop.

The first one ends the mission: every vehicle is ordered to hold until it shows it. A second one changes nothing and
says who has not shown it yet. A third one leaves, naming them. SIGHUP comes when a terminal closes or ssh drops: the
vehicles must not learn of it later than the operator.

A terminal does not suspend a mission either: nobody would steer. Ctrl-Z holds all robots, and the mission goes on; one
in the background neither reads nor is stopped for what is typed elsewhere.
"""

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType

STOPS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)
SUSPENDS = tuple(getattr(signal, name) for name in ("SIGTSTP",) if hasattr(signal, name))
BACKGROUND = tuple(getattr(signal, name) for name in ("SIGTTIN", "SIGTTOU") if hasattr(signal, name))


WHY = {
    "SIGINT": "stopped by Ctrl-C",
    "SIGTERM": "stopped by another program (SIGTERM)",
    "SIGHUP": "the terminal was closed (SIGHUP)",
    "SIGBREAK": "stopped by Ctrl-Break",
}
"""A signal's name to the reason that stands on every surface."""


class StopSignals:
    """What each signal in turn leads to: `first` ends the mission, `again` speaks, `last` stops waiting.

    `suspend` is for Ctrl-Z.
    """

    def __init__(
        self,
        first: Callable[[str], None],
        again: Callable[[], None],
        last: Callable[[], None],
        suspend: Callable[[], None] = lambda: None,
    ) -> None:
        self._first, self._again, self._last, self._suspend = first, again, last, suspend
        self.count = 0

    def came(self, number: int) -> None:
        """A signal has come, in the event loop's thread."""
        if number in SUSPENDS:
            self._suspend()
            return
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

        for number in (*STOPS, *SUSPENDS):
            try:
                loop.add_signal_handler(number, self.came, number)
                by_loop.append(number)
            except (NotImplementedError, RuntimeError):  # Windows; a thread that is not the main one
                with contextlib.suppress(ValueError):
                    before[number] = signal.signal(number, plain)
            except ValueError:
                continue
        for number in BACKGROUND:
            with contextlib.suppress(ValueError):  # a thread that is not the main one
                before[number] = signal.signal(number, signal.SIG_IGN)
        try:
            yield
        finally:
            for number in by_loop:
                loop.remove_signal_handler(number)
            for number, handler in before.items():
                signal.signal(number, handler)
