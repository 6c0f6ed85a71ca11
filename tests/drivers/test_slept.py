"""After this computer has slept: what waited unread has no date, and the silence of that time means nothing."""

import asyncio
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from benches import until

from drivers import links
from drivers.arrival import SETTLE_S, UNSEEN_S, Attention
from drivers.emulators.sniffers import NrfDongle, TiDongle
from drivers.emulators.wires import PluggedModule, PtyWire
from drivers.lines.receiver import open_receiver as open_lines
from drivers.links import REOPEN_AFTER_S, TcpLink
from drivers.sniffers.receiver import open_nrf, open_ti
from drivers.xbee.receiver import open_receiver as open_xbee
from fieldkit.clock import RealClock, awake_or_not_s
from fieldkit.geo import FieldFrame
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext


class Laptop:
    """A clock that can be put to sleep: it wakes up later, and nobody has run meanwhile."""

    def __init__(self) -> None:
        self.slept_s = 0.0

    def seconds(self) -> float:
        return awake_or_not_s() + self.slept_s


@pytest.fixture
def laptop(monkeypatch: pytest.MonkeyPatch) -> Laptop:
    laptop = Laptop()
    monkeypatch.setattr(links, "Attention", lambda: Attention(laptop.seconds))
    return laptop


def test_a_second_without_a_look_is_noticed_once_and_less_is_not() -> None:
    now_s = [10.0]
    attention = Attention(lambda: now_s[0])
    now_s[0] += UNSEEN_S - 0.01
    assert attention.look() == 0.0 and attention.settled
    now_s[0] += UNSEEN_S + 0.5
    assert attention.look() == pytest.approx(UNSEEN_S + 0.5) and not attention.settled
    now_s[0] += SETTLE_S - 0.01
    assert attention.look() == 0.0 and not attention.settled
    now_s[0] += 0.02
    assert attention.look() == 0.0 and attention.settled


def test_the_missions_clock_goes_on_while_the_computer_sleeps(monkeypatch: pytest.MonkeyPatch) -> None:
    if not hasattr(time, "CLOCK_BOOTTIME"):
        pytest.skip("this system has no clock that says so")
    clock, real = RealClock(), time.clock_gettime_ns
    before_ns, before_s = clock.now_ns(), clock.elapsed_s()
    monkeypatch.setattr(time, "clock_gettime_ns", lambda which: real(which) + 60_000_000_000)
    assert clock.now_ns() - before_ns >= 60_000_000_000
    assert clock.elapsed_s() - before_s >= 60.0


async def heard_around_a_sleep(
    receiver: object,
    hear: Callable[[], object],
    laptop: Laptop,
    slept_s: float,
    hears: Callable[[], bool] = lambda: True,
) -> list[RssReading | ReceiverState]:
    """A reception before the sleep, two that waited, and one after it."""
    seen: list[RssReading | ReceiverState] = []

    async def listen() -> None:
        async for item in receiver.readings():  # type: ignore[attr-defined]
            seen.append(item)

    def readings() -> int:
        return sum(isinstance(item, RssReading) for item in seen)

    async with receiver:  # type: ignore[attr-defined]
        task = asyncio.create_task(listen())
        await until(lambda: bool(seen) and hears())
        hear()
        await until(lambda: readings() == 1)
        laptop.slept_s += slept_s
        hear()
        hear()
        await until(lambda: receiver.unseen_readings == 2)  # type: ignore[attr-defined]
        await asyncio.sleep(SETTLE_S + 0.3)
        hear()
        await until(lambda: readings() == 2)
    await task
    return seen


def judge(seen: list[RssReading | ReceiverState], slept_s: float) -> None:
    """Down from when nobody looked, up since; then how many were left out, and what was heard since."""
    opened, before, down, up, told, after = seen
    assert isinstance(before, RssReading) and isinstance(after, RssReading)
    for state in (opened, down, up, told):
        assert isinstance(state, ReceiverState)
    assert not down.up and "nobody read it" in down.reason and up.up
    assert (up.t_ns - down.t_ns) * 1e-9 == pytest.approx(slept_s, abs=1.0)
    assert told.up and "2 receptions" in told.reason
    assert before.t_ns <= up.t_ns <= after.t_ns


async def test_a_printing_radio_says_that_nobody_read_it_and_leaves_out_what_waited(laptop, tmp_path) -> None:
    pipe = tmp_path / "radio"
    os.mkfifo(pipe)
    receiver = open_lines(
        "ada",
        {"port": str(pipe), "format": "regex", "pattern": "(?P<rss>-[0-9]+)"},
        DriverContext(RealClock(), FieldFrame(0.0, 0.0)),
    )
    seen = await heard_around_a_sleep(receiver, lambda: pipe.write_text("-70\n"), laptop, 61.0)
    judge(seen, 61.0)


async def test_an_xbee_says_that_nobody_read_it_and_leaves_out_what_waited(laptop, plug) -> None:
    radio = await plug("s2c")
    receiver = open_xbee("ada", {"port": radio.wire.port}, DriverContext(RealClock(), FieldFrame(0.0, 0.0)))
    seen = await heard_around_a_sleep(receiver, lambda: radio.hear(-70.0, 0x1234, b"x"), laptop, 2.5)
    judge(seen, 2.5)


@pytest.mark.parametrize(("make", "opener"), [(NrfDongle, open_nrf), (TiDongle, open_ti)])
async def test_a_sniffer_says_that_nobody_read_it_and_leaves_out_what_waited(
    laptop, tmp_path, make, opener
) -> None:
    clock = RealClock()
    radio = PluggedModule(make(lambda: clock.now_ns() // 1000), PtyWire(tmp_path / "dongle"))
    await radio.plug()
    receiver = opener("ada", {"port": radio.wire.port}, DriverContext(clock, FieldFrame(0.0, 0.0)))
    seen = await heard_around_a_sleep(
        receiver, lambda: radio.hear(-66.0, 5, b"x"), laptop, 30.0, lambda: radio.module.capturing
    )
    judge(seen, 30.0)
    radio.unplug()


def test_a_connection_that_nobody_read_for_long_is_opened_anew(laptop: Laptop) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = TcpLink(*server.getsockname())
        far, _ = server.accept()
        with far:
            far.sendall(b"a")
            assert link.read() == b"a"
            laptop.slept_s += REOPEN_AFTER_S - 1.0
            far.sendall(b"b")
            assert link.read() == b"b"
            laptop.slept_s += REOPEN_AFTER_S + 1.0
            with pytest.raises(ConnectionResetError, match="opened anew"):
                link.read()
        link.close()


LISTENER = """
import asyncio, sys
from drivers.lines.receiver import open_receiver
from fieldkit.clock import RealClock
from fieldkit.geo import FieldFrame
from fieldkit.messages import RssReading
from fieldkit.ports import DriverContext

async def listen():
    options = {"port": sys.argv[1], "format": "regex", "pattern": "(?P<rss>-[0-9]+)"}
    async with open_receiver("ada", options, DriverContext(RealClock(), FieldFrame(0.0, 0.0))) as receiver:
        async for item in receiver.readings():
            what = round(item.rss_dbm) if isinstance(item, RssReading) else "up" if item.up else "down"
            print(what, item.t_ns, flush=True)

asyncio.run(listen())
"""


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="this system stops no processes")
def test_a_process_that_was_stopped_dates_nothing_that_waited(tmp_path: Path) -> None:
    """The real thing: a radio prints on while its reader is stopped for three seconds."""
    pipe = tmp_path / "radio"
    os.mkfifo(pipe)
    command = [sys.executable, "-c", LISTENER, str(pipe)]
    said: list[tuple[str, int]] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout is not None
        radio = os.open(pipe, os.O_RDWR)

        def until(what: str) -> None:
            while not said or said[-1][0] != what:
                word, t_ns = listener.stdout.readline().split()
                said.append((word, int(t_ns)))

        def hear(rss_dbm: int) -> None:
            os.write(radio, f"{rss_dbm}\n".encode())

        try:
            until("up")
            hear(-70)
            until("-70")
            listener.send_signal(signal.SIGSTOP)
            for _ in range(3):
                time.sleep(1.0)
                hear(-80)
            listener.send_signal(signal.SIGCONT)
            time.sleep(3.0 * SETTLE_S)
            hear(-75)
            until("-75")
        finally:
            listener.kill()
            os.close(radio)
    assert [word for word, _ in said] == ["up", "-70", "down", "up", "up", "-75"]
    assert said[3][1] - said[2][1] > 2_000_000_000, "down from when nobody looked"
