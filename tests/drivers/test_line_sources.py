"""Where printed lines come from, whatever happens there, and what silence then means."""

import asyncio
import json
import os
import socket
import sqlite3
import threading
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path
from unittest.mock import Mock

import pytest
from lines_bench import context, receiving

from drivers.emulators.kismet import EmulatedKismet
from drivers.emulators.printer import PrintingRadio
from drivers.emulators.wires import PluggedModule, PtyWire
from drivers.lines.mapping import LineMap
from drivers.lines.maps import MAPS
from drivers.lines.receiver import SENSELESS, LineSplitter, open_receiver
from drivers.lines.sources import JoinedLink, open_source
from drivers.links import device_and_baud
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceError

# -- sources ---------------------------------------------------------------------------------------------------

GOOD = b'{"rss_dbm": -71, "source_id": "a"}\n'


async def test_udp_datagrams_are_lines(unused_udp_port: int) -> None:
    async with receiving(port=f"udp://127.0.0.1:{unused_udp_port}", map="json") as seen:
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            asyncio.DatagramProtocol, remote_addr=("127.0.0.1", unused_udp_port)
        )
        for _ in range(5):
            transport.sendto(GOOD.rstrip())
        await seen.until(lambda s: len(s.readings) == 5)
        transport.close()
    assert {(r.rss_dbm, r.frame_id, r.via) for r in seen.readings} == {(-71.0, "a", "lines")}


async def test_several_radios_may_connect_and_their_lines_are_not_mixed(unused_tcp_port: int) -> None:
    async with receiving(port=f"tcp://127.0.0.1:{unused_tcp_port}", map="json") as seen:
        writers = [(await asyncio.open_connection("127.0.0.1", unused_tcp_port))[1] for _ in range(3)]
        for half in (GOOD[:15], GOOD[15:]):
            for writer in writers:
                writer.write(half)
                await writer.drain()
                await asyncio.sleep(0.02)
        writers[0].write(GOOD.rstrip())  # its last line has no end: the connection's is one
        for writer in writers:
            writer.close()
        await seen.until(lambda s: len(s.readings) == 4)


async def test_a_file_that_grows_is_followed_also_when_it_is_replaced(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    log.write_bytes(GOOD * 3)
    async with receiving(port=str(log), map="json") as seen:
        await asyncio.sleep(0.2)
        assert not seen.readings  # what was in it already is the past
        with log.open("ab") as file:
            file.write(GOOD)
        await seen.until(lambda s: len(s.readings) == 1)
        other = tmp_path / "new.jsonl"
        other.write_bytes(GOOD * 2)
        other.replace(log)
        await seen.until(lambda s: len(s.readings) == 3)
    async with receiving(port=str(log), map="json", from_start=True) as seen:
        await seen.until(lambda s: len(s.readings) == 2)


async def test_half_a_line_and_half_another_are_no_reading(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_bytes(b"RSSI -9")  # of -90: we come in the middle of a line
    async with receiving(port=str(log), format="regex", pattern=r"(?P<rss>-?\d+)") as seen:
        with log.open("ab") as file:
            file.write(b"0\nRSSI -80\nRSSI -7")  # of -71: the file is replaced in the middle of a line
        await seen.until(lambda s: len(s.readings) == 1)
        await asyncio.sleep(0.2)
        new = tmp_path / "new"
        new.write_bytes(b"RSSI -82\n")
        new.replace(log)
        await seen.until(lambda s: len(s.readings) == 2)
        log.write_bytes(b"")  # cut
        await asyncio.sleep(0.2)
        log.write_bytes(b"RSSI -83\n")
        await seen.until(lambda s: len(s.readings) == 3)
    assert [reading.rss_dbm for reading in seen.readings] == [-80.0, -82.0, -83.0]


@pytest.mark.parametrize(
    ("pieces", "lines"),
    [
        ([b"07\nRSSI -80\n", b"RSSI -81\n"], ["RSSI -80", "RSSI -81"]),  # of "RSSI -107"
        ([b"", b"RSSI -82\n"], ["RSSI -82"]),  # it was quiet when it was opened: the first line is whole
        ([b"0", b"", b"7", b"\r\nRSSI -83\r\n"], ["RSSI -83"]),
    ],
)
def test_a_device_in_the_middle_of_a_line_loses_that_line_alone(
    pieces: list[bytes], lines: list[str]
) -> None:
    given, split = iter(pieces), LineSplitter()
    device = Mock(arrived_s=0.0, read=lambda: next(given, b""))
    link = JoinedLink(device)
    assert [line for _ in pieces for line in split.feed(link.read())] == lines


@pytest.mark.parametrize(
    ("text", "device", "baud"),
    [
        ("/dev/ttyUSB0", "/dev/ttyUSB0", None),
        ("/dev/ttyUSB0:4800", "/dev/ttyUSB0", 4800),
        ("COM3:38400", "COM3", 38400),
        ("COM3", "COM3", None),
        ("socket://10.0.0.2:4800", "socket://10.0.0.2:4800", None),
        ("/dev/serial/by-path/usb-0:1:1.0", "/dev/serial/by-path/usb-0:1:1.0", None),
    ],
)
def test_a_serial_device_may_carry_its_rate(text: str, device: str, baud: int | None) -> None:
    assert device_and_baud(text) == (device, baud)


def test_a_name_with_a_colon_that_is_there_is_a_name(tmp_path: Path) -> None:
    there = tmp_path / "usb-0:1"
    there.touch()
    assert device_and_baud(str(there)) == (str(there), None)


def test_the_rate_behind_a_device_counts_more_than_the_option(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Mock(return_value=Mock(read=lambda: b"", arrived_s=0.0))
    monkeypatch.setattr("drivers.lines.sources.open_link", asked)
    open_source("/dev/ttyNOT:4800", 9600, "radio", from_start=False)
    assert asked.call_args.args[:2] == ("/dev/ttyNOT", 4800)


async def test_a_named_pipe_outlives_its_writers(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    async with receiving(port=str(pipe), map="json") as seen:
        for count in (1, 2):
            descriptor = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
            os.write(descriptor, GOOD)
            os.close(descriptor)
            await seen.until(lambda s, count=count: len(s.readings) == count)  # type: ignore[misc]


@pytest.mark.parametrize("kind", ["pipe", "tcp"])
async def test_nobody_at_the_far_end_is_no_silence(
    kind: str, unused_tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.lines.sources.ALONE_S", 0.3)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    port = str(pipe) if kind == "pipe" else f"tcp://127.0.0.1:{unused_tcp_port}"

    def join() -> Callable[[], None]:
        if kind == "pipe":
            return partial(os.close, os.open(pipe, os.O_WRONLY | os.O_NONBLOCK))
        return socket.create_connection(("127.0.0.1", unused_tcp_port)).close

    async with receiving(port=port, map="json") as seen:
        await seen.until(lambda s: not s.is_up)
        leave = join()
        await seen.until(lambda s: s.is_up)  # it has printed nothing, and would
        await asyncio.sleep(0.5)
        assert seen.is_up
        leave()
        await seen.until(lambda s: not s.is_up)
    assert "connected" in seen.states[-1].reason or "writes into" in seen.states[-1].reason


async def test_standard_input_ends_when_the_other_program_does(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    with os.fdopen(reader) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        async with receiving(port="-", map="json") as seen:
            os.write(writer, GOOD)
            await seen.until(lambda s: len(s.readings) == 1)
            os.close(writer)
            await seen.until(lambda s: not s.is_up)
    assert "the program that prints has ended" in seen.states[-1].reason


async def test_a_broker_is_listened_to_and_missed_when_it_goes(unused_tcp_port: int) -> None:
    from amqtt.broker import Broker  # type: ignore[import-untyped]
    from paho.mqtt import publish

    config = {
        "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{unused_tcp_port}"}},
        "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
    }
    broker = Broker(config)
    await broker.start()
    send = partial(publish.single, "field/r1/rx", GOOD.rstrip(), hostname="127.0.0.1", port=unused_tcp_port)
    kept = partial(
        publish.single,
        "field/r1/rx",
        b'{"rss_dbm": -40}',
        retain=True,
        hostname="127.0.0.1",
        port=unused_tcp_port,
    )
    await asyncio.get_running_loop().run_in_executor(None, kept)  # nobody knows how long ago
    async with receiving(port=f"mqtt://127.0.0.1:{unused_tcp_port}/field/+/rx", map="json") as seen:
        await asyncio.get_running_loop().run_in_executor(None, send)
        await seen.until(lambda s: len(s.readings) == 1)
        await broker.shutdown()
        await seen.until(lambda s: not s.is_up)
    assert seen.readings[0].rss_dbm == -71.0


async def test_no_broker_is_an_error_that_names_the_address(unused_tcp_port: int) -> None:
    with pytest.raises(DeviceError, match=f"127.0.0.1:{unused_tcp_port}"):
        async with receiving(port=f"mqtt://127.0.0.1:{unused_tcp_port}/x", map="json"):
            pass
    with pytest.raises(DeviceError, match="got no topic"):
        async with receiving(port="mqtt://127.0.0.1", map="json"):
            pass


async def test_kismet_gives_a_line_for_each_device_heard_again() -> None:
    mac = "5C:31:3E:A1:B2:C3"
    with EmulatedKismet() as kismet:
        kismet.hear(mac, -61.0)
        kismet.hear("00:00:00:00:00:01", 0.0)  # 0: a device without a level
        async with receiving(port=kismet.port, map="kismet") as seen:
            await asyncio.sleep(1.2)
            assert not seen.readings  # known already when we came
            kismet.hear(mac, -61.0)
            await seen.until(lambda s: len(s.readings) == 1)
        assert not kismet.refused
        with pytest.raises(DeviceError, match="answers 401; give an API key"):
            async with receiving(port=kismet.port.partition("?")[0], map="kismet"):
                pass
        assert kismet.refused == 1
    assert (seen.readings[0].frame_id, seen.readings[0].channel) == (mac, 6)


@pytest.mark.parametrize("clock_off_s", [-300_000_000, 300_000_000])
async def test_a_kismet_whose_clock_is_years_off_is_heard(clock_off_s: int) -> None:
    with EmulatedKismet(clock_off_s=clock_off_s) as kismet:
        async with receiving(port=kismet.port, map="kismet") as seen:
            kismet.hear("AA", -61.0)
            await seen.until(lambda s: len(s.readings) == 1)


@pytest.mark.parametrize(
    "answer",
    [
        b"SSH-2.0-OpenSSH\r\n",
        b"HTTP/1.0 200 OK\r\nContent-Length: 50\r\n\r\n[]",
        b"HTTP/1.0 200 OK\r\n\r\n<html>",
        b"HTTP/1.0 200 OK\r\n\r\n" + b"[" * 100_000,
        b'HTTP/1.0 200 OK\r\n\r\n{"error": "no such view"}',
        b"HTTP/1.0 200 OK\r\n\r\n[1, 2]",
        b'HTTP/1.0 200 OK\r\n\r\n[{"mac": "a", "packets": [1]}]',
    ],
)
async def test_what_is_no_kismet_is_said_so_and_never_taken_for_silence(answer: bytes) -> None:
    answers, heard = [b"HTTP/1.0 200 OK\r\n\r\n[]"] * 2 + [answer] * 3, count(1)

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"]]}")  # what is unread when we close resets the connection
        again = b'HTTP/1.0 200 OK\r\n\r\n[{"mac": "a", "packets": %d, "signal": -50}]' % next(heard)
        answers.append(again)
        writer.write(answers.pop(0))
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        port = f"kismet://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        async with receiving(port=port, map="kismet") as seen:
            await seen.until(lambda s: not s.is_up)
            assert "is it Kismet?" in seen.states[-1].reason
            await seen.until(lambda s: s.is_up and len(s.readings) == 1)
        answers[:] = [answer]
        with pytest.raises(DeviceError, match="is it Kismet"):
            async with receiving(port=port, map="kismet"):
                pass


async def test_a_kismet_database_gives_a_line_for_each_packet(tmp_path: Path) -> None:
    path = tmp_path / "log.kismet"
    with sqlite3.connect(path) as database:
        database.execute(
            "create table packets (ts_sec int, ts_usec int, sourcemac text, frequency real, signal int)"
        )
        insert = "insert into packets values (1700000000, 250000, 'AA', 2437000, ?)"
        database.execute(insert, (-50,))
        database.commit()
        async with receiving(port=f"kismetdb:{path}", map="kismet") as seen:
            for signal in (-61, 0):  # 0: this interface tells no strength
                database.execute(insert, (signal,))
            database.commit()
            await seen.until(lambda s: len(s.readings) == 1)
    database.close()
    assert (seen.readings[0].rss_dbm, seen.readings[0].channel) == (-61.0, 6)
    (tmp_path / "text").write_text("no database")
    with pytest.raises(DeviceError, match="not a kismetdb"):
        async with receiving(port=f"kismetdb:{tmp_path / 'text'}", map="kismet"):
            pass


# -- silence ---------------------------------------------------------------------------------------------------


async def test_silence_is_known_to_be_silence_only_while_lines_come(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.touch()
    async with receiving(port=str(log), map="json", heard="rss_dbm", heartbeat_s=0.3) as seen:
        await seen.until(lambda s: not s.is_up)
        assert "no line for" in seen.states[-1].reason
        with log.open("ab") as file:
            file.write(b'{"rss_dbm": null}\n')
        await seen.until(lambda s: s.is_up)
        assert not seen.readings


async def test_bytes_without_an_end_of_line_are_no_sign_of_life(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for more, data, says in (
        ({"heartbeat_s": 0.3}, b"\x80x", "no line for"),
        ({}, b"x" * 30_000, "end of line"),
    ):
        async with receiving(port=str(pipe), map="json", **more) as seen:
            descriptor = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
            while seen.is_up:
                os.write(descriptor, data)
                await asyncio.sleep(0.02)
            os.write(descriptor, b"\n" + GOOD)
            await seen.until(lambda s: s.is_up and len(s.readings) == 1)
            os.close(descriptor)
        assert says in seen.states[-2].reason


async def test_a_reader_that_fails_is_no_silence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log"
    log.touch()
    async with receiving(port=str(log), map="json") as seen:
        with monkeypatch.context() as broken:
            broken.setattr(LineMap, "read", lambda self, line: 1 / 0)
            with log.open("ab") as file:
                file.write(GOOD)
            await seen.until(lambda s: not s.is_up)
        assert "its reader failed (ZeroDivisionError" in seen.states[-1].reason
        await seen.until(lambda s: s.is_up)
        with log.open("ab") as file:
            file.write(GOOD)
        await seen.until(lambda s: len(s.readings) == 1)


async def test_lines_that_make_no_sense_count_as_deafness_and_are_shown(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.touch()
    async with receiving(port=str(log), map="json") as seen:
        with log.open("ab") as file:
            file.write(b'{"rss_dbm": 71}\n' * SENSELESS)
        await seen.until(lambda s: not s.is_up)
        reason = seen.states[-1].reason
        assert (
            "its lines are no readings" in reason and "rss_dbm" in reason and 'is the unit "-dBm"' in reason
        )
        with log.open("ab") as file:
            file.write(GOOD)
        await seen.until(lambda s: s.is_up and len(s.readings) == 1)


async def test_a_radios_own_clock_may_be_years_off(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.touch()
    now_ns = RealClock().now_ns()
    async with receiving(port=str(log), map="json", time="t") as seen:
        for at_s in (1.25, 1.75, 900_000_000.5, 900_000_000.625):
            with log.open("ab") as file:
                file.write(json.dumps({"rss_dbm": -70, "t": at_s}).encode() + b"\n")
            await asyncio.sleep(0.1)
        await seen.until(lambda s: len(s.readings) == 4)
    stamps = [reading.t_ns for reading in seen.readings]
    assert stamps == sorted(stamps)
    assert all(0 <= stamp - now_ns < 5_000_000_000 for stamp in stamps)


async def test_only_what_is_asked_for_is_a_reading(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.touch()
    async with receiving(port=str(log), map="json", only="b", only_channel=6) as seen:
        with log.open("ab") as file:
            for source, channel in (("a", 6), ("b", 1), ("b", 6)):
                row = {"rss_dbm": -70, "source_id": source, "channel": channel}
                file.write(json.dumps(row).encode() + b"\n")
        await seen.until(lambda s: len(s.readings) == 1)
    assert (seen.readings[0].frame_id, seen.readings[0].channel) == ("b", 6)


async def test_packets_with_a_number_are_told_apart_and_joined(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.touch()
    async with receiving(port=str(log), map="meshtastic") as seen:
        with log.open("ab") as file:
            file.write(MAPS["meshtastic"].example.encode() + b"\n")
        await seen.until(lambda s: len(s.readings) == 1)
    assert seen.readings[0].frame_id == f"!7efeee00/{447103 & 255:02x}"


async def test_four_thousand_lines_a_second_are_all_taken(tmp_path: Path) -> None:
    """Every line that is printed, however fast; the rate itself is measured by the benchmark."""
    radio = PluggedModule(PrintingRadio(lambda: 0, "rylr"), PtyWire(tmp_path / "radio"))
    await radio.plug()
    try:
        async with receiving(port=radio.wire.port, map="rylr") as seen:
            for number in range(4_000):
                while not radio.hear(-60.0 - number % 30, number, b""):  # noqa: ASYNC110
                    await asyncio.sleep(0.001)
                if number % 50 == 0:
                    await asyncio.sleep(0.002)
            await seen.until(lambda s: len(s.readings) == 4_000)
    finally:
        radio.unplug()
    assert all(state.up for state in seen.states)


async def test_closing_waits_for_no_line_that_has_not_been_looked_at(
    unused_udp_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pattern may think for long about each of thousands of lines that came at once."""
    looked_at, may_go_on = 0, threading.Event()

    def read(_: LineMap, line: str) -> None:
        nonlocal looked_at
        looked_at += 1
        may_go_on.wait()

    monkeypatch.setattr(LineMap, "read", read)
    async with open_receiver(
        "ada", {"port": f"udp://127.0.0.1:{unused_udp_port}", "map": "json"}, context()
    ) as radio:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"{}\n" * 1_000, ("127.0.0.1", unused_udp_port))
        while not looked_at:  # noqa: ASYNC110 - it is the thread that is watched
            await asyncio.sleep(0.01)
        radio._running.clear()  # as closing begins
        may_go_on.set()
    assert looked_at == 1
