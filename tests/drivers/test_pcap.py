"""Captures as receivers: classic and next generation, strength by link type, damage, live pipes."""

import contextlib
import os
import struct
from pathlib import Path

import pytest
from benches import FRAME
from hypothesis import given
from hypothesis import strategies as st

from drivers.emulators.capture import classic_head, classic_record
from drivers.emulators.sniffers import data_frame
from drivers.sniffers.capture import CaptureError, CaptureReader
from drivers.sniffers.ieee802154 import fcs, frame_id
from drivers.sniffers.pcap import open_capture
from drivers.sniffers.strength import TAP, WITH_FCS, WITHOUT_FCS, from_status_bytes, from_tap
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceError
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext

T_NS = 1_700_000_000_123_456_000
PSDU = data_frame(0x1234, b"x", 9, short_address=True)


def tap(rss_dbm: float, psdu: bytes = PSDU, channel: int = 20) -> bytes:
    """A TAP packet as the specification 1.2 lays it out: RSS, channel, an unknown header, no check bytes."""
    headers = struct.pack("<HHf", 1, 4, rss_dbm) + struct.pack("<HHHBx", 3, 3, channel, 0)
    headers += struct.pack("<HHI", 999, 2, 0xABCD)
    return struct.pack("<BBH", 0, 0, 4 + len(headers)) + headers + psdu


def pcap(packets, link_type=TAP, order="<", nano=False) -> bytes:
    magic = 0xA1B23C4D if nano else 0xA1B2C3D4
    out = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link_type)
    for number, data in enumerate(packets):
        t_ns = T_NS + number * 1_000_000
        fraction = t_ns % 10**9 // (1 if nano else 1000)
        out += struct.pack(order + "IIII", t_ns // 10**9, fraction, len(data), len(data)) + data
    return out


def block(order: str, kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = 12 + len(body)
    return struct.pack(order + "II", kind, size) + body + struct.pack(order + "I", size)


def pcapng(packets, link_type=TAP, order="<") -> bytes:
    out = block(order, 0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))
    nanoseconds = struct.pack(order + "HHB3x", 9, 1, 9) + bytes(4)
    out += block(order, 1, struct.pack(order + "HHI", link_type, 0, 0) + nanoseconds)
    out += block(order, 5, bytes(12))  # statistics: skipped
    for number, data in enumerate(packets):
        t_ns = T_NS + number * 1_000_000
        out += block(
            order,
            6,
            struct.pack(order + "IIIII", 0, t_ns >> 32, t_ns & 0xFFFFFFFF, len(data), len(data)) + data,
        )
    return out


def makers():
    for order in "<>":
        yield lambda packets, link_type=TAP, order=order: pcap(packets, link_type, order)
        yield lambda packets, link_type=TAP, order=order: pcap(packets, link_type, order, nano=True)
        yield lambda packets, link_type=TAP, order=order: pcapng(packets, link_type, order)


every_format = pytest.mark.parametrize("make", list(makers()))


@every_format
def test_packets_and_times_come_out_of_every_format(make):
    packets = list(CaptureReader().feed(make([b"one", b"three"])))
    assert [packet.data for packet in packets] == [b"one", b"three"]
    assert [packet.t_ns - T_NS for packet in packets] == [0, 1_000_000]
    assert {packet.link_type for packet in packets} == {TAP}


@every_format
def test_bytes_may_come_one_by_one(make):
    reader = CaptureReader()
    got = [packet for byte in make([b"one", b"three"]) for packet in reader.feed(bytes([byte]))]
    assert [packet.data for packet in got] == [b"one", b"three"]


@pytest.mark.parametrize(
    "data", [b"%PDF-1.7" + bytes(30), pcap([]) + b"\xff" * 16, pcapng([]) + b"\xff" * 16]
)
def test_what_is_no_capture_is_an_error(data):
    with pytest.raises(CaptureError):
        list(CaptureReader().feed(data))


@given(st.binary(max_size=300), st.integers(0, 200), st.booleans())
def test_no_bytes_break_the_reader(noise, cut, new):
    data = (pcapng if new else pcap)([tap(-60.0)] * 3)
    reader = CaptureReader()
    try:
        for packet in (*reader.feed(data[:cut]), *reader.feed(noise), *reader.feed(data[cut:])):
            from_tap(packet.data)
            from_status_bytes(packet.data)
    except CaptureError:
        pass


@given(st.binary(max_size=80))
def test_any_tap_headers_are_read_or_refused(data):
    from_tap(data)
    from_tap(b"\x00\x00\x1c\x00" + data)


def test_tap_headers_are_read_and_unknown_ones_skipped():
    strength = from_tap(tap(-61.5))
    assert (strength.rss_dbm, strength.channel, strength.psdu) == (-61.5, 20, PSDU)


async def collect(port, count=None, **options):
    items = []
    async with open_capture(
        "ada", {"port": str(port), **options}, DriverContext(RealClock(), FRAME)
    ) as receiver:
        async for item in receiver.readings():
            items.append(item)
            if isinstance(item, ReceiverState) and not item.up:
                break
    return receiver, [item for item in items if isinstance(item, RssReading)], items


async def test_a_tap_file_gives_readings_with_its_own_times(tmp_path):
    path = tmp_path / "x.pcapng"
    path.write_bytes(pcapng([tap(-60.0), tap(-70.0)]))
    _, readings, items = await collect(path, saturation_dbm=-65)
    assert [(r.rss_dbm, r.t_ns - T_NS, r.via, r.channel) for r in readings] == [
        (-60.0, 0, "tap", 20),
        (-70.0, 1_000_000, "tap", 20),
    ]
    assert [reading.saturated for reading in readings] == [True, False]
    assert readings[0].frame_id == "1AAA:1234/09"
    assert items[-1].reason == "the capture has ended"


async def test_status_bytes_in_place_of_check_bytes_are_recognised(tmp_path):
    """TI: signed RSSI -73 dB, then bit 7 for a good check and the correlation."""
    path = tmp_path / "ti.pcap"
    path.write_bytes(pcap([PSDU + bytes([10, 0x80 | 100]), PSDU + bytes([0xF6, 0x80 | 90])], WITH_FCS))
    _, readings, _ = await collect(path, channel=15)
    assert [(r.rss_dbm, r.lqi, r.channel) for r in readings] == [(-63.0, 100, 15), (-83.0, 90, 15)]


@pytest.mark.parametrize(("link_type", "end"), [(WITH_FCS, fcs(PSDU)), (WITHOUT_FCS, b"")])
async def test_a_capture_without_strength_gives_none(tmp_path, link_type, end):
    path = tmp_path / "plain.pcap"
    path.write_bytes(pcap([PSDU + end] * 4, link_type))
    receiver, readings, _ = await collect(path)
    assert readings == [] and receiver.without_strength == 4


@pytest.mark.parametrize("rss_dbm", [float("nan"), float("inf"), 0.0, 20.0, -300.0])
async def test_a_strength_that_is_none_gives_no_reading(tmp_path, rss_dbm):
    path = tmp_path / "x.pcap"
    path.write_bytes(pcap([tap(rss_dbm), tap(-50.0)]))
    _, readings, _ = await collect(path)
    assert [reading.rss_dbm for reading in readings] == [-50.0]


async def test_a_cut_capture_gives_what_came_before(tmp_path):
    path = tmp_path / "cut.pcap"
    path.write_bytes(pcap([tap(-60.0), tap(-70.0)])[:-5])
    _, readings, _ = await collect(path)
    assert [reading.rss_dbm for reading in readings] == [-60.0]


@pytest.mark.parametrize("content", [b"", b"not a capture, and long enough to tell"])
async def test_what_is_no_capture_does_not_open(tmp_path, content):
    path = tmp_path / "x.pcap"
    path.write_bytes(content)
    with pytest.raises(DeviceError, match=r"empty|neither"):
        await collect(path)


async def test_a_missing_capture_is_named(tmp_path):
    with pytest.raises(DeviceError, match=r"gone\.pcap"):
        await collect(tmp_path / "gone.pcap")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes")
async def test_a_live_pipe_gives_readings_as_they_come(tmp_path):
    path = tmp_path / "live"
    os.mkfifo(path)
    writer = os.open(path, os.O_RDWR)
    os.write(writer, pcap([]))
    items = []
    async with open_capture("ada", {"port": str(path)}, DriverContext(RealClock(), FRAME)) as receiver:
        os.write(writer, pcap([tap(-60.0)])[24:])
        async for item in receiver.readings():
            items.append(item)
            if isinstance(item, RssReading):
                break
        os.close(writer)
        async for item in receiver.readings():
            items.append(item)
            if isinstance(item, ReceiverState):
                break
    assert [item.up for item in items if isinstance(item, ReceiverState)] == [True, False]


async def test_a_capture_whose_clock_jumps_back_keeps_its_order_and_says_so(tmp_path):
    path = tmp_path / "back.pcap"
    packets = [(T_NS, -60.0), (T_NS - 5_000_000_000, -61.0), (T_NS + 1_000_000, -62.0)]
    path.write_bytes(classic_head() + b"".join(classic_record(t, tap(rss)) for t, rss in packets))
    _, readings, items = await collect(path)
    assert [reading.t_ns - T_NS for reading in readings] == [0, 0, 1_000_000]
    assert [reading.rss_dbm for reading in readings] == [-60.0, -61.0, -62.0]
    assert any("went back by 5.0 s" in item.reason for item in items if isinstance(item, ReceiverState))


async def test_what_came_before_damage_is_given(tmp_path):
    path = tmp_path / "damaged.pcap"
    path.write_bytes(pcap([tap(-60.0)]) + b"\xff" * 16)
    _, readings, items = await collect(path)
    assert [reading.rss_dbm for reading in readings] == [-60.0]
    assert "not readable" in items[-1].reason


CAPTURES = Path(__file__).parents[3] / "shared" / "datasets" / "pcap_802154"


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the recorded captures are not here")
@pytest.mark.parametrize("path", sorted(CAPTURES.glob("*/*.*")), ids=lambda path: path.name)
async def test_captures_of_others_are_read_or_refused(path):
    """Real captures without strength, Daintree logs that are none, and malformed frames."""
    if path.suffix != ".pcap":
        with pytest.raises(DeviceError):
            await collect(path)
        return
    receiver, readings, items = await collect(path)
    assert not items[-1].up
    assert all(-200.0 < reading.rss_dbm < 0.0 for reading in readings)
    if path.name == "control4-sample.pcap":  # 407 frames with true check bytes: no strength
        assert (receiver.without_strength, readings) == (407, [])


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the recorded captures are not here")
def test_malformed_frames_go_through_every_frame_codec():
    count = 0
    for path in CAPTURES.glob("*/*.pcap"):
        with contextlib.suppress(CaptureError):
            for packet in CaptureReader().feed(path.read_bytes()):
                frame_id(packet.data)
                from_tap(packet.data)
                from_status_bytes(packet.data)
                count += 1
    assert count > 400
