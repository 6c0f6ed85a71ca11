"""What a vehicle would do by itself is judged by what its parameters mean, not by whether they are zero."""

import pytest

from drivers.mavlink import failsafes
from drivers.mavlink.modes import COPTER, PX4, ROVER
from fieldkit.ports import Demands

ROVER_GOOD = {
    "FS_GCS_ENABLE": 1.0, "FS_ACTION": 2.0, "FS_GCS_TIMEOUT": 5.0, "FS_TIMEOUT": 1.5, "FS_OPTIONS": 0.0,
    "FS_EKF_ACTION": 1.0, "FRAME_CLASS": 1.0, "FENCE_ENABLE": 1.0, "FENCE_TYPE": 6.0, "FENCE_ACTION": 2.0,
    "FENCE_MARGIN": 2.0, "BATT_FS_LOW_ACT": 2.0, "BATT_LOW_VOLT": 10.5, "BATT_LOW_MAH": 0.0, "WP_SPEED": 1.0,
    "RTL_SPEED": 0.0, "MAV_GCS_SYSID": 245.0,
}  # fmt: skip
COPTER_GOOD = {
    "FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 5.0, "FS_OPTIONS": 0.0, "FS_EKF_ACTION": 1.0, "FRAME_CLASS": 1.0,
    "FENCE_ENABLE": 1.0, "FENCE_TYPE": 7.0, "FENCE_ACTION": 1.0, "FENCE_MARGIN": 2.0, "BATT_FS_LOW_ACT": 1.0,
    "BATT_LOW_VOLT": 0.0, "BATT_LOW_MAH": 900.0, "WPNAV_SPEED": 100.0, "RTL_SPEED": 0.0, "RTL_ALT": 1500.0,
    "MAV_GCS_SYSID": 245.0,
}  # fmt: skip
PX4_GOOD = {
    "NAV_DLL_ACT": 1.0, "COM_DL_LOSS_T": 5.0, "NAV_RCL_ACT": 1.0, "GF_ACTION": 2.0, "COM_LOW_BAT_ACT": 2.0,
    "RTL_RETURN_ALT": 30.0, "MPC_XY_CRUISE": 1.0,
}  # fmt: skip
LIMIT = Demands(1.0)


def judged(firmware, values, demands=LIMIT):
    """Check to its worst level."""
    order = ("green", "amber", "red")
    found = {}
    for check in failsafes.judge("ada", firmware, values, 245, demands):
        assert check.level == "green" or check.remedy, check
        found[check.name] = max(found.get(check.name, "green"), check.level, key=order.index)
    return found


@pytest.mark.parametrize(("reckoned_m", "level"), [(None, None), (0.0, "amber"), (0.6, "amber"), (0.9, None)])
def test_a_car_that_turns_wider_than_the_mission_reckons_with(reckoned_m, level):
    demands = Demands(1.0, (), False, (), reckoned_m)
    assert judged(ROVER, ROVER_GOOD | {"TURN_RADIUS": 0.9}, demands).get("turning") == level
    assert "turning" not in judged(ROVER, ROVER_GOOD | {"TURN_RADIUS": 0.0}, demands), "it turns on the spot"
    assert "turning" not in judged(COPTER, COPTER_GOOD, demands)


@pytest.mark.parametrize(("firmware", "good"), [(ROVER, ROVER_GOOD), (COPTER, COPTER_GOOD), (PX4, PX4_GOOD)])
def test_a_vehicle_that_would_stop_by_itself_is_green_all_over(firmware, good):
    assert set(judged(firmware, good).values()) == {"green"}
    assert set(judged(firmware, good)) == {"failsafe", "battery failsafe", "fence action", "speed"}


@pytest.mark.parametrize(
    ("change", "check", "level"),
    [
        ({"FS_GCS_ENABLE": 0.0}, "failsafe", "red"),
        ({"FS_GCS_ENABLE": None}, "failsafe", "red"),
        ({"FS_ACTION": 0.0}, "failsafe", "red"),
        ({"FS_ACTION": None}, "failsafe", "red"),
        ({"FS_ACTION": 1.0}, "failsafe", "amber"),
        ({"FS_ACTION": 4.0}, "failsafe", "amber"),
        ({"FS_TIMEOUT": 60.0}, "failsafe", "red"),
        ({"FS_GCS_TIMEOUT": 12.0}, "failsafe", "amber"),
        ({"FS_EKF_ACTION": 0.0}, "failsafe", "amber"),
        ({"FRAME_CLASS": 2.0}, "failsafe", "amber"),
        ({"MAV_GCS_SYSID": 255.0}, "failsafe", "red"),
        ({"BATT_FS_LOW_ACT": 0.0}, "battery failsafe", "amber"),
        ({"BATT_LOW_VOLT": 0.0}, "battery failsafe", "amber"),
        ({"BATT_FS_LOW_ACT": 5.0}, "battery failsafe", "amber"),
        ({"BATT_FS_CRT_ACT": 5.0}, "battery failsafe", "amber"),
        ({"BATT_CRT_VOLT": 11.0}, "battery failsafe", "red"),
        ({"BATT_CRT_VOLT": 10.0}, "battery failsafe", "green"),
        ({"FENCE_ACTION": 0.0}, "fence action", "amber"),
        ({"FENCE_TYPE": 0.0}, "fence action", "amber"),
        ({"FENCE_ENABLE": 0.0}, "fence action", "amber"),
        ({"WP_SPEED": 5.0}, "speed", "amber"),
        ({"RTL_SPEED": 4.1}, "speed", "amber"),
    ],
)
def test_what_keeps_a_rover_going_when_we_are_dead_is_found(change, check, level):
    assert judged(ROVER, ROVER_GOOD | change)[check] == level


@pytest.mark.parametrize(
    ("change", "check", "level"),
    [
        ({"FS_GCS_ENABLE": 0.0}, "failsafe", "red"),
        ({"FS_GCS_ENABLE": 1.0}, "failsafe", "amber"),
        ({"FS_OPTIONS": 16.0}, "failsafe", "amber"),
        ({"FRAME_CLASS": 0.0}, "failsafe", "red"),
        ({"BATT_LOW_MAH": 0.0}, "battery failsafe", "amber"),
        ({"WPNAV_SPEED": 1000.0}, "speed", "amber"),
    ],
)
def test_what_keeps_a_copter_in_the_air_when_we_are_dead_is_found(change, check, level):
    assert judged(COPTER, COPTER_GOOD | change)[check] == level


@pytest.mark.parametrize(
    ("change", "check", "level"),
    [
        ({"NAV_DLL_ACT": 0.0}, "failsafe", "red"),
        ({"NAV_DLL_ACT": None}, "failsafe", "red"),
        ({"NAV_DLL_ACT": 2.0}, "failsafe", "amber"),
        ({"COM_DL_LOSS_T": 60.0}, "failsafe", "red"),
        ({"NAV_RCL_ACT": 0.0}, "failsafe", "amber"),
        ({"GF_ACTION": 1.0}, "fence action", "amber"),
        ({"COM_LOW_BAT_ACT": 0.0}, "battery failsafe", "amber"),
    ],
)
def test_px4_is_judged_by_its_own_parameters(change, check, level):
    assert judged(PX4, PX4_GOOD | change)[check] == level


def test_a_fence_that_the_mission_relies_on_has_to_act():
    relied = Demands(1.0, ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0)), True)
    for change in ({"FENCE_ACTION": 0.0}, {"FENCE_TYPE": 0.0}):
        assert judged(ROVER, ROVER_GOOD | change, relied)["fence action"] == "red"


def test_a_return_at_a_speed_of_its_own_is_named():
    (check,) = [
        check
        for check in failsafes.judge(
            "ada", ROVER, ROVER_GOOD | {"WP_SPEED": 5.0, "RTL_SPEED": 4.1}, 245, LIMIT
        )
        if check.name == "speed"
    ]
    assert "WP_SPEED 5" in check.found and "RTL_SPEED 4.1" in check.found and "1" in check.remedy


def test_a_range_of_ground_stations_and_the_older_parameters_name_are_understood():
    ranged = ROVER_GOOD | {"MAV_GCS_SYSID": 240.0, "MAV_GCS_SYSID_HI": 250.0}
    assert judged(ROVER, ranged)["failsafe"] == "green"
    old = ROVER_GOOD | {"MAV_GCS_SYSID": None, "SYSID_MYGCS": 255.0}
    assert judged(ROVER, old)["failsafe"] == "red"


def test_everything_that_is_judged_is_read():
    for firmware, good in ((ROVER, ROVER_GOOD), (COPTER, COPTER_GOOD), (PX4, PX4_GOOD)):
        assert set(good) <= set(failsafes.NAMES[firmware])
