"""The emulated rover against what was measured on ArduRover 4.7 in simulation."""

import numpy as np
import pytest
from benches import FRAME

from drivers.emulators.rover import GUIDED, HOLD, POSITION_ONLY, RTL, RoverAutopilot
from drivers.mavlink.codec import Packer, Parser, mavlink
from fieldkit.world.bodies import Car, car_for, car_sized

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4


class Bench:
    def __init__(self, **options):
        body = options.pop("body", None) or Car(0.0, 0.0, max_speed_m_s=1.0)
        self.rover = RoverAutopilot(1, body, FRAME, np.random.default_rng(1), **options)
        self.packer, self.parser, self.t_s = Packer(245, 190), Parser(), 0.0

    def tell(self, message):
        return self.parser.parse(self.rover.receive(self.packer.pack(message), self.t_s))

    def run(self, duration_s):
        heard = []
        for _ in range(int(duration_s * 10)):
            self.t_s += 0.1
            heard += self.parser.parse(self.rover.update(self.t_s))
        return heard

    def ask(self, command, *params, target=1):
        params = [*params, *([0] * (7 - len(params)))]
        heard = self.tell(mavlink.MAVLink_command_long_message(target, 1, command, 0, *params))
        return next(m.result for m in heard if m.get_type() == "COMMAND_ACK")

    def reposition(self, east_m, north_m, flags=1, xy=None, speed=-1.0):
        lat, lon, _ = FRAME.to_geodetic(east_m, north_m)
        x, y = xy or (round(lat * 1e7), round(lon * 1e7))
        message = mavlink.MAVLink_command_int_message(
            1, 1, 6, 192, 0, 0, speed, flags, 0, float("nan"), x, y, 0
        )
        return next(m.result for m in self.tell(message) if m.get_type() == "COMMAND_ACK")

    def target(self, lat, lon, mask=POSITION_ONLY):
        numbers = [0.0] * 9
        return self.tell(
            mavlink.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, mask, lat, lon, *numbers)
        )

    def guided(self):
        self.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        assert self.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED) == ACCEPTED
        return self


def at(bench):
    return bench.rover.body.east_m, bench.rover.body.north_m


def test_drives_to_a_reposition_and_echoes_it():
    bench = Bench().guided()
    bench.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 87, 1e6)
    assert bench.reposition(2.0, 3.0) == ACCEPTED
    heard = bench.run(20.0)
    assert at(bench) == pytest.approx((2.0, 3.0), abs=0.2)
    echo = [m for m in heard if m.get_type() == "POSITION_TARGET_GLOBAL_INT"][-1]
    lat, lon, _ = FRAME.to_geodetic(2.0, 3.0)
    assert (echo.lat_int, echo.lon_int) == (round(lat * 1e7), round(lon * 1e7))
    assert (echo.coordinate_frame, echo.type_mask) == (0, 0xFDF8)


def test_reposition_outside_guided_needs_the_flag():
    bench = Bench()
    bench.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert bench.reposition(2.0, 3.0, flags=0) == DENIED
    assert bench.reposition(2.0, 3.0, flags=1) == ACCEPTED
    assert bench.rover.mode == GUIDED


def test_reposition_to_0_0_is_denied_and_as_command_long_unsupported():
    bench = Bench().guided()
    assert bench.reposition(0, 0, xy=(0, 0)) == DENIED
    assert bench.ask(mavlink.MAV_CMD_DO_REPOSITION, -1, 1, 0, 0, 47.0, 8.0) == UNSUPPORTED


def test_a_position_target_outside_guided_is_dropped_without_a_word():
    bench = Bench()
    bench.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert bench.target(473978000, 85457000) == []
    bench.run(5.0)
    assert at(bench) == (0.0, 0.0)


def test_a_position_target_of_0_0_is_taken():
    bench = Bench().guided()
    bench.target(0, 0)
    bench.run(3.0)
    assert at(bench) != (0.0, 0.0)


def test_a_position_target_with_acceleration_is_refused_in_chunked_text():
    heard = Bench().guided().target(473978000, 85457000, mask=0)
    assert "".join(m.text for m in heard) == "Ignoring SET_POSITION_TARGET_GLOBAL_INT; set ACC_IGNORE in mask"


def test_an_unknown_mode_fails_and_auto_without_mission_says_why():
    bench = Bench()
    assert bench.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, 99) == FAILED
    heard = bench.tell(mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 10, 0, 0, 0, 0, 0))
    assert [m.text for m in heard if m.get_type() == "STATUSTEXT"] == ["No Mission. Can't set AUTO."]


def test_pause_is_unsupported_on_a_rover():
    assert Bench().ask(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0) == UNSUPPORTED


def test_arming_without_gps_fails_in_words():
    bench = Bench()
    bench.rover.lose_gps(True)
    heard = bench.tell(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    assert [m.text for m in heard if m.get_type() == "STATUSTEXT"] == ["Arm: GPS 1: Bad fix"]
    assert not bench.rover.armed


def test_losing_gps_holds_while_positions_go_on():
    bench = Bench().guided()
    bench.reposition(5.0, 5.0)
    bench.rover.lose_gps(True)
    heard = bench.run(2.0)
    assert bench.rover.mode == HOLD
    assert len([m for m in heard if m.get_type() == "GLOBAL_POSITION_INT"]) >= 7


def test_hold_outlasts_the_failsafe_that_caused_it():
    bench = Bench(gcs_failsafe_s=3.0).guided()
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
    bench.tell(beat)
    bench.run(5.0)
    assert bench.rover.mode == HOLD
    bench.tell(beat)
    texts = [m.text for m in bench.run(1.0) if m.get_type() == "STATUSTEXT"]
    assert texts == ["GCS Failsafe Cleared"] and bench.rover.mode == HOLD


def test_the_failsafe_needs_a_first_heartbeat():
    bench = Bench(gcs_failsafe_s=3.0).guided()
    bench.run(10.0)
    assert bench.rover.mode == GUIDED


def test_a_broadcast_is_obeyed():
    bench = Bench()
    assert bench.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, target=0) == ACCEPTED
    assert bench.rover.armed


def test_another_systems_commands_are_not():
    bench = Bench()
    assert bench.tell(mavlink.MAVLink_command_long_message(2, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)) == []


def test_return_drives_home():
    bench = Bench().guided()
    bench.reposition(3.0, 0.0)
    bench.run(8.0)
    assert bench.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, RTL) == ACCEPTED
    bench.run(20.0)
    assert at(bench) == pytest.approx((0.0, 0.0), abs=0.6)


def test_positions_come_at_the_rate_asked_for():
    bench = Bench()
    bench.run(1.0)
    bench.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 33, 1e6 / 5)
    heard = bench.run(10.0)
    assert 48 <= len([m for m in heard if m.get_type() == "GLOBAL_POSITION_INT"]) <= 51
    assert 9 <= len([m for m in heard if m.get_type() == "HEARTBEAT"]) <= 11


def test_noise_is_in_what_is_reported_only():
    bench = Bench(pose_noise_m=0.5)
    lats = [m.lat for m in bench.run(20.0) if m.get_type() == "GLOBAL_POSITION_INT"]
    assert np.std(lats) * 1e-7 * 111_000 == pytest.approx(0.5, rel=0.4)
    assert at(bench) == (0.0, 0.0)


# What the kind emulator did not do


def goes_for(bench, seconds, condition):
    for _ in range(int(seconds * 10)):
        bench.run(0.1)
        if condition():
            return bench.t_s
    raise AssertionError("did not happen")


def test_a_speed_in_the_stop_submode_fails_and_the_place_is_not_taken():
    bench = Bench().guided()
    assert bench.reposition(5.0, 5.0, speed=1.0) == FAILED
    assert bench.ask(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 0.5) == FAILED
    bench.run(5.0)
    assert at(bench) == (0.0, 0.0)
    assert bench.reposition(5.0, 5.0) == ACCEPTED
    assert bench.ask(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 0.5) == ACCEPTED
    assert bench.reposition(6.0, 5.0, speed=0.7) == ACCEPTED


def test_a_car_turns_wide_and_rests_short_of_its_way_point():
    bench = Bench(body=car_sized(0.0, 0.0)).guided()
    bench.reposition(0.0, -20.0)
    widest = 0.0
    for _ in range(400):
        bench.run(0.1)
        widest = max(widest, abs(at(bench)[0]))
    assert widest > 2.0, "behind it: it has to drive round"
    assert bench.rover.body.speed_m_s == 0.0
    assert 0.1 < np.hypot(at(bench)[0], at(bench)[1] + 20.0) < 1.5


def test_a_way_point_inside_its_turning_circle_may_end_further_away_than_it_began():
    bench = Bench(body=car_sized(0.0, 0.0)).guided()
    bench.reposition(1.5, -0.5)
    bench.run(30.0)
    assert np.hypot(at(bench)[0] - 1.5, at(bench)[1] + 0.5) > 1.0
    assert bench.rover.body.speed_m_s == 0.0


def test_a_rover_is_as_large_as_its_speed_tells():
    small, large = car_for(0.0, 0.0, 0.0, 0.4), car_for(0.0, 0.0, 0.0, 1.5)
    for number in ("turn_radius_m", "rest_m", "coast_s"):
        assert getattr(small, number) < getattr(large, number) <= getattr(car_sized(0.0, 0.0), number)


def test_told_to_hold_it_rolls_on():
    bench = Bench(body=car_sized(0.0, 0.0)).guided()
    bench.reposition(0.0, 60.0)
    bench.ask(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 1.0)
    bench.run(10.0)
    began_s, there = bench.t_s, at(bench)
    assert bench.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, HOLD) == ACCEPTED
    stood_s = goes_for(bench, 20.0, lambda: bench.rover.body.speed_m_s == 0.0)
    assert 3.0 < stood_s - began_s < 7.0
    assert 0.8 < at(bench)[1] - there[1] < 1.6


def test_a_rover_returns_at_a_speed_of_its_own():
    """RTL_SPEED, or WP_SPEED where that is 0: never what the mission drove at."""
    for own, expected in (({}, 6.0), ({"WP_SPEED": 3.0}, 3.0), ({"RTL_SPEED": 2.0}, 2.0)):
        bench = Bench(body=car_sized(0.0, 0.0)).guided()
        bench.rover.parameters |= own
        bench.reposition(0.0, 60.0)
        bench.ask(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 1.0)
        bench.run(70.0)
        bench.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, RTL)
        fastest = 0.0
        for _ in range(300):
            bench.run(0.1)
            fastest = max(fastest, bench.rover.body.speed_m_s)
        assert fastest == pytest.approx(expected, abs=0.6)


def test_why_it_would_not_arm_is_said_every_30_s_or_when_asked():
    bench = Bench()
    bench.rover.trouble.prearm = "Compass not calibrated"
    said = [m.text for m in bench.run(65.0) if m.get_type() == "STATUSTEXT"]
    assert said == ["PreArm: Compass not calibrated"] * 3
    heard = bench.tell(mavlink.MAVLink_command_long_message(1, 1, 401, 0, 0, 0, 0, 0, 0, 0, 0))
    assert [m.text for m in heard if m.get_type() == "STATUSTEXT"] == ["PreArm: Compass not calibrated"]
    assert [m.result for m in heard if m.get_type() == "COMMAND_ACK"] == [ACCEPTED]


def test_it_does_not_arm_with_a_fence_enabled_and_none_loaded():
    bench = Bench()
    bench.rover.parameters["FENCE_ENABLE"] = 1.0
    assert bench.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == FAILED
    bench.rover.parameters["FENCE_ENABLE"] = 0.0
    assert bench.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED


def test_its_status_bits_say_that_it_is_well():
    """A ground station takes a missing bit for a breach of the fence, or for arming checks switched off."""
    bench = Bench()
    status = [m for m in bench.run(2.0) if m.get_type() == "SYS_STATUS"][-1]
    for bit in (
        mavlink.MAV_SYS_STATUS_PREARM_CHECK,
        mavlink.MAV_SYS_STATUS_GEOFENCE,
        mavlink.MAV_SYS_STATUS_AHRS,
    ):
        assert status.onboard_control_sensors_present & bit
        assert status.onboard_control_sensors_health & bit
    assert status.voltage_battery == 12_600
    bench.rover.battery_pct = 50.0
    status = [m for m in bench.run(2.0) if m.get_type() == "SYS_STATUS"][-1]
    assert 10_500 < status.voltage_battery < 12_600


def test_a_sinking_voltage_is_nothing_to_it_without_a_limit():
    for limit_v, mode in ((0.0, GUIDED), (10.5, HOLD)):
        bench = Bench().guided()
        bench.rover.parameters |= {"BATT_LOW_VOLT": limit_v, "BATT_FS_LOW_ACT": 2.0}
        bench.rover.trouble.battery_v, bench.rover.battery_pct = 9.0, 98.0
        bench.run(15.0)
        assert bench.rover.mode == mode


@pytest.mark.parametrize(("action", "mode"), [(0.0, GUIDED), (1.0, RTL), (2.0, HOLD)])
def test_what_it_does_when_we_fall_silent_is_its_parameters_choice(action, mode):
    bench = Bench(gcs_failsafe_s=3.0).guided()
    bench.rover.parameters["FS_ACTION"] = action
    bench.tell(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
    bench.run(5.0)
    assert bench.rover.mode == mode


def test_another_stations_heartbeat_does_not_keep_it_going():
    bench = Bench(gcs_failsafe_s=3.0).guided()
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
    bench.tell(beat)
    other = Packer(200, 190)
    for _ in range(5):
        bench.rover.receive(other.pack(beat), bench.t_s)
        bench.run(1.0)
    assert bench.rover.mode == HOLD
