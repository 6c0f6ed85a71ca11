"""MAVLink 2 signing: pymavlink as the independent reader, and everything a forger may try."""

import os
import random
from pathlib import Path

import pytest
from benches import around, free_udp_port, rovers_on_udp, until

from drivers.mavlink.codec import Packer, Parser, mavlink
from drivers.mavlink.fleet import open_link
from drivers.mavlink.inspect import signing
from drivers.mavlink.signing import EPOCH_NS, SAVE_EVERY, UNIT_NS, Signer, read_key
from drivers.mavlink.wire import checksum
from fieldkit.clock import ScaledClock
from fieldkit.errors import ConfigError, DeviceTimeout
from fieldkit.messages import Pose

KEY, OTHER = bytes(range(32)), bytes(32)
NOW_NS = 1_800_000_000 * 10**9


def clock(offset_s: float = 0.0):
    """A clock that ticks a microsecond at every look."""
    ticks = iter(range(10**9))
    return lambda: NOW_NS + int(offset_s * 1e9) + next(ticks) * 20_000


def beat(mode=0):
    return mavlink.MAVLink_heartbeat_message(10, 3, 0, mode, 4, 3)


def pair(key=KEY, offset_s=0.0):
    return Packer(1, 1, Signer(key, clock(offset_s), link_id=5)), Parser(Signer(KEY, clock(), link_id=9))


def peer_of_pymavlink():
    mav = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    mav.signing.secret_key = KEY
    mav.signing.sign_outgoing = True
    mav.signing.link_id = 3
    mav.signing.timestamp = (NOW_NS - EPOCH_NS) // UNIT_NS
    return mav


def test_checksum_is_mavlinks():
    # CRC-16/MCRF4XX gives 6F91 for "123456789"; the start mark is left out, the extra byte comes last.
    assert checksum(b"\xfd12345678", ord("9")) == bytes.fromhex("916F")


def test_pymavlink_accepts_what_we_sign():
    packer, _ = pair()
    (message,) = peer_of_pymavlink().parse_buffer(bytearray(packer.pack(beat(4))))
    assert message.get_type() == "HEARTBEAT" and message.get_signed() and message.custom_mode == 4


def test_we_accept_what_pymavlink_signs():
    _, parser = pair()
    (message,) = parser.parse(beat(15).pack(peer_of_pymavlink()))
    assert message.custom_mode == 15 and message.get_srcSystem() == 7


def test_none_of_ten_thousand_forged_altered_and_replayed_frames_is_accepted():
    rng = random.Random(1)
    packer, parser = pair()
    forger, _ = pair(OTHER, offset_s=1e7)
    accepted, seen = 0, []
    for number in range(10_000):
        genuine = packer.pack(beat(number % 16))
        kind = number % 4
        if kind == 0:
            bad = forger.pack(beat())
        elif kind == 1:
            at = rng.randrange(1, len(genuine))
            bad = genuine[:at] + bytes([genuine[at] ^ 1 << rng.randrange(8)]) + genuine[at + 1 :]
        elif kind == 2:
            bad = rng.choice(seen) if seen else b""
        else:
            bad = Packer(1, 1).pack(beat())
        assert Parser(parser._signer).parse(bad) == [], (number, kind)
        seen.append(genuine)
        accepted += len(parser.parse(genuine))
    assert accepted == 10_000


def test_a_forged_frame_from_the_future_does_not_lock_the_genuine_sender_out():
    packer, parser = pair()
    forger, _ = pair(OTHER, offset_s=1e8)
    assert len(parser.parse(packer.pack(beat()))) == 1
    assert parser.parse(forger.pack(beat())) == []
    assert len(parser.parse(packer.pack(beat()))) == 1


def test_forged_streams_fill_no_memory():
    _, parser = pair()
    for system_id in range(1, 250):
        parser.parse(Packer(system_id, 1, Signer(OTHER, clock())).pack(beat()))
    assert parser._signer._streams == {}


def test_a_new_stream_a_minute_behind_is_refused():
    late, parser = pair(offset_s=-61.0)
    assert parser.parse(late.pack(beat())) == []
    fair, parser = pair(offset_s=-59.0)
    assert len(parser.parse(fair.pack(beat()))) == 1


def test_only_radio_status_is_taken_unsigned():
    _, parser = pair()
    radio = mavlink.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
    assert [m.get_type() for m in parser.parse(Packer(51, 68).pack(radio))] == ["RADIO_STATUS"]
    assert parser.parse(Packer(1, 1).pack(beat())) == []


def test_time_never_goes_back_over_a_restart(tmp_path):
    store = tmp_path / "link.time"
    first = Signer(KEY, clock(), store=store)
    Packer(1, 1, first).pack(beat())
    first.close()
    second = Signer(KEY, clock(offset_s=-3600.0), store=store)
    assert second._time >= first._time
    assert second._time <= first._time + SAVE_EVERY


def test_key_files(tmp_path: Path):
    path = tmp_path / "key"
    for content, key in ((KEY, KEY), (KEY.hex().encode() + b"\n", KEY)):
        path.write_bytes(content)
        path.chmod(0o600)
        assert read_key(path) == key
    path.write_text("a passphrase\n")
    assert len(read_key(path)) == 32


@pytest.mark.skipif(os.name != "posix", reason="file modes")
def test_a_key_that_others_may_read_is_refused(tmp_path: Path):
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(0o640)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_key(path)


def test_a_missing_or_empty_key_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match="gone"):
        read_key(tmp_path / "gone")
    (tmp_path / "empty").touch(0o600)
    with pytest.raises(ConfigError, match="is empty"):
        read_key(tmp_path / "empty")


@pytest.mark.parametrize("key", [KEY, OTHER], ids=["right key", "wrong key"])
async def test_a_signed_link_hears_and_steers_only_with_the_right_key(tmp_path, key, caplog):
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    time, port = ScaledClock(10.0), free_udp_port()
    signer = Signer(key, time.now_ns, link_id=200)
    robots = {"ada": {"system_id": 1, "signing_key": str(path)}}
    async with (
        rovers_on_udp({1: (0.0, 0.0)}, time, port, signer=signer) as rovers,
        open_link(f"udpin:127.0.0.1:{port}", robots, around(time)) as link,
    ):
        if key == KEY:
            await link.acquire_control("ada")
            assert rovers[0].autopilot.armed
            assert isinstance(await anext(p async for p in link.events() if isinstance(p, Pose)), Pose)
        else:
            with pytest.raises(DeviceTimeout, match="no heartbeat"):
                await link.acquire_control("ada")
            await until(lambda: link._signer.refused > 0)
            await until(lambda: "not signed with this link's key" in caplog.text)


@pytest.mark.parametrize("strict", [True, False], ids=["signed alone", "unsigned too"])
async def test_must_find_out_whether_the_vehicle_obeys_unsigned_frames(tmp_path, strict):
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    time, port = ScaledClock(20.0), free_udp_port()
    signer = Signer(KEY, time.now_ns, link_id=200)
    robots = {"ada": {"system_id": 1, "signing_key": str(path)}}
    async with (
        rovers_on_udp({1: (0.0, 0.0)}, time, port, signer=signer) as rovers,
        open_link(f"udpin:127.0.0.1:{port}", robots, around(time)) as link,
    ):
        if not strict:
            rovers[0].autopilot._parser = Parser()  # as ArduPilot's USB port
        (check,) = [check for check in await link.inspect("ada") if check.name == "signing"]
        assert check.level == ("green" if strict else "amber")
        assert strict or ("unsigned" in check.found and "USB" in check.remedy)


def test_a_vehicle_that_answers_nothing_does_not_pass_for_strict():
    assert signing("ada", None, None).level == "amber"
