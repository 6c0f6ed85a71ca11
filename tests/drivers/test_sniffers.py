"""Sniffer dongles: their codecs, and the receiver on emulated ones."""

import asyncio

import pytest
from benches import FRAME, until
from hypothesis import given
from hypothesis import strategies as st

from drivers.emulators.sniffers import NrfDongle, TiDongle, data_frame
from drivers.emulators.wires import PluggedModule, PtyWire
from drivers.sniffers.ieee802154 import fcs, frame_id
from drivers.sniffers.nrf import NrfText
from drivers.sniffers.protocol import Unwrap32
from drivers.sniffers.receiver import open_nrf, open_ti
from drivers.sniffers.ti import PING, TiBinary, command
from fieldkit.clock import RealClock
from fieldkit.errors import ConfigError
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext
from fieldkit.testing import nothing_left

LINE = b"received: 49a8e69a9c03004802ae00003c0b power: -61 lqi: 120 time: 123456789\r\n"


def heard_by(make, **options):
    """A dongle that captures on channel 15 already."""
    time_us = iter(range(1_000_000, 10**9, 1000))
    dongle = make(lambda: next(time_us), **options)
    protocol = NrfText() if make is NrfDongle else TiBinary()
    for each in protocol.start(15):
        for reply in dongle.receive(each, 0.0):
            assert list(protocol.feed(reply)) == []
    return dongle, protocol


both = pytest.mark.parametrize("make", [NrfDongle, TiDongle])


def test_the_check_sequence_is_the_standards():
    # IEEE 802.15.4-2015, 7.2.10: an acknowledgement, its bits printed in the order of transmission.
    assert fcs(bytes.fromhex("02006A")) == bytes.fromhex("E479")


def test_ping_is_the_manuals():
    assert command(PING) == bytes.fromhex("4053400000404045")


def test_a_line_of_nordics_text():
    (captured,) = NrfText().feed(LINE)
    assert (captured.rss_dbm, captured.lqi, captured.device_us) == (-61.0, 120, 123456789)
    assert captured.psdu == bytes.fromhex("49a8e69a9c03004802ae00003c0b")[:-2]


@both
def test_captured_frames_come_through(make):
    dongle, protocol = heard_by(make)
    data = b"".join(dongle.hear(-60.0 - n, 0x1234, b"x", short_address=True) for n in range(5))
    got = list(protocol.feed(data))
    assert [captured.rss_dbm for captured in got] == [-60.0, -61.0, -62.0, -63.0, -64.0]
    assert [frame_id(captured.psdu) for captured in got] == [f"1AAA:1234/{n:02x}" for n in range(1, 6)]


@both
def test_bytes_may_come_one_by_one(make):
    dongle, protocol = heard_by(make)
    data = b"".join(dongle.hear(-70.0, 0x0013A20041000001, b"abc") for _ in range(3))
    assert sum(len(list(protocol.feed(bytes([byte])))) for byte in data) == 3


@pytest.mark.parametrize("with_checksum", [False, True])
@pytest.mark.parametrize(
    "payload", [b"\x40\x45", b"\x40\x45\x40\x53", b"\x40\x53\xc0\x05\x00", b"\x40\x40\x45"]
)
def test_a_payload_may_contain_the_markers(payload, with_checksum):
    dongle, protocol = heard_by(TiDongle, with_checksum=with_checksum)
    data = b"".join(dongle.hear(-70.0, 1, payload) for _ in range(3))
    assert [captured.psdu[-len(payload) :] for captured in protocol.feed(data)] == [payload] * 3


@both
@given(garbage=st.binary(max_size=60))
def test_the_next_frames_after_garbage_are_read(make, garbage):
    dongle, protocol = heard_by(make)
    list(protocol.feed(garbage))
    # What a false start may swallow: one longest frame.
    for _ in range(20):
        list(protocol.feed(dongle.hear(-70.0, 1, b"0123456789abcdef")))
    assert len(list(protocol.feed(dongle.hear(-71.0, 1, b"next")))) == 1


@both
@given(chunks=st.lists(st.binary(max_size=400), max_size=10))
def test_no_bytes_break_the_codecs_or_fill_the_memory(make, chunks):
    protocol = NrfText() if make is NrfDongle else TiBinary()
    for chunk in chunks:
        for captured in protocol.feed(chunk):
            assert -129.0 < captured.rss_dbm < 0.0
            frame_id(captured.psdu)
    assert len(getattr(protocol, "_rest", b"") or getattr(protocol, "_buffer", b"")) < 1000


@given(st.binary(max_size=40))
def test_any_header_is_read_or_refused(psdu):
    frame_id(psdu)


def test_an_acknowledgement_names_nobody():
    assert frame_id(bytes.fromhex("020056")) is None


def test_long_and_short_senders_are_told_apart():
    assert frame_id(data_frame(0x0013A20041000001, b"", 7)) == "1AAA:0013A20041000001/07"
    assert frame_id(data_frame(0x0001, b"", 7, short_address=True)) == "1AAA:0001/07"


def test_a_beacon_without_destination_has_its_own_pan():
    assert frame_id(bytes.fromhex("008011AA1A0000")) == "1AAA:0000/11"


def test_32_bit_time_wraps_and_is_sometimes_signed():
    unwrap = Unwrap32()
    steps = [2**31 - 10, -(2**31), -10, 5, 100]
    assert [unwrap(step) - 2**31 for step in steps] == [-10, 0, 2**31 - 10, 2**31 + 5, 2**31 + 100]


@pytest.mark.parametrize(
    "line",
    [LINE[:30], LINE.replace(b"-61", b"61"), LINE.replace(b"-61", b"-200"), LINE.replace(b"49a8", b"49a")],
)
def test_damaged_lines_are_counted(line):
    protocol = NrfText()
    assert list(protocol.feed(line + b"\r\n")) == [] and protocol.bad_frames == 1


def test_an_interrupted_line_does_not_spoil_the_next():
    (captured,) = NrfText().feed(LINE[:40] + LINE)
    assert captured.rss_dbm == -61.0


@pytest.mark.parametrize(("make", "opener"), [(NrfDongle, open_nrf), (TiDongle, open_ti)])
async def test_hops_between_channels_and_says_so(tmp_path, make, opener):
    clock = RealClock()
    radio = PluggedModule(make(lambda: clock.now_ns() // 1000, channel=20), PtyWire(tmp_path / "dongle"))
    await radio.plug()
    items = []
    options = {"port": radio.wire.port, "channels": [15, 20], "dwell_s": 0.2}
    async with nothing_left():
        async with opener("ada", options, DriverContext(clock, FRAME)) as receiver:

            async def collect():
                async for item in receiver.readings():
                    items.append(item)

            task = asyncio.create_task(collect())
            for _ in range(100):
                radio.hear(-66.0, 5, b"x")
                await asyncio.sleep(0.01)
            await until(lambda: len([i for i in items if isinstance(i, ReceiverState)]) >= 4)
        await task
        radio.unplug()
    heard = [item for item in items if isinstance(item, RssReading)]
    assert heard and {reading.channel for reading in heard} == {20}
    assert {reading.via for reading in heard} == {"sniffer"}
    words = [item.reason for item in items if isinstance(item, ReceiverState)]
    assert words[1:4] == ["now on channel 20", "now on channel 15", "now on channel 20"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"port": "x", "channel": 27}, "11 to 26"),
        ({"port": "x", "channels": [15, "20"]}, "11 to 26"),
        ({"port": "x", "channels": 15}, "expected a list"),
        ({"port": "x", "dwell_s": 0}, "positive"),
    ],
)
def test_impossible_options_are_named(options, words):
    with pytest.raises(ConfigError, match=words):
        open_nrf("ada", options, DriverContext(RealClock(), FRAME))
