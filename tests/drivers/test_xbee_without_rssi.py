"""Modules whose frames carry no strength, IO samples, and energy scans: what ATDB and ATED may be used for."""

import asyncio

import pytest

from drivers.xbee.decode import db_answer, decode, name_of
from drivers.xbee.energy import energies, parameter
from drivers.xbee.frames import frame
from drivers.xbee.last_hop import STALE_S, LastHop
from fieldkit.messages import ReceiverState, RssReading

SENDER = 0x0013A20041000001


@pytest.mark.parametrize(("profile", "output"), [("s2c", 0), ("xb3", 1)])
async def test_without_mesh_the_answer_is_the_frames_strength(plug, listening, profile, output):
    radio = await plug(profile, AO=output)
    async with listening(radio.wire.port, ask_db=True) as heard:
        for strength in (-71.0, -82.0, -40.0):
            radio.hear(strength, SENDER, b"beacon")
            await heard.until(lambda want=strength: heard.readings and heard.readings[-1].rss_dbm == want)
    assert [reading.via for reading in heard.readings] == ["db"] * 3
    assert [reading.saturated for reading in heard.readings] == [False, False, True]
    assert {reading.frame_id.split("/")[0] for reading in heard.readings} == {"0013A20041000001"}


async def test_a_packet_has_the_same_id_with_and_without_strength_in_its_frame(plug, listening):
    with_rssi, without = await plug(serial_number=1), await plug(serial_number=2, AO=0)
    async with listening(with_rssi.wire.port) as first, listening(without.wire.port, ask_db=True) as second:
        for radio in (with_rssi, without):
            radio.hear(-60.0, SENDER, b"\x07")
        await first.until(lambda: bool(first.readings and second.readings))
    assert first.readings[0].frame_id == second.readings[0].frame_id


@pytest.mark.parametrize("profile", ["900hp", "zigbee"])
async def test_on_a_mesh_the_strength_is_the_last_hops_and_names_nobody(plug, listening, profile):
    radio = await plug(profile)
    async with listening(radio.wire.port, ask_db=True) as heard:
        radio.hear(-77.0, SENDER, b"beacon")
        await heard.until(lambda: heard.readings)
        assert radio.module.transmitted == 0
    (reading,) = heard.readings
    assert (reading.rss_dbm, reading.via, reading.frame_id) == (-77.0, "db", None)


async def test_an_answer_after_two_packets_names_neither(plug, listening):
    radio = await plug(AO=0)
    async with listening(radio.wire.port, ask_db=True) as heard:
        radio.hear(-60.0, SENDER, b"one")
        radio.hear(-80.0, SENDER + 1, b"two")
        await heard.until(lambda: heard.readings)
        await asyncio.sleep(0.05)
    assert [(reading.rss_dbm, reading.frame_id) for reading in heard.readings] == [(-80.0, None)]


async def test_nothing_is_asked_where_frames_carry_their_strength(plug, listening):
    radio = await plug()
    async with listening(radio.wire.port, ask_db=True) as heard:
        radio.hear(-60.0, SENDER, b"x")
        await heard.until(lambda: heard.readings)
    assert "DB" not in radio.module.asked


@pytest.mark.parametrize("profile", ["s1", "s1pro", "s2c", "xb3", "900hp", "zigbee"])
async def test_nothing_is_transmitted_on_any_family(plug, listening, profile):
    radio = await plug(profile)
    async with listening(radio.wire.port, ask_db=True) as heard:
        for number in range(5):
            radio.hear(-70.0, SENDER + number, b"a")
            radio.hear(-70.0, 0x1000 + number, b"b", short_address=True)
            await asyncio.sleep(0.02)
        await heard.until(lambda: heard.readings)
    assert radio.module.transmitted == 0
    assert set(radio.module.asked) <= {"AP", "HV", "VR", "SH", "SL", "NI", "MY", "CE", "SS", "SM"} | {
        *("AO", "MM", "ID", "CH", "DB")
    }


def test_a_late_answer_is_stale_and_gives_nothing():
    hop = LastHop(mesh=False)
    number = hop.received(1, "a", now_s=0.0)
    assert hop.answered(number, now_s=STALE_S + 0.01) is None and hop.stale == 1


def test_an_answer_to_an_older_question_is_stale():
    hop = LastHop(mesh=False)
    first = hop.received(1, "a", now_s=0.0)
    second = hop.received(2, "b", now_s=1.0)
    assert second != first
    assert hop.answered(first, now_s=1.01) is None
    assert hop.answered(second, now_s=1.01).frame_id == "b"
    assert hop.stale == 2  # one never answered in time, one answered too late


def test_db_0_is_no_strength_and_an_error_is_none():
    assert db_answer(frame(b"\x88\x01DB\x00\x00")).rss_dbm is None
    assert db_answer(frame(b"\x88\x01DB\x04\x28")).rss_dbm is None  # status 4 is a failure, not -4 dBm
    assert db_answer(frame(b"\x88\x07DB\x00\x28")).rss_dbm == -40.0


def test_frames_without_strength_name_their_sender():
    short = frame(b"\x90" + b"\xff" * 8 + b"\x12\x34\x02data")
    assert name_of(short).startswith("1234/")
    assert name_of(frame(b"\x91" + bytes(7) + b"\x01")) is None


# The IO frames

IO_64 = "7E 00 10 82 00 13 A2 00 41 00 00 01 46 00 01 00 0F 00 05"


async def test_io_samples_are_receptions_like_others(plug, listening):
    radio = await plug("s1")
    async with listening(radio.wire.port) as heard:
        radio.write(radio.module.sample(-66.0, SENDER, 0b0101))
        radio.write(radio.module.sample(-67.0, 0x1234, 0b0101, short_address=True))
        await heard.until(lambda: len(heard.readings) == 2)
    assert [(reading.rss_dbm, reading.via) for reading in heard.readings] == [(-66.0, "io"), (-67.0, "io")]


def test_an_io_sample_is_laid_out_as_in_the_manual():
    """Digi 90000982, frame 0x82: address, RSSI, options, sample count, channel mask, digital lines."""
    heard = decode(frame(bytes.fromhex(IO_64.replace(" ", ""))[3:]))
    assert (heard.rss_dbm, heard.via) == (-70.0, "io")


# Energy scans


@pytest.mark.parametrize(
    ("scan_s", "legacy", "expected"),
    [
        (0.2, True, (b"\x00", 0.24576)),
        (2.0, True, (b"\x04", 3.93216)),
        (1.9, True, (b"\x03", 1.96608)),
        (99.0, True, (b"\x06", 15.72864)),
        (2.0, False, (b"\x07\xd0", 2.0)),
        (99.0, False, (b"\x3a\x98", 15.0)),
    ],
)
def test_the_scan_takes_as_long_as_its_parameter_says(scan_s, legacy, expected):
    command, lasts_s = parameter(scan_s, legacy=legacy)
    assert (command, pytest.approx(lasts_s)) == expected


def test_energies_are_read_from_bytes_and_from_text():
    levels = [95] * 15 + [60]
    as_bytes = energies(bytes(levels))
    assert as_bytes == energies(",".join(f"{level:X}" for level in levels).encode())
    assert as_bytes == energies("".join(f"{level:X}\r" for level in levels).encode())
    assert (as_bytes[11], as_bytes[26]) == (-95.0, -60.0)
    assert min(energies(bytes([90] * 12))) == 12  # S1 PRO


@pytest.mark.parametrize("answer", [b"", b"\x5f", bytes(16), b"\xff" * 16, bytes(40)])
def test_an_energy_answer_without_sense_gives_nothing(answer):
    assert energies(answer) == {}


@pytest.mark.parametrize("profile", ["s1", "s2c"])
async def test_a_scan_is_in_the_readings_with_how_long_nothing_else_was_heard(plug, listening, profile):
    radio = await plug(profile)
    radio.module.energy_dbm = {15: -62.0}
    options = {"energy_scan_s": 0.2, "energy_scan_every_s": 3600.0}
    async with listening(radio.wire.port, **options) as heard:
        await heard.until(lambda: len(heard.states) >= 3)
        radio.hear(-70.0, SENDER, b"after")
        await heard.until(lambda: heard.readings[-1].rss_dbm == -70.0)
    kinds = ["state" if isinstance(item, ReceiverState) else item.via for item in heard.items]
    assert kinds == ["state", "state", *["ed"] * 16, "state", "rx64"]
    opened, down, back = heard.states
    assert [state.up for state in heard.states] == [True, False, True]
    assert "receiver down" in down.reason and "receiver was down for" in back.reason
    scanned = [r for r in heard.items if isinstance(r, RssReading) and r.via == "ed"]
    assert {r.channel: r.rss_dbm for r in scanned}[15] == -62.0
    assert all(down.t_ns <= r.t_ns < back.t_ns for r in scanned)
    assert radio.module.transmitted == 0 and opened.up


async def test_the_module_hears_nothing_while_it_scans(plug, listening):
    radio = await plug()
    options = {"energy_scan_s": 0.5, "energy_scan_every_s": 3600.0}
    async with listening(radio.wire.port, **options) as heard:
        await heard.until(lambda: len(heard.states) == 2 and radio.module.asked[-1] == "ED")
        assert not radio.hear(-60.0, SENDER, b"lost")
        await heard.until(lambda: len(heard.states) == 3)
        assert radio.hear(-60.0, SENDER, b"heard")


async def test_a_radio_unplugged_while_it_scans_is_noticed(plug, listening):
    radio = await plug()
    options = {"energy_scan_s": 1.0, "energy_scan_every_s": 3600.0}
    async with listening(radio.wire.port, **options) as heard:
        await heard.until(lambda: len(heard.states) == 2)
        radio.unplug()
        await heard.until(lambda: len(heard.states) == 3, timeout_s=2.0)
    assert not heard.states[-1].up and "went away" in heard.states[-1].reason
