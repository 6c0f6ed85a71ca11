"""Every fault an emulator knows, on every radio's wire; and a radio behind RFC 2217."""

import asyncio
import random
import socket
import threading
from types import SimpleNamespace

import pytest
import serial
from benches import FRAME, until
from serial.rfc2217 import PortManager

from drivers.emulators.faults import FAULTS, SkewedClock, wrong_baud
from drivers.emulators.sniffers import NrfDongle, TiDongle
from drivers.emulators.wires import PluggedModule, PtyWire
from drivers.emulators.xbee import Module
from drivers.sniffers.receiver import open_nrf, open_ti
from drivers.xbee.receiver import open_receiver
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceError
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext
from fieldkit.testing import nothing_left

CLOCK = RealClock()
SENDER = 0x0013A20041000001


def now_us() -> int:
    return CLOCK.now_ns() // 1000


RADIOS = {
    "xbee": (Module, open_receiver),
    "nrf": (lambda: NrfDongle(now_us), open_nrf),
    "ti": (lambda: TiDongle(now_us), open_ti),
}
every_radio = pytest.mark.parametrize("name", RADIOS)


class Open:
    """A driver on its emulator, and what it has given."""

    def __init__(self, name, path, **options):
        make, opener = RADIOS[name]
        self.radio = PluggedModule(make(), PtyWire(path / "radio"))
        self.path, self.opener, self.options = path, opener, options
        self.items = []

    async def __aenter__(self):
        await self.radio.plug()
        options = {"port": self.radio.wire.port, **self.options}
        self.receiver = self.opener("ada", options, DriverContext(CLOCK, FRAME))
        await self.receiver.__aenter__()
        self.task = asyncio.create_task(self.collect())
        return self

    async def collect(self):
        async for item in self.receiver.readings():
            self.items.append(item)

    async def __aexit__(self, *error):
        await self.receiver.__aexit__(None, None, None)
        await self.task
        self.radio.unplug()

    @property
    def strengths(self):
        return [int(item.rss_dbm) for item in self.items if isinstance(item, RssReading)]

    @property
    def states(self):
        return [item for item in self.items if isinstance(item, ReceiverState)]


@every_radio
@pytest.mark.parametrize("fault", FAULTS)
async def test_a_fault_costs_what_it_damaged_and_the_radio_stays(tmp_path, name, fault):
    """A false start may swallow the frames after it until the line is quiet for a moment; then all is well."""
    rng = random.Random(3)
    async with nothing_left(), Open(name, tmp_path) as bench:
        for number in range(30):
            bench.radio.rewrite = FAULTS[fault](rng) if number % 10 == 5 else None
            bench.radio.hear(-50.0 - number, SENDER, b"beacon")
            await asyncio.sleep(0.2 if number % 10 == 5 else 0.0)
        await until(lambda: bench.strengths[-1:] == [-79])
        got = [-50 - strength for strength in bench.strengths]
        assert set(range(30)) - set(got) <= {5, 15, 25}
        assert got == sorted(got)
    assert [state.up for state in bench.states] == [True]


@every_radio
async def test_a_pause_delays_and_loses_nothing(tmp_path, name):
    async with Open(name, tmp_path) as bench:
        bench.radio.pause()
        for number in range(5):
            bench.radio.hear(-60.0 - number, SENDER, b"x")
        await asyncio.sleep(0.3)
        assert not bench.strengths
        bench.radio.resume()
        await until(lambda: len(bench.strengths) == 5)
    assert bench.strengths == [-60, -61, -62, -63, -64]


@every_radio
async def test_a_radio_that_restarts_is_heard_again(tmp_path, name, monkeypatch):
    monkeypatch.setattr("drivers.sniffers.receiver.ASK_AGAIN_S", 0.3)
    async with Open(name, tmp_path) as bench:
        bench.radio.hear(-60.0, SENDER, b"x")
        await until(lambda: bench.strengths == [-60])
        bench.radio.reboot()
        await until(lambda: bench.radio.hear(-61.0, SENDER, b"x"))
        await until(lambda: -61 in bench.strengths)


@every_radio
async def test_a_radio_that_comes_back_under_another_name_is_taken_there(tmp_path, name, monkeypatch):
    adapter = {"vid": 0x0403, "pid": 0x6015, "serial_number": "DN04"}
    there = [SimpleNamespace(device=str(tmp_path / "radio"), **adapter)]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: list(there))
    async with Open(name, tmp_path) as bench:
        there.clear()
        bench.radio.unplug()
        await until(lambda: bench.states and not bench.states[-1].up, 3.0)
        await bench.radio.move(PtyWire(tmp_path / "elsewhere"))
        there.append(SimpleNamespace(device=str(tmp_path / "elsewhere"), **adapter))
        await until(lambda: bench.states[-1].up)
        bench.radio.hear(-64.0, SENDER, b"x")
        await until(lambda: bench.strengths == [-64])


@pytest.mark.parametrize(("make", "opener"), [(NrfDongle, open_nrf), (TiDongle, open_ti)])
async def test_a_dongles_clock_may_drift_and_jump_back(tmp_path, make, opener):
    """Stamps stay in order and near the truth."""
    skewed = SkewedClock(now_us, 200.0)
    radio = PluggedModule(make(skewed), PtyWire(tmp_path / "radio"))
    await radio.plug()
    readings, sent = [], []
    around = DriverContext(CLOCK, FRAME)
    async with opener("ada", {"port": radio.wire.port}, around) as receiver:

        async def collect():
            async for item in receiver.readings():
                if isinstance(item, RssReading):
                    readings.append(item)

        task = asyncio.create_task(collect())
        for number in range(40):
            if number == 20:
                skewed.jump_us = -3_600_000_000
            sent.append(CLOCK.now_ns())
            radio.hear(-60.0, SENDER, b"x")
            await asyncio.sleep(0.01)
        await until(lambda: len(readings) == 40)
    await task
    radio.unplug()
    stamps = [reading.t_ns for reading in readings]
    assert stamps == sorted(stamps)
    late_ms = sorted(abs(a - b) * 1e-6 for a, b in zip(stamps, sent, strict=True))
    assert late_ms[20] < 50.0


@every_radio
async def test_at_the_wrong_baud_rate_opening_fails_and_says_so(tmp_path, name):
    make, opener = RADIOS[name]
    radio = PluggedModule(make(), PtyWire(tmp_path / "radio"))
    radio.always = wrong_baud(random.Random(5))
    await radio.plug()

    async def chatter():
        while True:
            radio.write(b"some bytes at another rate")
            await asyncio.sleep(0.02)

    talking = asyncio.create_task(chatter())
    with pytest.raises(DeviceError, match="baud"):
        async with opener("ada", {"port": radio.wire.port}, DriverContext(CLOCK, FRAME)):
            pass
    talking.cancel()
    await asyncio.wait({talking})
    radio.unplug()


@pytest.mark.parametrize("opener", [open_nrf, open_ti])
async def test_another_firmware_is_told_from_none(tmp_path, opener):
    """A sniffer driver on an XBee's port, and on a port where nothing answers."""
    quiet, other = (PluggedModule(Module(), PtyWire(tmp_path / each)) for each in ("quiet", "other"))
    quiet.module.dead = True
    words = []
    for radio in (quiet, other):
        await radio.plug()

        async def chatter(radio=radio):
            while radio is other:
                radio.hear(-60.0, SENDER, b"an XBee hears this")
                await asyncio.sleep(0.02)

        talking = asyncio.create_task(chatter())
        with pytest.raises(DeviceError) as caught:
            async with opener("ada", {"port": radio.wire.port}, DriverContext(CLOCK, FRAME)):
                pass
        words.append(str(caught.value))
        talking.cancel()
        await asyncio.wait({talking})
        radio.unplug()
    assert "nothing answers" in words[0] and "firmware" in words[1] and words[0] != words[1]


@every_radio
async def test_a_missing_port_is_named_with_a_remedy(tmp_path, name):
    opener = RADIOS[name][1]
    with pytest.raises(DeviceError, match=r"no device at .*ttyUSB7"):
        async with opener("ada", {"port": str(tmp_path / "ttyUSB7")}, DriverContext(CLOCK, FRAME)):
            pass


@every_radio
async def test_a_busy_port_is_named_with_a_remedy(tmp_path, name):
    async with Open(name, tmp_path) as bench:
        with pytest.raises(DeviceError, match="in use by another program"):
            async with bench.opener("bob", {"port": bench.radio.wire.port}, DriverContext(CLOCK, FRAME)):
                pass


@pytest.mark.parametrize("rss_dbm", [0, 20])
@pytest.mark.parametrize(("make", "opener"), [(NrfDongle, open_nrf), (TiDongle, open_ti)])
async def test_a_strength_that_is_none_gives_no_reading(tmp_path, make, opener, rss_dbm):
    """0 and positive values are what a firmware says where it has no measurement."""
    radio = PluggedModule(make(now_us), PtyWire(tmp_path / "radio"))
    await radio.plug()
    async with opener("ada", {"port": radio.wire.port}, DriverContext(CLOCK, FRAME)) as receiver:
        radio.hear(float(rss_dbm), SENDER, b"x")
        radio.hear(-70.0, SENDER, b"x")
        async for item in receiver.readings():
            if isinstance(item, RssReading):
                assert item.rss_dbm == -70.0
                break
    radio.unplug()


class PtySerial(serial.Serial):
    """A pty for pyserial: it has no modem lines to ask or set."""

    cts = dsr = True
    ri = cd = False

    def _update_dtr_state(self) -> None:
        pass

    _update_rts_state = _update_break_state = _update_dtr_state


class Rfc2217Server:
    """One serial port served over TCP as RFC 2217 servers do, with pyserial's own protocol engine."""

    def __init__(self, port: str) -> None:
        self.serial = PtySerial(port, timeout=0.05)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"rfc2217://127.0.0.1:{self.listener.getsockname()[1]}"
        self.running = True
        self.threads = [threading.Thread(target=self.serve)]
        self.threads[0].start()

    def serve(self) -> None:
        self.listener.settimeout(0.1)
        while self.running:
            try:
                self.client, _ = self.listener.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            self.client.settimeout(0.05)
            manager = PortManager(self.serial, self)
            pump = threading.Thread(target=self.pump, args=(manager, self.client))
            pump.start()
            while self.running:
                try:
                    data = self.client.recv(1024)
                except TimeoutError:
                    continue
                except OSError:
                    break
                if not data:
                    break
                self.serial.write(b"".join(manager.filter(data)))
            self.client.close()
            pump.join()

    def pump(self, manager, client) -> None:
        while self.running and client.fileno() >= 0:
            try:
                if data := self.serial.read(self.serial.in_waiting or 1):
                    client.sendall(b"".join(manager.escape(data)))
            except OSError:
                return

    def write(self, data: bytes) -> None:
        """What the protocol engine sends."""
        self.client.sendall(data)

    def close(self) -> None:
        self.running = False
        self.threads[0].join()
        self.listener.close()
        self.serial.close()


async def test_a_radio_behind_rfc2217_is_heard(plug, listening):
    radio = await plug()
    server = await asyncio.to_thread(Rfc2217Server, radio.wire.port)
    async with nothing_left():
        async with listening(server.url) as heard:
            for number in range(5):
                radio.hear(-60.0 - number, SENDER, b"\xff\xff\x11\x13 telnet and flow control bytes")
            await heard.until(lambda: len(heard.readings) == 5)
        assert [reading.rss_dbm for reading in heard.readings] == [-60.0, -61.0, -62.0, -63.0, -64.0]
        await asyncio.to_thread(server.close)
