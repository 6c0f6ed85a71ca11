"""The terminal as it is: Ctrl-D, half a line, Ctrl-S. None of it stops the steering, or takes Enter away."""

import asyncio
import contextlib
import logging
import os
import sys
import termios
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from fieldkit.clock import RealClock
from fieldkit.messages import Operator
from mission.shell.keyboard import Typed, keyboard
from mission.shell.unhurried import LEFT_OUT, MOST_WAITING, unhurried_standard_error

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
WAIT_S = 20.0


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Our end of a terminal; the other one is standard input."""
    ours, theirs = os.openpty()
    with os.fdopen(theirs, encoding="utf-8") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield ours
    os.close(ours)


class Mission:
    """What the keyboard knows of a runner."""

    def __init__(self) -> None:
        self.orders: list[tuple[str, str | None]] = []
        self.reasons: list[str] = []
        self.mission = SimpleNamespace(kernel=SimpleNamespace(engine=SimpleNamespace(robots=("r1", "r2"))))
        self.setup = SimpleNamespace(clock=RealClock())

    def put(self, event: Operator) -> None:
        self.orders.append((event.action, event.robot))
        self.reasons.append(event.reason)

    async def until(self, number: int) -> list[tuple[str, str | None]]:
        for _ in range(int(WAIT_S / 0.01)):
            if len(self.orders) >= number:
                break
            await asyncio.sleep(0.01)
        return self.orders


def typed(terminal: int, *pieces: bytes, orders: int) -> list[tuple[str, str | None]]:
    """What comes of pieces typed one after the other, the loop going round in between."""
    mission: Any = Mission()

    async def type_them() -> None:
        with keyboard(mission):
            for piece in pieces:
                os.write(terminal, piece)
                await asyncio.sleep(0.5)  # longer than a terminal is left alone after Ctrl-D
            await mission.until(orders)

    asyncio.run(type_them())
    orders_given: list[tuple[str, str | None]] = mission.orders
    return orders_given


@pytest.mark.timeout(60)
def test_an_order_says_in_whose_terminal_it_was_given(terminal: int) -> None:
    mission: Any = Mission()

    async def type_one() -> None:
        with keyboard(mission, "agent", "r1's terminal"):
            os.write(terminal, b"\n")
            await mission.until(1)

    asyncio.run(type_one())
    assert mission.reasons == ["operator, in r1's terminal"]


@pytest.mark.timeout(60)
def test_enter_still_holds_after_ctrl_d(terminal: int) -> None:
    assert typed(terminal, b"\x04", b"\x04", b"\n", orders=1) == [("hold", None)]


@pytest.mark.timeout(60)
def test_half_a_line_is_not_waited_for(terminal: int) -> None:
    """Ctrl-D hands over what has been typed so far. Whoever waited for the rest would steer no more."""
    assert typed(terminal, b"resume r\x04", b"2\n", orders=1) == [("resume", "r2")]


@pytest.mark.timeout(60)
def test_a_raw_terminal_holds_by_its_enter_too(terminal: int) -> None:
    mode = termios.tcgetattr(terminal)
    mode[0] &= ~termios.ICRNL
    mode[3] &= ~termios.ICANON
    termios.tcsetattr(terminal, termios.TCSANOW, mode)
    assert typed(terminal, b"r", b"\r", b"\r", orders=2) == [("resume", None), ("hold", None)]


def test_lines_are_put_together_and_long_ones_cut() -> None:
    line = Typed()
    assert line.lines(b"ho") == [] and line.lines(b"ld\nr\nx") == ["hold", "r"]
    assert line.lines(b"\xff" * 100_000) == [] and len(line.lines(b"\n")[0]) < 10_000
    assert line.lines(b"\n") == [""]


@contextlib.contextmanager
def standard_error(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Standard error is a pipe in here; the end to read from, which nobody does by itself."""
    read, write = os.pipe()
    with os.fdopen(write, "w", encoding="utf-8") as stderr, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", stderr)
        yield read


@pytest.mark.timeout(60)
def test_nobody_waits_for_a_terminal_that_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than any pipe holds is written, then read: the newest is there, and a word on what is not."""
    got = b""
    with standard_error(monkeypatch) as read:
        log = logging.StreamHandler(sys.stderr)
        monkeypatch.setattr(logging.getLogger(), "handlers", [log])
        with unhurried_standard_error():
            for number in range(4_000):
                print(f"line {number} " + "x" * 100, file=sys.stderr)
            logging.getLogger("radio").warning("the last word")
            os.set_blocking(read, False)
            deadline_s = time.monotonic() + WAIT_S
            while b"the last word" not in got and time.monotonic() < deadline_s:
                with contextlib.suppress(BlockingIOError):
                    got += os.read(read, 65_536)
        assert log.stream is sys.stderr
        os.close(read)
    text = got.decode()
    assert "line 3999 " in text and "the last word" in text
    assert LEFT_OUT.strip() in text and len(text) < 4 * MOST_WAITING


@pytest.mark.timeout(60)
def test_a_terminal_that_has_gone_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with standard_error(monkeypatch) as read:
        os.close(read)
        before = sys.stderr
        with unhurried_standard_error():
            for _ in range(10):
                print("is anybody there?", file=sys.stderr)
        assert sys.stderr is before
