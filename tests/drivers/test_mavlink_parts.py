"""The MAVLink driver's pure parts: codec, modes, time, and one vehicle's state."""

import math
import os
from collections.abc import Callable
from itertools import count

import numpy as np
import pytest
from benches import FRAME
from hypothesis import given
from hypothesis import strategies as st

from drivers.mavlink.codec import Packer, Parser, mavlink
from drivers.mavlink.modes import COPTER, PX4, ROVER, firmware_of, set_mode
from drivers.mavlink.vehicle import Vehicle
from drivers.timebase import TimeBase
from fieldkit.messages import Pose, VehicleState

PEER = ("127.0.0.1", 5000)


def heartbeat(
    mode=4, autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, kind=mavlink.MAV_TYPE_GROUND_ROVER, base=1
):
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, base, mode, 4, 3)


def position(boot_ms, lat=473977000, lon=85456000, hdg=9000):
    return mavlink.MAVLink_global_position_int_message(boot_ms, lat, lon, 0, 1500, 0, 0, 0, hdg)


def test_frames_are_mavlink_2():
    assert Packer(245, 190).pack(heartbeat())[0] == 0xFD


def test_the_codec_leaves_the_process_alone():
    """mavutil would set the protocol version for everybody in an environment variable."""
    Parser().parse(Packer(1, 1).pack(heartbeat()))
    assert "MAVLINK20" not in os.environ


@given(st.binary(max_size=80), st.integers(0, 20), st.integers(0, 7))
def test_damage_is_skipped_and_the_next_frames_are_read(garbage, index, bit):
    packer, parser = Packer(1, 1), Parser()
    damaged = bytearray(packer.pack(heartbeat()))
    damaged[index % len(damaged)] ^= 1 << bit
    parser.parse(garbage + bytes(damaged))
    # A false start swallows at most one whole frame length, 280 bytes.
    for _ in range(20):
        parser.parse(packer.pack(heartbeat()))
    assert [m.get_type() for m in parser.parse(packer.pack(heartbeat()))] == ["HEARTBEAT"]


@given(st.lists(st.binary(max_size=300), max_size=10))
def test_no_bytes_break_the_codec(chunks):
    parser = Parser()
    for chunk in chunks:
        parser.parse(chunk)
        parser.parse(b"\xfd" + chunk)


def test_mode_4_is_hold_on_a_rover_and_guided_on_a_copter():
    assert (ROVER.meaning(4), COPTER.meaning(4)) == ("hold", "guided")
    assert (ROVER.number("guided"), ROVER.number("return")) == (15, 11)
    assert (COPTER.number("hold"), COPTER.number("return")) == (17, 6)


@pytest.mark.parametrize("firmware", [ROVER, COPTER, PX4])
@given(mode=st.integers(0, 2**32 - 1))
def test_an_unknown_mode_gives_no_authority(firmware, mode):
    if mode not in (*firmware.guided, *firmware.hold, *firmware.home, *firmware.land):
        assert firmware.meaning(mode) == "other"


def test_px4_takes_its_mode_in_two_numbers():
    message = set_mode(1, PX4, "return", 0)
    assert (message.param2, message.param3) == (4, 5)


def test_firmware_is_known_by_its_heartbeat():
    assert firmware_of(heartbeat()) is ROVER
    assert firmware_of(heartbeat(kind=mavlink.MAV_TYPE_QUADROTOR)) is COPTER
    assert firmware_of(heartbeat(autopilot=mavlink.MAV_AUTOPILOT_PX4)) is PX4
    assert firmware_of(heartbeat(kind=mavlink.MAV_TYPE_FIXED_WING)) is None


def test_positions_are_stamped_by_the_boot_clock_and_not_by_arrival():
    """Delays of 2 ms and an exponential 30 ms: the stamps are off by the shortest delay only."""
    rng = np.random.default_rng(1)
    base, offset_ns = TimeBase(), 1_700_000_000_000_000_000
    errors_ms = []
    for number in range(300):
        boot_ns = number * 200_000_000
        delay_ns = 2_000_000 + int(rng.exponential(30e6))
        errors_ms.append((base.heard(boot_ns, offset_ns + boot_ns + delay_ns) - offset_ns - boot_ns) * 1e-6)
    assert max(errors_ms[50:]) < 4.0 and min(errors_ms) >= 2.0


def test_the_time_base_follows_a_drifting_crystal():
    base, drift = TimeBase(), 200e-6
    for number in range(5000):
        true_ns = number * 200_000_000
        error_ns = base.heard(int(true_ns * (1 - drift)), true_ns + 1_000_000) - true_ns
    assert abs(error_ns) < 15e6  # a minute of 200 ppm, not a quarter of an hour of it


def test_poses_stay_in_order_when_the_clock_estimate_improves():
    vehicle = Vehicle("ada", 1, FRAME)
    vehicle.heard(heartbeat(), PEER, 0.0, 0)
    late = vehicle.heard(position(1000), PEER, 0.0, 900_000_000)
    early = vehicle.heard(position(1200), PEER, 0.2, 300_000_000)
    stamps = [item.t_ns for item in (*late, *early) if isinstance(item, Pose)]
    assert stamps == sorted(stamps) and len(stamps) == 2


GUIDED, HOLD = 15, 4  # ArduRover's custom modes


def ours() -> tuple[Vehicle, Callable[[int], str]]:
    """A rover in Guided that is ours; what it is after a heartbeat in a mode."""
    vehicle, beats = Vehicle("ada", 1, FRAME), count()

    def beat(mode: int) -> str:
        now_s = float(next(beats))
        vehicle.heard(
            heartbeat(mode, base=1 | mavlink.MAV_MODE_FLAG_SAFETY_ARMED), ("h", 1), now_s, round(now_s * 1e9)
        )
        return vehicle.owner

    beat(GUIDED)
    vehicle.owner = "us"
    vehicle.command("guided")
    assert beat(GUIDED) == "us"
    return vehicle, beat


def test_a_hold_that_a_newer_order_has_overtaken_is_no_strangers() -> None:
    """Ordered to hold and to go on at once, it shows first neither, then the hold, and at last where it is to go."""
    vehicle, beat = ours()
    vehicle.command("hold")
    vehicle.command("guided")
    assert [beat(mode) for mode in (GUIDED, HOLD, HOLD, GUIDED, GUIDED)] == ["us"] * 5
    assert beat(HOLD) == "lost", "by now it is somebody else's"


def test_one_that_stays_in_a_hold_that_was_overtaken_is_not_ours_for_ever() -> None:
    vehicle, beat = ours()
    vehicle.command("hold")
    vehicle.command("guided")
    assert [beat(mode) for mode in (GUIDED, HOLD, HOLD)] == ["us"] * 3
    assert beat(HOLD) == "lost"


def test_a_hold_that_was_seen_before_the_next_order_is_a_strangers_when_it_comes_again() -> None:
    vehicle, beat = ours()
    vehicle.command("hold")
    assert beat(HOLD) == "us"
    vehicle.command("guided")
    assert [beat(GUIDED), beat(HOLD)] == ["us", "lost"]


def test_a_position_before_the_first_fix_is_none():
    vehicle = Vehicle("ada", 1, FRAME)
    vehicle.heard(heartbeat(), PEER, 0.0, 0)
    assert not [x for x in vehicle.heard(position(0, 0, 0), PEER, 0.1, 10**8) if isinstance(x, Pose)]


def test_an_unknown_heading_keeps_the_last_one():
    vehicle = Vehicle("ada", 1, FRAME)
    vehicle.heard(heartbeat(), PEER, 0.0, 0)
    vehicle.heard(position(0), PEER, 0.1, 10**8)
    (pose,) = [
        x for x in vehicle.heard(position(200, hdg=65535), PEER, 0.3, 3 * 10**8) if isinstance(x, Pose)
    ]
    assert pose.heading_deg == 90.0 and pose.up_m == 0.0


def test_state_comes_on_change_and_once_a_second():
    vehicle = Vehicle("ada", 1, FRAME)
    states = []
    for tenth in range(50):
        heard = vehicle.heard(heartbeat(), PEER, tenth / 10, tenth) if tenth % 10 == 0 else []
        heard += vehicle.passed(tenth / 10, tenth)
        states += [item for item in heard if isinstance(item, VehicleState)]
    assert len(states) == 5
    changed = vehicle.heard(heartbeat(mode=0), PEER, 5.0, 50)
    assert [state.mode for state in changed] == ["other"]


def test_long_texts_are_put_together_again():
    vehicle = Vehicle("ada", 1, FRAME)
    vehicle.heard(heartbeat(), PEER, 0.0, 0)
    for number, part in enumerate(["x" * 50, "y" * 50, "end"]):
        heard = vehicle.heard(mavlink.MAVLink_statustext_message(4, part.encode(), 7, number), PEER, 0.1, 1)
    assert heard[-1].text == "x" * 50 + "y" * 50 + "end"


def test_forged_addresses_do_not_fill_the_memory():
    vehicle = Vehicle("ada", 1, FRAME)
    for number in range(1000):
        vehicle.heard(heartbeat(), ("10.0.0.1", number), number / 100, number)
    assert len(vehicle._speakers) <= 8


def test_messages_from_elsewhere_do_not_move_a_vehicle():
    vehicle = Vehicle("ada", 1, FRAME)
    vehicle.heard(heartbeat(), PEER, 0.0, 0)
    assert vehicle.heard(position(0), ("10.6.6.6", 1), 0.1, 1) == []


def test_battery_unknown_is_none():
    vehicle = Vehicle("ada", 1, FRAME)
    vehicle.heard(heartbeat(), PEER, 0.0, 0)
    for left, said in ((-1, None), (37, 37.0)):
        status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, left, 0, 0, 0, 0, 0, 0)
        vehicle.heard(status, PEER, 0.1, 1)
        assert vehicle.battery_pct == said
    assert math.isfinite(vehicle.heartbeat_s)
