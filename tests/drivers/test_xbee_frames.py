"""The XBee codec: the manuals' bytes, damage, and streams made to mislead."""

import pytest
from digi.xbee.models.mode import OperatingMode
from digi.xbee.packets import factory
from digi.xbee.packets.raw import RX64Packet
from hypothesis import given
from hypothesis import strategies as st

from drivers.xbee.decode import decode, rss_dbm_of
from drivers.xbee.frames import MAX_LENGTH, Deframer, escape, frame

# Digi manual 90000982 (XBee 802.15.4), frames 0x81 and 0x80: "TxData" at -94 dBm.
RX16 = bytes.fromhex("7E000B 81 1234 5E 01 547844617461 93")
RX64 = bytes.fromhex("7E0011 80 0013A20012345678 5E 01 547844617461 11")
# The same manual: AP queried and answered.
ASK_AP = bytes.fromhex("7E000409014150 64")
TELL_AP = bytes.fromhex("7E00068801415000 01E4")

payloads = st.binary(min_size=1, max_size=120)
plain_or_escaped = pytest.mark.parametrize("escaped", [False, True], ids=["plain", "escaped"])


def wire(good: bytes, escaped: bool) -> bytes:
    return frame(good[3:-1], escaped=escaped)


def frames_of(deframer: Deframer, data: bytes, escaped: bool) -> list[bytes]:
    return [found for _, found in deframer.feed(data, 0, escaped=escaped)]


@pytest.mark.parametrize("golden", [RX16, RX64, ASK_AP, TELL_AP])
def test_the_manuals_bytes_are_built_and_found(golden):
    assert frame(golden[3:-1]) == golden
    assert frames_of(Deframer(), golden, False) == [golden]


def test_the_manuals_receptions_are_minus_94_dbm():
    assert decode(RX16).rss_dbm == decode(RX64).rss_dbm == -94.0
    assert (decode(RX16).via, decode(RX64).via) == ("rx16", "rx64")
    assert decode(RX64).frame_id.startswith("0013A20012345678/")


def test_the_library_reads_what_we_build():
    packet = factory.build_frame(bytearray(frame(RX64[3:-1])), OperatingMode.API_MODE)
    assert isinstance(packet, RX64Packet) and packet.rssi == 0x5E


def test_rssi_0_and_255_are_no_measurement():
    assert rss_dbm_of(0) is None and rss_dbm_of(0xFF) is None
    assert rss_dbm_of(0x28) == -40.0


def test_a_remote_at_failure_is_not_a_strength():
    # A forum's favourite: status 04 of a failed remote ATDB read as "-4 dBm".
    assert decode(bytes.fromhex("7E000F97010013A20070407644FFFE444204C1")) is None


@pytest.mark.parametrize("data", [b"", b"\x28", b"\x28\x00", b"\x28\x00\x01"])
def test_a_reception_that_ends_early_is_no_reading(data):
    for kind in (b"\x80", b"\x81", b"\x82", b"\x83"):
        found = decode(frame(kind + b"\x12\x34" + data))
        assert found is None or found.rss_dbm < 0


@plain_or_escaped
def test_bytes_may_come_one_by_one(escaped):
    deframer, found = Deframer(), []
    for byte in wire(RX64, escaped) + wire(RX16, escaped):
        found += frames_of(deframer, bytes([byte]), escaped)
    assert found == [RX64, RX16]
    assert deframer.skipped_bytes == 0


@plain_or_escaped
def test_resyncs_after_garbage(escaped):
    found = frames_of(Deframer(), b"garbage \x00\x11" + wire(RX64, escaped), escaped)
    assert found == [RX64]


@plain_or_escaped
def test_a_spurious_start_costs_nothing(escaped):
    data = b"\x7e" + wire(RX64, escaped) + wire(RX16, escaped)
    assert frames_of(Deframer(), data, escaped) == [RX64, RX16]


@plain_or_escaped
def test_a_frame_behind_a_false_start_is_found_when_the_line_goes_quiet(escaped):
    deframer = Deframer()
    data = bytes.fromhex("7E00FF") + wire(RX64, escaped)
    found = frames_of(deframer, data, escaped)
    found += [each for _, each in deframer.idle(escaped=escaped)]
    assert found == [RX64]


@plain_or_escaped
@pytest.mark.parametrize("damage", ["flip", "drop", "truncate", "length"])
def test_damage_costs_only_the_damaged_frame(damage, escaped):
    good = wire(RX64, escaped)
    bad = {
        "flip": good[:9] + bytes([good[9] ^ 0x10]) + good[10:],
        "drop": good[:9] + good[10:],
        "truncate": good[:8],
        "length": good[:1] + bytes([good[1] ^ 0x40]) + good[2:],
    }[damage]
    deframer = Deframer()
    found = frames_of(deframer, good + bad + good + good, escaped)
    found += [each for _, each in deframer.idle(escaped=escaped)]
    assert found == [RX64] * 3


def test_a_frame_has_the_time_of_its_first_byte():
    deframer = Deframer()
    assert list(deframer.feed(b"noise" + RX64[:5], 100, escaped=False)) == []
    found = list(deframer.feed(RX64[5:] + RX16[:1], 200, escaped=False))
    found += list(deframer.feed(RX16[1:], 300, escaped=False))
    assert found == [(100, RX64), (200, RX16)]


@given(payloads, st.booleans())
def test_any_payload_survives_the_wire(payload, escaped):
    assert frames_of(Deframer(), frame(payload, escaped=escaped), escaped) == [frame(payload)]


@given(payloads)
def test_escaping_leaves_no_start_byte_inside(payload):
    assert 0x7E not in escape(payload)


@given(st.lists(payloads, max_size=6), st.binary(max_size=60), st.lists(st.integers(0, 500), max_size=5))
def test_in_escaped_mode_every_frame_behind_garbage_is_found(good, garbage, cuts):
    data = garbage + b"".join(frame(payload, escaped=True) for payload in good)
    deframer, found, begin = Deframer(), [], 0
    for end in [*sorted(min(cut, len(data)) for cut in cuts), len(data)]:
        found += frames_of(deframer, data[begin:end], True)
        begin = end
    wanted = [frame(payload) for payload in good]
    assert found[len(found) - len(wanted) :] == wanted


@given(st.lists(st.binary(max_size=400), max_size=20), st.booleans())
def test_no_stream_breaks_the_codec_or_fills_the_memory(chunks, escaped):
    deframer = Deframer()
    for chunk in chunks:
        for _, found in deframer.feed(chunk, 0, escaped=escaped):
            decode(found)
        assert len(deframer._buffer) <= 2 * (MAX_LENGTH + 4)
    for _, found in deframer.idle(escaped=escaped):
        decode(found)


@given(st.sampled_from([0x80, 0x81, 0x82, 0x83]), st.binary(max_size=40))
def test_any_content_with_a_good_checksum_decodes_or_is_refused(kind, content):
    heard = decode(frame(bytes([kind]) + content))
    assert heard is None or -255.0 < heard.rss_dbm < 0.0


def test_half_a_frame_whose_checksum_fits_by_chance_does_not_swallow_the_frame_after_a_silence():
    good = frame(b"\x80" + bytes(8) + b"\x46\x02data")
    start = bytes([0x7E, 0, 10, 1, 2, 3])  # claims ten bytes and a checksum; eight come with the next frame
    fitting = bytes([*start[:5], (3 + 0xFF - sum(start[3:] + good[:8])) & 0xFF])
    assert sum(fitting[3:] + good[:8]) & 0xFF == 0xFF
    codec = Deframer()
    assert list(codec.feed(fitting, 0, escaped=False)) == [] and list(codec.idle(escaped=False)) == []
    assert [data for _, data in codec.feed(good, 1, escaped=False)] == [good]
