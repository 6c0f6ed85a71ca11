"""Satellite receivers: golden sentences and reports, what is not to be believed, and both wires."""

import asyncio
import random
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st

from drivers.emulators.gnss import EmulatedGpsd, Seen, gpsd_report, nmea, sentence
from drivers.emulators.wires import PtyWire
from drivers.gnss.fixes import FROZEN_S, SETTLED, Fix, FixJudge, distance_m
from drivers.gnss.gpsd import GpsdReader
from drivers.gnss.nmea import NmeaReader
from drivers.gnss.source import _remedy, open_gnss
from fieldkit.clock import RealClock
from fieldkit.errors import ConfigError, DeviceError
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose
from fieldkit.ports import DriverContext

FRAME = FieldFrame(47.3977, 8.5456, 400.0)
START_NS = 1_700_000_000_000_000_000
# Examples that circulate with the standard, and of gpsd_json(5).
GGA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
RMC = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n"
TPV = (
    b'{"class":"TPV","device":"/dev/pts/1","time":"2005-06-08T10:34:48.283Z","ept":0.005,"lat":46.498293369,'
    b'"lon":7.567411672,"alt":1343.127,"eph":36.000,"epv":32.321,"track":10.3788,"speed":0.091,"climb":-0.085,'
    b'"mode":3}\n'
)


def context() -> DriverContext:
    return DriverContext(RealClock(), FRAME)


# -- words to fixes --------------------------------------------------------------------------------------------


def test_the_standards_example_is_read() -> None:
    (fix,) = NmeaReader().feed(RMC + GGA, 0.0)[-1:]
    assert (fix.lat_deg, fix.lon_deg) == pytest.approx((48.0 + 7.038 / 60.0, 11.0 + 31.0 / 60.0), abs=1e-7)
    assert (fix.alt_m, fix.sigma_m) == pytest.approx((545.4, 0.9 * 2.5))
    assert fix.speed_m_s == pytest.approx(22.4 * 1852.0 / 3600.0)
    assert fix.course_deg == pytest.approx(84.4)
    assert not fix.why_absent


def test_gpsds_example_is_read() -> None:
    (fix,) = GpsdReader().feed(TPV, 0.0)
    assert (fix.lat_deg, fix.lon_deg, fix.alt_m) == (46.498293369, 7.567411672, 1343.127)
    assert fix.sigma_m == pytest.approx(36.0 / 2**0.5)
    assert fix.time_s == pytest.approx(1118226888.283)
    assert not GpsdReader("/dev/ttyUSB0").feed(TPV, 0.0), "another receiver of the same gpsd"


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"GPGGA,123519,4807.038,N,01131.000,E,0,00,99.9,,M,,M,,", "no fix yet"),
        (b"GPGGA,123519,,,,,0,00,,,M,,M,,", "no fix yet"),
        (b"GPGGA,123519,4807.038,N,01131.000,E,6,08,0.9,545.4,M,46.9,M,,", "its position is dead reckoning"),
        (b"GPGGA,123519,4807.038,N,01131.000,E,8,08,0.9,545.4,M,46.9,M,,", "its position is simulated"),
    ],
)
def test_a_receiver_without_a_fix_says_so(line: bytes, why: str) -> None:
    (fix,) = NmeaReader().feed(sentence(line.decode()), 0.0)
    assert fix.why_absent == why


def test_rmc_alone_tells_a_place_and_nothing_of_its_quality() -> None:
    reader = NmeaReader()
    assert reader.feed(RMC, 100.0) == [], "a GGA may follow"
    assert reader.feed(RMC, 103.0) == []
    (fix,) = reader.feed(RMC, 106.0)
    assert fix.sigma_m is None
    assert "says nothing of its quality" in FixJudge(15.0, 25.0).doubt(fix, 0.0)


def test_after_a_pause_an_rmc_that_comes_before_its_gga_tells_no_place() -> None:
    reader = NmeaReader()
    assert len(reader.feed(RMC + GGA, 100.0)) == 1
    assert reader.feed(RMC, 120.0) == []
    (fix,) = reader.feed(GGA, 120.0)
    assert fix.sigma_m is not None


def test_errors_that_the_receiver_states_count_before_its_hdop() -> None:
    gst = sentence("GPGST,123519,1.0,,,,3.5,4.5,6.0")
    (fix,) = NmeaReader().feed(gst + GGA, 0.0)
    assert fix.sigma_m == 4.5
    reader = NmeaReader()
    reader.feed(gst, 0.0)
    (late,) = reader.feed(GGA, 60.0)
    assert late.sigma_m == pytest.approx(2.25)


@pytest.mark.parametrize(
    "line", [GGA.replace(b"4807", b"4907"), GGA.replace(b"*47", b""), b"$GPGGA,*00\r\n", b"noise\r\n"]
)
def test_a_sentence_with_a_wrong_checksum_is_no_position(line: bytes) -> None:
    reader = NmeaReader()
    assert reader.feed(line, 0.0) == []
    assert len(reader.feed(GGA, 0.0)) == 1, "the next good one is read"


@budget(max_examples=100, deadline=None)
@given(st.integers(1, 60), st.integers(0, 3))
def test_sentences_come_out_whole_however_they_are_cut(cut: int, extra: int) -> None:
    data = b"".join(nmea(Seen(START_NS + k * 10**9, k, -k), FRAME) for k in range(3 + extra))
    reader, fixes = NmeaReader(), list[Fix]()
    for at in range(0, len(data), cut):
        fixes += reader.feed(data[at : at + cut], 0.0)
    assert len([fix for fix in fixes if fix.sigma_m is not None]) == 3 + extra


@pytest.mark.parametrize("seed", range(5))
def test_damaged_streams_give_no_wrong_place(seed: int) -> None:
    """A checksum of eight bits lets one damaged sentence in 256 pass: the judge drops what jumps."""
    rng = random.Random(seed)
    nmea_reader, gpsd_reader, judge = NmeaReader(), GpsdReader(), FixJudge(15.0, 25.0)
    believed = []
    for k in range(400):
        seen = Seen(START_NS + k * 10**9, 0.1 * k, 5.0)
        data = bytearray(nmea(seen, FRAME))
        if rng.random() < 0.5:
            for _ in range(rng.randint(1, 5)):
                data[rng.randrange(len(data))] = rng.randrange(256)
        gpsd_reader.feed(bytes(data), float(k))
        believed += [fix for fix in nmea_reader.feed(bytes(data), float(k)) if not judge.doubt(fix, float(k))]
    assert len(believed) > 150
    for fix in believed:
        east, north, _ = FRAME.to_local(fix.lat_deg, fix.lon_deg)
        assert -20.0 < east < 60.0 and -20.0 < north < 30.0


# -- what is not to be believed --------------------------------------------------------------------------------


def fix_at(east_m: float, north_m: float, at_s: float, **more: Any) -> Fix:
    lat, lon, _ = FRAME.to_geodetic(east_m, north_m)
    return replace(Fix(lat, lon, 2.0, at_s, 400.0, 1.0, 90.0), **more)


def test_a_sentence_that_is_too_short_is_damaged_though_its_checksum_fits() -> None:
    reader = NmeaReader()
    assert reader.feed(sentence("GNGGA,092750.00,5321.6802,N,00630.3372,W,1,8"), 0.0) == []
    assert reader.damaged == 1


def test_distance_is_that_of_the_ellipsoid_to_a_few_parts_in_a_thousand() -> None:
    assert distance_m(fix_at(0, 0, 0.0), fix_at(300.0, 400.0, 0.0)) == pytest.approx(500.0, rel=5e-3)


def test_a_jump_is_absent_until_the_new_place_holds() -> None:
    judge = FixJudge(15.0, 25.0)
    assert not judge.doubt(fix_at(0, 0, 0.0), 0.0)
    assert "jumped by" in judge.doubt(fix_at(5_000.0, 0, 1.0), 1.0)
    assert not judge.doubt(fix_at(1.0, 0, 2.0), 2.0), "back where it was: one bad fix"
    for k in range(SETTLED - 1):
        assert "jumped" in judge.doubt(fix_at(5_000.0 + k, 0, 3.0 + k), 3.0 + k)
    assert not judge.doubt(fix_at(5_002.0, 0, 3.0 + SETTLED), 3.0 + SETTLED), "it is there, then"


def test_a_frozen_receiver_is_absent_and_one_that_stands_is_not() -> None:
    judge = FixJudge(15.0, 25.0)
    assert not judge.doubt(fix_at(0, 0, 1.0), 1.0)
    assert "time stands still" in judge.doubt(fix_at(0.5, 0, 1.0), 2.0)
    moving, standing = FixJudge(15.0, 25.0), FixJudge(15.0, 25.0)
    for k in range(int(FROZEN_S) + 2):
        told = moving.doubt(fix_at(0, 0, float(k)), float(k))
        assert not standing.doubt(fix_at(0, 0, float(k), speed_m_s=0.0), float(k))
    assert "is at the same place for" in told


@pytest.mark.parametrize(
    ("fix", "why"),
    [
        (fix_at(0, 0, 0.0, sigma_m=None), "nothing of its quality"),
        (fix_at(0, 0, 0.0, sigma_m=80.0), "good to 80 m only"),
        (fix_at(0, 0, 0.0, sigma_m=float("nan")), "good to nan m"),
        (Fix(0.0, 0.0, 2.0), "latitude and longitude are 0"),
        (Fix(91.0, 0.0, 2.0), "is nowhere"),
        (Fix(float("nan"), 8.0, 2.0), "is nowhere"),
        (fix_at(0, 0, 0.0, why_absent="no fix yet"), "no fix yet"),
    ],
)
def test_what_cannot_be_a_position_is_absent(fix: Fix, why: str) -> None:
    assert why in FixJudge(15.0, 25.0).doubt(fix, 0.0)


# -- on the wire -----------------------------------------------------------------------------------------------


@asynccontextmanager
async def following(**options: Any) -> AsyncIterator[tuple[Any, list[Pose]]]:
    poses: list[Pose] = []

    async def collect() -> None:
        async for pose in source.poses():
            poses.append(pose)

    async with open_gnss(options, context()) as source:
        task = asyncio.create_task(collect())
        yield source, poses
    await task


async def until(fits: Any) -> None:
    async with asyncio.timeout(15.0):
        while not fits():  # noqa: ASYNC110 - it is a list that is watched
            await asyncio.sleep(0.01)


async def test_nmea_on_a_serial_port_gives_poses_with_their_own_error(tmp_path: Path) -> None:
    wire = PtyWire(tmp_path / "gnss")
    await wire.open(lambda data: None)
    async with following(robots={"ada": wire.port}) as (source, poses):
        for k in range(5):
            wire.write(nmea(Seen(START_NS + k * 200_000_000, 3.0 + k, 4.0, 12.0, 5.0, 90.0, hdop=1.2), FRAME))
            await asyncio.sleep(0.05)
        await until(lambda: len(poses) == 5)
        assert source.absent == {}
        wire.write(nmea(Seen(START_NS + 10**9, 8.0, 4.0, quality=0), FRAME))
        await until(lambda: source.absent == {"ada": "no fix yet"})
    wire.close()
    last = poses[-1]
    assert (last.east_m, last.north_m) == pytest.approx((7.0, 4.0), abs=0.02)
    assert (last.up_m, last.heading_deg, last.sigma_m) == pytest.approx((12.0, 90.0, 3.0), abs=0.01)
    assert [pose.t_ns for pose in poses] == sorted(pose.t_ns for pose in poses)


async def test_a_gpsd_that_dies_leaves_its_robot_absent_until_it_is_back() -> None:
    gpsd = EmulatedGpsd(FRAME)
    await gpsd.open()
    async with following(robots={"ada": f"gpsd://127.0.0.1:{gpsd.port}"}) as (source, poses):

        async def tell(first: int) -> None:
            for k in range(first, first + 40):
                gpsd.tell(Seen(START_NS + k * 10**9, 1.0, 2.0 + 0.1 * k))
                await asyncio.sleep(0.05)

        await tell(0)
        await until(lambda: poses)
        await gpsd.die()
        await until(lambda: "went away" in source.absent.get("ada", ""))
        before = len(poses)
        await gpsd.open()
        for k in range(60):
            if len(poses) > before:
                break
            await tell(100 + 40 * k)
        await until(lambda: len(poses) > before and not source.absent)
    await gpsd.die()
    assert poses[0].sigma_m == pytest.approx(2.5)


async def test_no_report_however_odd_ends_the_reader(
    unused_udp_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    odd = b'{"class":"TPV","mode":3,"epx":1,"epy":1,"lat":1' + b"0" * 400 + b',"lon":8}\n'
    assert [fix.why_absent for fix in GpsdReader().feed(odd, 0.0)] == ["no fix yet"]
    async with following(robots={"ada": f"udp://127.0.0.1:{unused_udp_port}"}) as (source, poses):
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with monkeypatch.context() as broken:
            broken.setattr(NmeaReader, "feed", lambda *_: 1 / 0)
            sender.sendto(b"x", ("127.0.0.1", unused_udp_port))
            await until(lambda: "division by zero" in source.absent.get("ada", ""))
        for k in range(100):
            sender.sendto(nmea(Seen(START_NS + k * 10**9, 3.0, 4.0), FRAME), ("127.0.0.1", unused_udp_port))
            await asyncio.sleep(0.05)
            if poses:
                break
        sender.close()
        assert poses


async def test_a_phone_may_send_nmea_over_udp(unused_udp_port: int) -> None:
    async with following(robots={"ada": f"udp://127.0.0.1:{unused_udp_port}"}) as (_, poses):
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            asyncio.DatagramProtocol, remote_addr=("127.0.0.1", unused_udp_port)
        )
        transport.sendto(nmea(Seen(START_NS, 3.0, 4.0), FRAME))
        await until(lambda: poses)
        transport.close()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, "expected a robot with its receiver"),
        ({"robots": {"ada": 3}}, "robots.ada: expected a port, got 3"),
        ({"robots": {"ada": "/dev/x", "bob": "/dev/x"}}, "/dev/x is given to two robots"),
        ({"robots": {"ada": "/dev/x"}, "max_speed_m_s": 0}, "max_speed_m_s: expected above 0"),
        ({"robots": {"ada": "/dev/x"}, "sigma": 0}, "unknown option 'sigma'"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError) as refused:
        open_gnss(options, context())
    assert says in str(refused.value)


async def test_no_receiver_is_an_error_that_says_what_to_try(unused_tcp_port: int) -> None:
    with pytest.raises(
        DeviceError, match=r"gpsd://127\.0\.0\.1:\d+: connection refused; is gpsd running there"
    ):
        async with following(robots={"ada": f"gpsd://127.0.0.1:{unused_tcp_port}"}):
            pass


@pytest.mark.parametrize(
    ("port", "says"),
    [
        ("udp://0.0.0.0:10110", "an address of this computer"),
        ("gpsd://pi", "has gpsd a receiver"),
        ("socket://pi:5000", "send NMEA?"),
        ("/dev/ttyACM0", "at 9600 baud? /dev/ttyACM0:4800"),
        ("/dev/ttyUSB0:38400", "at 38400 baud? /dev/ttyUSB0:4800"),
    ],
)
def test_what_to_look_at_where_nothing_comes_depends_on_whence_it_should(port: str, says: str) -> None:
    assert says in _remedy(port, 9600)


def test_the_emulated_gpsd_reports_as_the_manual_does() -> None:
    (fix,) = GpsdReader().feed(gpsd_report(Seen(START_NS, 3.0, 4.0, hdop=2.0), FRAME), 0.0)
    assert fix.sigma_m == pytest.approx(5.0)
    assert fix.time_s == pytest.approx(START_NS * 1e-9)
