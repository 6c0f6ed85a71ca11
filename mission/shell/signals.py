"""SIGINT, SIGTERM and SIGHUP stop a mission, and nothing stops the stop.

The first one ends the mission: every vehicle is ordered to hold until it shows it. A second one changes nothing and
says who has not shown it yet. A third one leaves, naming them; those after it lead to nothing until what was found has
been said.

SIGHUP comes when a terminal closes or ssh drops: the vehicles must not learn of it later than the operator. A shell
passes it on to its jobs a moment later: after the first it leads to nothing outside of here either, and nothing is said
to the closed terminal, so that the report is written.

A terminal does not suspend a mission either: nobody would steer. Ctrl-Z holds all robots, and the mission goes on; one
in the background neither reads nor is stopped for what is typed elsewhere.
"""

import asyncio
import contextlib
import errno
import os
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


class StoppedEarly(KeyboardInterrupt):
    """The signal `number` came before there was a mission to answer it; `why` says so to people."""

    def __init__(self, number: int) -> None:
        super().__init__()
        name = signal.Signals(number).name
        self.number, self.why, self.terminal_gone = number, WHY[name], name == "SIGHUP"


def _stopped_early(number: int, _: FrameType | None) -> None:
    raise StoppedEarly(number)


def _leaving(_: int, __: FrameType | None) -> None:
    """The command is leaving already: whoever presses on must still read what was found."""


@contextlib.contextmanager
def early() -> Iterator[None]:
    """Each of `STOPS` raises `StoppedEarly` inside here, until `StopSignals.caught` takes them over for good.

    After the mission they lead to nothing until `interruptible` is called. A signal that is ignored (nohup) stays
    ignored.
    """
    before: dict[int, Callable[[int, FrameType | None], object] | int | None] = {}
    for number in STOPS:
        if signal.getsignal(number) != signal.SIG_IGN:
            with contextlib.suppress(ValueError):  # a thread that is not the main one
                before[number] = signal.signal(number, _stopped_early)
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) in (_stopped_early, _leaving):
                signal.signal(number, handler)


def interruptible() -> None:
    """What was found has been said: a signal ends the command again, as that of any other."""
    for number in STOPS:
        if signal.getsignal(number) is _leaving:
            plain = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
            signal.signal(number, plain)


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
        self._terminal_gone = False

    def came(self, number: int) -> None:
        """A signal has come, in the event loop's thread."""
        if number in SUSPENDS:
            self._suspend()
            return
        self._terminal_gone |= signal.Signals(number).name == "SIGHUP"
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
        were_early = [number for number in STOPS if signal.getsignal(number) is _stopped_early]
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
            for number in were_early:  # after a mission it is not early any more
                with contextlib.suppress(ValueError):  # a thread that is not the main one
                    signal.signal(number, _leaving)
            if self._terminal_gone:
                with contextlib.suppress(ValueError):  # a thread that is not the main one
                    signal.signal(signal.SIGHUP, signal.SIG_IGN)
                leave_closed_terminals()


def leave_closed_terminals(descriptors: tuple[int, ...] = (1, 2)) -> None:
    """Have nothing read what is said to a terminal that has gone: writing to it would be an error each time."""
    import termios

    for descriptor in descriptors:
        try:
            termios.tcgetattr(descriptor)
        except termios.error as error:
            if error.args[0] not in (errno.EIO, errno.ENXIO):  # a file or a pipe
                continue
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, descriptor)
            os.close(nothing)
